"""Print the lowest versions that pyproject.toml allows for fdcal and its extra `page`, as lines `name==version`."""

import re
import tomllib
from pathlib import Path

EXTRA = re.compile(r"fdcal\[(\w+)\]")
REQUIREMENT = re.compile(r"(?P<name>[A-Za-z0-9_.-]+)>=(?P<version>[0-9.]+)")

project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
requirements = [*project["dependencies"], "fdcal[page]"]
for requirement in requirements:
    if extra := EXTRA.match(requirement):
        requirements += project["optional-dependencies"][extra[1]]
    elif match := REQUIREMENT.match(requirement):
        print(f"{match['name']}=={match['version']}")
    else:
        raise SystemExit(f"pyproject.toml gives no lowest version of {requirement}")
