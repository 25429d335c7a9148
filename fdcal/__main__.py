"""`python -m fdcal ...` is the same as `fdcal ...`."""

from .cli import main

main()
