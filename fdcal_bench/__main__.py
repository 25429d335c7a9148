"""The command `fdcal-bench`: methods on all cases, beside the reference results."""

import click

from .cases import NAMES, cases
from .methods import REFERENCE_METHODS, diffuse_bound, tape_error
from .scores import method_of, read_reference, score, scored, table, write_reference

DRAWS = 10  # number of draws in the reference results


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
def main():
    """A benchmark for the calibration of microphone arrays."""


@main.command()
@click.argument("methods", nargs=-1, metavar="[module:method]...")
@click.option("--only", metavar="TEXT", default="", help="Only cases whose name contains this text.")
@click.option(
    "--draws",
    type=click.IntRange(1, DRAWS),
    default=1,
    show_default=True,
    metavar="N",
    help="Draws of each simulated case.",
)
@click.option("--reference", is_flag=True, help="Compute the reference results again.")
def run(methods, only, draws, reference):
    """Print a table of methods on all cases, beside the reference results.

    `help(fdcal_bench)` describes the function of a method.
    """
    if not any(only in name for name in NAMES):
        raise click.BadParameter(f'no case contains "{only}"; the cases are {"; ".join(NAMES)}', param_hint="--only")
    functions = REFERENCE_METHODS if reference else {text: method_of(text) for text in methods}
    scores = []
    for case in cases(DRAWS if reference else draws, only) if functions else ():
        if reference:
            scores.append(scored(case, "bound", diffuse_bound(case)))
            scores.append(scored(case, "tape measure", tape_error(case)))
        for name, function in functions.items():
            scores.append(score(case, function, name))
            click.echo(f"{case.name}: {name} {scores[-1].error_mm:.1f} mm, {scores[-1].seconds:.1f} s")
    if reference:
        write_reference(scores)
    else:  # all methods on the same draws
        scores += [one for one in read_reference() if only in one.case and (one.draw < draws or not scores)]
    click.echo(table(scores))


if __name__ == "__main__":
    main()
