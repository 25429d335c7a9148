"""Eq. 7 of the paper (`eq7`), its landscape, and the Gaussian likelihood of the pressures (`likelihood`).

The costs are pure functions of positions and pressures; some of their loops are compiled. No function gets the true
positions.

May import: model and acoustics.
"""
