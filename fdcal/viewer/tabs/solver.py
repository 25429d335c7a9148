"""The tab Solver: the method and its start, the modes in use."""

from __future__ import annotations

from dataclasses import replace

import viser

from ... import solvers
from ...model.scene import no_rectangle
from ...model.scene_file import MeasuredScene
from ...session.history import SessionView
from ...session.request import OpenRequest
from ..gui.binding import Binding
from ..server.client_values import bounded, one_of

MAX_SEED = 2**31 - 1
STARTS = ("affine", "random")
KEPT_BY_SOLVER = ("microphone", "follow", "shown", "modes", "take")  # choices that a change of the solver keeps


def default_start(solver: str) -> str:
    """Return the start of a solver unless another one is given."""
    return solvers.load(solver).TRAITS.default_start or STARTS[0]


class SolverTab:
    """Owns the controls of the tab."""

    def __init__(self, binding: Binding):
        self._binding = binding
        with binding.gui.add_folder("Solver"):
            self._add_method()
        with binding.gui.add_folder(f"{binding.row.capitalize()}s in use"):
            self._add_modes()
        self._show_relevant()
        self._listen()

    def _add_method(self) -> None:
        gui, settings, names = self._binding.gui, self._binding.run.scene.solver, self._names()
        self.name = gui.add_dropdown(
            "Method", names, initial_value=settings.name, disabled=len(names) == 1,
            hint="robust: all microphones at once, with their gains; joint: for matched channels; descent: one at a"
            " time; descent+joint: both in turn; room: shoebox room and sources together with the microphones",
        )  # fmt: skip
        self.start = gui.add_dropdown(
            "Start", STARTS, initial_value=settings.start or default_start(settings.name),
            hint="affine: closed-form estimate from the lowest modes; random: anywhere in the search domain",
        )  # fmt: skip
        self.seed = gui.add_number(
            "Seed", self._binding.choices.seed, min=0, max=MAX_SEED, step=1,
            hint="Of the random start, and of the order in which descent moves the microphones",
        )  # fmt: skip
        self.restart_button = gui.add_button("Restart", icon=viser.Icon.REFRESH, hint="Restart with these settings")

    def _add_modes(self) -> None:
        binding, state = self._binding, self._binding.session.view.state
        self.first = binding.gui.add_slider(f"First {binding.row}", 1, binding.modes, 1, state.first)
        self.last = binding.gui.add_slider(f"Last {binding.row}", 1, binding.modes, 1, state.last)
        self.automatic = binding.gui.add_checkbox(
            f"Add {binding.row}s automatically",
            state.automatic,
            hint=f"Add the next {binding.row} when the present stage has converged",
        )
        self.automatic.visible = binding.run.solver.TRAITS.adds_modes

    def _listen(self) -> None:
        binding = self._binding
        binding.on(self.name, self._choose_solver)
        binding.on(self.start, lambda _: self._show_relevant())
        binding.on(self.restart_button, lambda _: self.restart())
        binding.on(self.first, lambda value: self.use_modes(first=value))
        binding.on(self.last, lambda value: self.use_modes(last=value))
        binding.on(self.automatic, lambda value: self.use_modes(automatic=bool(value)))
        binding.on(self.seed, lambda value: binding.choose(seed=bounded(value, 0, MAX_SEED, 0)))

    def _names(self) -> tuple[str, ...]:
        """Return the names of the solvers that can solve this problem."""
        scene, problem = self._binding.run.scene, self._binding.run.problem
        searchable = problem.dimension == problem.array_dimension and problem.search is not None
        room_known = not isinstance(scene, MeasuredScene) and problem.array_dimension == problem.dimension
        room_known = room_known and not no_rectangle(scene)

        def can_solve(name: str) -> bool:
            traits = solvers.load(name).TRAITS
            return (searchable or not traits.needs_search) and (room_known or not traits.needs_room)

        return tuple(filter(can_solve, solvers.names()))

    def _choose_solver(self, value) -> None:
        name = one_of(value, self._names(), self._binding.run.scene.solver.name)
        self.start.value = default_start(name)
        self._show_relevant()

    def _show_relevant(self) -> None:
        """Hide the controls that have no effect on the chosen solver."""
        traits = solvers.load(one_of(self.name.value, self._names(), self._binding.run.scene.solver.name)).TRAITS
        self.start.visible = bool(traits.starts)
        self.seed.visible = traits.uses_seed(self.start.value)

    def refresh(self) -> None:
        """Let visibility follow the values of the controls."""
        self._show_relevant()

    def restart(self) -> None:
        """Restart with the settings of the tab: the same solver at once, another one as soon as it is ready."""
        binding, own = self._binding, self._binding.run.scene.solver
        name = one_of(self.name.value, self._names(), own.name)
        start = one_of(self.start.value, STARTS, default_start(name))
        if (name, start) == (own.name, own.start or default_start(own.name)):
            binding.session.reset(binding.choices.seed)
            return
        scene = replace(binding.run.scene, solver=replace(own, name=name, start=start))
        choices = {key: getattr(binding.choices, key) for key in KEPT_BY_SOLVER}
        binding.open(OpenRequest(scene, binding.choices.seed, binding.measurement, choices=choices, fewer_modes=True))

    def use_modes(self, first=None, last=None, automatic=None) -> None:
        """Set the modes in use; what is None stays.

        Where `first` would exceed `last`, the end that was not given moves along.
        """
        binding, state = self._binding, self._binding.session.view.state
        automatic = self.automatic.value if automatic is None else automatic
        low = bounded(self.first.value if first is None else first, 1, binding.modes, state.first)
        high = bounded(self.last.value if last is None else last, 1, binding.modes, state.last)
        if first is not None:
            high = max(low, high)
        binding.session.use_modes(min(low, high), high, bool(automatic))

    def show(self, view: SessionView) -> None:
        """Bring the sliders up to date; called by the main loop."""
        state, binding = view.state, self._binding
        binding.send("first", state.first, self.first)
        binding.send("last", state.last, self.last)
        binding.send("automatic", state.automatic, self.automatic)
