"""The tab Scene: opens another scene, or changes array, walls, noise and known microphones of the present one."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import viser

from ...model.scene import MEASURED_AND_MODELLED, WALLS, MeasuredScene, load_scene, scene_names
from ...model.validation import InputError, StorageError
from ...session.scene_edits import min_known, parameters_of, with_parameters
from ...session.sources import OpenRequest, scene_request
from .. import html
from ..state import Binding, Tab

MEASURED = (
    "This is a measurement: room, array and noise are as recorded and cannot be edited. Choose another scene to"
    " simulate one."
)
# Bounds of the controls: radius in metres, absorption in %, SNR in dB, error of the sound speed in %.
MICROPHONES, RADII, ABSORPTION, SNR, SPEED_ERROR = (4, 150), (0.05, 3.0), (0.1, 99.0), (-10, 90), (-5.0, 5.0)
DEFAULT_SNR, MAX_SEED = 40, 2**31 - 1  # dB, value of the slider when noise is switched on
MAX_TYPED = 1e5  # m; a radius typed in millimetres gets a message, while a larger number is dropped
RADIUS = f"{RADII[0]:g} to {RADII[1]:g} m"
# The remedy for problems whose own remedy names keys of the scene's file, which the page does not show.
SMALLER = 'change "Array radius (m)", "Microphones" or "Scene seed"'


class SceneTab(Tab):
    """Owns the controls of the tab. The session does not change before Apply, nor if the scene is refused."""

    part, where = "scene", "Scene"

    def __init__(self, binding: Binding):
        self._binding, self._scene, gui = binding, binding.run.scene, binding.gui
        scene, self._own_name = self._scene, self._scene.name
        names = tuple(dict.fromkeys((*scene_names(), self._own_name)))
        self.name = binding.dropdown("Scene", names, self._own_name, self.choose, hint="Opens the scene")
        if isinstance(scene, MeasuredScene):
            gui.add_html(html.remark(scene.title))
            self.message = gui.add_html(html.remark(f"{scene.remark} {MEASURED}".strip()))
            return
        parameters, modelled, count = parameters_of(scene), scene.room.response is not None, scene.array.number
        low, high = MICROPHONES
        self.microphones = binding.slider(
            "Microphones", min(low, count), max(high, count), 1, count, lambda _: self.refresh(),
            disabled=scene.array.positions is not None,
        )  # fmt: skip
        hint = f"{RADIUS}; for a rectangular array, half its longest side. The search domain changes with it"
        own = round(parameters.radius, 4)
        radius = gui.add_number("Array radius (m)", own, min=0.0, max=MAX_TYPED, step=0.01, hint=hint)
        self.radius = binding.on(radius, lambda _: self._check_radius())
        walls = parameters.walls if parameters.walls in WALLS else WALLS[0]  # those of a measured room are unknown
        self.walls = binding.dropdown("Walls", WALLS, walls, lambda _: self.refresh(), visible=not modelled)
        absorbed, (low, high) = round(100 * parameters.absorption, 2) or 1.0, ABSORPTION
        hint = "Fraction of the energy of a wave that a wall absorbs at normal incidence"
        self.absorption = gui.add_number("Absorption (%)", absorbed, min=low, max=high, step=0.1, hint=hint)
        noisy = math.isfinite(parameters.snr_db)
        self.noise = binding.checkbox("Noise", noisy, lambda _: self.refresh())
        snr = round(np.clip(parameters.snr_db, *SNR)) if noisy else DEFAULT_SNR
        self.snr = gui.add_slider("SNR (dB)", *SNR, 1, snr, hint="Signal-to-noise ratio of each frequency")
        error = float(np.clip(100 * parameters.sound_speed_error, *SPEED_ERROR))
        hint = "By how much the solver's sound speed exceeds the true one"
        self.speed = gui.add_slider("Sound-speed error (%)", *SPEED_ERROR, 0.1, error, hint=hint)
        hint = "Microphones whose positions are given"
        self.known = gui.add_slider("Known microphones", 0, max(MICROPHONES[1], count), 1, parameters.known, hint=hint)
        seed = min(parameters.seed, MAX_SEED)
        hint = "Seed of random microphone positions, of the noise and of random starts"
        self.seed = gui.add_number("Scene seed", seed, min=0, max=MAX_SEED, step=1, hint=hint)
        hint = "Simulate this scene and restart"
        self.apply = binding.on(gui.add_button("Apply", icon=viser.Icon.CHECK, hint=hint), lambda _: self.press())
        self.message = gui.add_html(html.remark(MEASURED_AND_MODELLED) if modelled else "")
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
        """Open another scene."""
        if name == self._own_name:
            return
        self.name.value = self._own_name  # until the other scene is shown, because it may be refused
        try:
            self._binding.open(scene_request(load_scene(name)))
        except (InputError, StorageError) as error:
            self.message.content = html.complaint(error)

    def _values(self) -> dict[str, Any]:
        """Return the parameters of the scene as the controls show them, rounded."""
        return {
            "microphones": self.microphones.value,
            "radius": float(np.clip(self.radius.value, *RADII)),
            "walls": self.walls.value,
            "absorption": self.absorption.value / 100 if self.walls.value == "absorbing" else None,
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
        """Open the changed scene, or show in one line why it is refused."""
        if not self._check_radius():
            return
        try:
            # What was not changed stays exactly as it is in the scene.
            changed = {key: value for key, value in self._values().items() if value not in (None, self._shown[key])}
            scene = with_parameters(self._scene, replace(parameters_of(self._scene), **changed))
        except InputError as error:
            of_the_file = "." in error.key or error.key == "array"
            self.message.content = html.complaint(InputError(error.problem, SMALLER) if of_the_file else error)
            return
        self.message.content = ""
        self._binding.open(OpenRequest(scene, fewer_modes=True))
