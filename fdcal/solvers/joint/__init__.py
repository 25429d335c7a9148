"""The joint solver: Levenberg-Marquardt on the likelihood, all free microphones at once.

May import: model, acoustics, cost and the modules of solvers that every solver shares.
"""
