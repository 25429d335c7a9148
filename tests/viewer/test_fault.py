"""A solver that fails, in a real browser: the page shows the exception and the path of the log, and works on."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from browsing import COARSE, press

WAIT = 60.0  # s, bound of every wait
FAILING = """
import sys
from fdcal.commands import cli
from fdcal.solvers import descent as descent
step = descent.step

def failing(problem, state):
    if state.step == 4:
        raise ZeroDivisionError("the floor <b>opens</b>")
    return step(problem, state)

descent.step = failing
cli.main(sys.argv[1:])
"""


@pytest.fixture(scope="module")
def page(tmp_path_factory, browser, kernels, edited_descent):
    """`fdcal view` with a solver that fails at its fifth step, in a browser; ends in good order."""
    command = [sys.executable, "-c", FAILING, "view", str(edited_descent), "--port", "0", "--no-browser"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ)
    try:
        url = server.stdout.readline().strip()
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+", url), server.stderr.read()
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.set_default_timeout(WAIT * 1e3)
        page.goto(f"{url}/{COARSE}")
        yield page
        page.close()
        server.send_signal(signal.SIGINT)
        _, errors = server.communicate(timeout=WAIT)
        assert server.returncode == 0 and "the solver stopped at state 4" in errors, errors
    finally:
        server.kill()


@pytest.fixture(scope="module")
def edited_descent(tmp_path_factory):
    from fdcal.model.scene_file import scene_folder

    path = tmp_path_factory.mktemp("fault") / "failing.toml"
    text = (scene_folder() / "tiny.toml").read_text(encoding="utf-8")
    path.write_text(text.replace('name = "robust"', 'name = "descent"'), encoding="utf-8")
    return path


def test_an_exception_of_the_solver_is_shown_with_the_path_of_the_log(page):
    page.get_by_text("step 0, sweep 0").wait_for()
    press(page, "Run")
    page.get_by_text("Stopped by an error", exact=True).wait_for()
    shown = page.get_by_text("ZeroDivisionError: the floor <b>opens</b>; details in").inner_text()
    log = Path(shown.rpartition("details in ")[2].strip())
    text = log.read_text(encoding="utf-8")
    assert "Traceback" in text and "the solver stopped at state 4" in text and "failing" in text


def test_the_page_works_after_an_exception(page):
    page.get_by_text("step 4, sweep 0").wait_for()
    page.get_by_role("button", name="Run", exact=True).wait_for()  # it is paused
    press(page, "Reset")
    page.get_by_text("step 0, sweep 0").wait_for()
    assert not page.get_by_text("ZeroDivisionError").count()
    press(page, "Step")
    page.get_by_text("step 1, sweep 0").wait_for()
    page.get_by_text("Paused").first.wait_for()
