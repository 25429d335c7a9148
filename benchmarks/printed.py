"""Run commands of `fdcal`, and put the figures that they print into a document that shows some of their lines."""

import contextlib
import io
import re
import shlex

from fdcal.commands.cli import main

VALUE = r" *[-+]?\d+(?:\.\d+)?(?:e[+-]?\d+)?"  # with the spaces before it, which align columns
MEASURED = re.compile(r" *[-+]?\d+\.\d+(?:e[+-]?\d+)?")  # a number with a decimal point depends on the machine
WITH_UNIT = re.compile(
    rf"{MEASURED.pattern}|{VALUE}(?= (?:mm|dB|degrees)\b)"
)  # a length may be printed as 6 mm in one run and 6.1 mm in the next


def run_fdcal(code: str) -> str:
    """Run the lines `fdcal ...` of a block, and return what they print; any of them may end with 0, 4 or 5."""
    printed = io.StringIO()
    for line in code.replace("\\\n", " ").splitlines():
        program, *arguments = shlex.split(line, comments=True)
        assert program == "fdcal", line
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(io.StringIO()):
            try:
                main(arguments)
            except SystemExit as end:
                assert end.code in (0, 4, 5), line
    return printed.getvalue()


def renewed(documented: str, printed: str, numbers: re.Pattern = WITH_UNIT) -> str:
    """Return documented lines with the numbers of the printed ones, in that order; "..." stands for the rest of a line.

    Raises ValueError if one of them is not printed.
    """
    lines, printed_lines = [], iter(printed.strip().splitlines())
    for line in documented.strip().splitlines():
        text, dots, _ = line.rstrip().partition("...")
        start = text.rstrip()
        wanted = re.compile(VALUE.join(map(re.escape, numbers.split(start))) + ("" if dots else "$"))
        found = next(filter(None, (wanted.match(one.rstrip()) for one in printed_lines)), None) if start else None
        if start and found is None:
            raise ValueError(f'"{line}" is not printed, but\n{printed}')
        lines.append((found.group() if found else "") + text[len(start) :] + dots)
    return "\n".join(lines)


def shows(documented: str, printed: str) -> bool:
    """Return whether each documented line is printed, in that order, except for numbers."""
    try:
        renewed(documented, printed, MEASURED)
    except ValueError:
        return False
    return True
