"""Eq. 7 of the paper, its landscape, and the Gaussian likelihood of the pressures.

May import: model and acoustics.
"""
