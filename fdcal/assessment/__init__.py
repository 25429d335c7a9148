"""Whether a result can be trusted: uncertainty, diagnostics, verdict, cross-validation and the result file.

Everything here works without the true positions, from the pressures and the estimated positions.

May import: model, acoustics, cost and solvers.
"""
