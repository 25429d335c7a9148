"""The cost of one microphone in space: nested isosurfaces and a slice, independent of a renderer.

    isosurface      where values on a lattice equal a level, by VTK's flying edges
    Volume          isosurfaces and slice, with the scale of their colours and the minima
    levels_of       round levels of cost for the isosurfaces
    volume_of       a Volume of costs on a lattice, still without a slice
    slice_of        a slice in the colours of a Volume
    brightened      a Volume for a dark page
    sampled_volume  values and minima on a lattice of the whole domain
    sliced          these with a slice across an axis
    basin_slice     a slice through the basins of attraction, without isosurfaces

The colours hold the shading of the surfaces, so that they look alike in any renderer, which adds no light.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..cost.maps import CostVolume, area, minima_of
from ..cost.scale import OUTSIDE, Minima
from ..model.settings import Search
from ..model.validation import frozen_array
from .glyphs import round_ticks
from .heatmap import TABLE, WHOLE, basin_image, colour_limits, normalise, to_rgb
from .primitives import Area, ColourBar, Plate, Surface

if TYPE_CHECKING:
    from ..cost.basins import Basins  # with compiled code, which a volume of costs does not need


def isosurface(values: np.ndarray, search: Search, level: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return vertices (V, 3), metres, faces (F, 3) and normals (V, 3), uphill, of where values equal a level.

    What is lower is enclosed: where it goes on beyond the lattice, the surface is closed there.
    """
    if level > values.max():
        return np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 3))
    # VTK takes a third of a second to load, so only a page with isosurfaces does
    import vtkmodules.util.numpy_support as arrays
    import vtkmodules.vtkCommonDataModel as vtk_data
    import vtkmodules.vtkFiltersCore as vtk_core

    closed = np.pad(np.asarray(values, float), 1, constant_values=float(values.max()) + BEYOND)
    low = np.array(search.origin)
    image = vtk_data.vtkImageData()
    image.SetDimensions(*closed.shape[::-1])
    image.SetOrigin(*(low - search.step))
    image.SetSpacing(search.step, search.step, search.step)
    flat = np.ascontiguousarray(closed).ravel()
    image.GetPointData().SetScalars(arrays.numpy_to_vtk(flat))
    contour = vtk_core.vtkFlyingEdges3D()
    contour.SetInputData(image)
    contour.SetValue(0, float(level))
    contour.ComputeNormalsOn()
    contour.ComputeScalarsOff()
    contour.Update()
    found = contour.GetOutput()
    if not found.GetNumberOfPolys():
        return np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 3))
    vertices = arrays.vtk_to_numpy(found.GetPoints().GetData()).astype(float)
    faces = arrays.vtk_to_numpy(found.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(int)
    normals = arrays.vtk_to_numpy(found.GetPointData().GetNormals()).astype(float)
    vertices = np.clip(vertices, low, low + search.step * (np.array(values.shape[::-1]) - 1))
    return vertices, faces, -normals  # VTK's point towards lower values


AXES = "xyz"
MAX_LEVELS = 4  # isosurfaces; more of them hide each other
LARGEST, SMALLEST = 0.13, 2e-4  # fractions of the domain that the outermost and the innermost isosurface enclose
COLOURED = 0.4  # fraction of the domain whose costs the scale tells apart: the isosurfaces are in its lower half
BEYOND = 1e3  # by how much the cost is higher beyond the lattice
OPACITY = (0.14, 0.95)  # of the outermost and of the innermost isosurface
SLICE_OPACITY = 0.42  # so that the array is seen through it
TOWARDS_LIGHT = np.array([-0.42, -0.55, 0.72])  # over the viewer's left shoulder in the oblique views
DARKEST = 0.6  # brightness of a surface that faces away from the light
ON_DARK = 0.15  # fraction of white in a surface on a dark page, and by how much more opaque it is
SHADES = 32  # columns of a texture


@dataclass(frozen=True)
class Volume:
    """The cost of one microphone in space."""

    surface: Surface  # of all isosurfaces
    plate: Plate | None  # the slice, or None
    bar: ColourBar | None  # of both; None where the colours of the slice stand for areas
    levels: tuple[float, ...]  # of the isosurfaces, in the unit of `bar`, ascending
    minima: Minima | None = None  # to be marked, or None
    areas: tuple[Area, ...] = ()  # what the colours of a slice without a bar stand for

    @property
    def text(self) -> str:
        """The levels in words, as "isosurfaces at -26, -24 and -22 dB"; "" of a volume of areas."""
        if self.areas:
            return ""
        if not self.levels:
            return "no isosurface"
        values = [f"{level:g}" for level in self.levels]
        listed = values[0] if len(values) == 1 else f"{', '.join(values[:-1])} and {values[-1]}"
        return f"isosurface{'s' if len(values) > 1 else ''} at {listed} dB"


def levels_of(decibels: np.ndarray) -> tuple[float, ...]:
    """Return round levels of cost, dB, ascending, each of which encloses a part that can be seen through."""
    low, middle = float(decibels.min()), float(np.quantile(decibels, LARGEST))
    for count in (MAX_LEVELS, 6, 10, 20):
        levels = [v for v in round_ticks(low, middle, count) if SMALLEST < np.mean(decibels < v) <= LARGEST]
        if len(levels) >= 3:
            break
    chosen = np.unique(np.linspace(0, len(levels) - 1, min(len(levels), MAX_LEVELS)).round().astype(int))
    return tuple(float(levels[i]) for i in chosen) if levels else ()


def volume_of(cost: np.ndarray, search: Search, log: bool, minima: Minima | None = None) -> Volume:
    """Return the isosurfaces of costs (nz, ny, nx), relative to the power; `log`: whether colours follow decibels."""
    low, high = colour_limits(np.minimum(cost, np.quantile(cost, COLOURED)), log, WHOLE)
    decibels = 10 * np.log10(np.maximum(cost, 1e-16))
    levels = levels_of(np.maximum(decibels, 10 * np.log10(max(low, 1e-16))))
    # the innermost first: an outer surface is drawn over the inner ones
    parts = [isosurface(decibels, search, level) for level in levels]
    colours = to_rgb(normalise(10 ** (np.array(levels) / 10), low, high, log)) if levels else np.zeros((0, 3), np.uint8)
    bar = ColourBar(low, high, "cost, Eq. 7 (relative to the power)")
    if log:
        bar = ColourBar(10 * float(np.log10(low)), 10 * float(np.log10(high)), "cost, Eq. 7 (dB)")
    # one surface of all isosurfaces: a row of the texture for each, its columns from dark to bright
    light = TOWARDS_LIGHT / np.linalg.norm(TOWARDS_LIGHT)
    count, first = len(parts), 0
    vertices, faces, places = [np.zeros((0, 3))], [np.zeros((0, 3), int)], [np.zeros((0, 2))]
    for row, (points, triangles, normals) in enumerate(parts):
        shade = 0.5 + 0.5 * normals @ light
        column = (0.5 + shade * (SHADES - 1)) / SHADES  # the middle of a texel
        vertices.append(points)
        faces.append(triangles + first)
        places.append(np.column_stack([column, np.full(len(points), (row + 0.5) / count)]))
        first += len(points)
    texture = np.zeros((max(count, 1), SHADES, 4), np.uint8)
    brightness = np.linspace(DARKEST, 1.0, SHADES)[:, None]
    for row, colour in enumerate(colours):
        fraction = 1.0 if count == 1 else row / (count - 1)  # 0 of the innermost
        texture[row, :, :3] = np.rint(brightness * colour)
        texture[row, :, 3] = round(255 * (OPACITY[1] + fraction * (OPACITY[0] - OPACITY[1])))
    surface = Surface(
        "isosurfaces",
        frozen_array(np.concatenate(vertices), np.float32),
        frozen_array(np.concatenate(faces), np.int32),
        frozen_array(np.concatenate(places), np.float32),
        frozen_array(texture, np.uint8),
    )
    return Volume(surface, None, bar, levels, minima)


def slice_of(cost: np.ndarray, axis: int, position: float, domain: np.ndarray, bar: ColourBar, log: bool) -> Plate:
    """Return a slice through a volume, in the colours of its `bar`, across an axis (0, 1, 2) at a position, metres.

    `cost` (h, w), in the middle of each pixel, rows along the later of the two axes; `domain` (2, 3), its corners.
    """
    low, high = (10 ** (bar.low / 10), 10 ** (bar.high / 10)) if log else (bar.low, bar.high)
    rgb = to_rgb(normalise(cost, low, high, log))
    return plate_of(rgb, axis, position, domain)


def plate_of(rgb: np.ndarray, axis: int, position: float, domain: np.ndarray) -> Plate:
    """Return an image (h, w, 3) uint8 as a slice; the other parameters as of `slice_of`."""
    others = [other for other in range(3) if other != axis]
    (a, b), (width, height) = domain[0][others], np.ptp(domain, axis=0)[others]
    origin, size = (float(a), float(b)), (float(width), float(height))
    return Plate("slice", frozen_array(rgb, np.uint8), axis, position, origin, size, SLICE_OPACITY)


def brightened(volume: Volume) -> Volume:
    """Return a volume for a dark page: brighter and less translucent, for the low costs have dark colours."""
    texture = volume.surface.texture.astype(float)
    texture[..., :3] += ON_DARK * (255 - texture[..., :3])
    texture[..., 3] *= 1 + ON_DARK
    texture = np.rint(np.minimum(texture, 255))
    return replace(volume, surface=replace(volume.surface, texture=frozen_array(texture, np.uint8)))


POINTS = 61  # along the longest edge of a volume that is finished
PIXELS = 240  # along the longer edge of its slice


@dataclass(frozen=True)
class SampledVolume:
    """A volume and its values on a lattice."""

    terms: CostVolume
    search: Search  # the lattice
    cost: np.ndarray  # (nz, ny, nx) float64
    minima: Minima


def sampled_volume(
    terms: CostVolume, count: int = POINTS, cancelled: Callable[[], bool] = lambda: False
) -> SampledVolume | None:
    """Return a volume on a lattice of the whole domain with its minima; None once `cancelled`."""
    domain = terms.domain
    step = max(domain.size) / (count - 1)
    shape = [max(int(length / step + 1e-6), 1) + 1 for length in domain.size]
    search = replace(domain, size=tuple((n - 1) * step for n in shape), step=step)
    x, y, z = (origin + step * np.arange(n) for origin, n in zip(search.origin, shape, strict=True))
    cost = terms.on(x, y, z, cancelled)
    return None if cost is None else SampledVolume(terms, search, cost, minima_of(cost, search))


def sliced(
    volume: Volume, sampled: SampledVolume, axis: str, position: float, log: bool = True, pixels: int = PIXELS
) -> Volume:
    """Return a volume with a slice across "x", "y" or "z", any other word for none, at a position, metres.

    Beyond the domain it is at its edge; `pixels`: along the longer edge of the slice.
    """
    if axis not in AXES or volume.bar is None:
        return replace(volume, plate=None)
    number, terms = AXES.index(axis), sampled.terms
    domain, lattice = area(terms.domain, 3), terms.domain
    low, high = domain[0], domain[1]
    place = float(np.clip(position, lattice.origin[number], lattice.origin[number] + lattice.size[number]))
    step = float(np.delete(high - low, number).max()) / pixels
    counts = np.maximum(np.rint((high - low) / step).astype(int), 2)
    places = [a + (b - a) * (np.arange(n) + 0.5) / n for a, b, n in zip(low, high, counts, strict=True)]
    places[number] = np.array([place])
    x, y, z = places
    cost = terms.on(x, y, z)
    if cost is None:
        raise ValueError("a slice that nobody cancels is complete")
    return replace(volume, plate=slice_of(np.squeeze(cost, axis=2 - number), number, place, domain, volume.bar, log))


NO_SURFACE = Surface(
    "isosurfaces", np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), np.zeros((0, 2), np.float32),
    np.zeros((1, 1, 4), np.uint8),
)  # fmt: skip


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
    numbers, areas = basin_image(basins, OUTSIDE if place is None else basins.at(search, place), name, labels)
    edges = domain + np.multiply([[-0.5], [0.5]], search.step)
    plate = plate_of(TABLE[numbers], number, domain[0][number] + at * search.step, edges)
    return Volume(NO_SURFACE, plate, None, (), minima, areas)
