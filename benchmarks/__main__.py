"""Run every benchmark, or the named ones: `python -m benchmarks [NAME ...]`."""

import importlib
import os
import pkgutil
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line sets it for itself; before NumPy is imported

import benchmarks


def main(wanted: list[str]) -> None:
    names = [m.name.removeprefix("bench_") for m in pkgutil.iter_modules(benchmarks.__path__, "") if "bench_" in m.name]
    unknown = set(wanted) - set(names)
    if unknown:
        sys.exit(f"unknown benchmark {', '.join(sorted(unknown))}; use {', '.join(names)}")
    for name in wanted or names:
        module = importlib.import_module(f"benchmarks.bench_{name}")
        if not wanted and getattr(module, "ALONE", False):
            continue  # too long to run unless it is named
        print(f"\n{name}")
        for figure in module.run():
            print(f"  {figure}", flush=True)


if __name__ == "__main__":  # workers of a benchmark import this module again
    main(sys.argv[1:])
