"""The scenario without a text editor: which scene, its array, walls, noise and known microphones; Apply runs it."""

from __future__ import annotations

import math

import viser

from ...model.measured_scene import MeasuredScene
from ...model.room import WALLS
from ...model.scene import Scene
from ...model.scene_file import load_scene, scene_names
from ...model.validation import InputError, StorageError
from ...session.request import OpenRequest
from ...session.scene_edits import SceneParameters, least_known, parameters_of, with_parameters
from ..gui import html
from ..gui.binding import Binding
from ..server.client_values import bounded, bounded_number, one_of

MOST_MICROPHONES, LARGEST_SEED = 150, 2**31 - 1
RADII = (0.05, 3.0)  # m
ABSORPTIONS = (0.1, 99.0)  # %
SNRS = (-10, 90)  # dB
LOUDEST_QUIET = 40  # dB, where the slider stands as noise is switched on
SPEED_ERRORS = (-5.0, 5.0)  # %
MEASURED = "These microphones were measured: nothing is simulated that could be set here. Choose a scene to simulate."


class SceneTab:
    """Owns the handles of the tab. Nothing happens before Apply; what cannot be is told, and nothing changes."""

    def __init__(self, binding: Binding):
        self._binding, gui, scene = binding, binding.gui, binding.work.scene
        self._scene, parameters = scene, parameters_of(scene)
        self._own = scene.name if scene.name not in scene_names() else None
        # A measurement whose file has the name of a scene is another thing.
        if isinstance(scene, MeasuredScene) and self._own is None:
            self._own = f"{scene.name} (measured)"
        names = (*scene_names(), *([self._own] if self._own else []))
        self.name = gui.add_dropdown("Scene", names, initial_value=self._own or scene.name)
        self.microphones = gui.add_slider("Microphones", 4, MOST_MICROPHONES, 1, 4)
        self.radius = gui.add_number(
            "Array radius (m)", 1.0, min=RADII[0], max=RADII[1], step=0.01,
            hint="Of a rectangle, half its longest side; the search domain grows along",
        )  # fmt: skip
        self.walls = gui.add_dropdown("Walls", WALLS, initial_value=parameters.walls)
        self.absorption = gui.add_number(
            "Absorption (%)", 1.0, min=ABSORPTIONS[0], max=ABSORPTIONS[1], step=0.1,
            hint="Of a wave's energy, at normal incidence",
        )  # fmt: skip
        self.noise = gui.add_checkbox("Noise", False)
        self.snr = gui.add_slider("SNR (dB)", *SNRS, 1, LOUDEST_QUIET, hint="Of each mode")
        self.speed = gui.add_slider(
            "c error (%)", *SPEED_ERRORS, 0.1, 0.0, hint="How much too high the sound speed is that the solver is told"
        )
        self.known = gui.add_slider("Known mics", 0, MOST_MICROPHONES, 1, 3, hint="Microphones told to the solver")
        self.seed = gui.add_number(
            "Scene seed", 0, min=0, max=LARGEST_SEED, step=1, hint="Draws random microphones, noise and random starts"
        )
        self.apply = gui.add_button("Apply", icon=viser.Icon.CHECK, hint="Simulate and begin anew")
        self.told = gui.add_html("")
        self._knobs = (self.microphones, self.radius, self.walls, self.absorption, self.noise, self.snr, self.speed)
        self._knobs += (self.known, self.seed, self.apply)
        self._put(scene)
        binding.on(self.name, self._choose)
        binding.on(self.walls, lambda value: self._show_walls(one_of(value, WALLS, parameters.walls)))
        binding.on(self.noise, lambda value: self._show_noise(bool(value)))
        binding.on(self.microphones, lambda value: self._bound_known(bounded(value, 4, MOST_MICROPHONES, 4)))
        binding.on(self.apply, lambda _: self.press())

    def _put(self, scene: Scene) -> None:
        """Set the controls to the scene's parameters; hide them for a measurement, which has none."""
        parameters, self._scene = parameters_of(scene), scene
        measured = isinstance(scene, MeasuredScene)
        for handle in self._knobs:
            handle.visible = not measured
        self.told.content = html.remark(MEASURED) if measured else ""
        if measured:
            return
        self.microphones.max = max(MOST_MICROPHONES, parameters.microphones)
        self.microphones.value = parameters.microphones
        self.microphones.disabled = scene.array.positions is not None
        self.radius.value, self.walls.value = round(parameters.radius, 4), parameters.walls
        self.absorption.value = round(100 * parameters.absorption, 2) or 1.0
        self.noise.value = quiet = math.isfinite(parameters.snr_db)
        self.snr.value = bounded(parameters.snr_db, *SNRS, LOUDEST_QUIET) if quiet else LOUDEST_QUIET
        self.speed.value = bounded_number(100 * parameters.sound_speed_error, *SPEED_ERRORS, 0.0)
        self.seed.value = min(parameters.seed, LARGEST_SEED)
        self._bound_known(parameters.microphones)
        self.known.value = parameters.known
        self._show_walls(parameters.walls)
        self._show_noise(quiet)

    def _bound_known(self, microphones: int) -> None:
        """As many known ones as fix the gauge at least, and one less than there are at most."""
        low, high = least_known(self._scene), max(microphones - 1, least_known(self._scene) + 1)
        self.known.value = min(max(self.known.value, low), high)
        self.known.min, self.known.max = low, high

    def _show_walls(self, walls: str) -> None:
        self.absorption.visible = walls == "absorbing"

    def _show_noise(self, noisy: bool) -> None:
        self.snr.visible = noisy

    def _choose(self, value) -> None:
        """Another scene's parameters; the one shown is as it is, not as it was in its file."""
        name = one_of(value, (*scene_names(), self._own or ""), self._scene.name)
        shown = self._binding.work.scene
        try:
            self._put(shown if name == self._own else load_scene(name))
        except (InputError, StorageError) as error:
            self.told.content = html.complaint(str(error))

    @property
    def parameters(self) -> SceneParameters:
        """What the handles say, bounded; where a hand has not touched one, exactly what the scene says."""
        old = parameters_of(self._scene)
        count = bounded(self.microphones.value, 4, int(self.microphones.max), old.microphones)
        return SceneParameters(
            microphones=old.microphones if self.microphones.disabled else count,
            radius=_or_old(bounded_number(self.radius.value, *RADII, old.radius), old.radius, 1e-4),
            walls=one_of(self.walls.value, WALLS, old.walls),
            absorption=_or_old(
                bounded_number(self.absorption.value, *ABSORPTIONS, 1.0) / 100, old.absorption, 1e-4
            ) if self.walls.value == "absorbing" else old.absorption,
            snr_db=self._snr(old.snr_db),
            sound_speed_error=_or_old(
                bounded_number(self.speed.value, *SPEED_ERRORS, 0.0) / 100, old.sound_speed_error, 1e-5
            ),
            known=bounded(self.known.value, least_known(self._scene), max(count - 1, 1), old.known),
            seed=bounded(self.seed.value, 0, LARGEST_SEED, old.seed),
        )  # fmt: skip

    def _snr(self, old: float) -> float:
        if not self.noise.value:
            return math.inf
        value = float(bounded(self.snr.value, *SNRS, LOUDEST_QUIET))
        return _or_old(value, old, 0.5)

    def press(self) -> None:
        """Open the scenario, or tell in one line why it cannot be."""
        if isinstance(self._scene, MeasuredScene):  # a client can press what it does not see
            return
        try:
            scene = with_parameters(self._scene, self.parameters)
        except InputError as error:
            self.told.content = html.complaint(str(error))
            return
        self.told.content = ""
        self._binding.open(OpenRequest(scene, fewer_modes=True))


def _or_old(value: float, old: float, rounding: float) -> float:
    """The scene's own number where the handle shows it, rounded."""
    return old if abs(value - old) <= rounding else value
