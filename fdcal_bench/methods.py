"""Methods to compare with: the coherence of a diffuse field, arrival times, and fdcal itself.

Coherence: I. McCowan, M. Lincoln, I. Himawan, "Microphone Array Shape Calibration in Diffuse Noise Fields", IEEE TASLP
16(3), 2008: the real part of the coherence of each pair, fitted by sinc(2 f d / c). Robust multidimensional scaling:
P. Forero, G. Giannakis, "Sparsity-Exploiting Robust Multidimensional Scaling", IEEE TSP 60(8), 2012: distances with
sparse outliers, stress majorisation. Time differences: C. Knapp, G. Carter, "The Generalized Correlation Method for
Estimation of Time Delay", IEEE TASSP 24(4), 1976.
"""

import tempfile
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import csd, resample_poly, stft
from scipy.spatial.distance import pdist, squareform

FINE = 16  # points per sample of an arrival time
FIRST = 0.5  # least level of the direct sound, as a fraction of the greatest value of a response
DECAYED = 0.03  # power relative to the first segment, below which segments are not used
TIMING = 0.003  # m, scatter of an arrival time times the sound speed; larger residuals count less


def cross_spectra(recorded, rate: float, segment: int, decays: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies (F,), Hz, and Welch's cross-spectra (N, N, F) of recordings (N, T).

    decays : whether the recordings are responses; segments down to 15 dB below the first then have equal weight
    """
    f, _, X = stft(recorded, fs=rate, nperseg=segment, boundary=None, padded=False, axis=1)  # pyright: ignore[reportArgumentType]
    if decays:
        power = np.mean(np.abs(X) ** 2, axis=0)
        loud = power.sum(axis=0) > DECAYED * power[:, 0].sum()
        X = X[:, :, loud] / np.sqrt(power[:, loud])
    X = X.transpose(1, 0, 2)
    return f, (X @ X.conj().transpose(0, 2, 1)).transpose(1, 2, 0)


def coherence(spectra) -> np.ndarray:
    """Return the real part of the coherence (N, N, F) of cross-spectra (N, N, F)."""
    power = np.real(np.einsum("nnf->nf", spectra))
    return np.real(spectra) / np.sqrt(power[:, None] * power[None])


def distances_of_coherence(gamma, frequencies, speed: float, longest: float = 1.5, step: float = 0.001) -> np.ndarray:
    """Return the distances (N, N), metres, at which sinc(2 f d / c) fits the coherence (N, N, F) best.

    All distances up to `longest` are tried, because the misfit has local minima; a parabola refines the best one.
    """
    N = len(gamma)
    pairs = gamma[np.triu_indices(N, 1)]
    tried = step * np.arange(1, int(longest / step) + 1)
    curves = np.sinc(2 * tried[:, None] * frequencies / speed)
    misfit = np.sum(curves**2, axis=1) - 2 * pairs @ curves.T
    best = np.clip(np.argmin(misfit, axis=1), 1, len(tried) - 2)
    left, middle, right = (misfit[np.arange(len(pairs)), best + n] for n in (-1, 0, 1))
    bend = np.maximum(left - 2 * middle + right, np.finfo(float).tiny)
    return squareform(tried[best] + step * np.clip(0.5 * (left - right) / bend, -1, 1))


def robust_scaling(distances, dimension: int = 3, rounds: int = 1000) -> np.ndarray:
    """Return positions (N, D), metres, about the origin, from distances (N, N), some of which are wrong.

    Stress majorisation begins with classical scaling. The part of a residual beyond 2.5 times the scatter of all
    residuals counts as an outlier and is subtracted from the distance.
    """
    N = len(distances)
    centre = np.eye(N) - 1 / N
    values, vectors = np.linalg.eigh(-0.5 * centre @ distances**2 @ centre)
    x = vectors[:, -dimension:] * np.sqrt(np.maximum(values[-dimension:], 0))
    for _ in range(rounds):
        between = squareform(pdist(x))
        residual = distances - between
        limit = 2.5 * 1.4826 * np.median(np.abs(squareform(residual, checks=False)))
        clean = distances - np.sign(residual) * np.maximum(np.abs(residual) - limit, 0)
        ratio = clean / (between + np.eye(N))
        x = (ratio.sum(axis=1)[:, None] * x - ratio @ x) / N
    return x


def first_arrivals(responses, rate: float) -> np.ndarray:
    """Return the times (N,), s, of the direct sound in impulse responses (N, T): the first high peak."""
    fine = np.abs(resample_poly(responses, FINE, 1, axis=1))
    times = np.empty(len(fine))
    for n, h in enumerate(fine):
        inner = h[1:-1]
        peaks = np.flatnonzero((inner >= h[:-2]) & (inner > h[2:]) & (inner > FIRST * h.max())) + 1
        times[n] = peaks[0] / (FINE * rate)
    return times


def time_differences(recorded, rate: float, longest: float, segment: int = 2048) -> np.ndarray:
    """Return the delays (N,), s, of recordings (N, T) against the first: generalised correlation, phase transform.

    longest : s, the greatest delay that is tried
    """
    _, cross = csd(recorded[:1], recorded, fs=rate, nperseg=segment, detrend=False)  # pyright: ignore[reportArgumentType]
    whitened = cross / np.maximum(np.abs(cross), np.finfo(float).tiny)
    correlation = np.fft.irfft(whitened, FINE * segment, axis=1)
    reach = int(np.ceil(longest * rate * FINE))
    tried = np.arange(-reach, reach + 1)
    return tried[np.argmax(correlation[:, tried], axis=1)] / (FINE * rate)


def positions_of_arrivals(times, sources, speed: float, sigma: float, centre) -> np.ndarray:
    """Return positions (N, 3), metres, from arrival times (S, N) of S sources whose positions are roughly known.

    Source positions and times of emission are estimated with the microphones, by robust least squares.

    Parameters
    ----------
    times : (S, N) float64, s, each row up to a constant
    sources : (S, 3) float64, metres, as measured
    speed : m/s
    sigma : metres, standard deviation of each coordinate of `sources`
    centre : (3,) float64, metres, about where the array is
    """
    S, N = times.shape
    sizes = np.cumsum([3 * N, 3 * S])

    def residuals(unknown):
        x, s, emitted = np.split(unknown, sizes)
        x, s = x.reshape(N, 3), s.reshape(S, 3)
        path = np.linalg.norm(s[:, None] - x, axis=-1) + emitted[:, None]
        return np.concatenate([((path - speed * times) / TIMING).ravel(), ((s - sources) / sigma).ravel()])

    places = np.tile(centre, (N, 1))
    emitted = np.mean(speed * times, axis=1) - np.linalg.norm(sources - centre, axis=1)
    start = np.concatenate([places.ravel(), np.ravel(sources), emitted])
    for loss in ("linear", "soft_l1"):
        start = least_squares(residuals, start, loss=loss, x_scale="jac", max_nfev=60).x
    return start[: 3 * N].reshape(N, 3)


STARTS = 5  # number of starts from arrival times alone
FEWEST = {2: 3, 3: 6}  # least number of takes by the dimension of an array; with fewer, an affine map is undetermined
DISTANCE = 2.0  # m, of the sources from the array in a start


def blind_positions_of_arrivals(times, speed: float, dimension: int, rng) -> np.ndarray | None:
    """Return positions (N, D), metres, from arrival times (S, N) alone; None where these do not determine them.

    Positions, sources and times of emission are fitted by robust least squares. A start assumes plane waves from random
    directions, which give its positions; of several results, the most likely one is returned. The sources of a plane
    array are sought in its plane, since their heights cannot be distinguished from its size.

    times : s, each row up to a constant; speed : m/s; dimension : D, 2 of an array that is known to be plane;
    rng : numpy.random.Generator
    """
    (S, N), D = np.shape(times), dimension
    if S * N <= D * N + (D + 1) * S - D * (D + 1) / 2 or S < FEWEST[D]:
        return None
    sizes, paths = np.cumsum([D * N, D * S]), speed * np.asarray(times)
    paths = paths - paths.mean(axis=1, keepdims=True)
    take, microphone = np.repeat(np.arange(S), N), np.tile(np.arange(N), S)
    each, axes = np.arange(S * N), np.arange(D)

    def away(unknown):
        x, s, emitted = np.split(unknown, sizes)
        x, s = x.reshape(N, D), s.reshape(S, D)
        return s[:, None] - x, s, emitted

    def residuals(unknown):
        apart, s, emitted = away(unknown)
        path = np.linalg.norm(apart, axis=-1) - np.linalg.norm(s, axis=1)[:, None] + emitted[:, None]
        return ((path - paths) / TIMING).ravel()

    def jacobian(unknown):
        apart, s, _ = away(unknown)
        towards = (apart / np.linalg.norm(apart, axis=-1, keepdims=True)).reshape(-1, D)
        J = np.zeros((S * N, len(unknown)))
        J[each[:, None], D * microphone[:, None] + axes] = -towards
        J[each[:, None], sizes[0] + D * take[:, None] + axes] = towards - (s / np.linalg.norm(s, axis=1)[:, None])[take]
        J[each, sizes[1] + take] = 1.0
        return J / TIMING

    best, least = None, np.inf
    for _ in range(STARTS):
        direction = rng.standard_normal((S, D))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        x = np.linalg.lstsq(-direction, paths, rcond=1e-3)[0].T
        start = np.concatenate([x.ravel(), DISTANCE * direction.ravel(), np.zeros(S)])
        for loss in ("linear", "soft_l1"):
            end = least_squares(residuals, start, jacobian, loss=loss, x_scale="jac", max_nfev=60)
            start = end.x
        if end.cost < least:
            best, least = start[: D * N].reshape(N, D), end.cost
    return best


BAND = (50.0, 2000.0)  # Hz, of the coherence
SEGMENT = {"noise": 512, "speech": 512, "impulse": 128}  # samples at 8 kHz, of the coherence
TAIL = 0.005  # s after the direct sound, where the coherence of a response begins
LARGEST = 1.0  # m, largest size of an array whose arrivals are compared
SOURCE_SIGMA = 0.05  # m, standard deviation of each coordinate of a source


def fdcal(recordings, rate, *, kind, speed, sources):
    """Return what fdcal finds with its default settings, from sound files."""
    import fdcal as own

    try:
        found = own.calibrate(_measurement(recordings, rate, kind, speed), known="none")
    except own.InputError:  # the recordings cannot be calibrated
        return None
    return found.positions, found.uncertainty


def _measurement(recordings, rate, kind, speed):
    """Return the measurement that fdcal imports from recordings."""
    import soundfile

    import fdcal as own

    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"take{n}.wav" for n in range(len(recordings))]
        for path, samples in zip(paths, recordings, strict=True):
            soundfile.write(path, 0.5 * samples.T / np.abs(samples).max(), rate, subtype="FLOAT")
        return own.load(paths, kind="impulse" if kind == "impulse" else "stationary", sound_speed=speed)


def by_coherence(recordings, rate, *, kind, speed, sources, dimension=3):
    """Return the positions from coherence and robust scaling; `dimension` is 2 for an array known to be plane."""
    total, f = 0.0, np.zeros(0)
    for samples in recordings:
        if kind == "impulse":
            samples = samples[:, int(rate * (first_arrivals(samples, rate).max() + TAIL)) :]
        f, spectra = cross_spectra(samples, rate, SEGMENT[kind] * max(1, rate // 8000), kind == "impulse")
        total = total + spectra / np.real(np.einsum("nnf->f", spectra))
    used = (f >= BAND[0]) & (f <= BAND[1])
    distances = distances_of_coherence(coherence(total)[..., used], f[used], speed)
    return robust_scaling(distances, dimension), None


def by_arrivals(recordings, rate, *, kind, speed, sources):
    """Return the positions that follow from arrival times and measured positions of the source."""
    if sources is None:
        return None
    impulse = kind == "impulse"
    times = [first_arrivals(one, rate) if impulse else time_differences(one, rate, LARGEST / speed)
             for one in recordings]  # fmt: skip
    centre = np.mean(sources, axis=0)
    return positions_of_arrivals(np.array(times), sources, speed, SOURCE_SIGMA, centre), None


def diffuse_bound(case) -> float:
    """Return the Cramer-Rao bound of a case, millimetres: a diffuse field at the frequencies and noise that fdcal uses.

    NaN for impulses, whose arrival times contain more information than their field.
    """
    from fdcal.assessment.uncertainty import Prior, diffuse_information, position_bound
    from fdcal.model.problem import mode_power

    if case.kind == "impulse":
        return float("nan")
    found = _measurement(case.recordings, case.rate, case.kind, case.speed)
    noise = float(np.median(found.noise_power / mode_power(found.pressures)))
    return 1e3 * position_bound(diffuse_information(case.truth, np.real(found.wavenumbers), noise, 3), Prior()).rms


TAPE = 0.005  # m, standard deviation of each coordinate measured with a tape


def tape_error(case) -> float:
    """Return the RMS error that positions (N, D) measured with a tape have on average, millimetres.

    The best rigid motion removes D translations and D (D - 1) / 2 rotations from the N D errors.
    """
    N, D = case.truth.shape
    return 1e3 * TAPE * float(np.sqrt(D - D * (D + 1) / (2 * N)))


REFERENCE_METHODS = {"fdcal": fdcal, "coherence": by_coherence, "arrival times": by_arrivals}
