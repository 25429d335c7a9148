"""Eq. 7 of the paper (`eq7`), its landscape, and the Gaussian likelihood of the pressures (`likelihood`).

Pure functions of positions and pressures, with compiled kernels behind them. True positions never enter.

May import: model and acoustics.
"""
