"""The extras of fdcal: which one brings a library, and what to do where that library is missing."""

import importlib
import re
from importlib import metadata
from types import ModuleType

from .validation import InputError

LIBRARY = {"PIL": "pillow", "mpl_toolkits": "matplotlib", "vtkmodules": "vtk"}  # of a package
REQUIREMENT = re.compile(r"""([\w.-]+).*; extra == ['"](\w+)['"]""")


def extra_of(package: str) -> str | None:
    """Return the smallest extra that brings a package, such as "page" for "viser"; None where none does."""
    brought: dict[str, set[str]] = {}
    for line in metadata.requires("fdcal") or ():
        if found := REQUIREMENT.match(line):
            brought.setdefault(found[2], set()).add(found[1].lower())
    library = LIBRARY.get(package, package).lower()
    return min((extra for extra in brought if library in brought[extra]), key=lambda e: len(brought[e]), default=None)


def install_remedy(extra: str) -> str:
    """Return how to install an extra of fdcal, in a checkout and elsewhere."""
    return f"install it: pip install -e '.[{extra}]' in a checkout of fdcal, pip install 'fdcal[{extra}]' elsewhere"


def missing_library(error: ImportError, extra: str | None = None) -> InputError | None:
    """Return what to say of a library that an extra brings and that is not installed; None of another fault.

    `extra`: the one, where an installation of before does not list it.
    """
    package = (error.name or "").partition(".")[0]
    extra = extra_of(package) or extra if isinstance(error, ModuleNotFoundError) and package else None
    if extra is None:
        return None
    library = LIBRARY.get(package, package)
    return InputError(f'this needs the library "{library}" of the extra "{extra}"', install_remedy(extra))


def needs(name: str, extra: str | None = None) -> ModuleType:
    """Import a library; raise InputError with the way to install it where it is missing; `extra` as above."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise missing_library(error, extra) or error from error
