"""A calibration in files and objects of other programs, and the signals of pyfar as a measurement."""

import xml.etree.ElementTree as tree
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from ..assessment.calibration import Calibration, placed_in_frame
from ..assessment.result_file import channel_table
from ..model.given_positions import MicrophonePositions
from ..model.libraries import needs
from ..model.measurement import Measurement
from ..model.storage import write_atomically
from ..model.validation import InputError, require_choice
from . import formats

FLAT = 1e-6  # metres: heights that differ less are one height


def export(
    self: Calibration,
    path: str | PathLike[str],
    *,
    frame: str | None = None,
    original: str | PathLike[str] | None = None,
    table: str = "positions",
    force: bool = False,
) -> None:
    """Write the positions, or the gains of the channels, for another program; the suffix selects the format.

    Parameters
    ----------
    path : str or path
        Ends in .csv (a table), .json, .xml (Acoular), .sofa or .npy (pyroomacoustics).
    frame : str, optional
        "known", the axes of the known microphones, as by default; "minimal" or "axes", as by default without any.
    original : str or path, optional
        A SOFA file into a copy of which the positions are written.
    table : str
        "positions", or "gains" of the channels, of solver "robust": a .csv table, or factors for Acoular (.xml).
    force : bool
        Whether an existing file is overwritten.

    Raises
    ------
    InputError
        No format has this suffix, the frame does not exist, or the file exists and `force` is not set.
    StorageError
        The file cannot be written.

    Examples
    --------
    >>> import tempfile, fdcal
    >>> from pathlib import Path
    >>> found = fdcal.calibrate(fdcal.load("tiny"), modes=12)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     found.export(f"{folder}/tiny.csv")
    ...     Path(f"{folder}/tiny.csv").read_text().splitlines()[0]
    'name,x,y,z,uncertainty'
    """
    require_choice("table", table, ("positions", "gains"))
    if table == "gains":
        export_gains(self, path, force)
    else:
        export_positions(self, path, frame, original, force)


def export_positions(
    result: Calibration,
    path: str | PathLike[str],
    frame: str | None = None,
    original: str | PathLike[str] | None = None,
    force: bool = False,
) -> MicrophonePositions:
    """Write the positions of a result, and return them as written; see `Calibration.export`."""
    path, given = Path(path), None if original is None else str(original)
    if path.suffix.lower() not in formats.suffixes("write"):
        problem = f'"{path}" ends in no suffix of a format for positions'
        raise InputError(problem, f"use one of {', '.join(formats.suffixes('write'))}", key="output", value=str(path))
    if given is not None and path.suffix.lower() != ".sofa":
        problem = f"original = {given} is for files of SOFA"
        raise InputError(problem, f"leave out <original> for {path.suffix}", key="original", value=given)
    placed = placed_in_frame(result, frame)
    write_atomically(path, lambda file: formats.write(file, path, placed, given), force)
    return placed


def export_gains(result: Calibration, path: str | PathLike[str], force: bool = False) -> None:
    """Write the gains of the channels: `fdcal.assessment.result_file.channel_table`, or Acoular's factors (.xml)."""
    path = Path(path)
    if path.suffix.lower() not in GAIN_TEXTS:
        problem = f'"{path}" ends in no suffix of a file of gains'
        remedy = f"use one of {', '.join(GAIN_TEXTS)}"
        raise InputError(problem, remedy, key="output", value=str(path))
    text = GAIN_TEXTS[path.suffix.lower()](result)
    write_atomically(path, lambda file: file.write_text(text, encoding="utf-8"), force)


def acoular_factors(result: Calibration) -> str:
    """Return the XML of Acoular's `Calib`: the factor of each channel, below 0 of an inverted one, 0 of a dead one.

    Acoular takes it for pascal per unit; here it is relative to the median channel.
    """
    channel_table(result)  # refuses a result without gains
    channels = result.channels
    assert channels is not None
    factors = np.copysign(10 ** (-channels.gain_db / 20), np.cos(np.radians(channels.phase_deg)))
    dead = {fault.name for fault in channels.faults if fault.kind == "dead"}
    root = tree.Element("Calib", name="relative to the median channel")
    for name, factor in zip(result.names, factors, strict=True):
        tree.SubElement(root, "pos", Name=name, factor=repr(0.0 if name in dead else float(factor)))
    tree.indent(root)
    return tree.tostring(root, "unicode", xml_declaration=True) + "\n"


GAIN_TEXTS = {".csv": channel_table, ".xml": acoular_factors}


def measurement_of_pyfar(data, coordinates=None, **options: Any) -> Measurement:
    """Return the measurement of an object of pyfar.

    Parameters
    ----------
    data : pyfar.FrequencyData or pyfar.Signal
        One channel a microphone. Of frequency data, all frequencies are taken as they are; of a signal they are
        chosen as for a recording.
    coordinates : pyfar.Coordinates, optional
        Positions of the microphones, to compare with.
    **options
        Of frequency data, as of `from_arrays`; of a signal, fields of
        `fdcal.recordings.import_options.ImportOptions`.

    Returns
    -------
    Measurement

    Raises
    ------
    InputError
        A value is impossible.

    Examples
    --------
    >>> import fdcal, pyfar
    >>> import numpy as np
    >>> data = pyfar.FrequencyData(np.exp(1j * np.arange(12.0)).reshape(4, 3), [100, 150, 210])
    >>> fdcal.Measurement.from_pyfar(data).count
    4
    """
    pyfar = needs("pyfar")
    positions = None if coordinates is None else np.asarray(coordinates.cartesian, float).reshape(-1, 3)
    if isinstance(data, pyfar.Signal):
        from .import_options import ImportOptions
        from .importer import measurement_of_takes  # brings the signal library, which an export does not need
        from .recording import recording_of

        samples = data.time.reshape(-1, data.n_samples)
        recording = recording_of("the signal", None, data.sampling_rate, samples, positions=positions)
        return measurement_of_takes([recording], ImportOptions(**options))[0]
    if not isinstance(data, pyfar.FrequencyData):
        raise InputError(f"{type(data).__name__} is no FrequencyData and no Signal of pyfar", "give one of them")
    if positions is not None and options.get("dimension", 3) == 2:
        if np.ptp(positions[:, 2]) > FLAT:
            raise InputError("a field of two dimensions needs microphones of one height", "leave out <dimension>")
        positions = positions[:, :2]
    pressures = data.freq.reshape(-1, data.n_bins).T
    return Measurement.from_arrays(data.frequencies, pressures, positions=positions, **options)


def pyfar_coordinates(self: Calibration, *, frame: str | None = None) -> Any:
    """Return the positions as `pyfar.Coordinates`; needs the extra "pyfar".

    Parameters
    ----------
    frame : str, optional
        As of `export`.

    Returns
    -------
    pyfar.Coordinates

    Examples
    --------
    >>> import fdcal
    >>> fdcal.calibrate(fdcal.load("tiny"), modes=12).to_pyfar().cshape
    (16,)
    """
    pyfar, placed = needs("pyfar"), placed_in_frame(self, frame)
    return pyfar.Coordinates(*placed.positions.T.copy(), comment=f"microphones {', '.join(placed.names)}")
