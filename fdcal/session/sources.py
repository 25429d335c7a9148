"""What is calibrated, and with which settings: a scene, a measurement or recordings, as `CalibrationInput`.

`with_settings` changes solver, number of modes, seed and settings, and checks that they suit the solver. `OpenRequest`
describes what a page is opened with: a scene, perhaps changed, and the states with which its session begins.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..acoustics.fdtd import make_grid
from ..acoustics.measure import cached_measurement, require_measurable
from ..model.arrays import positions_of
from ..model.measurement import FLAT, Measurement, exclude_microphones, list_labels, load_measurement, with_positions
from ..model.quantities import Count, Seed
from ..model.scene import Faults, MeasuredScene, Scene, load_scene, placeholder_scene
from ..model.settings import ALL_MODES, SolverSettings
from ..model.validation import InputError, convert, declaration, length_text, refusal
from ..recordings import formats
from ..recordings.formats.arrays import keys_of
from ..recordings.formats.positions import read_positions
from ..recordings.recording import ImportOptions
from ..solvers import PAPER, load

ProgressReport = Callable[[float, str], None]  # gets the fraction done, 0 to 1, or 0 if it is unknown, and a note


@dataclass(frozen=True)
class CalibrationInput:
    """A measurement and how to calibrate it."""

    name: str  # name of the scene or the file
    scene: Scene | None  # None if the measurement was read from a file, also if a measured scene names this file
    measurement: Measurement  # without the `excluded` microphones
    settings: SolverSettings
    seed: int
    excluded: tuple[str, ...] = ()  # names or numbers of microphones left out
    # (str, str, float) or None: names or numbers of two microphones, and their distance, metres, from which size and
    # sound speed follow
    distance: tuple[str, str, float] | None = None
    # seconds of processor time after which the best positions so far are assessed; `fdcal.solvers.interface.time_limit`
    # unless given
    time_limit: float | None = None
    # name, in reports of errors, of the positions compared with; "" for the true or the nominal positions
    compared_with: str = ""
    remark: str = ""  # how these positions were assigned to the channels; "" if there is nothing to say
    labels: tuple[str, ...] = ()  # names of the channels, each with its name in a list if that differs; () without one
    title: str = ""  # title of a scene that is a measurement; "" stands for the name of the scene
    radius: str = ""  # radius of the array and how the import determined it, in words; "" without recordings

    @property
    def given(self) -> tuple[int, ...]:
        """Numbers of the microphones whose positions the solver is given; the others are sought."""
        return tuple(map(int, self.measurement.known)) if self.settings.known == "all" else ()


def load_input(
    text: str | Sequence[str],
    progress: ProgressReport | None = None,
    excluded: tuple[str, ...] = (),
    options: ImportOptions | None = None,
) -> CalibrationInput:
    """Return the measurement of .npz files, of recordings, or of a scene.

    `text` is the path of a file or folder, or the name of a scene; several texts are the paths of takes, all of them
    recordings or all of them measurements. `excluded` are names or numbers of microphones to leave out; `options` say
    how recordings are imported.
    """
    texts = [text] if isinstance(text, str) else list(text)
    if not texts:
        raise InputError("no file is given", "give one or several", key="source")
    recorded, text, name, radius = [is_recording(one) for one in texts], texts[0], Path(texts[0]).stem, ""
    if len(texts) > 1:
        name += f" and {len(texts) - 1} other {'file' if len(texts) == 2 else 'files'}"
    if all(recorded):
        from ..recordings import importer  # imported here: it loads SciPy's filters, which a measurement does not need

        measurement, report = importer.import_recording(texts, options or ImportOptions(), progress)
        measurement, radius = _without(measurement, excluded), report.radius
        excluded = (*excluded, *report.left_out)
    elif any(recorded):
        other = texts[recorded.index(False)]
        raise InputError(f"{other} holds no recordings, but other files do", "give files of one kind", key="source")
    elif len(texts) > 1:
        scene = next((one for one in texts if not one.lower().endswith(".npz")), None)
        if scene is not None:
            raise InputError(f"{scene} is not a file of a take", "give one scene, or files of takes", key="source")
        measurement = Measurement.from_takes([load_measurement(one, excluded) for one in texts])
    elif text.lower().endswith(".npz"):
        measurement = load_measurement(text, excluded)
    else:
        inputs = scene_input(load_scene(text), progress)
        return replace(inputs, measurement=_without(inputs.measurement, excluded), excluded=excluded)
    return replace(measurement_input(measurement, name), excluded=excluded, radius=radius)


def measurement_input(
    measurement: Measurement,
    name: str = "measurement",
    excluded: tuple[str, ...] = (),
    settings: SolverSettings | None = None,
) -> CalibrationInput:
    """Return a measurement and the settings of a solver, with at most as many modes as the measurement has."""
    settings = settings or SolverSettings()
    if settings.modes != ALL_MODES:
        modes = min(settings.modes, len(measurement.frequencies))
        settings = replace(settings, modes=modes, first_modes=min(settings.first_modes, modes))
    if excluded:
        measurement = _without(measurement, excluded)
    return CalibrationInput(name, None, measurement, settings, 0, excluded)


def compared_with_file(inputs: CalibrationInput, path: str) -> CalibrationInput:
    """Return `inputs` whose results are compared with the positions in a table or geometry.

    The file may also have positions of the microphones in `inputs.excluded`.
    """
    placed, name = read_positions(path), Path(path).name
    measurement = with_positions(inputs.measurement, placed, inputs.excluded)
    labels, remark = list_labels(measurement.names, placed.names, inputs.excluded)
    differ = np.ptp(placed.positions[:, 2])
    if measurement.array_dimension == 2 and differ > FLAT:
        height = length_text(float(differ))
        remark += f"{remark and '; '}its heights differ by {height} and are ignored, since the array is plane"
    called = f"the positions in {name}"
    return replace(inputs, measurement=measurement, compared_with=called, remark=remark, labels=labels)


def scene_input(scene: Scene, progress: ProgressReport | None = None) -> CalibrationInput:
    """Return the measurement of a scene, simulated or from the cache, or from the file of a measured scene."""
    measurement = cached_measurement(scene, progress)
    if isinstance(scene, MeasuredScene):
        return replace(measurement_input(measurement, scene.name), title=scene.title)
    return CalibrationInput(scene.name, scene, measurement, scene.solver, scene.seed)


def is_recording(text: str) -> bool:
    """Return whether `text` names a file or folder of a kind that `fdcal import` reads, whether or not it exists."""
    path = Path(text)
    if path.suffix.lower() == ".npz":
        return bool(keys := keys_of(path)) and not {"pressures", "frequencies"} & set(keys)
    return formats.reader_of(path) is not None or bool(formats.sound_files(path))


def _without(measurement: Measurement, excluded: tuple[str, ...]) -> Measurement:
    table = {field.name: getattr(measurement, field.name) for field in fields(Measurement)}
    return Measurement(**exclude_microphones(table, excluded))


def check_scene(scene: Scene) -> None:
    """Check what can be checked without a simulation: array, source, band, outline of the room, CFL limit.

    InputError names the key of the scene that is wrong. A measured scene has been checked by its measurement.
    """
    if isinstance(scene, MeasuredScene):
        return
    positions_of(scene)
    require_measurable(scene)
    if scene.room.dimension == 2:
        make_grid(scene.room, scene.emitter.band.sample_rate)


def with_settings(
    inputs: CalibrationInput,
    solver: str | None = None,
    modes: int | None = None,
    seed: int | None = None,
    **others: str | float | None,
) -> CalibrationInput:
    """Return `inputs` with another solver, number of modes, seed, or fields of `SolverSettings`; None changes nothing.

    Raises InputError if an option of `fdcal calibrate` is given that has no effect on the solver.
    """
    given = {key: value for key, value in others.items() if value is not None}
    settings = replace(inputs.settings, **given)
    if seed is not None:
        seed = convert(seed, Seed, "seed")
    if modes is not None:
        count = convert(modes, Count, "modes")
        settings = replace(settings, modes=count, first_modes=min(settings.first_modes, count))
    settings = replace(settings, name=settings.name if solver is None else solver)
    traits = load(settings.name).TRAITS
    for key, value in given.items():
        option = declaration(SolverSettings, key)[1]
        if "solver" in option and key not in traits.settings:
            why, other = f'has no effect with solver.name = "{settings.name}"', option["solver"]
            raise refusal(key, value, why, f"leave out <{key}>, or use <solver> {other}")
        if "with_gains" in option and settings.gains == "fixed":
            raise refusal(key, value, "has no effect with gains = fixed", f"leave out <{key}>, or use <gains> auto")
    return replace(inputs, settings=settings, seed=inputs.seed if seed is None else seed)


@dataclass(frozen=True)
class OpenRequest:
    """A request to open a page, or to replace what it shows."""

    scene: Scene  # includes the settings of the solver
    # seed of the solver's start; None for the seed of the scene, with which its microphones and noise are drawn
    start_seed: int | None = None
    measurement: Measurement | None = None  # None for that of the scene, which is simulated or taken from the cache
    # states of the solver, oldest first, with which the history begins; () for the start of the solver
    states: tuple = ()
    index: int | None = None  # index of the state that is shown; None for the last state
    # values of the page's controls, by the names of `viewer.state.Choices` and `viewer.cost_maps.MapStyle`; a style
    # that is not given stays as it was on the page
    choices: Mapping[str, Any] = field(default_factory=dict)
    play: bool = False  # whether the solver starts to run at once
    fewer_modes: bool = False  # whether the number of modes is reduced to those that the measurement has

    def __post_init__(self):
        convert(self.start_seed, Seed | None, "start_seed")
        if self.index is not None and not 0 <= self.index < len(self.states):
            count = len(self.states)
            remedy = f"use 0 to {count - 1}" if count else "give states, or leave out index"
            raise refusal("index", self.index, f"is none of the {count} states", remedy)

    @property
    def seed(self) -> int:
        """Seed of the solver's start."""
        return self.scene.seed if self.start_seed is None else self.start_seed


def measurement_request(inputs: CalibrationInput) -> OpenRequest:
    """Return the request for a page that shows a measurement without a scene."""
    scene = placeholder_scene(inputs.measurement, inputs.name, inputs.settings, inputs.seed)
    return OpenRequest(scene, measurement=inputs.measurement, fewer_modes=True)


def scene_request(scene: Scene) -> OpenRequest:
    """Return the request for a page that shows a scene.

    If the scene is like those of the paper, a plate with one source and channels without faults, the page begins with
    the paper's method: random positions, and one microphone moves at a time. Known microphones always fix the frame in
    such a scene (`fdcal.model.arrays.positions_of`).
    """
    if not isinstance(scene, MeasuredScene) and scene.room.dimension == 2 and scene.search is not None:
        one_source = scene.source is not None and len(scene.source.places) == 1
        as_in_the_paper = one_source and scene.faults == Faults()
        if as_in_the_paper and (scene.solver.known, scene.solver.name) == ("all", SolverSettings().name):
            scene = replace(scene, solver=replace(scene.solver, name=PAPER, start="random"))
    return OpenRequest(scene, fewer_modes=True)


def as_given(scene: Scene, measurement: Measurement) -> Measurement:
    """Return the measurement that a page shows: without known microphones if the solver gets none."""
    if scene.solver.known != "none":
        return measurement
    return replace(measurement, known=(), known_positions=None)
