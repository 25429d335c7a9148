"""Names in fdcal/ are words that an acoustician, a signal-processing engineer or a NumPy programmer already knows."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "fdcal"

# Words that are not part of a name, and what to use in their place.
PRIVATE = {
    "told untold": "given, reported, known",
    "rehomed astray fled": "relocated, outlier, diverged",
    "bends": "polynomial deformation",
    "strain": "normalised chi-square",
    "foretell foretells foretold heard": "predict, prediction, leave-one-out error",
    "surprise votes": "studentised residual, influence",
    "faint convincing outdone": "low_noise, confirmed, worse_than_best",
    "wishes desk": "import options, binding",
    "bell knobs clocked shelf hollows": "wake event, parameters, timed, array store, local minima",
    "supposing supposed": "assumed, estimated",
}
NOT = {word: instead for words, instead in PRIVATE.items() for word in words.split()}


def names(tree: ast.AST):
    """Yield every name that a module defines or uses, with its line."""
    for node in ast.walk(tree):
        for field in ("name", "id", "attr", "arg"):
            value = getattr(node, field, None)
            if isinstance(value, str):
                yield value, getattr(node, "lineno", 0)


def words(name: str) -> set[str]:
    """Words of a name: "_NoiseTold" and "NOISE_TOLD" hold "told"."""
    return {part.lower() for part in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)}


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_names_are_words_of_the_field(path):
    found = [
        f"{path.relative_to(PACKAGE)}:{line}: {name}; use {NOT[word]}"
        for name, line in names(ast.parse(path.read_text(encoding="utf-8")))
        for word in words(name) & NOT.keys()
    ]
    assert not found, "\n".join(found)
