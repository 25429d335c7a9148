"""The command line ends with one line, an exit code and no traceback after any unexpected event."""

import contextlib
import os
import signal
import subprocess
import sys
from importlib import metadata

import pytest

from fdcal.assessment.result_file import load_result
from fdcal.commands import cli, options
from fdcal.model.libraries import LIBRARY, missing_library

FDCAL = [sys.executable, "-m", "fdcal"]


@pytest.fixture
def broken(monkeypatch):
    """Function that makes the command `scenes` raise."""

    def breaks(error: BaseException) -> None:
        def fail():
            raise error

        monkeypatch.setattr(cli, "scene_names", fail)

    return breaks


def ended(*arguments: str) -> int:
    with pytest.raises(SystemExit) as caught:
        cli.main(list(arguments))
    return caught.value.code


@pytest.mark.parametrize("arguments", [("scenes", "--debug"), ("--debug", "scenes")])
def test_debug_shows_the_traceback(arguments, broken, capsys):
    broken(ZeroDivisionError("by zero"))
    assert ended(*arguments) == 1
    errors = capsys.readouterr().err
    assert "Traceback" in errors and errors.splitlines()[-1].startswith("error: ")


@pytest.mark.parametrize(("error", "code", "words"), [
    (MemoryError(), 1, "not enough memory"), (KeyboardInterrupt(), 130, "interrupted"),
    (RecursionError("too deep"), 1, "report"), (OSError("disk on fire"), 3, "disk on fire"),
    (ValueError("x" * 10**6), 1, "..."),
    (ZeroDivisionError("division\nby zero"), 1, "ZeroDivisionError: division by zero"),
])  # fmt: skip
def test_each_kind_of_error_has_its_code(error, code, words, broken, capsys):
    broken(error)
    assert ended("scenes") == code
    out, errors = capsys.readouterr()
    assert out == "" and errors.strip().startswith("error: ")
    fault = isinstance(error, (RecursionError, ValueError, ArithmeticError))
    assert ("report" in errors and "--debug" in errors) == fault
    assert words in errors and errors.strip().count("\n") == 0 and len(errors) < 1000


def test_an_interrupt_while_a_command_loads_a_library_is_one_line(tmp_path):
    """Some extension modules, which a command loads when it needs them, turn the interrupt into an ImportError."""
    (tmp_path / "slow.py").write_text(
        "import os, signal\n"
        "try:\n    os.kill(os.getpid(), signal.SIGINT)\n    sum(range(10**6))\n"
        "except KeyboardInterrupt:\n    raise ImportError('initialization failed') from None\n"
    )
    script = (
        "from fdcal.commands import cli\n"
        "@cli.commands.command('slow')\ndef slow():\n    import slow\n"
        "from fdcal.__main__ import main\nmain()\n"
    )
    command = [sys.executable, "-c", script, "slow"]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert (run.returncode, run.stderr) == (130, "error: interrupted; no incomplete file is left\n")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_calibration_that_a_signal_ends_writes_its_best_positions_so_far(number, tmp_path, monkeypatch):
    @contextlib.contextmanager
    def bar(title):
        yield lambda done, note="": os.kill(os.getpid(), number) if "sweep 2" in note else None

    monkeypatch.setattr(options, "progress_bar", bar)
    assert ended("calibrate", "tiny", "-o", str(tmp_path / "result.json")) == 4
    assert load_result(tmp_path / "result.json").verdict == "not_converged"
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_closed_streams_are_no_fault(tmp_path):
    def close():
        for number in (0, 1, 2):
            os.close(number)

    command = [*FDCAL, "simulate", "tiny", "-o", "tiny.npz"]
    assert subprocess.run(command, preexec_fn=close, cwd=tmp_path, timeout=120, capture_output=True).returncode == 0
    assert (tmp_path / "tiny.npz").read_bytes()[:2] == b"PK"


def test_standard_output_that_nobody_reads_ends_the_command():
    reader, writer = os.pipe()
    os.close(reader)
    run = subprocess.run([*FDCAL, "scenes"], stdout=writer, stderr=subprocess.PIPE, text=True, timeout=60)
    os.close(writer)
    assert run.returncode == 1
    assert run.stderr == ""


@pytest.mark.parametrize(
    ("module", "extra"),
    [("viser", "page"), ("matplotlib.figure", "pictures"), ("PIL", "pictures"), ("vtkmodules", "pictures"),
     ("h5py", "formats"), ("netCDF4", "formats"), ("pandas", "pandas")],
)  # fmt: skip
def test_a_missing_library_is_one_line_that_names_its_extra(module, extra):
    library = module.partition(".")[0]
    missing = missing_library(ModuleNotFoundError(f"No module named {module!r}", name=module))
    assert missing is not None and f"pip install 'fdcal[{extra}]'" in missing.remedy
    assert LIBRARY.get(library, library) in missing.problem


def test_the_version_is_printed(capsys):
    assert ended("--version") == 0
    assert capsys.readouterr().out == f"fdcal {metadata.version('fdcal')}\n"


COMMAND = """
import atexit, sys
import fdcal
from fdcal.commands.cli import main
unneeded = {"numba", "llvmlite", "scipy.signal", "viser", "pyvista", "trimesh", "matplotlib", "PIL"}
unneeded |= {"soundfile", "h5py"}
atexit.register(lambda: print(sorted(unneeded & set(sys.modules))))
main(["calibrate", sys.argv[1], "--modes", "12"])
"""


def test_the_command_loads_only_what_a_calibration_needs(made):
    """No compiler, whichever solver; libraries for pictures, the page and recordings take seconds to load."""
    done = subprocess.run([sys.executable, "-c", COMMAND, made / "tiny.npz"], capture_output=True, text=True)
    *_, summary, loaded = done.stdout.splitlines()
    assert "verdict good" in summary and loaded == "[]"


def test_warm_compiles_everything_and_reports_its_progress(capsys, monkeypatch):
    """It does so on standard error. `benchmarks/checks/test_compiled.py` tests that nothing is left to compile."""
    names, compiled = [name for name, _ in cli.all_pieces()], []
    monkeypatch.setattr(cli, "all_pieces", lambda: [(name, lambda name=name: compiled.append(name)) for name in names])
    assert not ended("warm")
    out, errors = capsys.readouterr()
    assert out == "" and compiled == names
    for number, name in enumerate(names, 1):
        assert f"{number} of {len(names)}: {name} ..." in errors
