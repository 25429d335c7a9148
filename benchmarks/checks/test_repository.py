"""pyproject.toml, CONTRIBUTING.md, `.ci/run` and the workflow agree on what fdcal needs and is tested with."""

import functools
import re
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import yaml

import fdcal

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
NAME = re.compile(r"[A-Za-z0-9_.-]+")


IMPORTED = re.compile(r"^\s*(?:from|import) (\w+)", re.MULTILINE)  # in texts, too
OWN = re.compile(r"fdcal\[([\w,]+)\]")


def distributions(requirements: list[str]) -> set[str]:
    """Names of the libraries of some requirements, and of the extras among them."""
    found = set()
    for requirement in requirements:
        own = OWN.match(requirement)
        extras = own[1].split(",") if own else ()
        found |= set().union(*(distributions(EXTRAS[extra]) for extra in extras)) if own else {_name(requirement)}
    return found


def _name(requirement: str) -> str:
    return NAME.match(requirement).group().lower()


@functools.cache
def installed() -> dict[str, list[str]]:
    """The distributions that bring each package of the environment."""
    return metadata.packages_distributions()


def imports(folder: str) -> set[str]:
    """Names of the distributions that the modules of a folder import."""
    found = {name for path in (ROOT / folder).rglob("*.py") for name in IMPORTED.findall(path.read_text("utf-8"))}
    own = {path.stem for path in ROOT.rglob("tests/**/*.py")} | {"fdcal", "fdcal_bench", "benchmarks", "tests"}
    known = found - own - set(sys.stdlib_module_names)
    return {installed()[name][0].lower() for name in known if name in installed()}


def test_every_library_that_is_imported_is_named():
    needed = distributions(PROJECT["dependencies"])
    assert imports("fdcal") <= needed | distributions(EXTRAS["all"])
    assert imports("tests") <= needed | distributions(EXTRAS["test"])
    # the benchmark of wave fields with a finite-element mesh and the fuzz of all formats need more
    assert imports("benchmarks") <= needed | distributions(EXTRAS["benchmarks"])


# -- where it is tested ------------------------------------------------------------------------------------------------


def test_the_workflow_runs_what_ci_runs_on_every_python():
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8"))
    assert workflow[True].keys() == {"push", "pull_request"}, 'YAML reads the key "on" as true'
    (job,) = workflow["jobs"].values()
    assert any(step.get("run") == ".ci/run" for step in job["steps"])
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    pythons = re.search(r'^PYTHONS="([^"]+)"', script, re.MULTILINE).group(1).split()
    assert job["strategy"]["matrix"]["python"] == pythons
    assert PROJECT["requires-python"] == f">={pythons[0]}"
    assert "-m benchmarks.smoke" in script and ".ci/lowest.py" in script


# -- a release ---------------------------------------------------------------------------------------------------------


def test_a_tag_publishes_what_ci_has_passed():
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "publish.yml").read_text(encoding="utf-8"))
    assert workflow[True] == {"push": {"tags": ["v*"]}}
    build, publish = workflow["jobs"]["build"], workflow["jobs"]["publish"]
    runs = [step.get("run", "") for step in build["steps"]]
    assert runs.index(".ci/run") < runs.index("pipx run build") and "GITHUB_REF_NAME#v" in " ".join(runs)
    assert publish["needs"] == "build" and publish["permissions"] == {"id-token": "write"}
    assert any("gh-action-pypi-publish" in step["uses"] for step in publish["steps"])


def test_the_version_is_the_same_everywhere():
    version = PROJECT["version"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == version and citation["license"] == PROJECT["license"]
    assert fdcal.__version__ == metadata.version("fdcal")
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.findall(r"^## (.+)", changes, re.MULTILINE)[0] == f"[{version}] - {citation['date-released']}"
