"""The damped step that all solvers take, on costs whose minimum is known."""

import numpy as np

from fdcal.solvers.levenberg_marquardt import NewtonTerms, damped_step


def test_a_step_that_overshoots_is_shortened():
    A, x, damping = np.diag([1.0, 100.0]), np.ones(2), 1e-6
    for _ in range(3):
        # The matrix has about half the curvature of the cost.
        terms = NewtonTerms(float(x @ A @ x) / 2, A @ x, A / 1.9)
        step = damped_step(x, terms, lambda y: float(y @ A @ y) / 2, lambda y, x=x: x + y, np.max, damping, np.inf)
        x, damping = step.unknowns, step.damping
    assert np.abs(x).max() < 1e-6
