"""`python -m fdcal ...` is the same as `fdcal ...`."""

from .commands.cli import main

main()
