"""Draw which package of fdcal imports which: `python docs/packages.py` writes docs/packages.svg from the imports.

A row is a package, and its dots are the packages that it imports. All dots lie below the diagonal: nothing imports
upward. `tests/test_layers.py` fails if the drawing does not match the imports.
"""

from __future__ import annotations

import ast
from html import escape
from pathlib import Path

DOCS = Path(__file__).parent
PACKAGE, DRAWING = DOCS.parent / "fdcal", DOCS / "packages.svg"
CELL, LEFT, TOP, WIDTH = 34, 110, 40, 1040  # pixels


def imported(package: Path) -> set[str]:
    """Return the names of the packages that the modules of a package import, anywhere in their code."""
    found = set()
    for path in package.rglob("*.py"):
        inside = path.relative_to(PACKAGE.parent).parts[:-1]
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level:
                base = (*inside[: len(inside) - node.level + 1], *(node.module or "").split("."))
                names = [base[1]] if len(base) > 1 and base[1] else [alias.name for alias in node.names]
                found |= {name for name in names if (PACKAGE / name / "__init__.py").exists()}
    return found - {package.name}


def packages() -> dict[str, set[str]]:
    """Return each package and what it imports, those that import the fewest first."""
    found = {path.parent.name: imported(path.parent) for path in PACKAGE.glob("*/__init__.py")}
    order: list[str] = []
    while len(order) < len(found):
        ready = sorted(name for name in found if name not in order and found[name] <= set(order))
        order.append(min(ready, key=lambda name: (len(found[name]), name)))
    return {name: found[name] for name in order}


def purpose(name: str) -> str:
    """Return the first line of the docstring of a package."""
    text = ast.get_docstring(ast.parse((PACKAGE / name / "__init__.py").read_text(encoding="utf-8"))) or ""
    return text.splitlines()[0].replace("`", "")


def drawing() -> str:
    """Return the drawing as SVG."""
    found = packages()
    names, height = list(found), TOP + CELL * len(found) + 12
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" font-family="sans-serif"'
        ' font-size="13">',
        f'<rect width="{WIDTH}" height="{height}" fill="#ffffff"/>',
        f'<text x="{LEFT}" y="20" fill="#555555">imports (dots of a row), and what each package is for</text>',
    ]
    for row, name in enumerate(names):
        y, right = TOP + CELL * row, LEFT + CELL * (row + 1)
        lines.append(f'<text x="{LEFT - 8}" y="{y + 22}" text-anchor="end" font-weight="bold">{name}</text>')
        for column, other in enumerate(names[: row + 1]):
            x = LEFT + CELL * column
            fill = "#005ab5" if column == row else "#eef2f7"
            lines.append(f'<rect x="{x}" y="{y}" width="{CELL - 2}" height="{CELL - 2}" fill="{fill}"/>')
            if other in found[name]:
                lines.append(f'<circle cx="{x + CELL / 2 - 1:g}" cy="{y + CELL / 2 - 1:g}" r="7" fill="#d61828"/>')
        lines.append(f'<text x="{right + 8}" y="{y + 22}">{escape(purpose(name))}</text>')
    return "\n".join([*lines, "</svg>"]) + "\n"


if __name__ == "__main__":
    DRAWING.write_text(drawing(), encoding="utf-8")
