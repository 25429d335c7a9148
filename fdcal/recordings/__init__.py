"""Other people's recordings, from their files to a measurement.

May import: model, acoustics, cost, solvers and assessment.
"""
