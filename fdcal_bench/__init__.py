"""A benchmark for the calibration of microphone arrays: recordings with known positions, on which methods are compared.

    def method(recordings, rate, *, kind, speed, sources):
        ...
        return positions, sigma

recordings  list of arrays (N, T), one take each: the same microphones, the source at another place
rate        Hz
kind        "noise", "speech" or "impulse": what the source plays
speed       speed of sound, m/s
sources     (S, 3) float64, metres, positions of the source as measured with a tape, each coordinate to 5 cm; None if
            they were not measured
positions   (N, 3) float64, metres, in any axes
sigma       (N,) float64, metres, the method's own one sigma of each position, root of the sum over the coordinates;
            or None

A method that does not handle a case returns None, or None for both.

`fdcal-bench run module:method` prints a table of its errors beside the reference results. `fdcal study` runs many
simulated calibrations (`study`, `draw`, `tasks`, `run`) and draws what they found (`statistics`, `report`).
"""

from .cases import Case, cases
from .scores import Score, score

__all__ = ["Case", "Score", "cases", "score"]
