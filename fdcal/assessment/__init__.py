"""Can the answer be trusted: uncertainty, diagnostics, verdict, cross-validation, result file.

May import: model, acoustics, cost and solvers.
"""
