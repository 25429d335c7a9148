"""Sums and factorisations of many modes at once are those of one mode after the other."""

import numpy as np
import pytest

from fdcal.cost import batches
from fdcal.cost.batches import (
    applied,
    as_columns,
    blocks,
    hermitian_inverses,
    joined_columns,
    over_blocks,
    triangular_inverses,
    weighted_curvature,
    whole_curvature,
)

M, N = 7, 5


def hermitian(kind, seed=0):
    """Positive definite matrices (M, N, N)."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(M, N, N)) + (1j * rng.normal(size=(M, N, N)) if kind is complex else 0)
    return A @ np.conj(A.swapaxes(1, 2)) + np.eye(N)


@pytest.mark.parametrize("numbers", [1, 100, 10**9])
@pytest.mark.parametrize("modes", [1, 6, 1000])
def test_blocks_cover_every_mode_once_and_are_small(modes, numbers):
    found = blocks(modes, numbers)
    assert [m for block in found for m in range(modes)[block]] == list(range(modes))
    sizes = [block.stop - block.start for block in found]
    assert max(sizes) - min(sizes) <= 1 and (max(sizes) * numbers <= batches.BLOCK or max(sizes) == 1)


@pytest.mark.parametrize("least", [0.0, np.inf])
def test_blocks_are_computed_in_their_order_on_one_core_or_all(least, monkeypatch):
    monkeypatch.setattr(batches, "WORTH_THREADS", least)
    monkeypatch.setattr(batches, "BLOCK", 10)
    parts = list(over_blocks(lambda m: list(range(100)[m]), 100, 5))
    assert 1 < len(parts) <= batches.PARTS
    assert [mode for part in parts for block in part for mode in block] == list(range(100))


@pytest.mark.parametrize("kind", [float, complex])
def test_inverses_and_determinants_are_those_of_numpy(kind):
    C = hermitian(kind)
    G = np.linalg.cholesky(C)
    np.testing.assert_allclose(triangular_inverses(G.copy()), np.linalg.inv(G), atol=1e-12)
    inverse, log_det = hermitian_inverses(C.copy())
    np.testing.assert_allclose(inverse, np.linalg.inv(C), atol=1e-12)
    np.testing.assert_allclose(log_det, np.linalg.slogdet(C)[1], rtol=1e-12)


@pytest.mark.parametrize("kind", [float, complex])
def test_a_matrix_that_is_not_positive_definite_is_refused_by_its_mode(kind):
    C = hermitian(kind)
    C[4] *= -1
    with pytest.raises(np.linalg.LinAlgError, match="mode 4"):
        hermitian_inverses(C)


@pytest.mark.parametrize("kind", [float, complex])
def test_a_matrix_is_applied_to_complex_vectors_in_its_own_arithmetic(kind):
    rng = np.random.default_rng(1)
    v, A = rng.normal(size=(M, N)) + 1j * rng.normal(size=(M, N)), hermitian(kind)
    np.testing.assert_allclose(applied(A, v), np.einsum("mij,mj->mi", A, v))
    assert as_columns(v, A.dtype).dtype == A.dtype
    np.testing.assert_array_equal(joined_columns(as_columns(v, A.dtype)), v)


@pytest.mark.parametrize("largest", [30, 1.3e5])
@pytest.mark.parametrize("kind", [float, complex])
def test_the_curvature_is_the_sum_over_modes_whatever_the_blocks(kind, largest, monkeypatch):
    monkeypatch.setattr(batches, "BLOCK", largest)
    rng = np.random.default_rng(2)
    g, diagonal, matrices = rng.normal(size=(3, 2, M, N)), rng.uniform(size=M), hermitian(kind)
    J, whole = g[:, 0] + 1j * g[:, 1], matrices + diagonal[:, None, None] * np.eye(N)
    expected = np.einsum("ami,mij,bmj->iajb", J.conj(), whole, J).real
    found = whole_curvature(weighted_curvature(g, lambda m, rows: matrices[m, rows], diagonal))
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


def test_the_blocks_that_are_not_computed_are_zero(monkeypatch):
    """They are added, too, and memory that nobody has written may hold anything."""
    rng, empty = np.random.default_rng(0), np.empty
    g, matrices = rng.standard_normal((2, 2, 3, 5)), rng.standard_normal((3, 5, 5))

    def filled(shape, *arguments, **named):
        made = empty(shape, *arguments, **named)
        made.fill(np.nan)
        return made

    monkeypatch.setattr(np, "empty", filled)
    H = weighted_curvature(g, lambda m, rows: matrices[m, rows])
    assert np.isfinite(H).all() and not H[1, 0].any() and H[0, 1].any()
