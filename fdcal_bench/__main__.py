"""`fdcal-bench [module:method ...]`: a table of methods on all cases, beside the reference results."""

import argparse

from .cases import NAMES, cases
from .methods import REFERENCE_METHODS, diffuse_bound, tape_error
from .scores import method_of, read_reference, score, scored, table, write_reference

DRAWS = 10  # of the reference


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="fdcal-bench", description=__doc__)
    parser.add_argument("methods", nargs="*", metavar="module:method", help="Functions as `help(fdcal_bench)` says.")
    parser.add_argument("--only", metavar="TEXT", default="", help="Cases whose name holds this text.")
    parser.add_argument(
        "--draws", type=int, default=1, metavar="N", help=f"Of each family, at most {DRAWS}.  [default: 1]"
    )
    parser.add_argument("--reference", action="store_true", help="Compute the reference results, which needs fdcal.")
    asked = parser.parse_args(arguments)
    if not any(asked.only in name for name in NAMES):
        parser.error(f'no case holds "{asked.only}"; the cases are {"; ".join(NAMES)}')
    if not 1 <= asked.draws <= DRAWS:
        parser.error(f"--draws {asked.draws}: the reference has {DRAWS} draws of each family, give 1 to {DRAWS}")
    methods = REFERENCE_METHODS if asked.reference else {text: method_of(text) for text in asked.methods}
    scores = []
    for case in cases(DRAWS if asked.reference else asked.draws, asked.only) if methods else ():
        if asked.reference:
            scores.append(scored(case, "bound", diffuse_bound(case)))
            scores.append(scored(case, "tape measure", tape_error(case)))
        for name, method in methods.items():
            scores.append(score(case, method, name))
            print(f"{case.name}: {name} {scores[-1].error_mm:.1f} mm, {scores[-1].seconds:.1f} s", flush=True)
    if asked.reference:
        write_reference(scores)
    else:
        # all methods on the same draws
        scores += [one for one in read_reference() if asked.only in one.case and (one.draw < asked.draws or not scores)]
    print(table(scores))


if __name__ == "__main__":
    main()
