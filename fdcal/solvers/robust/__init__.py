"""Positions, channel gains and channel noise together: one likelihood, a noise that falls, several starts.

May import: model, acoustics and cost.
"""
