"""The race: who, from where; how far each is, in a table, in curves, and as marks in the scene."""

from __future__ import annotations

from html import escape

import numpy as np
import viser
from viser import uplot

from ...graphics.markers import SOLVER_MARKS
from ..background.comparison import ComparisonSetup, ComparisonWorker, RunSummary
from ..gui import html
from ..gui.binding import Binding
from ..gui.plots import Plot, decades
from ..server.client_values import bounded, one_of
from .solver import LARGEST_SEED, STARTS

FIELDS = {
    "all three": ("joint", "descent", "descent+joint"),
    "joint, descent": ("joint", "descent"),
    "joint, descent+joint": ("joint", "descent+joint"),
    "descent, descent+joint": ("descent", "descent+joint"),
}
DASHES = {"joint": (), "descent": (8, 5), "descent+joint": (2, 4)}
INTERVAL = 0.5  # s between two sendings of the curves
ALONE = "No race here: descent needs a plane sound field and a search domain, so joint would run alone."
LEAST_ERROR = 1e-3  # mm, drawn for anything below: logarithms have no zero


class ComparisonTab:
    """Owns the handles of the tab."""

    def __init__(self, binding: Binding, races: ComparisonWorker):
        self._binding, self._races, self._sent, self._shown, gui = binding, races, -1e9, None, binding.gui
        problem = binding.work.problem
        self._possible = problem.dimension == 2 and problem.search is not None
        self._plots: list = []
        if not self._possible:
            gui.add_html(html.remark(ALONE))
            return
        self.field = gui.add_dropdown("Racers", tuple(FIELDS), initial_value="all three")
        self.start = gui.add_dropdown("From", STARTS, initial_value="random", hint="The start that all of them share")
        self.seed = gui.add_number(
            "Race seed",
            binding.choices.seed,
            min=0,
            max=LARGEST_SEED,
            step=1,
            hint="Of the random start and of descent's order",
        )
        self.run = gui.add_button("Start", icon=viser.Icon.FLAG, hint="Start; press again to pause and to resume")
        self.again = gui.add_button_group(
            "", ("Reset", "End"), visible=False, hint="All back to the start; or no race any more"
        )
        self.marks = gui.add_checkbox("Show in the scene", True, hint="Where each racer supposes the microphones")
        self.table = gui.add_html("")
        self._place = gui.add_folder(None)  # of the plots, made when it is known who races
        binding.on(self.run, lambda _: races.toggle(self.entry))
        binding.on(self.again, lambda value: (races.reset if value == "Reset" else races.stop)())

    @property
    def entry(self) -> ComparisonSetup:
        """What the handles say, bounded."""
        names = FIELDS[one_of(self.field.value, FIELDS, "all three")]
        seed = bounded(self.seed.value, 0, LARGEST_SEED, 0)
        return ComparisonSetup(names, one_of(self.start.value, STARTS, "random"), seed)

    def marked(self, runners: tuple[RunSummary, ...]) -> tuple[RunSummary, ...]:
        """Those to be drawn in the scene."""
        return runners if self._possible and self.marks.value else ()

    def show(self, runners: tuple[RunSummary, ...], now: float) -> None:
        """Called by the main loop."""
        if not self._possible:
            return
        binding, races = self._binding, self._races
        binding.send("race word", races.button_label, self.run, "label")
        binding.send("race over", races.finished, self.run, "disabled")
        binding.send("race begun", bool(runners), self.again, "visible")
        binding.send("race table", html.complaint(races.error) + table(runners), self.table, "content")
        if runners is self._shown or now - self._sent < INTERVAL:
            return
        self._sent, self._shown = now, runners
        self._show_curves(runners)

    def _show_curves(self, runners: tuple[RunSummary, ...]) -> None:
        names = tuple(runner.name for runner in runners)
        ready = bool(runners) and all(len(runner.times) for runner in runners)
        if self._plots and (not ready or self._plots[0] != names):
            for plot in self._plots[1:]:
                plot.remove()
            self._plots = []
        if not ready:
            return
        axis = _axis(runners)
        curves = [[runner.costs for runner in runners]]
        if runners[0].mean_errors is not None:
            curves.insert(0, [np.maximum(runner.mean_errors, LEAST_ERROR) for runner in runners])
        data = [(axis, *(_held(axis, r.times, c) for r, c in zip(runners, one, strict=True))) for one in curves]
        if not self._plots:
            titles = ("Mean position error (mm)", "Cost (Eq. 7, all modes; dB re the power)")[-len(data) :]
            with self._place:
                self._plots = [names, *(self._plot(title, names) for title in titles)]
        for plot, columns in zip(self._plots[1:], data, strict=True):
            plot.show(columns, decades(*columns[1:]) if "error" in plot.title else None)

    def _plot(self, title: str, names) -> Plot:
        drawn = [
            uplot.Series(
                label=name, stroke=SOLVER_MARKS[name].colour, width=2.5, dash=DASHES[name], points={"show": False}
            )
            for name in names
        ]
        series = (uplot.Series(label="s"), *drawn)
        return Plot(self._binding.gui, title, series, "processor time (s)", height=200)


def _axis(runners: tuple[RunSummary, ...]) -> np.ndarray:
    """Every time at which a curve has a point : (P,) float64, s, ascending, each once."""
    return np.unique(np.concatenate([runner.times for runner in runners]))


def _held(axis: np.ndarray, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """A curve that stays where it is until its next point : (P,) float64."""
    return values[np.maximum(np.searchsorted(times, axis, side="right") - 1, 0)]


def table(runners: tuple[RunSummary, ...]) -> str:
    """Time, steps, error and cost of each : HTML."""
    if not runners:
        return ""
    rows = []
    for runner in runners:
        colour = SOLVER_MARKS[runner.name].colour
        dashes = ",".join(map(str, DASHES[runner.name]))
        line = (
            f"<svg width='30' height='10'><line x1='0' y1='5' x2='30' y2='5' stroke='{colour}' stroke-width='3'"
            f" stroke-dasharray='{dashes}'/></svg> {SOLVER_MARKS[runner.name].shape}"
        )
        error = (
            ""
            if runner.mean_error is None
            else f"{runner.mean_error:.3g} mm, largest {runner.largest_error:.3g} mm<br>"
        )
        cost = f"cost {runner.costs[-1]:.1f} dB" if len(runner.costs) else ""
        rows.append(
            f"<tr><td style='padding-right: 0.6em; vertical-align: top; white-space: nowrap'>{line}</td><td>"
            f"<b>{escape(runner.name)}</b>: {escape(runner.status)}<br>"
            f"{runner.seconds:.2f} s, {runner.step} steps<br>{error}{cost}</td></tr>"
        )
    return f"<div style='{html.CARD}'><table style='border-spacing: 0 0.2em'>{''.join(rows)}</table></div>"
