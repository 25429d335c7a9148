"""Parts of a calibration, and their keys in a result file: the evidence of a verdict, channels, a known room."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from ..cost.channel_correction import ChannelCorrection
from ..model.validation import frozen_array
from .corrected_positions import GivenPosition, given_of, given_table

DECIBELS_PER_NEPER = 20 / np.log(10)


@dataclass(frozen=True, eq=False)
class Evidence:
    """The figures behind a verdict.

    Attributes
    ----------
    residual_to_noise : float
        Reduced chi-square of the pressures: power of the residual over that of the noise.
    leave_one_out_db : float or None
        Leave-one-out prediction error over pressure, decibels, of all microphones and frequencies together.
    microphones_db : (N,) float64 or None
        The same of each microphone.
    frequencies_db : (M,) float64 or None
        The same of each frequency.
    noise_to_given : float or None
        Noise that solver "robust" finds over the noise given, medians of the frequencies: the factor in the words of
        the verdict model_mismatch. None without a given noise.
    """

    residual_to_noise: float
    leave_one_out_db: float | None = None
    microphones_db: np.ndarray | None = None
    frequencies_db: np.ndarray | None = None
    noise_to_given: float | None = None


@dataclass(frozen=True, eq=False)
class KnownRoom:
    """What solver "room" finds beside the positions.

    Attributes
    ----------
    size : tuple of D float
        Metres.
    source : (D,) float64
        Position of the source, metres.
    admittance : complex
        Specific admittance of the walls.
    symmetries : tuple of (str, (N, D) float64)
        Each array that the pressures cannot distinguish from the one found, which comes first: the map, such as
        "(6 - x, y)", and the positions, metres.
    """

    size: tuple[float, ...]
    source: np.ndarray
    admittance: complex
    symmetries: tuple[tuple[str, np.ndarray], ...]


def plain(value):
    """Return a value as JSON can hold it: arrays and tuples as lists."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    return list(value) if isinstance(value, tuple) else value


def evidence_table(evidence: Evidence | None) -> dict:
    """Return the keys of the evidence in a result file; none without it."""
    if evidence is None:
        return {}
    return {
        "residual_to_noise": evidence.residual_to_noise,
        "left_out_db": evidence.leave_one_out_db,
        "left_out_microphones_db": plain(evidence.microphones_db),
        "left_out_frequencies_db": plain(evidence.frequencies_db),
        "noise_to_given": evidence.noise_to_given,
    }


def evidence_of(table: dict) -> Evidence | None:
    """Return the evidence in the table of a result file; None where an older version wrote it."""
    if "residual_to_noise" not in table:
        return None
    names = ("left_out_db", "left_out_microphones_db", "left_out_frequencies_db", "noise_to_given")
    return Evidence(table["residual_to_noise"], *(table.get(name) for name in names))


def room_table(room: KnownRoom | None) -> dict:
    """Return the keys of the room in a result file; none without it."""
    if room is None:
        return {}
    return {
        "room": list(room.size),
        "symmetries": [{"map": name, "positions": positions.tolist()} for name, positions in room.symmetries],
        "source": room.source.tolist(),
        "admittance": [room.admittance.real, room.admittance.imag],
    }


def room_of(table: dict) -> KnownRoom | None:
    """Return the room in the table of a result file; None unless it is of solver "room"."""
    if "symmetries" not in table:
        return None
    size, walls = tuple(table["room"].tolist()), complex(*table["admittance"])
    return KnownRoom(size, table["source"], walls, tuple(table["symmetries"]))


@dataclass(frozen=True)
class ChannelFault:
    """What is wrong with a channel, or with the position given for it.

    Attributes
    ----------
    name : str
        Of the microphone.
    kind : str
        "inverted", "dead", "noisy", "delayed", "high_pass", "gain", "misplaced" or "exchanged", see
        `fdcal.assessment.odd_channels`.
    value : float or None
        Gain or noise over the median channel in decibels, phase in degrees, delay in seconds, corner frequency over
        that of the others in hertz, or distance from the given position in metres.
    unit : str
        Of the value: "dB", "degrees", "s", "Hz" or "m"; "" without a value.
    partner : str or None
        Name of the other microphone of an exchange.
    """

    name: str
    kind: str
    value: float | None = None
    unit: str = ""
    partner: str | None = None

    @property
    def text(self) -> str:
        """The fault in words.

        Examples
        --------
        >>> ChannelFault("17", "inverted").text
        'microphone 17: inverted'
        >>> ChannelFault("4", "delayed", 3e-4, "s").text
        'microphone 4: delayed by 0.3 ms'
        """
        value = self.value or 0.0
        words = {
            "noisy": f"noise {value:.0f} dB over the others'",
            "delayed": f"delayed by {1e3 * value:.2g} ms",
            "high_pass": f"high-pass at {value:.3g} Hz",
            "gain": f"phase {value:.0f} degrees" if self.unit == "degrees" else f"gain {value:+.1f} dB",
            "misplaced": f"{1e3 * value:.3g} mm from the position given",
            "exchanged": f"exchanged with microphone {self.partner}",
        }
        return f"microphone {self.name}: {words.get(self.kind, self.kind)}"


@dataclass(frozen=True, eq=False)
class Channels:
    """Gain and noise of every channel, and given positions as corrected, which solver "robust" finds.

    Attributes
    ----------
    gain_db, gain_sigma_db : (N,) float64
        Gain over that of the median channel and its one sigma, decibels.
    phase_deg, phase_sigma_deg : (N,) float64
        Phase against that of the median channel and its one sigma, degrees, from -180 to 180.
    noise_db : (N,) float64
        Noise over that of the median channel, decibels.
    faults : tuple of ChannelFault
        In the order of the microphones.
    given : tuple of GivenPosition
        Of the microphones whose positions were given, in their order.
    """

    gain_db: np.ndarray
    gain_sigma_db: np.ndarray
    phase_deg: np.ndarray
    phase_sigma_deg: np.ndarray
    noise_db: np.ndarray
    faults: tuple[ChannelFault, ...] = ()
    given: tuple[GivenPosition, ...] = ()

    def __post_init__(self):
        for key in CHANNEL_KEYS.values():
            object.__setattr__(self, key, frozen_array(getattr(self, key), float))

    @property
    def correction(self) -> ChannelCorrection:
        """Gains and noise as costs take them."""
        gains = 10 ** (self.gain_db / 20) * np.exp(1j * np.radians(self.phase_deg))
        return ChannelCorrection(gains, 10 ** (self.noise_db / 10))


UNITS = ("", "dB", "degrees", "s", "Hz", "m")  # of the value of a fault
CHANNEL_KEYS = {  # key in a result file, and attribute of `Channels`
    "channel_gain_db": "gain_db",
    "channel_gain_sigma_db": "gain_sigma_db",
    "channel_phase_deg": "phase_deg",
    "channel_phase_sigma_deg": "phase_sigma_deg",
    "channel_noise_db": "noise_db",
}


def channels_table(channels: Channels | None) -> dict:
    """Return the keys of the channels in a result file; none without them."""
    if channels is None:
        return {}
    table: dict = {key: plain(getattr(channels, name)) for key, name in CHANNEL_KEYS.items()}
    table["odd_channels"] = [fault.name for fault in channels.faults]
    return table | {"odd_channel_details": [asdict(fault) for fault in channels.faults]} | given_table(channels.given)


def channels_of(table: dict) -> Channels | None:
    """Return the channels in the table of a result file; None unless it is of a solver that finds them."""
    if "channel_gain_db" not in table:
        return None
    arrays = {name: table[key] for key, name in CHANNEL_KEYS.items()}
    faults = tuple(ChannelFault(**one) for one in table.get("odd_channel_details", ()))
    return Channels(**arrays, faults=faults, given=given_of(table))
