"""The architecture: which package imports which, and what may appear where; found by reading the source."""

import ast
import pkgutil
import runpy
import subprocess
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import fdcal
from fdcal import solvers

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "fdcal"

# The order is from the ground up; a package imports only from packages earlier in this list.
PACKAGES = "model acoustics cost solvers assessment recordings session graphics viewer commands".split()

# A library may be imported only in these packages or modules.
HOMES = {
    **{name: {"commands"} for name in ("click", "tqdm")},
    **{name: {"graphics.snapshot"} for name in ("pyvista", "vtk")},
    **{name: {"recordings.formats"} for name in ("soundfile", "h5py", "sofar")},
    **{name: {"session"} for name in ("threading", "_thread")},
    "concurrent": {"session", "acoustics.compiled"},
    "matplotlib": {"graphics", "viewer"},
    "pandas": {"assessment.result_file"},
    "platformdirs": {"model.storage"},
    "sounddevice": {"recordings.take"},
    "threadpoolctl": {"session.process"},
    "tomllib": {"model"},
    "viser": {"viewer"},
    "vtkmodules": {"graphics.volume"},
}
MODULES = sorted(PACKAGE.rglob("*.py"))


def name_of(path: Path) -> str:
    """Dotted name of a module inside `fdcal`, as "model.scene"; of a package that of its folder."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


NAMES = {name_of(path): path for path in MODULES}
INSIDE = [path for path in MODULES if path.parent != PACKAGE]


def package_of(name: str) -> str:
    return name.partition(".")[0]


@cache
def nodes(path: Path) -> list[ast.AST]:
    """All nodes of the syntax tree of a module."""
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


@cache
def imports(path: Path) -> set[str]:
    """Absolute dotted names that a module imports, inside its functions, too."""
    parts = ("fdcal", *path.relative_to(PACKAGE).parts[:-1])
    found = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = parts[: len(parts) - node.level + 1] if node.level else ()
            base = ".".join((*base, *filter(None, [node.module])))
            found |= {f"{base}.{alias.name}" for alias in node.names}
    return found


@cache
def modules_of(path: Path) -> set[str]:
    """Modules of `fdcal`, as of `name_of`, that a module imports."""
    found = set()
    for name in imports(path):
        inner = name.removeprefix("fdcal.")
        if name.startswith("fdcal."):
            found.add(inner if inner in NAMES else inner.rpartition(".")[0])
    return found - {name_of(path), ""}


def test_the_packages_are_those_of_the_plan_and_none_imports_the_root():
    assert {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()} == set(PACKAGES)
    assert {path.name for path in PACKAGE.glob("*.py")} == {"__init__.py", "__main__.py"}
    public = {"fdcal", *(f"fdcal.{name}" for name in fdcal.PUBLIC)}
    assert not [name_of(path) for path in INSIDE if imports(path) & public]


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_says_what_it_is_for_and_has_no_import_cycle(package):
    assert "May import" in (ast.get_docstring(ast.parse(NAMES[package].read_text(encoding="utf-8"))) or "")
    inside = [path for path in INSIDE if package_of(name_of(path)) == package]
    try:
        TopologicalSorter({name_of(path): modules_of(path) for path in inside}).prepare()
    except CycleError as error:
        pytest.fail(f"import cycle: {' -> '.join(error.args[1])}")


def test_a_module_imports_only_from_packages_below():
    for path in INSIDE:
        rank = PACKAGES.index(package_of(name_of(path)))
        for other in modules_of(path):
            assert PACKAGES.index(package_of(other)) <= rank, f"{name_of(path)} imports {other}, which is above it"


def test_a_library_is_imported_only_where_it_belongs():
    for path in INSIDE:
        name = name_of(path)
        for library in {one.partition(".")[0] for one in imports(path)} & set(HOMES):
            homes = HOMES[library]
            assert any(f"{name}.".startswith(f"{home}.") for home in homes), f"{name}: {library} belongs in {homes}"


@pytest.mark.parametrize(
    ("owner", "name", "target"), [(o, n, t) for o, m in fdcal.METHODS.items() for n, t in m.items()]
)
def test_a_method_that_is_bound_at_the_root_is_there(owner, name, target):
    """Its module belongs to a higher package than its class; otherwise the method would stand in the class."""
    assert fdcal.Calibration and fdcal.Measurement and fdcal.landscape
    module = owner.partition(":")[0]
    own = getattr(pkgutil.resolve_name(f"fdcal.{owner}"), name)
    assert (own.__module__, own.__name__) == (f"fdcal.{target.partition(':')[0]}", target.partition(":")[2])
    assert PACKAGES.index(package_of(target)) >= PACKAGES.index(package_of(module))


def of_packages(*packages: str) -> list[Path]:
    return [path for path in INSIDE if package_of(name_of(path)) in packages]


def test_assessment_reads_what_every_solver_reports():
    """It reads what solvers have in common and nothing of a single one, so that a solver can be added."""
    for path in of_packages("assessment"):
        inside = {name.split(".")[1] for name in modules_of(path) if name.startswith("solvers.")}
        assert inside <= {"interface", "requirements"}, f"{name_of(path)} imports {sorted(inside)}"


def test_cost_and_solvers_never_see_the_truth():
    for path in of_packages("cost", "solvers"):
        hidden = {"model.arrays", "model.storage", "acoustics.measure", "acoustics.fdtd"}
        assert not modules_of(path) & hidden, name_of(path)
        for node in nodes(path):
            names = {getattr(node, "id", ""), getattr(node, "attr", ""), getattr(node, "arg", "")}
            assert not names & {"Measurement", "Scene", "truth", "load_measurement", "load_scene"}, name_of(path)


SOLVERS = set(solvers.names())


def compared_texts(node: ast.AST) -> set[str]:
    """Text constants that a comparison, or a call of startswith or endswith, compares with."""
    if isinstance(node, ast.Compare):
        parts = [node.left, *node.comparators]
    elif isinstance(node, ast.Call) and getattr(node.func, "attr", "") in ("startswith", "endswith"):
        parts = node.args
    elif isinstance(node, ast.MatchValue):
        parts = [node.value]
    else:
        return set()
    inside = [inner for part in parts for inner in (getattr(part, "elts", None) or [part])]
    return {one.value for one in inside if isinstance(one, ast.Constant) and isinstance(one.value, str)}


def test_no_decision_depends_on_the_name_of_a_solver():
    """Other code asks for the traits of a solver (`fdcal.solvers.interface.Traits`), so that one can be added."""
    for path in of_packages(*(package for package in PACKAGES if package != "solvers")):
        for node in nodes(path):
            assert not compared_texts(node) & SOLVERS, f"{name_of(path)}:{node.lineno}"


def test_the_drawing_of_the_packages_is_that_of_the_source():
    drawing = runpy.run_path(str(ROOT / "docs" / "packages.py"))
    assert drawing["DRAWING"].read_text(encoding="utf-8") == drawing["drawing"](), "run: python docs/packages.py"


HEAVY = {"pyvista", "trimesh", "numba", "matplotlib", "scipy"}
LATE = {"pyvista", "trimesh", "scipy.optimize", "scipy.spatial"}  # the first picture does not need these libraries


LIGHT = {  # one process imports the modules in this order; none may have loaded these libraries so far
    "fdcal": {"fdcal.model", "numpy", "viser"} | HEAVY,
    "fdcal.model.scene": {"viser"} | HEAVY,
    "fdcal.session.session": {"viser"} | HEAVY,
    "fdcal.commands.cli": {"viser"} | HEAVY,
    "fdcal.viewer": HEAVY,  # the address of the page is printed before these are loaded
    "fdcal.viewer.scene3d": {"trimesh", "numba", "scipy"},
    "fdcal.viewer.page": LATE,
}


def test_import_stays_light():
    code = "import importlib, sys\n" + "".join(
        f"importlib.import_module({module!r}); print({module!r}, *{heavy} & set(sys.modules))\n"
        for module, heavy in LIGHT.items()
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert run.stdout.splitlines() == list(LIGHT)
