"""A measurement from a scene or a file, solved, scored and told: what `fdcal calibrate` does, without a command line.

Given      measurement, settings and seed
source_of  from the name of a scene, its file, an .npz file, or what `fdcal import` reads
solve      run the solver to its end
summary    the outcome in words
"""

from __future__ import annotations

import collections
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from ..acoustics.measure import require_measurable
from ..acoustics.room_modes import nearest_symmetry
from ..cost.eq7 import lattice_of, require_modes
from ..model.arrays import positions_of
from ..model.channels import check_channels, exclude_microphones, microphone_index
from ..model.gauge import align, move_to_frame, position_errors
from ..model.measurement import Measurement, Problem
from ..model.measurement_file import load_measurement
from ..model.scene import Scene, SolverSettings, load_scene, require_rectangle
from ..model.validation import InputError, require_positive
from ..solvers.identifiability import check_solvable
from . import room_calibration

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Given:
    """A measurement and how to solve it; `scene` is None where a file alone was given.

    `excluded` microphones are no longer in the measurement; `distance` is two names or numbers, and metres.
    """

    name: str
    scene: Scene | None
    measurement: Measurement
    settings: SolverSettings
    seed: int
    excluded: tuple[str, ...] = ()
    estimate_sound_speed: bool = False
    distance: tuple[str, str, float] | None = None


def source_of(text: str, progress: Progress | None = None, excluded: tuple[str, ...] = ()) -> Given:
    """The measurement of an .npz file, of recordings, or of a scene, without the microphones `excluded`.

    Raises InputError and StorageError.
    """
    if is_recording(text):
        from ..recordings.importer import intake  # the signal library, which a measurement does without

        measurement = _without(intake(text)[0], excluded)
    elif text.lower().endswith(".npz"):
        measurement = load_measurement(text, excluded)
    else:
        given = from_scene(load_scene(text), progress)
        return replace(given, measurement=_without(given.measurement, excluded), excluded=excluded)
    count = len(measurement.frequencies)
    settings = SolverSettings(
        modes=min(SolverSettings.modes, count), first_modes=min(SolverSettings.first_modes, count)
    )
    return Given(Path(text).stem, None, measurement, settings, 0, excluded)


def is_recording(text: str) -> bool:
    """Whether `text` is a file or folder that `fdcal import` reads, or would be if it were there."""
    from ..recordings import formats
    from ..recordings.formats import archive

    path = Path(text)
    if path.suffix.lower() in archive.SUFFIXES:
        return "recordings" in archive.keys_of(path)
    return formats.reader_of(path) is not None


def _without(measurement: Measurement, excluded: tuple[str, ...]) -> Measurement:
    table = {field.name: getattr(measurement, field.name) for field in fields(Measurement)}
    return Measurement(**exclude_microphones(table, excluded))


def check_scene(scene: Scene) -> None:
    """Raise InputError for what can be told of a scene without simulating: array, source, band, outline, CFL limit."""
    from ..acoustics.fdtd import make_grid

    positions_of(scene)
    require_measurable(scene)
    if scene.room.dimension == 2:
        make_grid(scene.room, scene.source.sample_rate)


def from_scene(scene: Scene, progress: Progress | None = None) -> Given:
    """The measurement of a scene, simulated or from the cache. Raises InputError and StorageError."""
    from ..acoustics.measurement_cache import cached_measurement  # brings the simulation, which only scenes need

    return Given(scene.name, scene, cached_measurement(scene, progress), scene.solver, scene.seed)


def changed(
    given: Given, solver: str | None = None, modes: int | None = None, seed: int | None = None, **others: str | None
) -> Given:
    """`given` with another solver, number of modes, seed, or other fields of `SolverSettings`, each where not None.

    Raises InputError for values that cannot be.
    """
    settings = replace(given.settings, **{key: value for key, value in others.items() if value is not None})
    if seed is not None and seed < 0:
        raise InputError(f"seed = {seed} must not be negative; use 0 or more")
    if modes is not None:
        if modes < 1:
            raise InputError(f"modes = {modes} must be at least 1; use 1 to {len(given.measurement.frequencies)}")
        settings = replace(settings, modes=modes, first_modes=min(settings.first_modes, modes))
    settings = replace(settings, name=solver or settings.name)
    idle = [key for key in ("noise", "snr_db", "cost") if others.get(key) is not None]
    if settings.name == "descent" and idle:
        option = "--cost" if idle == ["cost"] else "--noise"
        raise InputError(f'{option} does nothing with solver.name = "descent"; leave it out, or use --solver joint')
    if settings.name == "room" and given.scene is not None:
        require_rectangle(given.scene)
        settings = replace(settings, room=settings.room or given.scene.room.size)
    return replace(given, settings=settings, seed=given.seed if seed is None else seed)


def problem_of(given: Given) -> Problem:
    """What the solver sees of a measurement, with the known microphones that the settings leave it."""
    return given.measurement.problem(given.settings.weights, given.settings.known)


def states_of(given: Given, progress: Progress | None = None, problem: Problem | None = None) -> Iterator:
    """Every state of the solver, from the start to the end; `problem` is that of `problem_of`.

    Raises InputError where the solver cannot start, and whatever `progress` raises to stop the run.
    """
    from ..solvers import run

    _require_reachable(given)
    problem, last = problem_of(given) if problem is None else problem, given.settings.modes
    check_channels(given.measurement.pressures, given.measurement.names)
    if given.settings.name == "room":
        room_calibration.check(given.measurement, given.settings)
    else:
        check_solvable(problem, last, given.measurement.names)
    for state in run(problem, given.settings, given.seed):
        if progress is not None:
            progress(state.last / last, f"{state.last} modes, sweep {state.sweep}, cost {state.cost:.3g}")
        yield state


def solve(given: Given, progress: Progress | None = None) -> dict:
    """Run the solver to its end.

    Returns
    -------
    dict, what a result file holds: positions (N, D) list, metres, and names (N,); known, names; excluded, names of
    microphones left out, which have no row; solver; seed; frequencies used, Hz; cost, dimensionless; sweeps; elapsed_s;
    converged; mean_error_m and max_error_m over all microphones, None without truth; aligned, whether nothing fixes
    rotation, translation and mirror, so that the errors are those after the best rigid motion; verdict, verdict_text,
    uncertainty_m (N,) and residual_to_noise (see `fdcal.assessment.verdict.Verdict`); sound_speed, m/s, told or
    estimated;
    left_out_db, left_out_microphones_db (N,), left_out_frequencies_db (see `fdcal.assessment.cross_validation.Report`)

    Raises InputError where the solver cannot start, and whatever `progress` raises to stop the run.
    """
    problem = problem_of(given)
    _require_length(given, problem)
    start = time.perf_counter()
    state = collections.deque(states_of(given, progress, problem), maxlen=1).pop()
    known_room = given.settings.name == "room"
    positions, problem, trust = (room_calibration.trusted if known_room else _trusted)(given, problem, state)
    truth, blind = given.measurement.positions, problem.frame is None and not len(problem.known) and not known_room
    placed = positions
    if truth is not None and (blind or known_room):
        placed = (
            nearest_symmetry(positions, truth, given.settings.room).of(positions)
            if known_room
            else align(positions, truth)
        )
    errors = None if truth is None else position_errors(placed, truth)
    return {
        "positions": positions.tolist(),
        "names": list(given.measurement.names),
        "excluded": list(given.excluded),
        "known": [given.measurement.names[n] for n in given.measurement.known],
        "solver": given.settings.name,
        "seed": given.seed,
        "frequencies": problem.frequencies[state.first - 1 : state.last].tolist(),
        "cost": float(state.cost),
        "sweeps": int(state.sweep),
        "elapsed_s": time.perf_counter() - start,
        "converged": bool(state.converged),
        "mean_error_m": None if errors is None else float(errors.mean()),
        "max_error_m": None if errors is None else float(errors.max()),
        "aligned": blind,
        "sound_speed": problem.sound_speed,
        **trust,
    }


def _trusted(given: Given, problem: Problem, state) -> tuple[np.ndarray, Problem, dict]:
    """Positions and problem, of another sound speed where that was asked for, and the keys of the verdict."""
    from ..assessment import sound_speed
    from ..assessment.cross_validation import report
    from ..assessment.verdict import judge

    # Where hardly any noise is left, the verdict's real kernel has its own limit, which it finds itself.
    positions, noise = state.positions, None if getattr(state, "near", False) else getattr(state, "noise_power", None)
    if given.estimate_sound_speed:
        found = (
            sound_speed.from_known(problem, positions, state.modes, noise)
            if given.distance is None
            else sound_speed.from_distance(problem, positions, _pair(given), given.distance[2])
        )
        positions = found.positions if problem.frame is None else move_to_frame(found.positions, problem.frame)
        problem = found.problem
    verdict = judge(problem, positions, state.modes, noise, given.measurement.names, state.converged)
    heard = report(problem, positions, state.modes, noise)
    return (
        positions,
        problem,
        {
            "uncertainty_m": verdict.uncertainty.tolist(),
            "residual_to_noise": verdict.residual_to_noise,
            "verdict": verdict.code,
            "verdict_text": verdict.text,
            "left_out_db": heard.whole,
            "left_out_microphones_db": heard.microphones.tolist(),
            "left_out_frequencies_db": heard.modes.tolist(),
        },
    )


def _pair(given: Given) -> tuple[int, int]:
    """Numbers of the two microphones of --distance."""
    names = given.measurement.names
    first, second = (microphone_index(text, names, "--distance") for text in given.distance[:2])
    if first == second:
        raise InputError(f"--distance names microphone {names[first]} twice; name two")
    return first, second


def _require_length(given: Given, problem: Problem) -> None:
    """Raise InputError where the sound speed is asked for without a length, or with two."""
    if given.settings.name == "room" and (given.estimate_sound_speed or given.settings.known == "minimal"):
        raise InputError("a known room fixes size and place; leave out --estimate-sound-speed and --known minimal")
    if given.distance is not None:
        if not given.estimate_sound_speed:
            raise InputError("--distance fixes the size, so that the sound speed follows; add --estimate-sound-speed")
        if len(problem.known):
            raise InputError("--distance is for arrays without known microphones; these fix the size already")
        require_positive("--distance", given.distance[2], "m")
        _pair(given)
    elif given.estimate_sound_speed and len(problem.known) < 2:
        raise InputError("--estimate-sound-speed needs two known microphones at least, or --distance I,J,METRES")


def _require_reachable(given: Given) -> None:
    """Raise InputError where the truth, if it is told, lies outside the search domain: descent could never find it."""
    measurement = given.measurement
    if measurement.positions is None or measurement.search is None or not given.settings.name.startswith("descent"):
        return
    search, free = measurement.search, np.setdiff1d(np.arange(measurement.count), measurement.known)
    low, high = np.array(search.origin) - search.step, np.add(search.origin, search.size) + search.step
    truth = measurement.positions[free]
    outside = free[np.any((truth < low) | (truth > high), axis=1)]
    if len(outside):
        raise InputError(
            f"microphone {outside[0]} stands at {measurement.positions[outside[0]].tolist()} m, outside the search"
            f" domain of origin {list(search.origin)} m and size {list(search.size)} m; enlarge or move it"
        )


def summary(given: Given, result: dict) -> str:
    """The outcome in seven lines."""
    count, f = given.measurement.count, result["frequencies"]
    free = count - len(given.measurement.known) * (given.settings.known == "all")
    end = "converged" if result["converged"] else "stopped before it converged"
    error = "unknown, since the true positions are"
    if result["mean_error_m"] is not None:
        mean, largest = (round(1e3 * result[key], 3) for key in ("mean_error_m", "max_error_m"))
        error = f"mean {mean:.3g} mm, largest {largest:.3g} mm over all {count} microphones"
        error += ", moved as a whole onto the truth" if result["aligned"] else ""
        error += ", in the nearest of the room's symmetries" if "symmetries" in result else ""
    lines = (
        f"{given.name}: {free} of {count} microphones sought by {result['solver']}, seed {result['seed']}",
        f"modes   {len(f)}, {f[0]:.1f} to {f[-1]:.1f} Hz",
        f"run     {result['sweeps']} sweeps in {result['elapsed_s']:.1f} s, {end}",
        f"cost    {result['cost']:.3g} ({'dimensionless' if given.settings.weights == 'unit' else 'pressure squared'})",
        f"error   {error}",
        f"heard   {_heard(result)}",
        f"verdict {result['verdict']}: {result['verdict_text']}",
    )
    return "\n".join([*lines, *room_calibration.lines(result)])


def _heard(result: dict) -> str:
    """How well the microphones foretell one another."""
    microphones, modes = (np.array(result[f"left_out_{what}_db"]) for what in ("microphones", "frequencies"))
    n, m = int(microphones.argmax()), int(modes.argmax())
    return (
        f"each microphone from the others to {result['left_out_db']:.1f} dB; worst microphone {result['names'][n]},"
        f" {microphones[n]:.1f} dB, worst frequency {result['frequencies'][m]:.1f} Hz, {modes[m]:.1f} dB"
    )


def require_told(measurement: Measurement) -> None:
    """Raise InputError where a measurement tells no positions to compare with."""
    if measurement.positions is None:
        raise InputError("--check compares with the positions in the file, which has none; leave it out")


def checked(given: Given, result: dict) -> str:
    """How the positions that the measurement tells compare with those found, and which channels are swapped."""
    from ..assessment.alignment import check, told

    measurement = given.measurement
    require_told(measurement)
    positions = positions_from(measurement, result) if result.get("symmetries") else result["positions"]
    known = measurement.known if given.settings.known == "all" else ()
    return told(check(positions, measurement.positions, known), measurement.names, result["verdict"], len(known) > 0)


def joint_landscape(given: Given, positions, n: int, modes: int) -> np.ndarray:
    """What a step of descent on microphone `n` minimises, the `modes` lowest modes together : (ny, nx) float64."""
    from ..cost.lattice_search import lattice_landscape  # compiled code, which reading a file does without
    from ..solvers.descent import order_offset_of

    problem, settings = given.measurement.problem(given.settings.weights), given.settings
    offset = order_offset_of(settings, modes)
    require_modes(problem, offset, modes)
    lattice = lattice_of(problem, offset)
    centre = lattice.nearest(np.mean(positions, axis=0))
    maps = lattice_landscape(problem, lattice, positions, n, centre, slice(0, modes), settings.known_weight)
    return maps.sum(axis=0)


def heard_inside(given: Given, result: dict | None, wanted: list[float] | None, step: float | None):
    """`fdcal.assessment.field_map.FieldMap` of a measurement at `wanted` frequencies, Hz, from a result or the true
    positions.

    A result that leaves microphones out belongs to a measurement without them.
    """
    from ..assessment.field_map import field_map

    positions = positions_from(given.measurement, None if result is None else {**result, "excluded": []})
    if wanted is None and result is not None:
        wanted = [result["frequencies"][i] for i in (0, len(result["frequencies"]) // 2, -1)]
    return field_map(given.measurement, positions, wanted, step, (result or {}).get("sound_speed"))


def positions_from(measurement: Measurement, result: dict | None) -> np.ndarray:
    """Positions of a result, or the true ones without a result : (N, D) float64, metres.

    Those of a result that nothing has placed are moved as a whole onto the truth, where it is told.
    """
    if result is None:
        if measurement.positions is None:
            raise InputError("the measurement holds no true positions; give those of a result: --result RESULT.json")
        return measurement.positions
    positions = np.asarray(result["positions"], float)
    if result.get("excluded"):
        raise InputError(
            f"the result leaves out microphone {', '.join(map(str, result['excluded']))}, and this needs a place for"
            " all of them; calibrate without --exclude"
        )
    shape = (measurement.count, measurement.array_dimension)
    if positions.shape != shape:
        raise InputError(
            f"the result has positions of shape {positions.shape}, the measurement {shape}; use its own result"
        )
    if result.get("symmetries") and measurement.positions is not None:
        return nearest_symmetry(positions, measurement.positions, result["room"]).of(positions)
    return (
        align(positions, measurement.positions)
        if result.get("aligned") and measurement.positions is not None
        else positions
    )
