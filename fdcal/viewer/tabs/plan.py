"""The tab Plan: how exact the array of the scene could be calibrated, before anything is measured.

The bound is computed on a thread of its own while microphones are dragged.
"""

from dataclasses import dataclass, replace
from html import escape

import numpy as np
import viser

from ...assessment.uncertainty import confidence_factor, ellipse_axes
from ...session.plan import Layout, Plan, PlanRequest, make_plan, plan_sentences, plan_table
from .. import html
from ..binding import Binding, Tab
from ..html import error_message
from ..prepare import PreparedRun
from ..state import PageState, PlanChoices


@dataclass(frozen=True)
class PlannedArray:
    """What is to be expected of an array before anything is measured."""

    choices: PlanChoices  # for which it was computed
    # (N, D, D) float64, metres, half axes of the 95 % ellipses in rows, the longest last; empty after an error
    axes: np.ndarray
    plan: Plan | None = None  # None after an error
    max_frequencies: int = 0  # number of frequencies that the array can use
    error: str = ""  # why there is no bound, "" if there is


def plan_request(run: PreparedRun, choices: PlanChoices) -> PlanRequest:
    """Return what the tab asks for.

    Raises InputError: no calibration is possible under these circumstances.
    """
    measurement, scene = run.measurement, run.scene
    room = None if scene.room.size is None else tuple(scene.room.size)
    if room is None and scene.room.dimension == 2:  # that is no rectangle: the box round it
        room = tuple(np.ptp(scene.room.vertices, axis=0).tolist())
    layout = Layout(run.scene.name, measurement.names, choices.placed(measurement.positions), run.known_scene)
    return PlanRequest(
        layout,
        room=room,
        snr_db=choices.snr_db,
        known=choices.known,
        gain_sigma_db=choices.gain_sigma_db,
        sound_speed=measurement.sound_speed,
        modes=choices.frequencies,
        takes=choices.takes,
    )


def planned_array(run: PreparedRun, choices: PlanChoices) -> PlannedArray:
    """Return the bound of the array, or in one line why there is none."""
    try:
        plan = make_plan(plan_request(run, choices))
        every = len(replace(plan.request, modes=None).band_frequencies)
    except ValueError as error:  # an InputError, too
        return PlannedArray(choices, np.zeros((0, 2, 2)), error=error_message(error))
    bound = plan.bound
    covariance = np.where(bound.free[:, None, None], bound.covariance, 0.0)
    axes = ellipse_axes(covariance, confidence_factor(0.95, covariance.shape[-1]))
    return PlannedArray(choices, axes, plan, every)


MEASURED = "This is a measurement; open a scene that is simulated to plan its array."
HINT = "Ellipses of the least error that is possible, before anything is measured; drag microphones to see it change"
DRAGGED = "The scene shows the plan, not the solver. Dragged microphones change the plan only."


SNR, GAIN_SIGMA = (1, 60), (0.0, 6.0)  # dB, between which the controls can be set
MIN_FREQUENCIES, MAX_TAKES = 3, 16


class PlanTab(Tab):
    """Owns the controls of the tab, of which a measurement has none, and the thread of the bound."""

    def __init__(self, binding: Binding):
        self._binding, self._max, self._possible = binding, 0, binding.run.known_scene is not None
        self._possible = self._possible and binding.measurement.positions is not None  # of a scene, not a recording
        if not self._possible:
            binding.gui.add_html(html.remark(MEASURED))
            return
        self._worker = binding.threads.map(lambda choices: planned_array(binding.run, choices))
        noise, known = binding.run.scene.measurement.snr_db, binding.measurement.known.tolist()
        snr = float(np.clip(np.round(noise), *SNR)) if np.isfinite(noise) else PlanChoices().snr_db
        takes = min(binding.measurement.take_count, MAX_TAKES)
        plan = PlanChoices(snr_db=snr, known=tuple(known), takes=takes)  # the circumstances of the scene itself
        # the microphones whose positions are given: first those that the scene gives, then the others by their numbers
        self._order = known + [n for n in range(binding.measurement.count) if n not in known]
        binding.choices = replace(binding.choices, plan=plan)
        choose, low = self._choose, MIN_FREQUENCIES
        self.shown = binding.checkbox("Show the plan", plan.shown, lambda value: choose(shown=value), hint=HINT)
        self.snr = binding.slider(
            "Planned SNR (dB)", *SNR, 1, round(plan.snr_db), lambda value: choose(snr_db=float(value)),
            hint="Signal-to-noise ratio of each frequency",
        )  # fmt: skip
        self.frequencies = binding.slider(
            "Frequencies", low, low + 1, 1, low + 1,
            lambda value: choose(frequencies=None if value >= self._max else value),  # the end stands for all
            visible=False, hint="The lowest so many of the independent ones",
        )  # fmt: skip
        self.known = binding.slider(
            "Given positions", 0, binding.measurement.count - 1, 1, len(plan.known),
            lambda value: choose(known=tuple(sorted(self._order[:value]))),
            hint="Microphones whose positions will be measured",
        )  # fmt: skip
        self.gain = binding.slider(
            "Gain sigma (dB)", *GAIN_SIGMA, 0.1, plan.gain_sigma_db,
            lambda value: choose(gain_sigma_db=value), hint="Spread of the channels' gains",
        )  # fmt: skip
        self.takes = binding.slider(
            "Places of the source", 1, MAX_TAKES, 1, plan.takes, lambda value: choose(takes=value),
            hint="Takes: one recording of the same length from each",
        )  # fmt: skip
        self.reset = binding.button(
            "Original positions", lambda _: choose(moved=()), icon=viser.Icon.ARROW_BACK_UP, disabled=True
        )
        self.summary = binding.gui.add_html("")

    def _choose(self, **changes) -> None:
        self._binding.choose(plan=replace(self._binding.choices.plan, **changes))

    @property
    def planned(self) -> PlannedArray | None:
        """The newest bound, which may be of choices a moment ago; None while there is none or no plan is shown."""
        plan = self._binding.choices.plan
        latest = self._worker.newest(plan) if self._possible and plan.shown else None
        return None if latest is None else latest.result

    def show(self, tick: PageState) -> None:
        """Bring the summary up to date."""
        if not self._possible:
            return
        plan, planned = self._binding.choices.plan, self.planned
        self.reset.disabled = not plan.moved
        if not plan.shown:
            self.summary.content = ""
        elif planned is not None:
            self.summary.content = summary(planned)
            count = planned.max_frequencies  # that the array can use, where the slider ends
            if count != self._max and count > MIN_FREQUENCIES:
                self._max, self.frequencies.visible, self.frequencies.max = count, True, count
                self.frequencies.value = count if plan.frequencies is None else min(plan.frequencies, count)


def summary(planned: PlannedArray) -> str:
    """Return the plan in words, or why there is none, as HTML."""
    if planned.plan is None:
        return html.complaint(planned.error)
    lines, (caption, advice) = plan_sentences(planned.plan)
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    cells = ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in plan_table(planned.plan)]
    table = f"<table style='text-align: right'><tr>{'</tr><tr>'.join(cells)}</tr></table>"
    return (
        f"<div style='{html.CARD}'><ul style='padding-left: 1.1em; margin: 0'>{items}</ul><p>{escape(caption)}</p>"
        f"{table}<p>{escape(advice)}</p></div>{html.remark(DRAGGED)}"
    )
