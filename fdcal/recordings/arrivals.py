"""When the direct sound of an impulse response arrives at each microphone, relative to the others.

    first     the first high peak of the response. It reaches all microphones within the time that sound takes across
              the array
    template  what all microphones have in common within a short window about that peak: the leading singular vector of
              the aligned windows. It includes the effects of an extended source, of the channels' filters and of the
              band of the recording, so that no shape is assumed
    time      the lag, interpolated between samples, at which the window correlates best with the template (Knapp and
              Carter, "The Generalized Correlation Method for Estimation of Time Delay", IEEE TASSP 24(4), 1976)

A microphone has no arrival (NaN) if its window differs from the template, or if an earlier peak is nearly as high. A
reflection within the window shifts the time by about

    sigma = a sqrt(1 - rho^2) / rho / B

which is the standard deviation of a maximum likelihood estimate at the ratio of signal to interference that rho
implies. A solver begins with this sigma and estimates the actual one.

    rho    correlation of the window with the template
    B      angular RMS bandwidth of the template
    a      fraction of the difference between window and template that has the effect of a shift
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import resample_poly


@dataclass(frozen=True)
class ArrivalRules:
    """How arrivals are found."""

    fine: int = 16  # points per sample
    first: float = 0.4  # least peak of the direct sound, as a fraction of the highest peak
    # before, after: lengths of the window before and after a peak, in samples, but each at least `min_window` seconds
    before: float = 4.0
    after: float = 4.0
    min_window: float = 2.5e-4  # seconds, shortest part before or after a peak
    taper: float = 0.5  # fraction of the window, at either end, over which it rises and falls
    quiet: float = 2.0  # least ratio of the peak to the largest amplitude before its window
    min_correlation: float = 0.7  # least correlation of a window with the template
    span: float = 0.02  # seconds, largest difference of an arrival from the median, as in an array of some metres
    rounds: int = 4  # number of iterations in which template and times are found
    # `a` of the equation above. With a = 1, sigma would be 1.1 mm where the errors are 0.3 mm (rooms of image sources),
    # and 1.3 mm where they are 0.4 mm (a measured array)
    shifted: float = 0.4
    min_sigma: float = 3e-4  # least sigma of an arrival, as a path length in metres
    speed: float = 343.0  # m/s; `min_sigma` divided by it is a time


DIRECT_SOUND = ArrivalRules()


def first_arrivals(responses: np.ndarray, rate: float) -> tuple[np.ndarray, float] | None:
    """Return the arrivals (N,) of the direct sound of impulse responses, and their sigma, seconds; None if it is weak.

    `responses` (N, T) at a sampling `rate`, Hz. Times are relative to the earliest arrival; NaN where a channel has
    none.
    """
    N, T = responses.shape
    peak = np.abs(responses).max(axis=1)
    first = np.array([np.argmax(np.abs(h) > DIRECT_SOUND.first * top) for h, top in zip(responses, peak, strict=True)])
    margin = int(rate * max(DIRECT_SOUND.min_window, 1e-3)) + 40
    low = max(0, int(np.median(first)) - int(rate * DIRECT_SOUND.span) - margin)
    high = min(T, int(np.median(first)) + int(rate * DIRECT_SOUND.span) + margin)
    fine = resample_poly(responses[:, low:high], DIRECT_SOUND.fine, 1, axis=1)
    step = 1 / (DIRECT_SOUND.fine * rate)
    at = np.full(N, np.nan)  # points of `fine`
    for n, a in enumerate(np.abs(fine)):
        inner = a[1:-1]
        tops = np.flatnonzero((inner >= a[:-2]) & (inner > a[2:]) & (inner > DIRECT_SOUND.first * peak[n]))
        at[n] = tops[0] + 1 if len(tops) else np.nan
    ends = DIRECT_SOUND.before, DIRECT_SOUND.after
    before, after = (int(max(n / rate, DIRECT_SOUND.min_window) / step) for n in ends)
    t = np.arange(-before, after + 1)
    edge = np.where(t < 0, (before + t) / before, (after - t) / after) / DIRECT_SOUND.taper
    window = np.sin(np.pi / 2 * np.clip(edge, 0.0, 1.0)) ** 2
    found = np.isfinite(at) & (at > before) & (at < fine.shape[1] - after - 1)
    if np.sum(found) < 3:
        return None
    at = np.where(found, at, before)
    pad = 2 * int(DIRECT_SOUND.fine)  # an arrival lies less than two samples from its peak
    correlation, template = np.zeros(N), np.zeros(len(window))
    for _ in range(DIRECT_SOUND.rounds):
        cut = np.array([_cut(h, t, before, after) for h, t in zip(fine, at, strict=True)]) * window
        unit = cut / np.maximum(np.linalg.norm(cut, axis=1), np.finfo(float).tiny)[:, None]
        template = np.linalg.svd(unit[found], full_matrices=False)[2][0]
        for n in np.flatnonzero(found):
            at[n], correlation[n] = _best_lag(fine[n], at[n], template * window, window, before, after, pad)
    for n, a in enumerate(np.abs(fine)):  # the peak must stand out from everything before its window
        first = max(int(at[n]) - before, 0)
        highest = a[first : int(at[n]) + before].max()
        found[n] &= highest > DIRECT_SOUND.quiet * a[:first].max(initial=0.0)
    found &= correlation > DIRECT_SOUND.min_correlation
    found &= np.abs(at - np.median(at[found]) if np.any(found) else at) * step < DIRECT_SOUND.span
    if np.sum(found) < max(3, N // 2):
        return None
    rho = float(np.median(correlation[found]))
    bandwidth = np.linalg.norm(np.gradient(template, step)) / np.linalg.norm(template)
    sigma = DIRECT_SOUND.shifted * np.sqrt(max(1 - rho**2, 0.0)) / rho / bandwidth
    times = np.where(found, at * step, np.nan)
    return times - np.nanmin(times), float(max(sigma, DIRECT_SOUND.min_sigma / DIRECT_SOUND.speed))


def _cut(h: np.ndarray, at: float, before: int, after: int) -> np.ndarray:
    """Return samples of h from `before` points before `at` to `after` points after it, interpolated linearly."""
    first = int(np.floor(at))
    part, weight = h[first - before : first + after + 2], at - first
    return (1 - weight) * part[:-1] + weight * part[1:]


def _best_lag(h, at: float, template, window, before: int, after: int, pad: int) -> tuple[float, float]:
    """Return the point at which windowed samples correlate best with the template, and the correlation there."""
    lags = np.arange(-pad, pad + 1)
    lags = lags[(at + lags > before) & (at + lags < len(h) - after - 2)]
    if len(lags) < 3:
        return at, 0.0
    cuts = np.array([_cut(h, at + lag, before, after) for lag in lags])
    values = np.abs(cuts @ template) / np.maximum(np.linalg.norm(cuts * window, axis=1), np.finfo(float).tiny)
    best = int(np.clip(np.argmax(values), 1, len(lags) - 2))
    left, middle, right = values[best - 1 : best + 2]
    curvature = left - 2 * middle + right
    shift = 0.5 * (left - right) / curvature if curvature < 0 else 0.0
    return float(at + lags[best] + np.clip(shift, -1, 1)), float(values[best])
