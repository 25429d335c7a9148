"""Preset of the likelihood solver for matched channels and exact given positions.

May import: model, acoustics, cost and the other solvers.
"""
