"""The functions of the Python API, such as `fdcal.load` and `fdcal.calibrate`, and checks of their arguments."""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, replace
from os import PathLike
from typing import TYPE_CHECKING, Annotated, Any

from ..assessment.calibration import Calibration
from ..model.measurement import Measurement, MicrophonePositions, microphone_index, with_known, with_positions
from ..model.scene import MeasuredScene, Scene, load_scene
from ..model.settings import SolverSettings
from ..model.validation import InputError, convert, refusal, require_arguments, require_array, shown, within
from ..recordings.formats.positions import read_positions
from ..recordings.recording import ImportOptions
from .calibration_run import solve
from .process import one_blas_thread
from .sources import ProgressReport, is_recording, load_input, measurement_input, scene_input, with_settings

if TYPE_CHECKING:
    from ..cost.maps import LandscapePanels


LOAD_FIRST = "load it first: fdcal.load(...)"
OF_SCENE = "give those of a scene: fdcal.load_scene(...).solver"


def load(
    source: str | PathLike[str] | Sequence[str | PathLike[str]],
    *,
    exclude: Sequence[str | int] = (),
    positions: Any = None,
    sources: int | str | None = None,
    progress: ProgressReport | None = None,
    **options: Any,
) -> Measurement:
    """Return the measurement of a file, of recordings or of a scene.

    Parameters
    ----------
    source : str or path, or a sequence of them
        A measurement (.npz), recordings of any kind that `fdcal import` reads (WAV, FLAC, SOFA, HDF5 of Acoular, a
        folder of MeshRIR), or a scene: its .toml file, or the name of one that comes with fdcal. A scene is simulated,
        or read from the cache. Several files are several takes, recordings of the same microphones with the source at
        another place in each; files with one channel each are the channels of a single take.
    exclude : sequence of str or int
        Names or numbers of microphones to leave out.
    positions : path or (N, D) array_like, optional
        Positions of all microphones to compare results with, metres: an array, or the path of a table or of a geometry,
        such as Acoular's. They are never given to a solver.
    sources : int or str, optional
        Which source of a file of recordings with several sources: its number, counted from 0 (the default), or "all",
        which makes each source a take.
    progress : callable, optional
        Called with the fraction done, 0 to 1, and a note while a scene is simulated or recordings are imported.
    **options
        For recordings only: fields of `fdcal.recordings.recording.ImportOptions`, such as `known="0,3,12"`,
        `temperature=21.5`, `frequencies="30:300"`, `split=10.0` (s) or `files="channels"`.

    Returns
    -------
    Measurement

    Raises
    ------
    InputError, StorageError
        The source cannot be used, or cannot be read.

    Examples
    --------
    >>> import fdcal
    >>> measurement = fdcal.load("tiny")
    >>> measurement.count, measurement.known.tolist()
    (16, [0, 5, 7])
    """
    paths = [source] if isinstance(source, (str, PathLike)) else source
    if not isinstance(paths, (list, tuple)) or not all(isinstance(one, (str, PathLike)) for one in paths):
        problem = f"load takes the path of a file, several paths or the name of a scene, not {type(source).__name__}"
        raise InputError(problem, "give it as text", key="source")
    require_type("progress", progress or print, Callable, "give a function")
    texts, excluded = [str(one) for one in paths], microphone_names("exclude", exclude)
    if sources is not None:
        options["source"] = sources
    imported = None
    if options:
        other = next((text for text in texts if not is_recording(text)), None)
        if other is not None:
            given = ", ".join("sources" if key == "source" else key for key in options)
            raise InputError(f"{other} holds no recordings", f"leave out {given}")
        require_arguments("load", options, (field.name for field in fields(ImportOptions)))
        imported = ImportOptions(**options)
    with one_blas_thread():
        inputs = load_input(texts, progress, excluded, imported)
    if positions is None:
        return inputs.measurement
    if isinstance(positions, (str, PathLike)):
        listed = read_positions(positions)
    else:
        given = require_array("positions", positions, "real", (None, None), "m")
        listed = MicrophonePositions(tuple(map(str, range(len(given)))), given)
    return with_positions(inputs.measurement, listed, inputs.excluded)


def simulate(scene: Scene | str | PathLike[str], *, progress: ProgressReport | None = None) -> Measurement:
    """Return what the microphones of a scene measure, from the cache if the scene was simulated before.

    Parameters
    ----------
    scene : Scene, str or path
        A scene, its .toml file, or the name of one that comes with fdcal.
    progress : callable, optional
        Called with the fraction done, 0 to 1, and a note.

    Returns
    -------
    Measurement
        With the true positions.

    Raises
    ------
    InputError, StorageError
        The scene cannot be simulated, or cannot be read.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import fdcal
    >>> scene = fdcal.load_scene("tiny")
    >>> fdcal.simulate(replace(scene, gauge=replace(scene.gauge, known=(1, 5, 7)))).known.tolist()
    [1, 5, 7]
    """
    chosen = scene if isinstance(scene, Scene) else load_scene(str(scene))
    if isinstance(chosen, MeasuredScene):
        raise InputError(f"{chosen.name} is a measurement", f'use fdcal.load("{chosen.name}")', key="scene")
    with one_blas_thread():
        return scene_input(chosen, progress).measurement


def calibrate(
    measurement: Measurement,
    *,
    known: str | Mapping | Sequence | None = None,
    solver: str | None = None,
    modes: int | None = None,
    noise: str | float | None = None,
    seed: int | None = None,
    exclude: Sequence[str | int] = (),
    distance: tuple[str | int, str | int, float] | None = None,
    time_limit: float | None = None,
    settings: SolverSettings | None = None,
    progress: ProgressReport | None = None,
    **others: Any,
) -> Calibration:
    """Find the microphones of a measurement and assess the result.

    Parameters
    ----------
    measurement : Measurement
        As returned by `load` or `simulate`.
    known : str, mapping or sequence, optional
        Microphones whose positions the solver gets: "all" known microphones of the measurement (the default);
        "minimal", only what fixes translation, rotation and mirror image ("joint", "robust"); "none"; a list of names
        or numbers of microphones; or a mapping of names or numbers to positions (D,), metres.
    solver : str, optional
        "robust" (the default), "joint" or "descent".
    modes : int, optional
        Number of frequencies in use at the end, which are the lowest. By default the solver uses all that it can.
    noise : str or float, optional
        "reported" uses the noise power of the measurement (the default), "auto" estimates it; a number is the
        signal-to-noise ratio of each frequency, dB.
    seed : int, optional
        Seed of the solver's random numbers; 0 unless given.
    exclude : sequence of str or int
        Names or numbers of microphones to leave out.
    distance : (microphone, microphone, float), optional
        Names or numbers of two microphones and their distance, metres, for an array without known microphones. Its size
        and the sound speed follow from it.
    time_limit : float, optional
        Seconds of processor time after which the best positions so far are assessed, with the verdict
        "not_converged"; by default 90, more for large arrays. An interrupt (Ctrl-C) has the same effect.
    settings : SolverSettings, optional
        Settings to begin with, such as those of a scene (`scene.solver`).
    progress : callable, optional
        Called with the fraction done, 0 to 1, and a note. If it raises an exception, the run ends.
    **others
        Any other field of `SolverSettings`, such as `start="random"`. Solver "robust" also has `gains="fixed"`,
        `gain_sigma_db=1.0` (decibels), `phase_sigma_deg=5.0` (degrees) and `known_sigma=0.005` (metres), and "robust"
        and "joint" have `sound_speed_sigma=0.003` (relative).

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        The solver cannot start; the error names the argument and the remedy.

    Examples
    --------
    >>> import fdcal
    >>> found = fdcal.calibrate(fdcal.load("tiny"), modes=12)
    >>> found.positions.shape, found.known
    ((16, 2), ('0', '5', '7'))
    >>> bool(found.max_error < 0.02)
    True
    """
    require_type("measurement", measurement, Measurement, LOAD_FIRST)
    require_type("settings", SolverSettings() if settings is None else settings, SolverSettings, OF_SCENE)
    require_type("progress", progress or print, Callable, "give a function")
    own = {*inspect.signature(calibrate).parameters} - {"others"}
    require_arguments("calibrate", others, own | {field.name for field in fields(SolverSettings)})
    gauge = known if known is None or isinstance(known, str) else "all"  # all that are named, whatever `settings` say
    if gauge is not known:
        measurement = with_known(measurement, known if isinstance(known, Mapping) else microphone_names("known", known))
    inputs = measurement_input(measurement, excluded=microphone_names("exclude", exclude), settings=settings)
    others |= {"known": gauge, "noise": None if noise is None else str(noise)}
    inputs = with_settings(inputs, solver, modes, seed, **others)
    if distance is not None:
        parts = [] if isinstance(distance, str) or not isinstance(distance, Iterable) else list(distance)
        if len(parts) != 3:
            raise refusal("distance", distance, "is not two microphones and a length", "write (0, 1, 0.25), metres")
        distance = str(parts[0]), str(parts[1]), convert(parts[2], float, "distance")
    return solve(replace(inputs, distance=distance, time_limit=time_limit), progress, keep=True)


def landscape(
    measurement: Measurement,
    microphone: str | int,
    modes: Sequence[int] = (1, 5, 9),
    *,
    calibration: Calibration | None = None,
    settings: SolverSettings | None = None,
) -> "LandscapePanels":
    """Return the cost of moving one microphone, for each frequency and for their sum.

    The cost is that of Eq. 7, as in the paper's Fig. 1.

    Parameters
    ----------
    measurement : Measurement
        A measurement of a two-dimensional field, with a search domain.
    microphone : str or int
        Name of the microphone, or its number, counted from 0.
    modes : sequence of int
        Numbers of the P frequencies, counted from 1.
    calibration : Calibration, optional
        Result that gives the positions of the other microphones; by default they are at their true positions.
    settings : SolverSettings, optional
        Settings such as those of a scene (`scene.solver`); only `weights` and `order_offset` are used.

    Returns
    -------
    LandscapePanels
        `maps` (P + 1, ny, nx): the cost at each frequency, then the sum; `minima` (P + 1, 2): position of the lowest
        cost in each map, metres; `plot()` draws them.

    Raises
    ------
    InputError
        A microphone or frequency does not exist, no positions are known, or there is no search domain.

    Examples
    --------
    >>> import fdcal
    >>> panels = fdcal.landscape(fdcal.load("tiny"), 3, modes=[1, 2, 3])
    >>> panels.maps.shape
    (4, 25, 25)
    """
    require_type("measurement", measurement, Measurement, LOAD_FIRST)
    settings = SolverSettings() if settings is None else settings
    require_type("settings", settings, SolverSettings, OF_SCENE)
    if not (entries := _entries("modes", modes, "modes", remedy := "write <modes> = [1, 5, 9]")):
        raise InputError("modes names no frequency", remedy, key="modes")
    used = convert(entries, list[Annotated[int, within(1, len(measurement.frequencies))]], "modes")
    n = microphone_index(str(microphone), measurement.names, "microphone")
    from ..cost.maps import landscape_panels

    if calibration is not None:
        require_type("calibration", calibration, Calibration, "give what fdcal.calibrate returns")
    positions = measurement.positions if calibration is None else calibration.positions_for(measurement)
    if positions is None:
        remedy = "give a result of fdcal.calibrate"
        raise InputError("the measurement holds no true positions", remedy, key="calibration")
    with one_blas_thread():
        return landscape_panels(measurement.problem(settings.weights), positions, n, used, settings.order_offset)


def microphone_names(key: str, values: Any) -> tuple[str, ...]:
    """Return a list of names or numbers of microphones as texts; raise InputError if they are not in a list."""
    remedy = f"put names or numbers into a list: <{key}> = [{shown(values, quoted=True)}]"
    return tuple(map(str, _entries(key, values, "microphones", remedy)))


def _entries(key: str, values: Any, what: str, remedy: str) -> list[Any]:
    """Return the entries of a list; raise InputError for a text, or for a value that cannot be iterated."""
    if isinstance(values, (str, bytes)) or not isinstance(values, Iterable):
        raise InputError(f"{key} = {shown(values, quoted=True)} must be a list of {what}", remedy, key=key)
    return list(values)


def require_type(key: str, value: Any, kind: Any, remedy: str) -> None:
    """Raise InputError unless `value` is of the type `kind`."""
    if not isinstance(value, kind):
        raise InputError(f"{key} = {shown(value, quoted=True)} must be a {kind.__name__}", remedy, key=key)
