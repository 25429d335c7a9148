"""A run: to its end in one call, or live with its thread, its history and its files.

May import: model, acoustics, cost, solvers, assessment and recordings.
"""
