"""The time that runs of the lessons take on the page, from their steps and speeds."""

from fdcal import solvers
from fdcal.acoustics.measure import cached_measurement
from fdcal.model.validation import parse_modes
from fdcal.session.lesson import lesson_names, load_lesson
from fdcal.viewer.panels import LESSON_RATE, WATCHED_MOVES, watched_rate


def runs_to_the_end(lessons):
    """Number of steps of runs of lessons that go to their ends, and whether a step moves all microphones.

    Of several runs of one scene whose steps move all microphones, only the first is made, because it takes seconds.
    """
    seen = set()
    for lesson in lessons:
        begun = None
        for number, step in enumerate(lesson.steps):
            for setting, revealed in ((step.page, False), (step.then, True)):
                scene, seed = lesson.start(number, revealed)
                solver = solvers.load(scene.solver.name)
                if begun != scene or setting.begins or setting.reset:
                    problem = cached_measurement(scene).problem(scene.solver.weights, scene.solver.known)
                    state = solver.init(problem, solvers.with_mode_count(problem, scene.solver), seed)
                    begun = scene
                if setting.modes is not None or setting.automatic is not None:
                    modes = parse_modes(setting.modes or f"{state.first}-{state.last}", len(problem.pressures))
                    automatic = state.automatic if setting.automatic is None else setting.automatic
                    state = solver.use_modes(problem, state, modes[0], modes[-1], automatic)
                steps, kind = 0, (scene.name, solver.TRAITS.moves_all)
                while setting.run == "end" and kind not in seen and not state.finished:
                    state, steps = solver.step(problem, state), steps + 1
                if steps:
                    seen |= {kind} if solver.TRAITS.moves_all else set()
                    yield steps, solver.TRAITS.moves_all


def test_a_run_of_a_lesson_can_be_followed_and_takes_ten_seconds_at_most():
    runs = list(runs_to_the_end(map(load_lesson, lesson_names())))
    assert {moves_all for _, moves_all in runs} == {False, True}
    for steps, moves_all in runs:
        rate, done, duration = LESSON_RATE if moves_all else WATCHED_MOVES, 0.0, 0.0
        while done < steps:
            done, duration = done + 0.01 * watched_rate(rate, duration), duration + 0.01
        assert 5.0 <= duration <= 10.0, (steps, duration)
