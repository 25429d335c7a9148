"""Studies on own processes of Dask that are interrupted, killed, or lose a worker; they take long."""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from urllib.request import urlopen

import pandas
import pytest

from fdcal.commands.cli import main
from fdcal_bench import run
from fdcal_bench.run import PARTS, Results, connected, read_results, run_study
from fdcal_bench.study import load_study

TEXT = """
scene = "tiny"
draws = {draws}
[axes]
snr_db = [20, 40]
"solver.modes" = [12, 20]
[fixed]
"solver.name" = "joint"
[drawn]
source = true
least_distance = 0.2
"""

# `fdcal` whose studies write every batch as it comes, so that there is a row to keep at once.
EAGER = """
import sys
from dataclasses import replace
from fdcal.commands.cli import main
from fdcal_bench import run
run.BATCHING = replace(run.BATCHING, write_seconds=0.0)
main(sys.argv[1:])
"""

# `fdcal` that stops working after its first row, so that it never ends before it is killed.
HALTED = """
import time
from fdcal_bench.run import Results
append = Results.append
Results.append = lambda results, rows: (append(results, rows), time.sleep(600))
"""


def await_a_row(process, folder):
    """Wait for the first row of a study, or for the end of its process."""
    waited, end = threading.Event(), time.monotonic() + 120
    while process.poll() is None and not list(folder.glob(PARTS)):
        if time.monotonic() > end:
            os.killpg(process.pid, signal.SIGKILL)
            pytest.fail("the study has written no row in 120 s")
        waited.wait(0.05)


def test_an_interrupted_study_says_in_one_line_what_is_kept_and_how_it_goes_on(tmp_path):
    path, folder = tmp_path / "study.toml", tmp_path / "out"
    path.write_text(TEXT.format(draws=100))
    process = subprocess.Popen(
        [sys.executable, "-c", EAGER, "study", str(path), "-o", str(folder), "--workers", "1"],
        start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    await_a_row(process, folder)
    os.killpg(process.pid, signal.SIGINT)  # a terminal interrupts the workers, too
    _, errors = process.communicate(timeout=60)
    kept = len(Results(folder, load_study(path), True).done())
    said = f"interrupted; {kept} of 400 calibrations are in {folder}: the same command with --resume continues"
    assert process.returncode == 130 and kept and errors.splitlines()[-1] == f"error: {said}"
    assert "Traceback" not in errors


def test_a_killed_study_continues_and_a_killed_worker_loses_no_row(tmp_path, monkeypatch):

    path, folder = tmp_path / "study.toml", tmp_path / "out"
    path.write_text(TEXT.format(draws=3))
    command = ["study", str(path), "-o", str(folder), "--workers"]
    process = subprocess.Popen(
        [sys.executable, "-c", HALTED + EAGER, *command, "1"],
        start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    await_a_row(process, folder)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    study = load_study(path)
    assert Results(folder, study, True).done()
    killed = []

    def killing_one(study, results, client, progress):
        pids, notes = list(client.run(os.getpid).values()), []

        def noted(done, note):
            notes.append(note)
            if len(notes) == 2:
                os.kill(pids[0], signal.SIGKILL)
                killed.append(pids[0])
            progress(done, note)

        return run_study(study, results, client, noted)

    monkeypatch.setattr(run, "run_study", killing_one)
    monkeypatch.setattr(run, "BATCHING", replace(run.BATCHING, write_seconds=1e9))  # all rows in the end
    with pytest.raises(SystemExit) as ended:
        main([*command, "1", "--resume"])
    assert not ended.value.code
    assert len(killed) == 1
    _, rows = read_results(folder)
    assert sorted(rows["task"]) == list(range(study.count))
    assert len(pandas.read_parquet(folder / "rows")) == study.count, "no calibration was done twice"


def test_the_dashboard_is_there_when_it_is_asked_for():
    with connected(1, dashboard=True) as client, urlopen(client.dashboard_link, timeout=10) as page:
        assert client.dashboard_link.startswith("http://127.0.0.1:") and page.status == 200
