"""Which solver, from which start, with which modes, how fast."""

from __future__ import annotations

from dataclasses import replace

import viser

from ... import solvers
from ...model.measured_scene import MeasuredScene
from ...model.scene import no_rectangle
from ...session.history import SessionView
from ...session.request import OpenRequest
from ..gui.binding import Binding
from ..server.client_values import bounded, one_of
from .run import FASTEST

LARGEST_SEED = 2**31 - 1
STARTS = ("affine", "random")
KEPT = ("microphone", "follow", "shown", "modes")  # choices that outlive a change of solver


def usual_start(name: str) -> str:
    """Return the start of a solver unless another one is given."""
    return solvers.load(name).TRAITS.default_start or STARTS[0]


class SolverTab:
    """Owns the handles of the tab."""

    def __init__(self, binding: Binding):
        self._binding, gui = binding, binding.gui
        state, settings = binding.session.view.state, binding.work.scene.solver
        with gui.add_folder("Solver"):
            names = self._names()
            self.name = gui.add_dropdown(
                "Method", names, initial_value=settings.name, disabled=len(names) == 1,
                hint="joint moves all microphones at once, descent one at a time; descent+joint is both in turn",
            )  # fmt: skip
            self.start = gui.add_dropdown(
                "Start", STARTS, initial_value=settings.start or usual_start(settings.name),
                hint="affine: in closed form from the lowest modes; random: anywhere in the search domain",
            )  # fmt: skip
            self.seed = gui.add_number(
                "Seed", binding.choices.seed, min=0, max=LARGEST_SEED, step=1,
                hint="Of a random start, and of the order in which descent moves microphones",
            )  # fmt: skip
            self.anew = gui.add_button(
                "Start anew", icon=viser.Icon.REFRESH, hint="As Reset does, with what is set here"
            )
        with gui.add_folder("Modes in use"):
            self.first = gui.add_slider("First mode", 1, binding.modes, 1, state.first)
            self.last = gui.add_slider("Last mode", 1, binding.modes, 1, state.last)
            self.automatic = gui.add_checkbox(
                "Add modes automatically",
                state.automatic,
                hint="The next mode comes in when no microphone moves any more",
            )
        self.speed = gui.add_slider(
            "Steps a second", 1, FASTEST, 1, FASTEST, hint=f"{FASTEST} is as fast as the machine can"
        )
        self.automatic.visible = binding.work.solver.TRAITS.adds_modes
        self._show_what_counts()
        self._listen()

    def _listen(self) -> None:
        binding = self._binding
        binding.on(self.name, self._choose_solver)
        binding.on(self.start, lambda _: self._show_what_counts())
        binding.on(self.anew, lambda _: self.start_anew())
        binding.on(self.first, lambda value: self.use_modes(first=value))
        binding.on(self.last, lambda value: self.use_modes(last=value))
        binding.on(self.automatic, lambda value: self.use_modes(automatic=bool(value)))
        binding.on(self.seed, lambda value: binding.choose(seed=bounded(value, 0, LARGEST_SEED, 0)))
        binding.on(self.speed, self.pace)

    def _names(self) -> tuple[str, ...]:
        """Return the names of the solvers that can solve this problem."""
        scene, problem = self._binding.work.scene, self._binding.work.problem
        searchable = problem.dimension == 2 and problem.search is not None
        room_known = not isinstance(scene, MeasuredScene) and problem.array_dimension == problem.dimension
        room_known = room_known and not no_rectangle(scene)

        def can_solve(name: str) -> bool:
            traits = solvers.load(name).TRAITS
            return (searchable or not traits.needs_search) and (room_known or not traits.needs_room)

        return tuple(filter(can_solve, solvers.names()))

    def _choose_solver(self, value) -> None:
        name = one_of(value, self._names(), self._binding.work.scene.solver.name)
        self.start.value = usual_start(name)
        self._show_what_counts()

    def _show_what_counts(self) -> None:
        """Hide the controls that do not matter to the chosen solver."""
        traits = solvers.load(one_of(self.name.value, self._names(), self._binding.work.scene.solver.name)).TRAITS
        self.start.visible = bool(traits.starts)
        self.seed.visible = traits.uses_seed(self.start.value)

    def start_anew(self) -> None:
        """From the beginning: with the same solver at once, with another as soon as it is ready."""
        binding, own = self._binding, self._binding.work.scene.solver
        name = one_of(self.name.value, self._names(), own.name)
        start = one_of(self.start.value, STARTS, usual_start(name))
        if (name, start) == (own.name, own.start or usual_start(own.name)):
            binding.session.reset(binding.choices.seed)
            return
        scene = replace(binding.work.scene, solver=replace(own, name=name, start=start))
        choices = {key: getattr(binding.choices, key) for key in KEPT}
        binding.open(OpenRequest(scene, binding.choices.seed, binding.measurement, choices=choices, fewer_modes=True))

    def pace(self, value) -> None:
        rate = bounded(value, 1, FASTEST, FASTEST)
        self._binding.session.pace(0 if rate == FASTEST else rate)

    def use_modes(self, first=None, last=None, automatic=None) -> None:
        """What is not given stays; the end that was not moved gives way to the one that was."""
        binding = self._binding
        state = binding.session.view.state
        automatic = self.automatic.value if automatic is None else automatic
        low = bounded(self.first.value if first is None else first, 1, binding.modes, state.first)
        high = bounded(self.last.value if last is None else last, 1, binding.modes, state.last)
        if first is not None:
            high = max(low, high)
        low = min(low, high)
        binding.session.use_modes(low, high, bool(automatic))

    def show(self, view: SessionView) -> None:
        """Called by the main loop."""
        state, binding = view.state, self._binding
        binding.send("first", state.first, self.first)
        binding.send("last", state.last, self.last)
        binding.send("automatic", state.automatic, self.automatic)
