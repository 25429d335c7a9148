"""The scale of a map: its colours, and the round values beside them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from matplotlib.ticker import LogLocator

from .glyphs import round_ticks

COLOUR_MAP = "viridis"  # of matplotlib.colormaps, for costs
DIVERGING_COLOUR_MAP = "RdBu_r"  # likewise, for fields of both signs
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
BAR_LENGTH = 44  # characters that fit along a colour bar


@dataclass(frozen=True)
class ColourBar:
    """The scale of a map."""

    # low, high: values of the first and of the last colour
    low: float
    high: float
    log: bool  # whether the scale is logarithmic
    label: str  # name and unit
    clipped: bool = False  # whether lower values than `low` exist, which share its colour
    colour_map: str = COLOUR_MAP  # of matplotlib.colormaps

    @property
    def ticks(self) -> tuple[tuple[float, str], ...]:
        """Fraction of the bar's length, 0 to 1, and text of about five round values."""
        if not self.log:
            values = round_ticks(self.low, self.high, 5)
            span = self.high - self.low
            return _without_overlaps((float((v - self.low) / span), format_number(v, 4)) for v in values)
        decades = np.log10(self.high / self.low)
        values = self._round_values((1.0, 2.0, 5.0) if decades <= 3 else (1.0,))
        if len(values) > 6 and 2 < decades <= 3:
            values = self._round_values((1.0, 3.0))
        if decades <= 2 and not 3 <= len(values) <= 6:  # within a decade the locator may return as many as ten
            even = round_ticks(self.low, self.high, 4)
            values = even[even >= self.low]
        digits = 3 if decades > 0.05 else 5
        return _without_overlaps((float(np.log10(v / self.low) / decades), format_number(v, digits)) for v in values)

    def _round_values(self, mantissas: tuple[float, ...]) -> np.ndarray:
        """Return the values of the scale that are one of the mantissas times a power of ten."""
        values = np.asarray(LogLocator(subs=mantissas).tick_values(self.low, self.high))
        return values[(values >= self.low * (1 - 1e-9)) & (values <= self.high * (1 + 1e-9))]


def format_number(value: float, digits: int) -> str:
    """Return a number with so many significant digits.

    Whole numbers up to a million are written in full, very large and very small numbers as in "2·10⁷".
    """
    if 10.0**digits <= abs(value) < 1e6:
        return f"{value:.0f}"
    mantissa, _, power = f"{value:.{digits}g}".partition("e")
    if not power:
        return mantissa
    return ("" if mantissa == "1" else f"{mantissa}·") + f"10{str(int(power)).translate(SUPERSCRIPTS)}"


def _without_overlaps(ticks: Iterable[tuple[float, str]]) -> tuple[tuple[float, str], ...]:
    """The ticks without those whose text would touch the text before."""
    kept: list[tuple[float, str]] = []
    for fraction, text in ticks:
        if not kept or (fraction - kept[-1][0]) * BAR_LENGTH >= (len(text) + len(kept[-1][1])) / 2 + 2:
            kept.append((fraction, text))
    return tuple(kept)
