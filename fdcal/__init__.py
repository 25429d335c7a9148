"""fdcal: microphone positions from the resonances of a room.

After Nowakowski, Daudet, de Rosny, "Microphone array position calibration in the frequency domain using a single
unknown source". Eq. 7 of the paper is in `fdcal.cost.eq7`, Eqs. 3, 4 and 9 in `fdcal.acoustics.dictionary`.

The names of the public API are loaded when they are first used (PEP 562), so that `import fdcal` itself is fast.

Examples
--------
>>> import fdcal
>>> fdcal.InputError("the measurement has no search domain", "give <search>").remedy
'give <search>'
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .assessment.calibration import Calibration
    from .assessment.position_check import compare_positions
    from .graphics.landscape import landscape
    from .model.measurement import Measurement
    from .model.scene import Scene
    from .model.scene_file import load_scene
    from .model.validation import InputError, StorageError
    from .session.api import calibrate, load, simulate

# Where each public name is defined: "package.module:attribute".
PUBLIC = {
    "Calibration": "assessment.calibration:Calibration",
    "InputError": "model.validation:InputError",
    "Measurement": "model.measurement:Measurement",
    "Scene": "model.scene:Scene",
    "StorageError": "model.validation:StorageError",
    "calibrate": "session.api:calibrate",
    "compare_positions": "assessment.position_check:compare_positions",
    "landscape": "graphics.landscape:landscape",
    "load": "session.api:load",
    "load_scene": "model.scene_file:load_scene",
    "simulate": "session.api:simulate",
}

# What methods of public classes leave to packages above their own, which they cannot import.
EXTENSIONS = {
    "calibration_html": "graphics.calibration_html:calibration_html",
    "data_frame": "assessment.tables:data_frame",
    "draw_calibration": "graphics.calibration_figure:draw_calibration",
    "export_gains": "recordings.export:export_gains",
    "export_positions": "recordings.export:export_positions",
    "load_result": "assessment.result_file:load_result",
    "measurement_of_pyfar": "recordings.pyfar_objects:measurement_of_pyfar",
    "pyfar_coordinates": "recordings.pyfar_objects:pyfar_coordinates",
    "read_result": "assessment.result_file:read_result",
    "result_text": "assessment.result_file:result_text",
    "save_result": "assessment.result_file:save_result",
}

__all__ = [
    "Calibration", "InputError", "Measurement", "Scene", "StorageError", "calibrate", "compare_positions",
    "landscape", "load", "load_scene", "simulate",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = _resolved(PUBLIC[name])
    globals()[name] = value  # found directly from now on
    return value


def extension(name: str) -> Any:
    """Return the function of EXTENSIONS that carries out a method of a public class."""
    return _resolved(EXTENSIONS[name])


def _resolved(target: str) -> Any:
    module, _, attribute = target.partition(":")
    return getattr(importlib.import_module(f".{module}", __name__), attribute)


def __dir__() -> list[str]:
    return sorted({*(name for name in globals() if name.startswith("__")), *PUBLIC})
