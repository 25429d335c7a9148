"""The single checks of given positions in the verdict on an array with the gains of its channels.

Each returns a message, or "" where there is nothing to report; arguments stand in angle brackets, as in
`fdcal.assessment.findings`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..model.problem import Problem
from ..solvers.robust.given_positions import inaccurate
from ..solvers.robust.state import State
from . import findings
from .given_check import GivenCheck
from .odd_channels import OddChannel


@dataclass(frozen=True)
class GivenThresholds:
    """Limits beyond which a figure becomes a finding.

    Attributes
    ----------
    misplaced_share : part of the given positions that may be misplaced; one may always be
    contradiction : probability below which given positions and pressures contradict each other
    unchecked, unchecked_sigmas : metres, and sigmas of the array: where the pressures and the other given positions
        place a given microphone no better than the larger one, an error of its position would go unseen
    """

    misplaced_share: float = 0.2
    contradiction: float = 0.01
    unchecked: float = 0.025
    unchecked_sigmas: float = 2.0


LIMITS = GivenThresholds()


def disagreement(problem: Problem, odd: Sequence[OddChannel], given: GivenCheck, names: Sequence[str]) -> str:
    """Report given positions that the pressures contradict, one by one or as a whole."""
    return misplaced_positions(problem, odd, names) or contradiction(problem, given)


def contradiction(problem: Problem, given: GivenCheck) -> str:
    """Report that the pressures and the given positions as a whole do not agree."""
    if not len(problem.known) or given.probability > LIMITS.contradiction:
        return ""
    seldom = f"1 of {1 / given.probability:.0f}" if given.probability > 1e-6 else "less than 1 of 1000000"
    return (
        f"the positions given and the pressures do not agree; by chance they would disagree so in {seldom} cases: a"
        " given position or the sound speed is wrong, or the array was not found; check them, or use more <modes>"
    )


def unchecked(problem: Problem, given: GivenCheck, spread: float) -> str:
    """Report that an error of a given position would go unseen; `spread` is one sigma of the array, metres."""
    if not len(problem.known) or given.loosest < max(LIMITS.unchecked, LIMITS.unchecked_sigmas * spread):
        return ""
    return (
        "nothing would show an error of a given position: the pressures and the other given positions place that"
        f" microphone only to {1e3 * given.loosest:.2g} mm; use more <modes>, or give more positions"
    )


def misplaced_positions(problem: Problem, odd: Sequence[OddChannel], names: Sequence[str]) -> str:
    """Report wrong given positions that are too many, or leave too few, to hold the array."""
    wrong = [one for one in odd if one.number in problem.known and one.kind in ("misplaced", "exchanged")]
    misplaced = [one for one in wrong if one.kind == "misplaced"]
    few = len(wrong) > 0 and len(problem.known) - len(wrong) < problem.array_dimension + 1
    if few or len(misplaced) > max(1, LIMITS.misplaced_share * len(problem.known)):
        return findings.contradicted([names[one.number] for one in wrong])
    return ""


def inaccuracy(problem: Problem, state: State) -> str:
    """Return a remark where all given positions are inaccurate; "" otherwise."""
    if not len(problem.known) or not inaccurate(state):
        return ""
    return f"; the given positions are inaccurate, one sigma {1e3 * state.model.known_sigma:.2g} mm"
