"""fdcal: microphone positions from the resonances of a room.

After Nowakowski, Daudet, de Rosny, "Microphone array position calibration in the frequency domain using a single
unknown source". Eq. 7 of the paper is in `fdcal.cost.eq7`, Eqs. 3, 4 and 9 in `fdcal.acoustics.dictionary`.

The names of the public API are loaded when they are first used (PEP 562), so that `import fdcal` itself is fast.

Examples
--------
>>> import fdcal
>>> fdcal.InputError("microphones 0 and 1 coincide", "name others: <distance>").remedy
'name others: <distance>'
"""

import importlib
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .assessment.calibration import Calibration
    from .assessment.position_check import compare_positions
    from .model.measurement import Measurement
    from .model.scene import Scene, load_scene
    from .model.validation import InputError, StorageError
    from .session.api import calibrate, landscape, load, simulate

# Where each public name is defined: "package.module:attribute".
PUBLIC = {
    "Calibration": "assessment.calibration:Calibration",
    "InputError": "model.validation:InputError",
    "Measurement": "model.measurement:Measurement",
    "Scene": "model.scene:Scene",
    "StorageError": "model.validation:StorageError",
    "calibrate": "session.api:calibrate",
    "compare_positions": "assessment.position_check:compare_positions",
    "landscape": "session.api:landscape",
    "load": "session.api:load",
    "load_scene": "model.scene:load_scene",
    "simulate": "session.api:simulate",
}

# Methods of public classes, implemented in higher packages: they are bound here, and loaded when first used.
METHODS = {
    "assessment.calibration:Calibration": {
        "_repr_html_": "graphics.figures:calibration_html",
        "export": "recordings.export:export",
        "from_json": "assessment.result_file:read_result",
        "load": "assessment.result_file:load_result",
        "plot": "graphics.figures:draw_calibration",
        "save": "assessment.result_file:save_result",
        "show": "graphics.figures:show_calibration",
        "to_dataframe": "assessment.result_file:data_frame",
        "to_json": "assessment.result_file:result_text",
    },
    "cost.maps:LandscapePanels": {"plot": "graphics.figures:draw_landscape"},
}
STATIC = {"from_json", "load"}  # methods of the class, not of an instance
RETURNED = {"landscape": "cost.maps:LandscapePanels"}  # classes whose modules are not loaded with the function

__all__ = [
    "Calibration", "InputError", "Measurement", "Scene", "StorageError", "calibrate", "compare_positions",
    "landscape", "load", "load_scene", "simulate",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version(__name__)
    if name not in PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = _resolved(PUBLIC[name])
    for target, methods in METHODS.items():
        if target == RETURNED.get(name) or f"{__name__}.{target.partition(':')[0]}" in sys.modules:
            for method in methods:
                _bind(_resolved(target), method, methods[method])
    globals()[name] = value  # found directly from now on
    return value


def _bind(owner: type, name: str, target: str) -> None:
    """Give a class a method whose module is loaded when it is first used."""

    class Later:
        def __get__(self, instance: object, _: type) -> Any:
            found = _resolved(target)
            setattr(owner, name, staticmethod(found) if name in STATIC else found)
            return getattr(owner if instance is None else instance, name)

    if name not in vars(owner):
        setattr(owner, name, Later())


def _resolved(target: str) -> Any:
    module, _, attribute = target.partition(":")
    try:
        return getattr(importlib.import_module(f".{module}", __name__), attribute)
    except ModuleNotFoundError as error:
        from .model.libraries import missing_library

        raise missing_library(error) or error from error


def __dir__() -> list[str]:
    return sorted({*(name for name in globals() if name.startswith("__")), *PUBLIC})
