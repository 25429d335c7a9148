"""Block coordinate descent of section 3 of the paper: one microphone at a time over all candidates.

May import: model, acoustics, cost and the modules of solvers that every solver shares.
"""
