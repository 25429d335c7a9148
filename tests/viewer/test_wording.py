"""No text of the page, of a lesson or of a report uses a wording that readers found odd."""

import ast
import re
from pathlib import Path

import pytest

import fdcal
from fdcal.model.scene_file import scene_folder
from fdcal.session.lesson import lesson_folder

# As the page once had them, in pieces where a number or a name stood between.
ODD_WORDINGS = (
    "nothing moves any more", "Step on and on", "Pause stops it", "Start anew", "As Reset does", "Steps a second",
    "c error (%)", "told to the solver", "Those in use", "Chosen here", "supposed position", "supposed place",
    "local minima inside", "share the darkest colour", "(greatest 1)", "what the microphones heard",
    "supposed to be", "a mode more or another goal", "Point at a curve to read it off", "Of this page alone",
    "The way that each microphone has come", "come once the solver has finished",
    "nothing is simulated that could be set here", "nothing tells within which bounds", "All back to the start",
    "no race any more", "drawn anew", "to go on another day", "where it was left", "of the microphone before",
    "Last step of the lesson", "Set again", "as this step wants them", "in mean", "Where it is dark the microphone",
    "what it did hear", "But mind what helped", "told by its colour alone", "heard: each microphone",
    "what all hear", "not where told to be", "cannot be;",
)  # fmt: skip
ODD = {phrase: re.compile(rf"(?<!\w){re.escape(phrase)}(?!\w)", re.IGNORECASE) for phrase in ODD_WORDINGS}
PACKAGE = Path(fdcal.__file__).parent
PARTS = ("viewer", "graphics", "assessment", "session", "model", "recordings")  # whose texts the page can show
RIDDLE = re.compile(r"\bIt is [A-C]\b")


def literals(path):
    """The texts in a module, without docstrings; a value within an f-string is a pair of braces."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    comments = {
        id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in comments:
            yield node.value


def odd_wordings(text):
    text = " ".join(text.split())
    return [phrase for phrase, pattern in ODD.items() if pattern.search(text)] + RIDDLE.findall(text)


@pytest.mark.parametrize("part", PARTS)
def test_no_text_of_the_program_has_one(part):
    modules = sorted((PACKAGE / part).rglob("*.py"))
    found = {(path.name, odd) for path in modules for text in literals(path) for odd in odd_wordings(text)}
    assert modules and not found


def test_no_lesson_scene_or_exported_page_has_one():
    files = [path for kind in ("toml", "html", "js", "md") for path in PACKAGE.rglob(f"*.{kind}")]
    files += [*scene_folder().glob("*.toml"), *lesson_folder().glob("*.toml")]
    found = {(path.name, odd) for path in files for odd in odd_wordings(path.read_text(encoding="utf-8"))}
    assert len(files) > 5 and not found


def test_an_odd_wording_is_found_across_lines_and_values(tmp_path):
    module = tmp_path / "page.py"
    module.write_text('"""Steps a second."""\nx = f"{n} local minima" \' inside\'\ny = "cannot be; 100 Hz can"\n')
    assert {odd for text in literals(module) for odd in odd_wordings(text)} == {"local minima inside", "cannot be;"}
