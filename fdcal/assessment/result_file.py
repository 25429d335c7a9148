"""A calibration as text: the JSON of a result file, CSV of positions and of gains; and as a table of pandas.

`Keys` declares every key with its type and its shape; what a solver does not find has no key. Keys that are not
declared are ignored. A file carries its version, and another one is refused.
"""

import csv
import io
import json
import re
import sys
from collections.abc import Iterable
from dataclasses import asdict, fields
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict, get_type_hints

import msgspec
import numpy as np
from msgspec import structs

from ..model.libraries import needs
from ..model.measurement import Measurement
from ..model.storage import parse_json, read_bytes, write_atomically
from ..model.validation import LIMITS, InputError, shown
from .calibration import CHANNEL_NUMBERS, Calibration, ChannelFault, Channels, Evidence, GivenPosition, KnownRoom
from .position_check import PositionCheck

LARGEST = sys.float_info.max

Number = Annotated[float, msgspec.Meta(ge=-LARGEST, le=LARGEST)]  # neither NaN nor infinite
Vector = Annotated[list[Number], msgspec.Meta(min_length=1)]
Matrix = Annotated[list[Vector], msgspec.Meta(min_length=1)]
Place = Annotated[list[Number], msgspec.Meta(min_length=2, max_length=3)]
Positions = Annotated[list[Place], msgspec.Meta(min_length=1)]
# Shapes stand last in an annotation: N microphones, D coordinates.
OfEachMicrophone = Annotated[Vector, "N"]
OfEachAxis = Annotated[Vector, "D"]


class Symmetry(msgspec.Struct):
    """An array that the pressures cannot distinguish from the one found."""

    map: str
    positions: Positions


class FaultRow(msgspec.Struct, forbid_unknown_fields=True):
    """A `ChannelFault`, of which every key must be there."""

    name: str
    kind: str
    value: Number | None
    unit: Literal["", "dB", "degrees", "s", "Hz", "m"]
    partner: str | None


class GivenRow(msgspec.Struct, forbid_unknown_fields=True):
    """A `GivenPosition`, metres."""

    name: str
    given_m: Place
    found_m: Place
    difference_m: Number
    sigma_m: Number
    wrong: bool


class CheckRow(msgspec.Struct):
    """What is read of the comparison with a list: whether it fits, and at whose place each microphone stands."""

    fits: bool
    order: list[str]


class RequiredKeys(TypedDict):
    """Keys of every result; null where the true positions are unknown."""

    fdcal_result: int
    positions: Annotated[Positions, "ND"]
    solver: str
    seed: int
    frequencies: Vector
    cost: Number
    sweeps: int
    elapsed_s: Number
    converged: bool
    mean_error_m: Number | None
    max_error_m: Number | None


class Keys(RequiredKeys, total=False):
    """All keys; `room` to `symmetries` are of solver "room", `channel_gain_db` and what follows of the others."""

    names: Annotated[list[str], "N"]
    known: list[str]
    excluded: list[str]
    aligned: bool
    errors_m: Annotated[Vector | None, "N"]
    sound_speed: Number
    verdict: str
    verdict_text: str
    uncertainty_m: OfEachMicrophone
    covariance_m2: Annotated[list[Matrix], "NDD"]
    sound_speed_sigma: Number
    rms_error_m: Number | None
    cost_db: Number
    residual_to_noise: Number
    left_out_db: Number
    left_out_microphones_db: OfEachMicrophone
    left_out_frequencies_db: Vector
    noise_to_given: Number
    room: OfEachAxis
    source: OfEachAxis
    admittance: tuple[Number, Number]
    symmetries: list[Symmetry]
    channel_gain_db: OfEachMicrophone
    channel_gain_sigma_db: OfEachMicrophone
    channel_phase_deg: OfEachMicrophone
    channel_phase_sigma_deg: OfEachMicrophone
    channel_noise_db: OfEachMicrophone
    odd_channels: list[str]
    odd_channel_details: list[FaultRow]
    given_positions: list[GivenRow]
    check: CheckRow


VERSION = 1  # of a result file
REQUIRED = tuple(RequiredKeys.__annotations__)
SHAPES = {
    key: hint.__metadata__[-1]
    for key, hint in get_type_hints(Keys, include_extras=True).items()
    if isinstance(getattr(hint, "__metadata__", (None,))[-1], str)
}
# Attributes of each part, and their keys where these are others.
RENAMED = {
    "elapsed": "elapsed_s", "mean_error": "mean_error_m", "max_error": "max_error_m", "rms_error": "rms_error_m",
    "errors": "errors_m", "uncertainty": "uncertainty_m", "covariance": "covariance_m2",
    "leave_one_out_db": "left_out_db", "microphones_db": "left_out_microphones_db",
    "frequencies_db": "left_out_frequencies_db",
}  # fmt: skip
PARTS = {"evidence", "room", "channels", "run", "order"}
RESULT = {f.name: RENAMED.get(f.name, f.name) for f in fields(Calibration) if f.name not in PARTS}
EVIDENCE = {f.name: RENAMED.get(f.name, f.name) for f in fields(Evidence)}
CHANNELS = {name: f"channel_{name}" for name in CHANNEL_NUMBERS}


def result_text(self: Calibration) -> str:
    """Return the text of a result file.

    Returns
    -------
    str

    Raises
    ------
    InputError
        A value is not finite, or an array has the wrong shape.
    """
    result = self
    table = {"fdcal_result": VERSION, **{key: getattr(result, name) for name, key in RESULT.items()}}
    if result.evidence is not None:
        table |= {key: getattr(result.evidence, name) for name, key in EVIDENCE.items()}
    if (room := result.room) is not None:
        table |= {
            "room": room.size,
            "symmetries": [{"map": name, "positions": positions} for name, positions in room.symmetries],
            "source": room.source,
            "admittance": [room.admittance.real, room.admittance.imag],
        }
    if (channels := result.channels) is not None:
        table |= {key: getattr(channels, name) for name, key in CHANNELS.items()}
        table["odd_channels"] = [fault.name for fault in channels.faults]
        table["odd_channel_details"] = [asdict(fault) for fault in channels.faults]
        table["given_positions"] = [
            {"name": p.name, "given_m": p.given, "found_m": p.found, "difference_m": p.difference, "sigma_m": p.sigma,
             "wrong": p.wrong} for p in channels.given
        ] or None  # fmt: skip
    kept = {key: value for key, value in table.items() if key in REQUIRED or value is not None}
    text = json.dumps(kept, indent=1, default=lambda array: array.tolist()) + "\n"
    read_result(text, "the result")
    return text


def read_result(text: str | bytes, where: str = "the result") -> Calibration:
    """Return the calibration of a result file with this text.

    Parameters
    ----------
    text : str, or bytes in UTF-8
    where : str
        What an error calls the text, as the path of its file.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        `text` is no JSON, or a key is missing or malformed.
    """
    table = parse_json(text, where)
    if not isinstance(table, dict):
        raise InputError(f"{where} must hold one JSON object with the keys {', '.join(REQUIRED)}")
    if table.get("fdcal_result") != VERSION:
        found = shown(table.get("fdcal_result"), 20)
        problem = f"{where} is no result of this version of fdcal (fdcal_result = {found})"
        raise InputError(problem, "write it with `fdcal calibrate -o`", key="fdcal_result", value=found)
    table = _checked(table, where)
    values = {name: table[key] for name, key in RESULT.items() if key in table}
    values["names"] = table.get("names", map(str, range(len(table["positions"]))))
    values |= {key: tuple(values[key]) for key in ("names", "known", "excluded") if key in values}
    if "residual_to_noise" in table:
        values["evidence"] = Evidence(**{name: table[key] for name, key in EVIDENCE.items() if key in table})
    if "symmetries" in table:
        arrays = tuple((one.map, np.array(one.positions)) for one in table["symmetries"])
        values["room"] = KnownRoom(tuple(table["room"]), table["source"], complex(*table["admittance"]), arrays)
    if "check" in table and table["check"].fits:
        values["order"] = tuple(table["check"].order)
    if "channel_gain_db" in table:
        faults = tuple(ChannelFault(**structs.asdict(row)) for row in table.get("odd_channel_details", ()))
        given = tuple(
            GivenPosition(row.name, tuple(row.given_m), tuple(row.found_m), row.sigma_m, row.wrong)
            for row in table.get("given_positions", ())
        )
        numbers = {name: table[key] for name, key in CHANNELS.items()}
        values["channels"] = Channels(**numbers, faults=faults, given=given)
    return Calibration(**values)


def save_result(
    self: Calibration, path: str | PathLike[str], *, force: bool = False, check: PositionCheck | None = None
) -> None:
    """Write the result as JSON, which `fdcal.Calibration.load` and every `--result` read.

    Parameters
    ----------
    path : str or path
    force : bool
        Whether an existing file is overwritten.
    check : PositionCheck, optional
        A comparison with a list of positions, written as the key "check", of which `order` is read again.

    Raises
    ------
    InputError
        The file exists, and `force` is not set.
    StorageError
        The file cannot be written.

    Examples
    --------
    >>> import tempfile, fdcal
    >>> found = fdcal.calibrate(fdcal.load("tiny"), modes=12)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     found.save(f"{folder}/tiny.json")
    ...     fdcal.Calibration.load(f"{folder}/tiny.json").names == found.names
    True
    """
    text = result_text(self)
    if check is not None:
        text = json.dumps(json.loads(text) | {"check": check.table(self.names)}, indent=1, allow_nan=False) + "\n"
    write_atomically(Path(path), lambda temporary: temporary.write_text(text, encoding="utf-8"), force)


def load_result(path: str | PathLike[str]) -> Calibration:
    """Return the calibration in a file that `save` or `fdcal calibrate -o` wrote.

    Parameters
    ----------
    path : str or path

    Returns
    -------
    Calibration

    Raises
    ------
    InputError, StorageError
        The file is no result, or cannot be read.

    Examples
    --------
    >>> import tempfile, fdcal
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     fdcal.calibrate(fdcal.load("tiny"), modes=12).save(f"{folder}/tiny.json")
    ...     fdcal.Calibration.load(f"{folder}/tiny.json").known
    ('0', '5', '7')
    """
    content = read_bytes(str(path), LIMITS.result)
    if not content.lstrip()[:1] == b"{":
        remedy = "give the .json file that `fdcal calibrate -o` writes"
        raise InputError(f"{path} is not a result", remedy, key="result", value=str(path))
    return read_result(content, str(path))


def _checked(table: dict, where: str) -> dict[str, Any]:
    """Return the declared keys of a table after a check of their types, shapes and what they have to do with others."""

    def missing(key: str) -> InputError:
        return InputError(f'{where} has no "{key}"', "write it with `fdcal calibrate -o`", key=key)

    try:
        checked: dict[str, Any] = {**msgspec.convert(table, Keys)}
    except msgspec.ValidationError as error:  # as "Expected `float`, got `str` - at `$.positions[0][1]`"
        if lacking := re.fullmatch(r"Object missing required field `(\w+)`", str(error)):
            raise missing(lacking[1]) from None
        reason, _, place = str(error).rstrip("`").rpartition(" - at `$.")
        key = re.split(r"\W", place)[0]
        reason = "must be finite" if str(LARGEST) in reason else shown(reason.replace("`", ""), 120)
        inside = "" if place == key else f" at {place}"
        problem = f'{where}: "{key}" is malformed: {reason[0].lower()}{reason[1:]}{inside}'
        raise InputError(problem, key=key, value=table.get(key)) from None

    def has_shape(values: list, shape: tuple[int, ...]) -> bool:
        try:
            return np.shape(values) == shape
        except ValueError:  # rows of different lengths
            return False

    def require(right: bool, key: str, problem: str) -> None:
        if not right:
            raise InputError(f'{where}: "{key}" {problem}', key=key, value=table.get(key))

    sizes = {"N": len(checked["positions"]), "D": len(checked["positions"][0])}
    shapes = {key: tuple(sizes[axis] for axis in axes) for key, axes in SHAPES.items()}
    for key, shape in shapes.items():
        right = checked.get(key) is None or has_shape(checked[key], shape)
        require(right, key, f"must be of shape {shape}, of {sizes['N']} microphones in {sizes['D']} dimensions")
    absent = [key for key in CHANNELS.values() if key not in checked]
    if 0 < len(absent) < len(CHANNELS):
        raise missing(absent[0])
    if "symmetries" in checked:
        beside = {"room", "source", "admittance"} <= checked.keys()
        require(beside, "symmetries", 'needs "room", "source" and "admittance"')
        right = all(has_shape(one.positions, shapes["positions"]) for one in checked["symmetries"])
        require(right, "symmetries", 'must hold positions of the same shape as "positions"')
    for key in ("odd_channel_details", "given_positions"):
        right = "names" not in checked or {row.name for row in checked.get(key, ())} <= {*checked["names"]}
        require(right, key, 'has a name that is not in "names"')
    places = [place for row in checked.get("given_positions", ()) for place in (row.given_m, row.found_m)]
    require(all(len(place) == sizes["D"] for place in places), "given_positions", f"must hold {sizes['D']} coordinates")
    return checked


def position_table(measurement: Measurement, positions, sigma=None, by: slice | np.ndarray = slice(None)) -> str:
    """Return positions (N, D) as CSV; lengths in metres, unknown values empty, numbers to full precision.

    Without any known microphone the error is that after the best rigid motion or mirror image of the whole array, which
    the microphones `by` determine, in a column called error_once_aligned_m. Nominal positions have columns nominal_x_m.
    """
    truth, errors, axes = measurement.positions, measurement.errors(positions, by), "xyz"[: measurement.array_dimension]
    unknown = np.full((measurement.count, len(axes) + 1), None)
    true = unknown if truth is None or errors is None else np.column_stack([truth, errors])
    numbers = np.column_stack([np.asarray(positions, float), true, unknown[:, 0] if sigma is None else sigma])
    known = ["yes" if n in measurement.known else "no" for n in range(measurement.count)]
    aligned = "_once_aligned" if measurement.blind and truth is not None else ""
    compared = [f"{measurement.reference}_{axis}_m" for axis in axes]
    head = [*(f"{axis}_m" for axis in axes), *compared, f"error{aligned}_m", "uncertainty_m"]
    return _csv(["name", "known", *head], zip(measurement.names, known, *numbers.T.tolist(), strict=True))


def channel_table(result: Calibration) -> str:
    """Return gain, phase and noise of every channel as CSV, numbers to full precision.

    To correct a recording, divide the pressures of a channel by 10^(gain_db / 20) exp(j phase_deg pi / 180). The fault
    is empty, or one of those of `fdcal.assessment.channels`.
    """
    if result.channels is None or not result.channels.gains_sought:
        problem = f"the result of solver {result.solver} holds no gains of the channels"
        raise InputError(problem, "calibrate with <solver> robust", key="table", value="gains")
    columns = _channel_columns(result)
    return _csv(["name", *columns], zip(result.names, *columns.values(), strict=True))


def data_frame(self: Calibration) -> Any:
    """Return a pandas table with one row a microphone, if pandas is installed.

    Columns: x, y (z), metres; known; uncertainty, one sigma in metres; error, metres, where it is known; where the
    solver finds them gain_db, gain_sigma_db, phase_deg, phase_sigma_deg, noise_db and fault, "" where healthy,
    and of given positions given_x, given_y (given_z) and given_difference, metres, NaN where none is given. The
    index are the names.

    Returns
    -------
    pandas.DataFrame

    Raises
    ------
    InputError
        pandas is not installed.

    Examples
    --------
    >>> import fdcal
    >>> found = fdcal.calibrate(fdcal.load("tiny"), modes=12)
    >>> found.to_dataframe().columns.tolist()[:6]
    ['x', 'y', 'known', 'uncertainty', 'error', 'gain_db']
    """
    result = self
    pandas = needs("pandas")
    axes = "xyz"[: result.positions.shape[1]]
    columns: dict[str, Any] = dict(zip(axes, result.positions.T, strict=True))
    if result.known is not None:
        columns["known"] = [name in result.known for name in result.names]
    if result.uncertainty is not None:
        columns["uncertainty"] = result.uncertainty
    if result.errors is not None:
        columns["error"] = result.errors
    columns |= _channel_columns(result)
    if result.channels is not None and result.channels.given:
        given = {one.name: one.given for one in result.channels.given}
        places = np.array([given.get(name, (np.nan,) * len(axes)) for name in result.names])
        columns |= {f"given_{axis}": column for axis, column in zip(axes, places.T, strict=True)}
        columns["given_difference"] = np.linalg.norm(result.positions - places, axis=1)
    return pandas.DataFrame(columns, index=pandas.Index(result.names, name="microphone"))


def _channel_columns(result: Calibration) -> dict[str, list]:
    """Return gain, phase, noise and fault of every channel, "" where it is healthy; nothing without channels."""
    if result.channels is None:
        return {}
    faults = {fault.name: fault.kind for fault in result.channels.faults}
    columns = {name: getattr(result.channels, name).tolist() for name in CHANNEL_NUMBERS}
    return columns | {"fault": [faults.get(name, "") for name in result.names]}


def _csv(head: list[str], rows: Iterable[Iterable[object]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    return text.getvalue()
