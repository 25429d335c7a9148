"""The command line: its options, its commands and their reports.

May import: every other package of fdcal.
"""
