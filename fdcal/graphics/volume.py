"""The cost of one microphone in space: isosurfaces, and the layer at its height, independent of a renderer.

    isosurface      where values on a lattice equal a level, by VTK's flying edges
    Volume          isosurfaces, with the scale of their colours and the minima
    levels_of       round levels of cost for the isosurfaces
    volume_of       a Volume of costs on a lattice
    brightened      a Volume for a dark page
    sampled_volume  values and minima on a lattice of the whole domain
    layer_floor     the layer at one height, in the colours of a Volume, on the floor, where it hides no microphone
    volume_around   the cost around a microphone of a measurement, without gains of the channels
    map_of          the map of a microphone for a snapshot, also for a plane array

The colours contain the shading of the surfaces, so that they look alike in all renderers, which add no light.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..assessment.words import listed
from ..cost.eq7 import ORDER_OFFSET, expansion_of, require_modes, require_plane_field, search_domain
from ..cost.maps import CostVolume, area, cost_volume, descent_maps, minima_of
from ..cost.scale import Minima
from ..model.settings import Search
from ..model.validation import InputError, evenly_spaced, frozen_array
from ..session.sources import CalibrationInput
from .glyphs import round_ticks
from .heatmap import SHOWN, WHOLE, colour_limits, cost_floor, normalise, to_rgb
from .primitives import ColourBar, Floor, Surface


def isosurface(values: np.ndarray, search: Search, level: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return vertices (V, 3), metres, faces (F, 3) and uphill normals (V, 3) of the surface where values equal a level.

    The surface encloses all lower values. Where these reach the edge of the lattice, it is closed there.
    """
    nothing = np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 3))
    if level > values.max():
        return nothing
    # VTK takes a third of a second to load, so only a page with isosurfaces loads it
    import vtkmodules.util.numpy_support as arrays
    import vtkmodules.vtkCommonDataModel as vtk_data
    import vtkmodules.vtkFiltersCore as vtk_core

    closed = np.pad(np.asarray(values, float), 1, constant_values=float(values.max()) + BEYOND)
    low = np.array(search.origin)
    image = vtk_data.vtkImageData()
    image.SetDimensions(*closed.shape[::-1])
    image.SetOrigin(*(low - search.step))
    image.SetSpacing(search.step, search.step, search.step)
    image.GetPointData().SetScalars(arrays.numpy_to_vtk(np.ascontiguousarray(closed).ravel()))
    contour = vtk_core.vtkFlyingEdges3D()
    contour.SetInputData(image)
    contour.SetValue(0, float(level))
    contour.ComputeNormalsOn()
    contour.ComputeScalarsOff()
    contour.Update()
    found = contour.GetOutput()
    if not found.GetNumberOfPolys():
        return nothing
    vertices = arrays.vtk_to_numpy(found.GetPoints().GetData()).astype(float)
    faces = arrays.vtk_to_numpy(found.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(int)
    normals = arrays.vtk_to_numpy(found.GetPointData().GetNormals()).astype(float)
    vertices = np.clip(vertices, low, low + search.step * (np.array(values.shape[::-1]) - 1))
    return vertices, faces, -normals  # VTK's point towards lower values


MAX_LEVELS = 3  # largest number of isosurfaces; more of them would hide each other
LARGEST, SMALLEST = 0.06, 2e-4  # fractions of the domain that the outermost and the innermost isosurface enclose
BEYOND = 1e3  # added to the cost beyond the lattice, so that surfaces are closed at its edge
OPACITY = (0.14, 0.6)  # opacity of the outermost and of the innermost isosurface
TOWARDS_LIGHT = np.array([-0.42, -0.55, 0.72])  # over the viewer's left shoulder in the oblique views
DARKEST = 0.6  # brightness of a surface that faces away from the light
ON_DARK = 0.15  # fraction of white in a surface on a dark page, and relative increase of its opacity
SHADES = 32  # columns of a texture


@dataclass(frozen=True)
class Volume:
    """The cost of one microphone in space."""

    surface: Surface | None  # all isosurfaces; None if there are none
    bar: ColourBar  # colour bar of isosurfaces and layer
    levels: tuple[float, ...] = ()  # dB, levels of the isosurfaces, ascending
    minima: Minima | None = None  # the minima to be marked, or None

    @property
    def text(self) -> str:
        """The levels in words, such as "isosurfaces at -26, -24 and -22 dB"."""
        if not self.levels:
            return "no isosurface"
        return f"isosurface{'s' if len(self.levels) > 1 else ''} at {listed(f'{x:g}' for x in self.levels)} dB"


def levels_of(decibels: np.ndarray) -> tuple[float, ...]:
    """Return round levels of cost, dB, ascending, whose surfaces are neither too large nor too small to be useful."""
    low, middle = float(decibels.min()), float(np.quantile(decibels, LARGEST))
    for count in (MAX_LEVELS, 6, 10, 20):
        levels = [v for v in round_ticks(low, middle, count) if SMALLEST < np.mean(decibels < v) <= LARGEST]
        if len(levels) >= 3:
            break
    return tuple(float(levels[i]) for i in evenly_spaced(len(levels), MAX_LEVELS)) if levels else ()


def volume_of(
    cost: np.ndarray, search: Search, log: bool, minima: Minima | None = None, label: str = "cost, Eq. 7"
) -> Volume:
    """Return the isosurfaces of costs (nz, ny, nx), relative to the power; `log`: whether colours follow decibels."""
    low, high = colour_limits(cost, log, (WHOLE[0], SHOWN[1]))
    decibels = 10 * np.log10(np.maximum(cost, 1e-16))
    levels = levels_of(np.maximum(decibels, 10 * np.log10(max(low, 1e-16))))
    # The innermost comes first, because an outer surface is drawn over the inner ones.
    parts = [isosurface(decibels, search, level) for level in levels]
    colours = to_rgb(normalise(10 ** (np.array(levels) / 10), low, high, log)) if levels else np.zeros((0, 3), np.uint8)
    bar = ColourBar(low, high, f"{label} (relative to the power)")
    if log:
        bar = ColourBar(10 * float(np.log10(low)), 10 * float(np.log10(high)), f"{label} (dB)")
    # All isosurfaces form one surface. Each has a row of the texture, whose columns go from dark to bright.
    light = TOWARDS_LIGHT / np.linalg.norm(TOWARDS_LIGHT)
    count, first = len(parts), 0
    vertices, faces, places = [np.zeros((0, 3))], [np.zeros((0, 3), int)], [np.zeros((0, 2))]
    for row, (points, triangles, normals) in enumerate(parts):
        column = (0.5 + (0.5 + 0.5 * normals @ light) * (SHADES - 1)) / SHADES  # the middle of a texel
        vertices.append(points)
        faces.append(triangles + first)
        places.append(np.column_stack([column, np.full(len(points), (row + 0.5) / count)]))
        first += len(points)
    texture = np.zeros((max(count, 1), SHADES, 4), np.uint8)
    brightness = np.linspace(DARKEST, 1.0, SHADES)[:, None]
    for row, colour in enumerate(colours):
        fraction = 1.0 if count == 1 else row / (count - 1)  # 0 for the innermost isosurface
        texture[row, :, :3] = np.rint(brightness * colour)
        texture[row, :, 3] = round(255 * (OPACITY[1] + fraction * (OPACITY[0] - OPACITY[1])))
    surface = Surface(
        "isosurfaces",
        frozen_array(np.concatenate(vertices), np.float32),
        frozen_array(np.concatenate(faces), np.int32),
        frozen_array(np.concatenate(places), np.float32),
        frozen_array(texture, np.uint8),
    )
    return Volume(surface if levels else None, bar, levels, minima)


def brightened(volume: Volume) -> Volume:
    """Return a volume for a dark page: brighter and less translucent, because low costs have dark colours."""
    if volume.surface is None:
        return volume
    texture = volume.surface.texture.astype(float)
    texture[..., :3] += ON_DARK * (255 - texture[..., :3])
    texture[..., 3] *= 1 + ON_DARK
    texture = np.rint(np.minimum(texture, 255))
    return replace(volume, surface=replace(volume.surface, texture=frozen_array(texture, np.uint8)))


POINTS = 61  # points along the longest edge of a finished volume
PIXELS = 240  # number of pixels along the longer edge of a layer


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


def layer_floor(
    volume: Volume, sampled: SampledVolume, z: float, height: float, log: bool, pixels: int = PIXELS
) -> Floor:
    """Return the layer at `z`, metres, as a map at `height`, metres, `pixels` along its longer edge.

    If `z` lies outside of the domain, the layer at the edge is returned.
    """
    bar, terms = volume.bar, sampled.terms
    domain, lattice = area(terms.domain, 2), terms.domain
    z = float(np.clip(z, lattice.origin[2], lattice.origin[2] + lattice.size[2]))
    counts = np.maximum(np.rint(np.ptp(domain, axis=0) * pixels / np.ptp(domain, axis=0).max()).astype(int), 2)
    x, y = (a + (b - a) * (np.arange(n) + 0.5) / n for a, b, n in zip(*domain, counts, strict=True))
    cost = terms.on(x, y, np.array([z]))
    assert cost is not None  # only a layer that can be cancelled may be incomplete
    low, high = (10 ** (bar.low / 10), 10 ** (bar.high / 10)) if log else (bar.low, bar.high)
    bar = replace(bar, label=f"{bar.label}, on the floor the layer z = {z:z.2f} m")
    rgb = frozen_array(to_rgb(normalise(cost[0], low, high, log)), np.uint8)
    (x, y), (width, depth) = domain[0].tolist(), np.ptp(domain, axis=0).tolist()
    return Floor(rgb, (x, y), (width, depth), bar, (), height, show_minima=False)


def volume_around(inputs: CalibrationInput, positions: np.ndarray, n: int, modes: int) -> SampledVolume:
    """Return the cost of moving microphone `n` of an array in space (N, 3) through the search domain.

    `modes`: number of the highest mode of the sum, which contains only carried modes (`fdcal.cost.eq7.carried_modes`).
    """
    problem = inputs.measurement.problem(inputs.settings.weights)
    carried = expansion_of(problem, ORDER_OFFSET).carried.modes + 1
    used = carried[carried <= modes].tolist()
    if not used:
        fault = f"the microphones are too few for any frequency at search.radius = {search_domain(problem).radius:g} m"
        raise InputError(fault, "give the scene or the file a smaller radius", key="search.radius")
    terms = cost_volume(problem, positions, n, used, ORDER_OFFSET)
    sampled = None if terms is None else sampled_volume(terms)
    assert sampled is not None  # only a volume that can be cancelled may be incomplete
    return sampled


def map_of(
    inputs: CalibrationInput, positions: np.ndarray, n: int, modes: int, height: float
) -> tuple[Floor, Volume | None]:
    """Return the map of a microphone for a snapshot, at a height, metres, and in space the cost around it."""
    measurement, settings = inputs.measurement, inputs.settings
    if measurement.search is None:
        raise InputError(f"{inputs.name} has no search domain for a map", "leave out <microphone>", key="microphone")
    if measurement.array_dimension == 3:
        sampled = volume_around(inputs, positions, n, modes)
        volume = volume_of(sampled.cost, sampled.search, True, sampled.minima)
        return layer_floor(volume, sampled, float(positions[n, 2]), height, True), volume
    from ..solvers.descent import order_offset_of  # compiled code, which other commands do not need

    problem, offset = measurement.problem(settings.weights), order_offset_of(settings, modes)
    require_plane_field(problem)
    require_modes(problem, offset, modes)
    # the cost that a step of descent minimises
    cost = descent_maps(problem, positions, n, range(1, modes + 1), offset, settings.known_weight).sum(axis=0)
    return cost_floor(cost, measurement.search, log=True, minima=minima_of(cost, measurement.search)), None
