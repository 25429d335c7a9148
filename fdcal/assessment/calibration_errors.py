"""The errors of a calibration against the true positions of a measurement, and over which microphones they count."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Self, cast

import numpy as np

from ..model.gauge import align, position_errors
from ..model.measurement import Measurement
from ..model.validation import InputError
from .result_parts import Channels, KnownRoom


class CalibrationErrors:
    """Methods of `fdcal.assessment.calibration.Calibration`, whose attributes they read."""

    positions: np.ndarray
    names: tuple[str, ...]
    excluded: tuple[str, ...]
    aligned: bool
    room: KnownRoom | None
    channels: Channels | None

    @property
    def healthy(self) -> np.ndarray:
        """Numbers of the microphones with a sound channel, of all if there is none : (K,) int64."""
        faults = () if self.channels is None else self.channels.faults
        faulty = {fault.name for fault in faults if fault.kind != "misplaced"}
        healthy = np.flatnonzero([name not in faulty for name in self.names])
        return healthy if len(healthy) else np.arange(len(self.names))

    def counted(self, given=()) -> np.ndarray:
        """Return the numbers of the microphones whose errors are averaged: those sought, with a sound channel.

        Parameters
        ----------
        given : sequence of int
            Microphones whose positions were given; they count only where no other is left.

        Returns
        -------
        (K,) int64
        """
        sought = np.setdiff1d(self.healthy, np.asarray(given, np.int64))
        return sought if len(sought) else self.healthy

    def positions_for(self, measurement: Measurement) -> np.ndarray:
        """Return the positions in the axes of a measurement's true positions, where it has them.

        A blind result is moved as a whole onto the true positions, by its sound channels; of the symmetries of a known
        room the nearest one is taken.

        Parameters
        ----------
        measurement : Measurement

        Returns
        -------
        (N, D) float64
            Metres.

        Raises
        ------
        InputError
            The result is of another number of microphones than the measurement.
        """
        shape = (measurement.count, measurement.array_dimension)
        if self.positions.shape != shape and self.excluded:
            raise InputError(
                f"the result leaves out microphone {', '.join(self.excluded)}, but the positions of all are needed",
                "calibrate again without <exclude>",
                key="result",
            )
        if self.positions.shape != shape:
            raise InputError(
                f"the result has positions of shape {self.positions.shape}, the measurement {shape}",
                "use the result of this measurement",
                key="result",
            )
        truth = measurement.positions
        if truth is not None and self.room is not None:
            arrays = [positions for _, positions in self.room.symmetries]
            return min(arrays, key=lambda positions: float(np.sum((positions - truth) ** 2)))
        return align(self.positions, truth, self.healthy) if truth is not None and self.aligned else self.positions

    def compared_with(self, measurement: Measurement, given=()) -> Self:
        """Return this calibration with its errors against the true positions of a measurement, where it has them.

        Parameters
        ----------
        measurement : Measurement
        given : sequence of int
            As of `counted`.

        Returns
        -------
        Calibration
        """
        if measurement.positions is None:
            return self
        errors = position_errors(self.positions_for(measurement), measurement.positions)
        of = errors[self.counted(given)]
        rms = float(np.sqrt(np.mean(of**2)))
        return replace(
            cast(Any, self), errors=errors, mean_error=float(of.mean()), rms_error=rms, max_error=float(of.max())
        )
