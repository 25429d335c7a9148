"""The settings of the solver, below its buttons: the method and its start, the modes in use."""

from dataclasses import replace

from ... import solvers
from ...model.scene import MeasuredScene, no_rectangle
from ...session.sources import OpenRequest
from ..gui import html
from ..gui.binding import Binding, Tab, Tick

MAX_SEED = 2**31 - 1
STARTS = ("affine", "random")
KEPT_BY_SOLVER = ("microphone", "follow", "shown", "modes", "take")  # choices that a change of the solver keeps


def default_start(solver: str) -> str:
    """Return the start of a solver unless another one is given."""
    return solvers.load(solver).TRAITS.default_start or STARTS[0]


class SolverTab(Tab):
    """Owns the controls, and restarts the solver with them."""

    def __init__(self, binding: Binding):
        self._binding, state, settings = binding, binding.session.view.state, binding.run.scene.solver
        names, row, modes = self._names(), binding.row, binding.modes
        with binding.gui.add_folder("Settings", expand_by_default=False):
            self.first = binding.slider(
                f"First {row}", 1, modes, 1, state.first,
                lambda value: self.use_modes(value, max(value, self.last.value)),
            )  # fmt: skip
            self.last = binding.slider(
                f"Last {row}", 1, modes, 1, state.last,
                lambda value: self.use_modes(min(self.first.value, value), value),
            )  # fmt: skip
            self.automatic = binding.checkbox(
                f"Add {row}s automatically", state.automatic,
                lambda value: self.use_modes(self.first.value, self.last.value, value),
                visible=binding.run.solver.TRAITS.adds_modes,
                hint=f"Add the next {row} when the present stage has converged",
            )  # fmt: skip
            self.refusal, self._refused = binding.gui.add_html(""), None
            self.name = binding.dropdown(
                "Method", names, settings.name, self._choose_solver, disabled=len(names) == 1,
                hint="robust: all microphones at once, with their gains; joint: for matched channels; descent: one at a"
                " time; room: shoebox room and sources together with the microphones",
            )  # fmt: skip
            self.start = binding.dropdown(
                "Start", STARTS, settings.start or default_start(settings.name), lambda _: self.refresh(),
                hint="affine: closed-form estimate from the lowest modes; random: anywhere in the search domain",
            )  # fmt: skip
            self.seed = binding.number(
                "Seed", binding.choices.seed, lambda value: binding.choose(seed=value), min=0, max=MAX_SEED, step=1,
                hint="Of the random start, and of the order in which descent moves the microphones",
            )  # fmt: skip
            binding.gui.add_html(html.remark("The modes apply at once, the rest with Reset."))
        self.refresh()

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

    def _choose_solver(self, name: str) -> None:
        self.start.value = default_start(name)
        self.refresh()

    def refresh(self) -> None:
        """Hide the controls that have no effect on the chosen solver."""
        traits = solvers.load(self.name.value).TRAITS
        self.start.visible = bool(traits.starts)
        self.seed.visible = traits.uses_seed(self.start.value)

    def restart(self) -> None:
        """Restart with the settings: the same solver at once, another one as soon as it is ready."""
        binding, own = self._binding, self._binding.run.scene.solver
        name, start = self.name.value, self.start.value
        if (name, start) == (own.name, own.start or default_start(own.name)):
            binding.session.reset(binding.choices.seed)
            return
        scene = replace(binding.run.scene, solver=replace(own, name=name, start=start))
        choices = {key: getattr(binding.choices, key) for key in KEPT_BY_SOLVER}
        binding.open(OpenRequest(scene, binding.choices.seed, binding.measurement, choices=choices, fewer_modes=True))

    def use_modes(self, first: int, last: int, automatic: bool | None = None) -> None:
        """Set the modes in use, and whether the solver adds more; as the box says unless given."""
        automatic = self.automatic.value if automatic is None else automatic
        self._binding.session.use_modes(min(first, last), last, automatic)

    def show(self, tick: Tick) -> None:
        """Let the controls follow the solver."""
        state, send, refused = tick.view.state, self._binding.send, tick.view.refused
        if refused is not self._refused:
            self._refused, self.refusal.content = refused, html.complaint(refused or "")
            for handle in (self.first, self.last, self.automatic) if refused else ():
                self._binding.sent.pop(id(handle), None)  # back to what the solver uses
        send(self.first, state.first)
        send(self.last, state.last)
        send(self.automatic, state.automatic)
