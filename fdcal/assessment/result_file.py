"""A calibration as text (JSON of a result file, CSV of positions and of gains), and as a table of pandas.

`ResultTable` declares every key with its type and its shape. A file has no key for a quantity that the solver does not
find. Keys that are not declared are ignored, except in the rows of given positions, where they are refused. Files of
another version are refused.
"""

import csv
import io
import json
import re
import sys
from collections.abc import Iterable
from dataclasses import fields
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import msgspec
import numpy as np
from msgspec import structs

from ..model.libraries import needs
from ..model.measurement import Measurement
from ..model.storage import parse_text, read_bytes, write_atomically
from ..model.validation import LIMITS, InputError, shown
from .calibration import CHANNEL_NUMBERS, Calibration, ChannelFault, Channels, Evidence, GivenPosition
from .position_check import PositionCheck

LARGEST = sys.float_info.max

Number = Annotated[float, msgspec.Meta(ge=-LARGEST, le=LARGEST)]  # neither NaN nor infinite
Vector = Annotated[list[Number], msgspec.Meta(min_length=1)]
Matrix = Annotated[list[Vector], msgspec.Meta(min_length=1)]
Place = Annotated[tuple[Number, ...], msgspec.Meta(min_length=2, max_length=3)]
Positions = Annotated[list[Place], msgspec.Meta(min_length=1)]
# Shapes stand last in an annotation: N microphones, D coordinates, M frequencies.
OfEachMicrophone = Annotated[Vector, "N"]
ABSENT: Any = None  # the default of a key that a file need not have; null in a file is refused
VERSION = 1  # version of a result file


class GivenRow(msgspec.Struct, forbid_unknown_fields=True):
    """A `GivenPosition`, metres."""

    name: str
    given_m: Place
    found_m: Place
    difference_m: Number
    sigma_m: Number
    wrong: bool


class CheckRow(msgspec.Struct):
    """The part of a comparison with a list that is read again: whether it fits, and the order of the rows."""

    fits: bool
    order: tuple[str, ...]


# Keys that differ from the names of the attributes of `Calibration`, `Evidence` and `Channels`.
RENAMED = {
    "elapsed": "elapsed_s", "mean_error": "mean_error_m", "max_error": "max_error_m", "rms_error": "rms_error_m",
    "errors": "errors_m", "uncertainty": "uncertainty_m", "covariance": "covariance_m2",
    "microphones_db": "leave_one_out_microphones_db", "frequencies_db": "leave_one_out_frequencies_db",
    "faults": "faulty_channel_details", "given": "given_positions",
    **{name: f"channel_{name}" for name in CHANNEL_NUMBERS},
}  # fmt: skip


class ResultTable(msgspec.Struct, rename=RENAMED):
    """All keys; those without a default are in every file."""

    positions: Annotated[Positions, "ND"]
    solver: str
    seed: int
    frequencies: Vector
    cost: Number
    sweeps: int
    elapsed: Number
    converged: bool
    mean_error: Number | None  # null where the true positions are unknown
    max_error: Number | None
    fdcal_result: int = VERSION
    names: Annotated[tuple[str, ...], "N"] = ABSENT
    known: tuple[str, ...] = ABSENT
    excluded: tuple[str, ...] = ()
    aligned: bool = False
    errors: Annotated[Vector | None, "N"] = None
    sound_speed: Number = ABSENT
    sound_speed_sigma: Number = ABSENT
    verdict: str = ""
    verdict_text: str = ""
    uncertainty: OfEachMicrophone = ABSENT
    covariance: Annotated[list[Matrix], "NDD"] = ABSENT
    rms_error: Number | None = None
    cost_db: Number = ABSENT
    residual_to_noise: Number = ABSENT
    leave_one_out_db: Number = ABSENT
    microphones_db: OfEachMicrophone = ABSENT
    frequencies_db: Annotated[Vector, "M"] = ABSENT
    noise_to_given: Number = ABSENT
    gain_db: OfEachMicrophone = ABSENT
    gain_sigma_db: OfEachMicrophone = ABSENT
    phase_deg: OfEachMicrophone = ABSENT
    phase_sigma_deg: OfEachMicrophone = ABSENT
    noise_db: OfEachMicrophone = ABSENT
    odd_channels: list[str] = ABSENT
    faults: tuple[ChannelFault, ...] = ABSENT
    given: list[GivenRow] = ABSENT
    check: CheckRow = ABSENT

    def part(self, kind: type, **others: Any) -> Any:
        """Return a dataclass whose fields have the names of keys, except for `others`."""
        names = {field.name for field in fields(kind)} & {*self.__struct_fields__} - {*others}
        return kind(**{name: getattr(self, name) for name in names}, **others)


REQUIRED = {field.encode_name for field in structs.fields(ResultTable) if field.required}
SHAPES = {
    RENAMED.get(name, name): hint.__metadata__[-1]
    for name, hint in get_type_hints(ResultTable, include_extras=True).items()
    if isinstance(getattr(hint, "__metadata__", (None,))[-1], str)
}


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
    channels, keys = self.channels, ResultTable.__struct_fields__
    values = {key: getattr(part, key) for part in (self, self.evidence, channels) for key in keys if hasattr(part, key)}
    if channels is not None:
        values["odd_channels"] = [fault.name for fault in channels.faults]
        rows = [GivenRow(p.name, p.given, p.found, p.difference, p.sigma, p.wrong) for p in channels.given]
        values["given"] = rows or None
    table = msgspec.to_builtins(ResultTable(**values), enc_hook=lambda array: array.tolist())
    kept = {key: value for key, value in table.items() if value is not None or key in REQUIRED}
    text = json.dumps(kept, indent=1) + "\n"
    read_result(text, "the result")
    return text


def read_result(text: str | bytes, where: str = "the result") -> Calibration:
    """Return the calibration of a result file with this text.

    Parameters
    ----------
    text : str, or bytes in UTF-8
    where : str
        Name of the text in error messages, such as the path of its file.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        `text` is not JSON, or a key is missing or malformed.
    """
    content = parse_text(text, "JSON", where)
    if not isinstance(content, dict):
        raise InputError(f"{where} must hold one JSON object with the keys {', '.join(sorted(REQUIRED))}")
    if content.get("fdcal_result") != VERSION:
        found = shown(content.get("fdcal_result"), 20)
        problem = f"{where} is not a result of this version of fdcal (fdcal_result = {found})"
        raise InputError(problem, "write it with `fdcal calibrate -o`", key="fdcal_result")
    table = _checked(content, where)
    evidence = channels = None
    if table.residual_to_noise is not None:
        evidence = table.part(Evidence)
    if table.gain_db is not None:
        rows = table.given or ()
        given = tuple(GivenPosition(row.name, row.given_m, row.found_m, row.sigma_m, row.wrong) for row in rows)
        channels = table.part(Channels, faults=table.faults or (), given=given)
    names = table.names or tuple(map(str, range(len(table.positions))))
    order = table.check.order if table.check is not None and table.check.fits else None
    return table.part(Calibration, names=names, evidence=evidence, channels=channels, order=order)


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
        A comparison with a list of positions, which is written under the key "check". `load` reads only its order.

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
        The file does not hold a result, or cannot be read.

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
        raise InputError(f"{path} is not a result", remedy, key="result")
    return read_result(content, str(path))


def _checked(content: dict, where: str) -> ResultTable:
    """Return the declared keys of a file after a check of their types, shapes and mutual consistency."""

    def require(right: bool, key: str, problem: str, remedy: str = "") -> None:
        if not right:
            raise InputError(f'{where}: "{key}" {problem}', remedy, key=key)

    missing = "is missing", "write it with `fdcal calibrate -o`"

    try:
        table = msgspec.convert(content, ResultTable)
    except msgspec.ValidationError as error:  # as "Expected `float`, got `str` - at `$.positions[0][1]`"
        if absent := re.fullmatch(r"Object missing required field `(\w+)`", str(error)):
            require(False, absent[1], *missing)
        reason, _, place = str(error).rstrip("`").rpartition(" - at `$.")
        key = re.split(r"\W", place)[0]
        reason = "must be finite" if str(LARGEST) in reason else shown(reason.replace("`", ""), 120)
        inside = "" if place == key else f" at {place}"
        require(False, key, f"is malformed: {reason[0].lower()}{reason[1:]}{inside}")
        raise

    sizes = {"N": len(table.positions), "D": len(table.positions[0]), "M": len(table.frequencies)}
    shapes = {key: tuple(sizes[axis] for axis in axes) for key, axes in SHAPES.items()}
    whole = f"{sizes['N']} microphones in {sizes['D']} dimensions at {sizes['M']} frequencies"
    for key, shape in shapes.items():
        right = content.get(key) is None or np.array(content[key], object).shape == shape
        require(right, key, f"must be of shape {shape}, of {whole}")
    absent = [RENAMED[name] for name in CHANNEL_NUMBERS if getattr(table, name) is None]
    if 0 < len(absent) < len(CHANNEL_NUMBERS):
        require(False, absent[0], *missing)
    require(len({*(table.names or ())}) == len(table.names or ()), "names", "has a name twice")
    given = table.given or ()
    for key, rows in (("faulty_channel_details", table.faults or ()), ("given_positions", given)):
        right = table.names is None or {row.name for row in rows} <= {*table.names}
        require(right, key, 'has a name that is not in "names"')
    right = all(len(place) == sizes["D"] for row in given for place in (row.given_m, row.found_m))
    require(right, "given_positions", f"must hold {sizes['D']} coordinates")
    return table


def position_table(measurement: Measurement, positions, sigma=None, by: slice | np.ndarray = slice(None)) -> str:
    """Return positions (N, D) as CSV; lengths in metres, unknown values empty.

    `sigma` (N,), metres, is one sigma of each position. Without known microphones the errors are those after the best
    rigid motion or mirror image, which the microphones `by` determine, and their column is called error_once_aligned_m.
    The columns of nominal positions are called nominal_x_m and so on.
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
    """Return gain, phase and noise of every channel as CSV.

    To correct a recording, divide the pressures of a channel by 10^(gain_db / 20) exp(j phase_deg pi / 180). The column
    "fault" is empty for healthy channels, otherwise it holds a fault of `fdcal.assessment.channels`.
    """
    if result.channels is None or not result.channels.gains_sought:
        problem = f"the result of solver {result.solver} holds no gains of the channels"
        raise InputError(problem, "calibrate with <solver> robust", key="table")
    columns = _channel_columns(result)
    return _csv(["name", *columns], zip(result.names, *columns.values(), strict=True))


def data_frame(self: Calibration) -> Any:
    """Return a pandas table with one row for each microphone, if pandas is installed.

    The columns are x, y (and z), metres; known; uncertainty, one sigma in metres; and error, metres, if it is known.
    A result with channels adds gain_db, gain_sigma_db, phase_deg, phase_sigma_deg, noise_db and fault, which is
    "" for a healthy channel. Given positions add given_x, given_y (given_z) and given_difference, metres, which are
    NaN for a microphone without one. The names are the index.

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
    pandas = needs("pandas")
    axes = "xyz"[: self.positions.shape[1]]
    columns: dict[str, Any] = dict(zip(axes, self.positions.T, strict=True))
    if self.known is not None:
        columns["known"] = [name in self.known for name in self.names]
    for name, values in (("uncertainty", self.uncertainty), ("error", self.errors)):
        if values is not None:
            columns[name] = values
    columns |= _channel_columns(self)
    if self.channels is not None and self.channels.given:
        positions = {one.name: one.given for one in self.channels.given}
        given = np.array([positions.get(name, (np.nan,) * len(axes)) for name in self.names])
        columns |= {f"given_{axis}": column for axis, column in zip(axes, given.T, strict=True)}
        columns["given_difference"] = pandas.Series({one.name: one.difference for one in self.channels.given})
    return pandas.DataFrame(columns, index=pandas.Index(self.names, name="microphone"))


def _channel_columns(result: Calibration) -> dict[str, list]:
    """Return gain, phase, noise and fault of every channel, "" where it is healthy; nothing without channels."""
    if result.channels is None:
        return {}
    faults = {fault.name: fault.kind for fault in result.channels.faults}
    columns = {name: getattr(result.channels, name).tolist() for name in CHANNEL_NUMBERS}
    return columns | {"fault": [faults.get(name, "") for name in result.names]}


def _csv(head: list[str], rows: Iterable[Iterable[object]]) -> str:
    """Return rows as CSV, numbers to nine digits."""
    text = io.StringIO()
    shown = ([f"{x:.9g}" if isinstance(x, float) else x for x in row] for row in rows)
    csv.writer(text, lineterminator="\n").writerows([head, *shown])
    return text.getvalue()
