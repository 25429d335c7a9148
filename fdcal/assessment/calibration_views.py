"""What a calibration can be turned into: a file, a table, a picture, objects of other libraries.

What packages above this one carry out (pictures, other programs' formats) is looked up in `fdcal.EXTENSIONS`.
"""

from __future__ import annotations

from os import PathLike
from typing import Any

import fdcal

from ..model.lengths import length_text
from ..model.validation import require_choice


class CalibrationViews:
    """Methods of `fdcal.assessment.calibration.Calibration`."""

    def save(self, path: str | PathLike[str], *, force: bool = False) -> None:
        """Write the result as JSON, which `fdcal.Calibration.load` and every `--result` read.

        Parameters
        ----------
        path : str or path
        force : bool
            Whether an existing file is overwritten.

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
        fdcal.extension("save_result")(self, path, force)

    @staticmethod
    def load(path: str | PathLike[str]) -> fdcal.Calibration:
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
        return fdcal.extension("load_result")(path)

    def export(
        self,
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
            "positions", or "gains": a .csv table of gain, phase and noise of every channel, of solver "robust".
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
            fdcal.extension("export_gains")(self, path, force)
        else:
            fdcal.extension("export_positions")(self, path, frame, original, force)

    def to_pyfar(self, *, frame: str | None = None) -> Any:
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
        return fdcal.extension("pyfar_coordinates")(fdcal.extension("placed_in_frame")(self, frame))

    def to_dataframe(self) -> Any:
        """Return a pandas table with one row a microphone, if pandas is installed.

        Columns: x, y (z), metres; known; uncertainty, one sigma in metres; error, metres, where it is known; where the
        solver finds them gain_db, gain_sigma_db, phase_deg, phase_sigma_deg, noise_db and fault, "" where sound,
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
        return fdcal.extension("data_frame")(self)

    def plot(self, truth=None) -> Any:
        """Return a matplotlib figure of the positions, with error ellipses and the known microphones.

        Parameters
        ----------
        truth : (N, D) array_like, optional
            True positions to draw as well, metres, in the axes of the result.

        Returns
        -------
        matplotlib.figure.Figure

        Examples
        --------
        >>> import fdcal
        >>> measurement = fdcal.load("tiny")
        >>> figure = fdcal.calibrate(measurement, modes=12).plot(measurement.positions)
        >>> figure.axes[0].get_xlabel()
        'x (m)'
        """
        return fdcal.extension("draw_calibration")(self, truth)

    def __repr__(self) -> str:
        result: Any = self
        known = "" if result.known is None else f", {len(result.known)} known"
        error = "" if result.mean_error is None else f", mean error {length_text(result.mean_error)}"
        return (
            f"<Calibration by {result.solver}: {len(result.names)} microphones{known},"
            f" {len(result.frequencies)} frequencies, verdict {result.verdict or 'unknown'}{error}>"
        )

    def _repr_html_(self) -> str:
        return fdcal.extension("calibration_html")(self)
