"""The tab Scene: array, walls, noise and known microphones of the scene; Apply simulates the changed scene."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import viser

from ...model.scene import MEASURED_AND_MODELLED, WALLS, MeasuredScene, Scene, load_scene, scene_names
from ...model.validation import InputError, StorageError
from ...session.scene_edits import min_known, parameters_of, with_parameters
from ...session.sources import OpenRequest
from .. import html
from ..state import Binding, Tab

MEASURED = (
    "This is a measurement: room, array and noise are as recorded and cannot be edited. Choose another scene to"
    " simulate one."
)
OPEN, APPLY = ("Open", "Open this measurement and restart"), ("Apply", "Simulate this scene and restart")


# Bounds of the controls: radius in metres, absorption in %, SNR in dB, error of the sound speed in %.
MICROPHONES, RADII, ABSORPTION, SNR, SPEED_ERROR = (4, 150), (0.05, 3.0), (0.1, 99.0), (-10, 90), (-5.0, 5.0)
DEFAULT_SNR, MAX_SEED = 40, 2**31 - 1  # dB, value of the slider when noise is switched on
MAX_TYPED = 1e5  # m, so that a radius in millimetres gets a message; a larger number is dropped
RADIUS = f"{RADII[0]:g} to {RADII[1]:g} m"
# A remedy for problems whose remedy names keys of the scene's file, which the page does not show.
SMALLER = 'change "Array radius (m)", "Microphones" or "Scene seed"'


class SceneTab(Tab):
    """Owns the controls of the tab. The session does not change before Apply, nor if the scene is refused."""

    part, where = "scene", "Scene"

    def __init__(self, binding: Binding):
        self._binding, self._scene = binding, binding.run.scene
        name, self._own_name = self._scene.name, ""  # in the list, of a scene that does not come with fdcal
        if name not in scene_names():
            self._own_name = name
        elif isinstance(self._scene, MeasuredScene) and not self._scene.file:
            self._own_name = f"{name} (measured)"  # distinguishes it from the scene of the same name
        gui, walls = binding.gui, self._scene.room.walls
        names = (*scene_names(), *([self._own_name] if self._own_name else []))
        self.name = binding.dropdown("Scene", names, self._own_name or self._scene.name, self.choose)
        self.title = gui.add_html("")
        low, high = MICROPHONES
        self.microphones = binding.slider("Microphones", low, high, 1, low, lambda _: self.refresh())
        hint = f"{RADIUS}. Of a rectangular array: half of its longest side. The search domain grows with it"
        radius = gui.add_number("Array radius (m)", 1.0, min=0.0, max=MAX_TYPED, step=0.01, hint=hint)
        self.radius = binding.on(radius, lambda _: self._check_radius())
        self.walls = binding.dropdown("Walls", WALLS, walls if walls in WALLS else WALLS[0], lambda _: self.refresh())
        low, high = ABSORPTION
        self.absorption = gui.add_number(
            "Absorption (%)", 1.0, min=low, max=high, step=0.1, hint="Absorbed energy of a wave at normal incidence"
        )
        self.noise = binding.checkbox("Noise", False, lambda _: self.refresh())
        self.snr = gui.add_slider("SNR (dB)", *SNR, 1, DEFAULT_SNR, hint="Signal-to-noise ratio of each mode")
        self.speed = gui.add_slider(
            "Sound-speed error (%)", *SPEED_ERROR, 0.1, 0.0,
            hint="By how much the solver's sound speed exceeds the true one",
        )  # fmt: skip
        self.known = gui.add_slider(
            "Known microphones", 0, MICROPHONES[1], 1, 3, hint="Microphones whose positions are given"
        )
        self.seed = gui.add_number(
            "Scene seed", 0, min=0, max=MAX_SEED, step=1,
            hint="Of random microphone positions, of the noise and of random starts",
        )  # fmt: skip
        self.apply = binding.button(APPLY[0], lambda _: self.press(), icon=viser.Icon.CHECK, hint=APPLY[1])
        self.message = binding.gui.add_html("")
        self._show_scene(self._scene)

    def _show_scene(self, scene: Scene) -> None:
        """Set the controls to the scene's parameters; hide them for a measurement, which has none."""
        self._scene, measured = scene, isinstance(scene, MeasuredScene)
        has_walls = not measured and scene.room.response is None
        self.title.content, self.title.visible = html.remark(scene.title), measured
        for handle in (
            self.microphones, self.radius, self.absorption, self.noise, self.snr, self.speed, self.known, self.seed,
        ):  # fmt: skip
            handle.visible = not measured
        self.walls.visible = has_walls
        self.apply.visible = not isinstance(scene, MeasuredScene) or bool(scene.file)
        self.apply.label, self.apply.hint = OPEN if measured else APPLY
        if isinstance(scene, MeasuredScene):
            self.message.content = html.remark(f"{scene.remark} {MEASURED}".strip())
            return
        self.message.content = "" if scene.room.response is None else html.remark(MEASURED_AND_MODELLED)
        parameters = parameters_of(scene)
        self.microphones.max = max(MICROPHONES[1], parameters.microphones)
        self.microphones.value = parameters.microphones
        self.microphones.disabled = self._scene.array.positions is not None
        self.radius.value = round(parameters.radius, 4)
        if parameters.walls in WALLS:  # those of a measured room are unknown
            self.walls.value = parameters.walls
        self.absorption.value = round(100 * parameters.absorption, 2) or 1.0
        self.noise.value = noisy = math.isfinite(parameters.snr_db)
        self.snr.value = round(np.clip(parameters.snr_db, *SNR)) if noisy else DEFAULT_SNR
        self.speed.value = float(np.clip(100 * parameters.sound_speed_error, *SPEED_ERROR))
        self.seed.value = min(parameters.seed, MAX_SEED)
        self.refresh()
        self.known.value = parameters.known
        self._shown = self._values()

    def refresh(self) -> None:
        """Adapt visibility and limits of the controls to their values.

        The number of known microphones is enough to fix the gauge, and leaves at least one microphone to be found.
        """
        if isinstance(self._scene, MeasuredScene):
            return
        self.absorption.visible = self.walls.visible and self.walls.value == "absorbing"
        self.snr.visible = self.noise.value
        low = min_known(self._scene)
        high = max(self.microphones.value - 1, low + 1)
        self.known.value = min(max(self.known.value, low), high)
        self.known.min, self.known.max = low, high

    def choose(self, name: str) -> None:
        """Show the parameters of another scene; those of the page's own scene are the present ones."""
        try:
            self._show_scene(self._binding.run.scene if name == self._own_name else load_scene(name))
        except (InputError, StorageError) as error:
            self.message.content = html.complaint(error)

    def _values(self) -> dict[str, Any]:
        """Return the parameters of the scene as the controls show them, rounded."""
        absorbing = self.walls.value == "absorbing"
        return {
            "microphones": self.microphones.value,
            "radius": float(np.clip(self.radius.value, *RADII)),
            "walls": self.walls.value,
            "absorption": self.absorption.value / 100 if absorbing else None,
            "snr_db": float(self.snr.value) if self.noise.value else math.inf,
            "sound_speed_error": self.speed.value / 100,
            "known": min(max(self.known.value, min_known(self._scene)), max(self.microphones.value - 1, 1)),
            "seed": self.seed.value,
        }

    def _check_radius(self) -> bool:
        """Return whether the radius is possible; if not, show a message."""
        value, (low, high) = self.radius.value, RADII
        own = abs(value - parameters_of(self._scene).radius) <= 1e-4  # the scene's own radius may be larger
        possible = own or (math.isfinite(value) and low <= value <= high)
        text = "" if possible else f"Array radius = {value:g} m is not possible; use {RADIUS}"
        self.message.content = html.complaint(text)
        return possible

    def press(self) -> None:
        """Open the changed scene, or say in one line why it is refused."""
        if isinstance(self._scene, MeasuredScene):
            if self._scene.file:  # a client can press a hidden button
                self._binding.open(OpenRequest(self._scene, fewer_modes=True))
            return
        if not self._check_radius():
            return
        try:
            # What was not changed stays exactly as it is in the scene.
            values, measured = self._values(), ("walls", "absorption") if self._scene.room.response is not None else ()
            changed = {key: value for key, value in values.items() if value not in (None, self._shown[key])}
            changed = {key: value for key, value in changed.items() if key not in measured}
            scene = with_parameters(self._scene, replace(parameters_of(self._scene), **changed))
        except InputError as error:
            of_the_file = "." in error.key or error.key == "array"
            self.message.content = html.complaint(InputError(error.problem, SMALLER) if of_the_file else error)
            return
        self.message.content = ""
        self._binding.open(OpenRequest(scene, fewer_modes=True))
