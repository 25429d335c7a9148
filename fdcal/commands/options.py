"""What several commands of the command line share: options, progress, and what their arguments name."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

import click

from ..model.scene_file import load_scene, scene_names
from ..model.validation import InputError
from ..session.request import OpenRequest
from . import parameter_types

if TYPE_CHECKING:  # SciPy and the solvers, which a page loads while the browser opens
    from ..assessment.calibration import Calibration
    from .sources import CalibrationInput, Progress

SESSIONS = (".zip", ".json")

# How the command line calls the arguments that an error's remedy mentions (`InputError.worded`).
OPTIONS = {
    "array_radius": "--array-radius R",
    "check": "--check",
    "cost": "--cost",
    "dimension": "--dimension",
    "distance": "--distance I,J,METRES",
    "estimate_sound_speed": "--estimate-sound-speed",
    "exclude": "--exclude",
    "force": "--force",
    "frame": "--frame",
    "frequencies": "--frequencies",
    "kind": "--kind",
    "known": "--known",
    "leave_out": "--leave-out",
    "modes": "--modes",
    "most": "--most",
    "noise": "--noise",
    "original": "--original",
    "output": "-o",
    "plane": "--plane",
    "radius": "--radius R",
    "reference": "--reference",
    "reference_microphone": "--reference-microphone",
    "result": "--result RESULT.json",
    "room": "--room",
    "search": "--search ORIGIN,SIZE,STEP",
    "size": "--size WxH",
    "seed": "--seed",
    "solver": "--solver",
    "sound_speed": "--sound-speed",
    "source": "--source",
    "start": "--start",
    "step": "--step",
    "subset": "--subset",
    "temperature": "--temperature",
    "window": "--window",
}


@contextmanager
def progress_bar(title: str) -> Iterator[Progress]:
    """A bar on standard error that appears with the first call of the function it gives."""
    from tqdm import tqdm

    bars: list[tqdm] = []

    def progress(done: float, note: str = "") -> None:
        if not bars:
            layout = "{desc} {percentage:3.0f} % |{bar:30}| {elapsed}, {remaining} to go{postfix}"
            bars.append(tqdm(total=1.0, desc=title, bar_format=layout, mininterval=0.2, file=sys.stderr))
        bars[0].set_postfix_str(note, refresh=False)
        bars[0].update(done - bars[0].n)

    try:
        yield progress
    finally:
        for bar in bars:
            bar.close()


def output_option(what: str, required: bool = True):
    """The option -o of a command that writes `what`."""
    return click.option("-o", "--output", required=required, metavar=what, help="File to write.")


force_option = click.option("--force", is_flag=True, help="Overwrite an output that exists.")
result_option = click.option("--result", metavar="RESULT.json", help="Positions that `fdcal calibrate -o` found.")
search_option = click.option(
    "--search",
    metavar="ORIGIN,SIZE,STEP",
    help="Search domain, five numbers in metres: x,y of its lowest corner, width,height, step."
    " For example 2.01,1.71,1.2,1.2,0.01",
)
radius_option = click.option("--radius", type=float, metavar="R", help="Radius R of the order rule ceil(k R), metres.")


def simulated(scene: str) -> CalibrationInput:
    """What a scene gives; InputError for a measurement."""
    if scene.lower().endswith(".npz"):
        raise InputError(f"{scene} is a measurement; give a scene: a .toml file or one of {', '.join(scene_names())}")
    return loaded_input(scene)


def loaded_input(
    source: str, search: str | None = None, radius: float | None = None, excluded: tuple[str, ...] = ()
) -> CalibrationInput:
    """What a scene or a file gives, with the search domain of --search and --radius, without the `excluded`."""
    from .sources import load_input

    with progress_bar("simulating") as progress:
        inputs = load_input(source, progress, excluded)
    measurement = inputs.measurement
    domain = parameter_types.search_domain(measurement.search, measurement.array_dimension, search, radius)
    return replace(inputs, measurement=replace(measurement, search=domain))


def result_of(path: str | None) -> Calibration | None:
    """What the file of --result holds."""
    if path is None:
        return None
    from ..assessment.result_file import load_result

    return load_result(path)


def opening_of(text: str) -> OpenRequest:
    """What a page is to show: a session left by another, a measurement or recordings, or a scene."""
    if text.lower().endswith(SESSIONS):
        from ..session.session_file import read

        return read(text)
    if text in scene_names():  # a test simulates each of these
        return OpenRequest(load_scene(text))
    from .sources import check_scene, is_recording, load_input

    if text.lower().endswith(".npz") or is_recording(text):
        from ..model.measured_scene import placeholder_scene

        inputs = load_input(text)
        scene = placeholder_scene(inputs.measurement, inputs.name, inputs.settings, inputs.seed)
        return OpenRequest(scene, measurement=inputs.measurement, fewer_modes=True)
    scene = load_scene(text)
    check_scene(scene)  # one that cannot be simulated is refused before a page opens
    return OpenRequest(scene)
