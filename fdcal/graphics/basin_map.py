"""The basins of attraction of a map in colours, with a legend of areas in place of a colour bar.

The basin of one place, such as the true position, has the first colour; the largest of the others have one each, and
those that remain share a grey. Dark lines separate basins, also where two of them are grey.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..cost.basins import OUTSIDE, Basins
from ..cost.maps import map_positions
from ..cost.scale import Minima
from ..model.settings import Search
from ..model.validation import frozen_array, length_text
from .heatmap import marks_of
from .primitives import Area, Colour, Floor, Surface
from .volume import AXES, Volume, plate_of

PLACE: Colour = (68, 170, 153)  # of the basin of one place
LARGEST: tuple[Colour, ...] = ((136, 204, 238), (221, 204, 119), (153, 68, 85), (108, 140, 213), (160, 120, 74))
OTHERS: Colour = (200, 200, 200)
EDGE: Colour = (246, 246, 246)  # of places from which descent ends at the edge of the map
BORDER: Colour = (30, 32, 38)  # between basins
PIXELS = 500  # at least, along the longer edge of the image
_OTHERS, _EDGE, _BORDER = 1 + len(LARGEST), 2 + len(LARGEST), 3 + len(LARGEST)
TABLE = np.array((PLACE, *LARGEST, OTHERS, EDGE, BORDER), np.uint8)
BYTES = np.array([1 << 16, 1 << 8, 1])  # of a colour in one number
NO_SURFACE = Surface(
    "isosurfaces", np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), np.zeros((0, 2), np.float32),
    np.zeros((1, 1, 4), np.uint8),
)  # fmt: skip


@dataclass(frozen=True)
class BasinImage:
    """A map of basins as numbers of colours of TABLE."""

    numbers: np.ndarray  # (h, w) uint8, row 0 at low y
    areas: tuple[Area, ...]  # of the legend, in its order


def basin_image(basins: Basins, here: int, name: str, labels: np.ndarray | None = None) -> BasinImage:
    """Return the colours of basins and what they stand for; `labels` (h, w) are of a slice through a volume.

    `here`: the basin that has the first colour, of the place `name`; OUTSIDE for no such basin.
    """
    labels = basins.labels if labels is None else labels
    finer = -(-PIXELS // max(labels.shape))
    labels = labels.repeat(finer, axis=0).repeat(finer, axis=1)
    shares = basins.shares
    by_size = [int(k) for k in np.argsort(-shares, kind="stable") if k != here and shares[k] > 0]
    table = np.full(len(basins.minima) + 1, _OTHERS, np.uint8)  # its last entry is that of OUTSIDE
    table[by_size[: len(LARGEST)]] = np.arange(1, 1 + len(by_size[: len(LARGEST)]))
    table[OUTSIDE] = _EDGE
    if here != OUTSIDE:
        table[here] = 0
    border = np.zeros(labels.shape, bool)
    border[:, 1:] |= labels[:, 1:] != labels[:, :-1]
    border[1:] |= labels[1:] != labels[:-1]
    numbers = np.where(border, np.uint8(_BORDER), table[labels])
    return BasinImage(numbers, _areas(basins, by_size, None if here == OUTSIDE else here, name))


def table_numbers(rgb: np.ndarray) -> np.ndarray:
    """Return the numbers (h, w) uint8 of the colours of an image (h, w, 3) of basins: a third of the memory."""
    keys = TABLE @ BYTES
    order = np.argsort(keys)
    return order[np.searchsorted(keys[order], rgb @ BYTES)].astype(np.uint8)


def _areas(basins: Basins, by_size: Sequence[int], here: int | None, name: str) -> tuple[Area, ...]:
    """The legend: the basin of the place, the largest of the others, all that remain, and the edge."""
    shares, own, rest = basins.shares, by_size[: len(LARGEST)], by_size[len(LARGEST) :]
    areas = [] if here is None else [Area("basins/place", f"basin of the {name} {_percent(shares[here])}", PLACE)]
    for i, (k, colour) in enumerate(zip(own, LARGEST, strict=False)):
        areas.append(Area(f"basins/{i}", f"basin {_percent(shares[k])}", colour))
    if rest:
        text = f"{len(rest)} other{'s' if len(rest) > 1 else ''} {_percent(shares[rest].sum())}"
        areas.append(Area("basins/others", text, OTHERS))
    if basins.outside:
        areas.append(Area("basins/edge", f"leaves the map {_percent(basins.outside)}", EDGE))
    return tuple(areas)


def basin_floor(
    basins: Basins, search: Search, minima: Minima, place=None, name: str = "true position", height: float = 0.0
) -> Floor:
    """Return the map of basins of attraction, the first colour for that of `place` (2,), metres, if it is given."""
    image = basin_image(basins, OUTSIDE if place is None else basins.at(search, place), name)
    half, (ny, nx) = search.step / 2, basins.labels.shape
    lowest, others = marks_of(minima)
    return Floor(
        rgb=frozen_array(TABLE[image.numbers], np.uint8),
        origin=(search.origin[0] - half, search.origin[1] - half),
        size=(nx * search.step, ny * search.step),
        bar=None,
        lowest=lowest,
        height=height,
        minima=others,
        areas=image.areas,
    )


def basin_slice(
    basins: Basins,
    search: Search,
    axis: str,
    position: float,
    minima: Minima,
    place=None,
    name: str = "true position",
) -> Volume:
    """Return a slice through the basins of attraction in space, without isosurfaces.

    `basins`: of the volume; `search`: lattice of the volume; `axis`: "x", "y" or "z", across the slice; any other word
    for no slice; `position`: along that axis, metres; beyond the lattice, its edge; `minima`: to be marked; `place`
    (3,) float64, metres, whose basin has the first colour; None for no such basin; `name`: of that place.
    """
    if axis not in AXES:
        return Volume(NO_SURFACE, None, None, (), minima)
    number, domain = AXES.index(axis), np.stack([search.origin, np.add(search.origin, search.size)])
    at = int(np.clip(np.rint((position - domain[0][number]) / search.step), 0, basins.labels.shape[2 - number] - 1))
    labels = basins.labels.take(at, axis=2 - number)
    image = basin_image(basins, OUTSIDE if place is None else basins.at(search, place), name, labels)
    edges = domain + np.multiply([[-0.5], [0.5]], search.step)
    plate = plate_of(TABLE[image.numbers], number, domain[0][number] + at * search.step, edges)
    return Volume(NO_SURFACE, plate, None, (), minima, image.areas)


def descent_text(basins: Basins, search: Search, place, name: str = "true position") -> str:
    """Return where descent from a place (2,), metres, ends, and how much of the map its basin holds, in words."""
    here = basins.at(search, place)
    if here == OUTSIDE:
        return f"descent from the {name} leaves the map"
    end = map_positions(basins.minima[[here]], search)[0]
    away = float(np.linalg.norm(end - np.asarray(place, float)[: len(end)]))
    distance = f"{length_text(away)} away" if away > search.step else f"within {length_text(search.step)}"
    return f"descent from the {name} ends {distance}; its basin holds {_percent(basins.shares[here])} of the map"


def _percent(fraction: float) -> str:
    """As "12 %", and "0.3 %" below one."""
    percent = 100 * float(fraction)
    return f"{percent:.0f} %" if percent >= 1 else f"{percent:.1g} %" if percent >= 0.1 else "below 0.1 %"
