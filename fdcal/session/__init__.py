"""A live run: its thread, its history and its files.

May import: model, acoustics, cost, solvers, assessment and recordings.
"""
