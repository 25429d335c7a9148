"""Read a lesson from its TOML file, and refuse one that no page could show."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from pathlib import Path

from ..model.arrays import positions_of
from ..model.from_table import build
from ..model.reading import parse_toml, read_bytes
from ..model.scene import Scene
from ..model.texts import parse_modes
from ..model.validation import InputError, StorageError, require_choice, shown
from .lesson import IN_USE, MAPS, MAX_CHOICES, MAX_ORDER_OFFSET, QUANTITIES, RUN, SCALES, VIEWS, Lesson, Setting, Step


@dataclass(frozen=True)
class LessonLimits:
    """How large a lesson may be."""

    file_bytes: int = 1_000_000  # size of its file
    steps: int = 50  # number of steps
    choices: int = MAX_CHOICES  # number of choices of one question
    characters: int = 5000  # length of a text, a question or a reveal
    mode: int = 9999  # highest number of a mode, counted from 1


LIMITS = LessonLimits()


def lesson_folder() -> Path:
    """Return the folder of the built-in lessons: in the checkout, or inside an installed package."""
    beside = Path(__file__).parents[1] / "lessons"
    return beside if beside.is_dir() else Path(__file__).parents[2] / "lessons"


def lesson_names() -> list[str]:
    """Return the names of the built-in lessons, in their order."""
    return sorted(path.stem for path in lesson_folder().glob("*.toml"))


def load_lesson(path: str | Path) -> Lesson:
    """Return the lesson of a TOML file, or a built-in one by its name.

    Raises InputError: unknown name, or a file that is no lesson; the message names the file, the key, its value and the
    remedy; StorageError: the file cannot be read.
    """
    path = _file_of(path)
    table = _read(path)
    try:
        for key in Lesson.OPTIONAL:
            if key in table:
                raise InputError(f"{key} is not a key of a lesson", "remove it, the file has one", key=key)
        lesson = build(Lesson, {**table, "name": path.stem, "folder": str(path.parent)}, whole="lesson")
        check(lesson)
    except InputError as error:
        raise error.within(path) from error
    return lesson


def _file_of(path: str | Path) -> Path:
    """Return the file of a lesson that is given by its path or its name."""
    path = Path(path)
    if path.suffix == ".toml":
        return path
    names = lesson_names()
    if str(path) not in names:
        near = difflib.get_close_matches(str(path), names, 1)
        remedy = f'did you mean "{near[0]}"?' if near else f"use a .toml file or one of {', '.join(names)}"
        raise InputError(f'lesson "{path}" is unknown', remedy, key="lesson", value=str(path))
    return lesson_folder() / f"{path}.toml"


def _read(path: Path) -> dict:
    return parse_toml(read_bytes(path, LIMITS.file_bytes, "lesson"), path)


def check(lesson: Lesson) -> None:
    """Raise InputError if no page could show a lesson."""
    count = len(lesson.steps)
    if not 1 <= count <= LIMITS.steps:
        raise InputError(f"steps has {count} entries", f"give 1 to {LIMITS.steps} [[steps]]", key="steps", value=count)
    if lesson.steps[0].page.scene is None:
        key = "steps[1].page.scene"
        raise InputError(f"{key} is missing", 'name a scene, as "tiny", that the lesson begins with', key=key)
    scene = _scene_of(lesson, 0, False, "steps[1].page")
    for number, step in enumerate(lesson.steps):
        key = f"steps[{number + 1}]"
        _check_texts(key, step)
        _check_question(key, step)
        for part, setting, revealed in (("page", step.page, False), ("then", step.then, True)):
            if setting.begins:
                scene = _scene_of(lesson, number, revealed, f"{key}.{part}")
            _check_setting(f"{key}.{part}", setting, scene)


def _check_texts(key: str, step: Step) -> None:
    for name in ("text", "question", "reveal"):
        length = len(getattr(step, name))
        if length > LIMITS.characters:
            remedy = f"use {LIMITS.characters} at most"
            raise InputError(f"{key}.{name} has {length} characters", remedy, key=f"{key}.{name}", value=length)
    if not step.text.strip():
        raise InputError(f'{key}.text = "" says nothing', "write a few sentences", key=f"{key}.text", value=step.text)


def _check_question(key: str, step: Step) -> None:
    count = len(step.choices)
    if bool(step.question) != bool(count) or count == 1 or count > LIMITS.choices:
        remedy = f"give 2 to {LIMITS.choices} with a question, none without"
        raise InputError(f"{key}.choices has {count} entries", remedy, key=f"{key}.choices", value=count)
    if (count or step.answer) and not 1 <= step.answer <= count:
        problem = f"{key}.answer = {step.answer} is none of the {count} choices"
        raise InputError(problem, "count them from 1", key=f"{key}.answer", value=step.answer)
    key = f"{key}.reveal"
    if count and not step.reveal.strip():
        raise InputError(f'{key} = "" leaves the question open', "write the answer and why", key=key, value=step.reveal)
    if not count and (step.reveal or step.then != Setting()):
        remedy = "add a question and choices, or remove it and the settings of `then`"
        raise InputError(f"{key} has no question before it", remedy, key=key, value=step.reveal)


def _scene_of(lesson: Lesson, number: int, revealed: bool, key: str) -> Scene:
    try:
        start = lesson.start(number, revealed)
    except InputError as error:
        raise error.within(f"{key}.scene or {key}.changes") from error
    except StorageError as error:
        problem = f"{key}.scene or {key}.changes: {error}"
        raise InputError(problem, "name a scene that can be read", key=f"{key}.scene") from error
    if start is None:
        raise InputError(f"{key}.scene is missing", "name a scene", key=f"{key}.scene")
    return start[0]


def _check_setting(key: str, setting: Setting, scene: Scene) -> None:
    setting = _check_frame(f"{key}.frame", setting)
    for name, choices in (("map", MAPS), ("quantity", QUANTITIES), ("scale", SCALES), ("view", VIEWS)):
        if getattr(setting, name) is not None:
            require_choice(f"{key}.{name}", getattr(setting, name), choices)
    _check_modes(key, setting)
    if setting.map == "volume" and positions_of(scene).shape[1] != 3:
        remedy = "name a scene whose array is in space, as ball3d, or another map"
        raise InputError(f'{key}.map = "volume" needs an array in space', remedy, key=f"{key}.map", value="volume")
    if setting.run not in (None, "end") and not RUN.fullmatch(setting.run):
        remedy = 'write "end", or as "3 sweeps", "1 step", "2 stages"'
        raise InputError(f'{key}.run = "{setting.run}" is unknown', remedy, key=f"{key}.run", value=setting.run)
    offset = setting.order_offset
    if offset is not None and not 0 <= offset <= MAX_ORDER_OFFSET:
        remedy = f"use 0 to {MAX_ORDER_OFFSET}"
        raise InputError(f"{key}.order_offset = {offset} is impossible", remedy, key=f"{key}.order_offset")
    seed = setting.start_seed
    if seed is not None and seed < 0:
        raise InputError(f"{key}.start_seed = {seed} is negative", "use 0 or more", key=f"{key}.start_seed", value=seed)
    if setting.microphone is not None:
        _check_microphone(f"{key}.microphone", setting.microphone, scene)


def _check_frame(key: str, setting: Setting) -> Setting:
    """Return the setting with the values of its frame."""
    if setting.frame is not None and setting.run is not None:
        remedy = "let one step run the solver, and another one show the frame"
        raise InputError(f"{key} and run are both given", remedy, key=key, value=setting.frame)
    try:
        return setting.unfolded()
    except InputError as error:
        raise error.within(key) from error


def _check_microphone(key: str, microphone: int, scene: Scene) -> None:
    count = len(positions_of(scene))
    if not 0 <= microphone < count:
        remedy = f"{scene.name} has 0 to {count - 1}"
        raise InputError(f"{key} = {microphone} is not there", remedy, key=key, value=microphone)


def _check_modes(key: str, setting: Setting) -> None:
    if setting.modes is not None:
        modes = _modes(f"{key}.modes", setting.modes)
        if modes != tuple(range(modes[0], modes[-1] + 1)):
            problem, remedy = f'{key}.modes = "{setting.modes}" has gaps', "give one range, as 1-20"
            raise InputError(problem, remedy, key=f"{key}.modes", value=setting.modes)
    if setting.map_modes not in (None, IN_USE):
        _modes(f"{key}.map_modes", setting.map_modes)


def _modes(key: str, text: str) -> tuple[int, ...]:
    try:
        return parse_modes(text, LIMITS.mode)
    except InputError as error:
        raise error.within(f'{key} = "{shown(text)}"') from error
