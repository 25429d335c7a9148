"""The description of a case."""

from dataclasses import dataclass

from fdcal_bench.draw import Scenario


@dataclass(frozen=True)
class Spec:
    """All that determines a case.

    Attributes
    ----------
    seed : int
    dimension : 2 or 3, of the sound field
    room : "rectangle", "box", "pyroomacoustics", or a key of `finite_elements.SHAPES`
    size_of_room : lengths, metres, or None for drawn ones
    geometry : array shape, see `geometries`
    count : microphones
    size : metres across the array
    modes : frequencies at most
    lowest, highest : Hz; the latter bounded by Eq. 9 unless `beyond` is set
    decay : 1/s, imaginary part of the angular frequency in two dimensions
    frequencies : "peaks" of the mean power, or a "grid"
    snr : dB, or None for no noise
    noise : "reported" with the measurement, "unknown", or a "floor" that is the same at all frequencies, unknown
    known : number of microphones whose positions are given
    known_mode : "all", "minimal" or "none", given to the solver
    neighbours : whether the given ones are neighbours
    fault : name and size of what is wrong, see `faults`, or None
    takes : recordings of the array, with the source at as many places
    source : "far", "near" (0.3 m), "inside" or "two"
    scatterer : radius, metres, and admittance of a cylinder inside the array, or None
    scatterer_offset : from the array's middle, as a fraction of its radius
    reflection : range of the walls' pressure reflection factors in three dimensions
    order : of the image sources
    scenario : scenario as of `studies/calibration.toml` that draws the whole case, or None
    """

    seed: int
    dimension: int = 2
    room: str = "rectangle"
    size_of_room: tuple[float, ...] | None = None
    geometry: str = "disc"
    count: int = 30
    size: float = 0.8
    modes: int = 40
    lowest: float = 35.0
    highest: float = 300.0
    beyond: bool = False
    decay: float = 3.0
    frequencies: str = "peaks"
    snr: float | None = 40.0
    noise: str = "reported"
    known: int = 4
    known_mode: str = "all"
    neighbours: bool = False
    fault: tuple[str, float] | None = None
    takes: int = 1
    source: str = "far"
    scatterer: tuple[float, float] | None = None
    scatterer_offset: float = 0.0
    reflection: tuple[float, float] = (0.75, 0.95)
    order: int = 8
    scenario: Scenario | None = None

    @property
    def blind(self) -> bool:
        """Whether the solver gets no given position."""
        return self.known_mode == "none" or not self.known
