# What `fdcal.graphics.snapshot` uses of pyvista. Its own types take a type checker ten seconds to read, with VTK's.
from typing import Any, Self

import numpy as np

class Plotter:
    def __init__(self, *, off_screen: bool, window_size: list[int], lighting: str) -> None: ...
    def __getattr__(self, name: str) -> Any: ...

class PolyData:
    active_texture_coordinates: np.ndarray
    @classmethod
    def from_regular_faces(cls, points: np.ndarray, faces: np.ndarray) -> Self: ...

class StructuredGrid:
    point_data: dict[str, np.ndarray]
    def __init__(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> None: ...

class ImageData:
    cell_data: dict[str, np.ndarray]
    def __init__(
        self,
        *,
        dimensions: tuple[int, int, int],
        spacing: tuple[float, float, float],
        origin: tuple[float, float, float],
    ) -> None: ...

class Texture:
    def __init__(self, image: np.ndarray) -> None: ...

def line_segments_from_points(points: np.ndarray) -> PolyData: ...
