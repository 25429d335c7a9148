"""The plan of the house holds: who imports whom, and what may appear where. Read from the source, not by running it."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "fdcal"

# From the ground up; a module imports only from rooms earlier in this list. Rooms on one line stand side by side
# and do not import each other; a folder is one room, whose modules may.
ROOMS = [
    ["checks"],
    ["tables", "modeset"],
    ["vtkxml"],
    ["scene"],
    ["gauge"],
    ["space"],
    ["arrays"],
    ["compiled"],
    ["stencil"],
    ["fdtd"],
    ["dictionary", "spherical"],
    ["spectrum"],
    ["shoebox"],
    ["measurement"],
    ["selection"],
    ["measurement_file"],
    ["store"],
    ["cost"],
    ["candidates"],
    ["series"],
    ["sinc"],
    ["dense", "expansion"],
    ["learned"],
    ["likelihood"],
    ["likelihood_maps"],
    ["basins"],
    ["landscapes"],
    ["rehearsal"],
    ["rectangle"],
    ["solvers"],
    ["requirements"],
    ["uncertainty"],
    ["evidence", "soundspeed", "listening"],
    ["fieldmap"],
    ["fieldfiles"],
    ["verdict"],
    ["roomverdict"],
    ["roomruns"],
    ["recording", "placed", "bins"],
    ["decay", "health"],
    ["formats", "responses", "decimation"],
    ["steady", "deconvolution", "choosing", "frames"],
    ["wishes", "imported"],
    ["intake"],
    ["history"],
    ["worker"],
    ["session"],
    ["measured"],
    ["opening", "scenario", "race"],
    ["shapes"],
    ["framing"],
    ["primitives"],
    ["painting"],
    ["panels"],
    ["picture"],
    ["camera"],
    ["lettering"],
    ["offscreen"],
    ["figures"],
    ["export"],
    ["lesson"],
    ["viewer", "snapshot"],
    ["arguments", "runs"],
    ["paper"],
    ["options"],
    ["drawing"],
    ["cli"],
    ["__main__"],
]
RANK = {name: rank for rank, names in enumerate(ROOMS) for name in names}

# Where a library may be imported, and nowhere else.
HOMES = {
    "viser": {"viewer"},
    "pyvista": {"snapshot"},
    "vtk": {"snapshot"},
    "threading": {"session", "worker"},
    "_thread": {"session"},
    "concurrent": {"session", "compiled"},
    "matplotlib": {"shapes", "primitives", "painting", "lettering", "panels", "viewer", "figures", "fieldfiles"}
    | {"paper"},
    "click": {"options", "drawing", "cli"},
    "tqdm": {"options"},
    "platformdirs": {"store"},
    "tomllib": {"scene", "lesson"},
    "soundfile": {"formats"},
    "h5py": {"formats"},
    "sofar": {"formats"},
}
MODULES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


def room(path: Path) -> str:
    """Room of a module: its folder inside the package, or its own name."""
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def imports(path: Path) -> set[tuple[str, ...]]:
    """Every module that `path` imports anywhere, by its absolute dotted name's parts."""
    package = ("fdcal", *path.relative_to(PACKAGE).parts[:-1])
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {tuple(alias.name.split(".")) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            base += tuple(node.module.split(".")) if node.module else ()
            found |= {(*base, alias.name) for alias in node.names}
    return found


def rooms_of(path: Path) -> set[str]:
    """Other rooms that a module imports from."""
    return {name[1] for name in imports(path) if name[0] == "fdcal" and len(name) > 1} - {room(path)}


def id_of(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


def test_every_room_has_one_place():
    names = [name for row in ROOMS for name in row]
    assert sorted(names) == sorted(set(names))


@pytest.mark.parametrize("path", MODULES, ids=id_of)
def test_module_imports_only_from_lower_rooms(path):
    assert room(path) in RANK, f"{room(path)} has no place in ROOMS; give it one"
    for other in rooms_of(path):
        assert other in RANK, f"{other} has no place in ROOMS; give it one"
        assert RANK[other] < RANK[room(path)], f"{id_of(path)} imports {other}, which is above or beside it"


@pytest.mark.parametrize("path", MODULES, ids=id_of)
def test_library_stays_in_its_home(path):
    for library in {name[0] for name in imports(path)} & set(HOMES):
        assert room(path) in HOMES[library], f"{library} belongs in {HOMES[library]}"


@pytest.mark.parametrize("path", [p for p in MODULES if RANK.get(room(p), 0) < RANK["measurement_file"]], ids=id_of)
def test_lower_rooms_read_no_files(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    loader = {
        id(node)
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef) and (room(path), function.name) == ("scene", "load_scene")
        for node in ast.walk(function)
    }
    readers = {"open", "read_text", "read_bytes", "loadtxt", "fromfile", "memmap", "genfromtxt"}
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and id(node) not in loader:
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            library = getattr(getattr(node.func, "value", None), "id", "")
            reads = name in readers or (name in ("load", "loads") and library in ("np", "json", "pickle", "tomllib"))
            assert not reads, f"{id_of(path)}:{node.lineno} reads a file"


@pytest.mark.parametrize("path", [p for p in MODULES if room(p) in ("cost", "candidates", "solvers")], ids=id_of)
def test_cost_and_solvers_never_see_the_truth(path):
    assert not rooms_of(path) & {"arrays", "store", "fdtd"}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = {getattr(node, "id", ""), getattr(node, "attr", ""), getattr(node, "arg", "")}
        assert not names & {"Measurement", "Scene", "truth", "load_measurement", "load_scene"}


def test_app_stays_small():
    assert len((ROOT / "app.py").read_text(encoding="utf-8").splitlines()) < 60


SOLVERS = {"pyvista", "trimesh", "numba", "matplotlib", "scipy"}


@pytest.mark.parametrize(
    ("module", "heavy"),
    [
        ("fdcal", {"viser"} | SOLVERS),
        ("fdcal.scene", {"viser"} | SOLVERS),
        ("fdcal.session", {"viser"} | SOLVERS),
        ("fdcal.cli", {"viser"} | SOLVERS),
        ("fdcal.viewer", SOLVERS),  # the address of the page is told before they are loaded
        ("fdcal.viewer.firstlook", {"trimesh", "numba", "scipy"}),
    ],
)
def test_import_stays_light(module, heavy):
    code = f"import sys, {module}; print(*{heavy} & set(sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert run.stdout.split() == []
