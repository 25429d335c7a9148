"""The result of a calibration: `Calibration`, which `fdcal calibrate` prints and writes as JSON."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, fields

import numpy as np

from ..model.reading import parse_json
from ..model.validation import InputError, frozen_array
from .calibration_errors import CalibrationErrors
from .calibration_views import CalibrationViews
from .result_parts import (
    Channels,
    Evidence,
    KnownRoom,
    channels_of,
    channels_table,
    evidence_of,
    evidence_table,
    plain,
    room_of,
    room_table,
)
from .result_schema import REQUIRED, require_result

PARTS = ("evidence", "room", "channels")  # attributes that have several keys in the file


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(CalibrationErrors, CalibrationViews):
    """Positions of the microphones of an array, and whether to trust them.

    Attributes
    ----------
    positions : (N, D) float64
        Metres.
    names : tuple of N str
    solver : str
    seed : int
    frequencies : (M,) float64
        Those used, Hz, ascending.
    cost : float
        What the solver minimised; dimensionless with modes of unit RMS. Solvers minimise different quantities.
    cost_db : float or None
        Eq. 7 over all modes that the microphones can carry, dB of their power: alike for all solvers.
    sweeps : int
        Number of times that all free microphones were moved.
    elapsed : float
        Seconds.
    converged : bool
    known : tuple of str or None
        Names of the microphones whose positions were given; None if the file does not say.
    excluded : tuple of str
        Names of microphones left out, which have no row in `positions`.
    aligned : bool
        Whether nothing fixes translation, rotation and mirror image, so that the errors are those after the best
        rigid motion.
    mean_error, rms_error, max_error : float or None
        Over the microphones that `counted` names, metres; None where the true positions are unknown.
    errors : (N,) float64 or None
        Distance of each microphone from its true position, metres.
    sound_speed : float or None
        As given or as estimated, m/s.
    verdict : str
        A code of `fdcal.assessment.verdict` or `fdcal.assessment.room_verdict`, such
        as "good"; "" if the file has none.
    verdict_text : str
        The verdict in words.
    uncertainty : (N,) float64 or None
        One sigma of each position, metres; 0 for a known microphone whose position the solver held.
    covariance : (N, D, D) float64 or None
        Of each position, metres^2.
    evidence : Evidence or None
    room : KnownRoom or None
        Of solver "room" only.
    channels : Channels or None
        Gain and noise of every channel, and what is wrong with it; of solver "robust" only.
    sound_speed_sigma : float or None
        One sigma of a sound speed that was estimated with the positions, m/s; of solver "robust" only.

    Examples
    --------
    >>> found = Calibration([[0, 0], [3, 4]], ("a", "b"), "joint", 0, [50.0], 0.1, 3, 1.5, True, verdict="good")
    >>> Calibration.from_json(found.to_json()).positions.tolist()
    [[0.0, 0.0], [3.0, 4.0]]
    """

    positions: np.ndarray
    names: tuple[str, ...]
    solver: str
    seed: int
    frequencies: np.ndarray
    cost: float
    sweeps: int
    elapsed: float = field(metadata={"key": "elapsed_s"})
    converged: bool
    known: tuple[str, ...] | None = None
    excluded: tuple[str, ...] = ()
    aligned: bool = False
    mean_error: float | None = field(default=None, metadata={"key": "mean_error_m"})
    max_error: float | None = field(default=None, metadata={"key": "max_error_m"})
    errors: np.ndarray | None = field(default=None, metadata={"key": "errors_m"})
    sound_speed: float | None = None
    verdict: str = ""
    verdict_text: str = ""
    uncertainty: np.ndarray | None = field(default=None, metadata={"key": "uncertainty_m"})
    covariance: np.ndarray | None = field(default=None, metadata={"key": "covariance_m2"})
    evidence: Evidence | None = None
    room: KnownRoom | None = None
    channels: Channels | None = None
    sound_speed_sigma: float | None = None
    rms_error: float | None = field(default=None, metadata={"key": "rms_error_m"})
    cost_db: float | None = None

    def __post_init__(self):
        for name in ("positions", "frequencies", "errors", "uncertainty", "covariance"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen_array(getattr(self, name), float))

    def to_json(self) -> str:
        """Return the text of a result file.

        Returns
        -------
        str

        Raises
        ------
        InputError
            A value is not finite, or an array has the wrong shape.
        """
        table = {_key(f): plain(getattr(self, f.name)) for f in fields(self) if f.name not in PARTS}
        table |= evidence_table(self.evidence) | room_table(self.room) | channels_table(self.channels)
        kept = {key: value for key, value in table.items() if key in REQUIRED or value is not None}
        require_result(kept, "the result")
        return json.dumps(kept, indent=1, allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, text: str | bytes, where: str = "the result") -> Calibration:
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
        table = require_result(table, where)
        known, count = table.get("known"), len(table["positions"])
        plain = {f.name: table[_key(f)] for f in fields(cls) if _key(f) in table and f.name not in PARTS}
        return cls(
            **plain
            | {
                "names": tuple(table.get("names", map(str, range(count)))),
                "known": None if known is None else tuple(known),
                "excluded": tuple(table.get("excluded", ())),
                "evidence": evidence_of(table),
                "room": room_of(table),
                "channels": channels_of(table),
            }
        )


def _key(attribute) -> str:
    """Return the key of an attribute in the file."""
    return attribute.metadata.get("key", attribute.name)
