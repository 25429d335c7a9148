"""`fdcal-bench [module:method ...]`: a table of methods on all cases, beside the reference results."""

import argparse

from .cases import NAMES, cases
from .methods import REFERENCE_METHODS, diffuse_bound, tape_error
from .scores import Score, method_of, read_reference, score, table, write_reference


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="fdcal-bench", description=__doc__)
    parser.add_argument("methods", nargs="*", metavar="module:method", help="Functions as `help(fdcal_bench)` says.")
    parser.add_argument("--only", metavar="TEXT", default="", help="Cases whose name holds this text.")
    parser.add_argument("--draws", type=int, default=1, metavar="N", help="Of each simulated family.  [default: 1]")
    parser.add_argument("--reference", action="store_true", help="Compute the reference results, which needs fdcal.")
    asked = parser.parse_args(arguments)
    if not any(asked.only in name for name in NAMES):
        parser.error(f'no case holds "{asked.only}"; the cases are {"; ".join(NAMES)}')
    methods = REFERENCE_METHODS if asked.reference else {text: method_of(text) for text in asked.methods}
    scores = []
    for case in cases(asked.draws, asked.only) if methods else ():
        if asked.reference:
            nan = float("nan")
            scores.append(Score(case.name, "bound", diffuse_bound(case), nan, nan))
            scores.append(Score(case.name, "tape measure", tape_error(case), nan, nan))
        for name, method in methods.items():
            scores.append(score(case, method, name))
            print(f"{case.name}: {name} {scores[-1].error_mm:.1f} mm, {scores[-1].seconds:.1f} s", flush=True)
    if asked.reference:
        write_reference(scores)
    else:
        shown = {one.case for one in scores} or {name for name in NAMES if asked.only in name}
        scores += [one for one in read_reference() if one.case in shown]
    print(table(scores))


if __name__ == "__main__":
    main()
