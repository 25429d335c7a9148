"""Where a command may write its result."""

from __future__ import annotations

from pathlib import Path

from ..model.validation import InputError, StorageError


def output_path(text: str, suffix: str | list[str], force: bool, *inputs: str | None) -> Path:
    """Return the path of a result; it is checked before the work begins, which may take long.

    `text`: of the option -o; `suffix`, str or list of str, allowed suffixes, in lower case; `force`: whether an
    existing file may be overwritten; `*inputs`: files that must not be overwritten. Raises InputError, StorageError:
    the suffix is wrong, the file exists or is one of the inputs; its folder does not exist.
    """
    path = Path(text)
    allowed = [suffix] if isinstance(suffix, str) else suffix
    if path.suffix.lower() not in allowed:
        problem, remedy = (
            f'-o "{text}" must end in {" or ".join(allowed)}',
            f"write {path.stem or 'result'}{allowed[0]}",
        )
        raise InputError(problem, remedy, key="output", value=text)
    if path.is_dir():
        raise InputError(f"-o {text} is a folder", "name a file", key="output", value=text)
    if not path.parent.is_dir():
        raise StorageError(f"-o {text} lies in a folder that does not exist; make it first: mkdir -p {path.parent}")
    for source in inputs:
        if source is not None and (Path(source).resolve() == path.resolve() or _same_file(Path(source), path)):
            problem = f"-o {text} is the input itself, which is never overwritten"
            raise InputError(problem, "choose another name", key="output", value=text)
    if path.exists() and not force:
        remedy = "add <force> to overwrite it, or choose another name"
        raise InputError(f"-o {text} exists", remedy, key="output", value=text)
    return path


def _same_file(one: Path, other: Path) -> bool:
    """Return whether two paths lead to one file, as hard links do."""
    return one.exists() and other.exists() and one.samefile(other)
