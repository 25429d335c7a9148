"""Write slow.txt, the tests that `pytest -m "not slow"` leaves out, from the durations of a run.

    python -m pytest --durations=0 -vv >durations.txt; python .ci/slow.py durations.txt

Each line is a function and the seconds that its cases take together.
"""

import re
import sys
from collections import Counter
from pathlib import Path

MIN_TIME = 0.6  # s, of the tests that are listed
LINE = re.compile(r"([\d.]+)s (?:call|setup|teardown) +(?:fdcal_bench/)?tests/\S*?::(\w+)")

if __name__ == "__main__":
    seconds: Counter[str] = Counter()
    for took, name in LINE.findall(Path(sys.argv[1]).read_text(encoding="utf-8")):
        seconds[name] += float(took)
    listed = sorted(f"{name} {took:.1f}\n" for name, took in seconds.items() if took >= MIN_TIME)
    Path(__file__).parents[1].joinpath("tests", "slow.txt").write_text("".join(listed), encoding="utf-8")
