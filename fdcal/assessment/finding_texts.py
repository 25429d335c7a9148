"""Messages of findings that several checks of a verdict have in common; arguments stand in angle brackets."""

from __future__ import annotations

from collections.abc import Sequence

CAUSES = "a source or an obstacle inside the array, odd channels, or positions not found yet (try another solver)"


def contradicted(names: Sequence[str]) -> str:
    """Return the message of known microphones that are elsewhere than given."""
    return (
        f"known microphone {enumerated(names)}: the position given contradicts the recordings; it is wrong, or the"
        " channel is swapped with another; check the positions and the cables of the known microphones"
    )


def mostly_noise(share: float) -> str:
    """Return the message of a measurement with so much noise as a share of the power."""
    return (
        f"about {100 * share:.0f} % of the power is noise or unexplained; measure longer, louder, or use fewer <modes>"
    )


def unexplained(share: float) -> str:
    """Return the message of so much unexplained, as a share of the power, without any noise given."""
    return (
        f"{100 * share:.1g} % of the power is left unexplained, though the measurement is said to be free of noise:"
        f" {CAUSES}"
    )


def unfitted(names: Sequence[str]) -> str:
    """Return the message of channels that no sound field without sources explains."""
    return f"no sound field without sources explains microphone {enumerated(names)}: {CAUSES}"


def enumerated(names: Sequence[str]) -> str:
    """Return names as a text: "a, b and c"."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
