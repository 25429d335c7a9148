"""What map a page wants, and how it is drawn; which map may stand in for another."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ...solvers.interface import RunState


@dataclass(frozen=True)
class MapStyle:
    """How a map is drawn."""

    log: bool = True  # whether its scale is logarithmic
    opacity: float = 1.0  # 0 to 1
    relief: bool = False  # whether its heights rise with its colours
    relief_height: float = 0.3  # of the highest cost, of the longer side of the search domain
    shared: bool = False  # one scale for all the maps side by side
    dark: bool = False  # whether the page is
    shape: bool = False  # the sound field of the last of the modes instead of a cost
    minima: bool = True  # whether its local minima are marked and counted
    volume: bool = False  # the cost in space instead of on the floor
    basins: bool = False  # the basins of attraction instead of the cost
    slice_axis: str = "z"  # "x", "y" or "z", across the slice through the volume; "none" for no slice
    slice_position: float | None = None  # of the slice along that axis, metres; None for the estimate of the microphone


@dataclass(frozen=True)
class CostMapRequest:
    """A map to be computed."""

    revision: int  # counts the states on the screen, which have no cheap equality of their own
    microphone: int  # counted from 0
    modes: tuple[int, ...]  # counted from 1
    order_offset: int | None  # of the map of Eq. 7; None for what the solver minimises
    custom_modes: bool  # whether the user has chosen the modes; otherwise they are those in use
    style: MapStyle
    follow: bool = field(compare=False)  # whether any microphone will do, as long as the solver has moved it lately
    state: RunState = field(compare=False)  # of the solver
    lineage: object = field(compare=False)  # of the history that the state belongs to
    take: int | None = None  # whose rows the map is of; None for those of all takes

    def stands_for(self, wanted: CostMapRequest, running: bool) -> bool:
        """Whether this map may be shown in place of `wanted`: while running, the map of an older state may."""
        if self == wanted or not running:
            return self == wanted
        mine, theirs = (
            (
                None if wanted.follow else one.microphone,
                one.modes if one.custom_modes else None,
                one.order_offset,
                one.style,
                one.take,
            )
            for one in (self, wanted)
        )
        return mine == theirs and self.lineage is wanted.lineage

    def differs_in_style(self, wanted: CostMapRequest) -> bool:
        """Whether `wanted` is this map of costs or field in another style; its state may be newer."""
        alike = self.style.shape == wanted.style.shape and replace(self, style=wanted.style).stands_for(wanted, True)
        return alike and self.style != wanted.style

    def differs_in_slider(self, wanted: CostMapRequest) -> bool:
        """Whether `wanted` is this volume with another slice, or this relief of another height."""
        moved = {name: getattr(wanted.style, name) for name in ("slice_axis", "slice_position", "relief_height")}
        return replace(self, style=replace(self.style, **moved)) == wanted

    def differs_in_theme(self, wanted: CostMapRequest) -> bool:
        """Whether `wanted` is this map on a page of the other theme, whose colours of costs are the same."""
        return self != wanted and replace(self, style=replace(self.style, dark=wanted.style.dark)) == wanted

    def differs_in_one_position(self, wanted: CostMapRequest) -> bool:
        """Whether `wanted` is this map except for the position of one microphone, as during a drag."""
        if replace(self, revision=wanted.revision) != wanted:
            return False
        mine, theirs = (np.asarray(one.state.positions) for one in (self, wanted))
        return mine.shape == theirs.shape and int(np.count_nonzero((mine != theirs).any(axis=1))) <= 1
