"""Array shapes, and which microphones of an array are known."""

import numpy as np

CLOSEST = 0.012  # metres between two microphones; closer ones are moved


def _circle(count, radius, rng):
    return radius * _unit(2 * np.pi * (np.arange(count) + rng.random()) / count)


def _grid(count, radius, rng):
    side = np.linspace(-radius, radius, int(np.ceil(np.sqrt(count)))) / np.sqrt(2) * 1.2
    return np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)[:count]


def _disc(count, radius, rng):
    r = radius * np.sqrt(rng.random(count))
    return r[:, None] * _unit(2 * np.pi * rng.random(count))


def _clusters(count, radius, rng):
    x = 0.1 * rng.standard_normal((count, 2))
    x[: count // 2, 0] -= 0.5
    x[count // 2 :, 0] += 0.5
    return x * (2 * radius / 1.2)


def _line(count, radius, rng):
    return np.c_[rng.uniform(-radius, radius, count), rng.uniform(-radius, radius, count) / 20]


def _elongated(count, radius, rng):
    return np.c_[rng.uniform(-radius, radius, count), rng.uniform(-radius, radius, count) / 3]


def _spiral(count, radius, rng):
    t = np.linspace(0.15, 1, count)
    return radius * t[:, None] * _unit(5 * np.pi * t)


def _outlier(count, radius, rng):
    x = geometry("disc", count, 2 * radius / 3, rng)
    x[-1] = 0.9 * radius * _unit(np.array([2 * np.pi * rng.random()]))[0]
    return x


PLANE_SHAPES = {
    "circle": _circle,
    "grid": _grid,
    "disc": _disc,
    "clusters": _clusters,
    "line": _line,
    "elongated": _elongated,
    "spiral": _spiral,
    "outlier": _outlier,
}


def _space_shape(kind: str, count: int, radius: float, rng) -> np.ndarray:
    v = rng.standard_normal((count, 3))
    v /= np.linalg.norm(v, axis=1)[:, None]
    if kind == "sphere":
        return radius * v
    if kind == "ball":
        return radius * v * rng.random((count, 1)) ** (1 / 3)
    if kind == "cube":
        side = np.linspace(-radius, radius, int(np.ceil(count ** (1 / 3)))) / np.sqrt(3) * 1.3
        lattice = np.stack(np.meshgrid(side, side, side), -1).reshape(-1, 3)
        return lattice[rng.permutation(len(lattice))[:count]]
    if kind == "shell":  # a hemisphere
        x = radius * v
        x[:, 2] = np.abs(x[:, 2])
        return x
    if kind == "slab":
        return rng.uniform(-radius, radius, (count, 3)) * [0.8, 0.8, 0.16]
    if kind == "plane":
        return geometry("disc", count, 2 * radius, rng)
    if kind == "line3":
        return rng.uniform(-radius, radius, (count, 3)) * [1, 0.05, 0.05]
    raise ValueError(f"no array shape {kind!r}")


def geometry(kind: str, count: int, size: float, rng, dimension: int = 2) -> np.ndarray:
    """Return a centred and turned array of about `size` metres across : (N, 2) or (N, 3) float64, metres.

    "plane" in three dimensions gives two coordinates: the array lies in a horizontal plane.
    """
    radius = size / 2
    shape = PLANE_SHAPES[kind](count, radius, rng) if dimension == 2 else _space_shape(kind, count, radius, rng)
    x = _apart(shape, rng)
    cosine, sine = _unit(np.array([rng.uniform(0, 2 * np.pi)]))[0]
    if x.shape[1] == 2 and kind != "plane":
        x = x @ np.array([[cosine, -sine], [sine, cosine]])
    if x.shape[1] == 3:
        x = x @ np.linalg.qr(rng.standard_normal((3, 3)))[0]
    return x - x.mean(axis=0)


def _apart(x: np.ndarray, rng) -> np.ndarray:
    for _ in range(50):
        distance = np.linalg.norm(x[:, None] - x[None], axis=-1) + 9 * np.eye(len(x))
        close = np.flatnonzero(distance.min(axis=1) < CLOSEST)
        if not len(close):
            break
        x[close] += 0.01 * rng.standard_normal((len(close), x.shape[1]))
    return x


def _unit(angle: np.ndarray) -> np.ndarray:
    return np.c_[np.cos(angle), np.sin(angle)]


def spread_known(x: np.ndarray, count: int, rng) -> np.ndarray:
    """Return `count` microphones far from one another, the third off the line of the first two : (A,) int64."""
    chosen = [int(rng.integers(len(x)))]
    while len(chosen) < count:
        distance = np.linalg.norm(x[:, None] - x[chosen][None], axis=-1).min(axis=1)
        if len(chosen) == 2:
            direction = x[chosen[1]] - x[chosen[0]]
            direction /= np.linalg.norm(direction)
            apart = x - x[chosen[0]]
            distance = np.linalg.norm(apart - np.outer(apart @ direction, direction), axis=1)
        distance[chosen] = -1
        chosen.append(int(distance.argmax()))
    return np.sort(chosen)
