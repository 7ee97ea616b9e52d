"""Inverses and solutions of the algebra against NumPy, in every interpretation."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker import algebra
from tracker.models import less, where
from tracker.testing.laws.filter import Traced
from tracker.types import Array

seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 5)
batches = st.sampled_from([(), (1,), (3,), (2, 3), (2, 0)])
conditions = st.floats(0.0, 8.0).map(lambda power: 10.0**power)


def covariance(rng: np.random.Generator, n: int, condition: float) -> Array:
    basis, _ = np.linalg.qr(rng.standard_normal((n, n)))
    root = basis * np.sqrt(np.geomspace(1.0, 1.0 / condition, n))
    P = root @ root.T
    return np.tril(P) + np.tril(P, -1).T


def stacked(batch: tuple[int, ...], make: Callable[[], Array]) -> Array:
    one = make()
    out = np.empty((*one.shape, *batch))
    for lane in np.ndindex(*batch):
        out[(..., *lane)] = make()
    return out


def each(batch: tuple[int, ...], *arrays: Array) -> Any:
    for lane in np.ndindex(*batch):
        yield tuple(a[(..., *lane)] for a in arrays)


def on_nodes(verb: Callable[..., Any], *arrays: Array) -> Array:
    traced = Traced()
    nodes = [
        traced.vector(f"a{i}_", array.ravel()).reshape(array.shape)
        for i, array in enumerate(arrays)
    ]
    return traced.worth(verb(*nodes))


@given(seeds, sizes, batches, conditions)
def test_an_inverse_is_one(seed: int, n: int, batch: tuple[int, ...], condition: float) -> None:
    rng = np.random.default_rng(seed)
    P = stacked(batch, lambda: covariance(rng, n, condition))
    inverse = algebra.inverse(P)
    assert np.array_equal(inverse, inverse.swapaxes(0, 1))
    for own, ours in each(batch, P, inverse):
        limit = 1e-14 * n * condition
        assert np.abs(own @ ours - np.eye(n)).max() <= limit
        theirs = on_nodes(algebra.inverse, own)
        assert np.abs(theirs - ours).max() <= limit * np.abs(ours).max()


@pytest.mark.parametrize("P", [np.zeros((2, 2)), np.diag([1.0, 0.0]), -np.eye(2)])
def test_what_is_not_positive_definite_has_no_inverse(P: Array) -> None:
    assert np.isnan(algebra.inverse(P)).any()
    lanes = algebra.inverse(np.stack([P, np.eye(2)], axis=-1))
    assert np.isnan(lanes[..., 0]).all()
    assert np.array_equal(lanes[..., 1], np.eye(2)), "the lane beside it is not touched"
    assert np.isnan(on_nodes(algebra.inverse, P).diagonal()).all()


@given(seeds, sizes, sizes, batches)
def test_a_solution_solves(seed: int, n: int, k: int, batch: tuple[int, ...]) -> None:
    rng = np.random.default_rng(seed)
    A = stacked(
        batch, lambda: np.linalg.qr(rng.standard_normal((n, n)))[0] * rng.uniform(0.1, 9, n)
    )
    B = rng.standard_normal((n, k, *batch))
    X = algebra.solve(A, B)
    for a, b, x in each(batch, A, B, X):
        assert np.abs(a @ x - b).max() < 1e-12
        assert np.abs(on_nodes(algebra.solve, a, b) - x).max() < 1e-12
    shared = rng.standard_normal((n, n, *(1 for _ in batch))) + 4.0 * np.eye(n).reshape(
        n, n, *(1 for _ in batch)
    )
    for b, x in each(batch, B, algebra.solve(shared, B)):
        assert np.abs(shared.reshape(n, n) @ x - b).max() < 1e-11


@given(seeds, sizes, sizes, batches)
def test_whitening_undoes_a_factor(seed: int, m: int, k: int, batch: tuple[int, ...]) -> None:
    rng = np.random.default_rng(seed)
    L = stacked(batch, lambda: np.linalg.cholesky(covariance(rng, m, 100.0)))
    for B in (rng.standard_normal((m, *batch)), rng.standard_normal((m, k, *batch))):
        W = algebra.whiten(L, B)
        assert W.shape == B.shape
        for own, b, w in each(batch, L, B, W):
            assert np.abs(own @ w - b).max() < 1e-12
            assert np.abs(on_nodes(algebra.whiten, own, b) - w).max() < 1e-11


def test_a_direction_without_spread_is_whitened_to_nothing() -> None:
    L, v = np.diag([2.0, 0.0]), np.array([4.0, 3.0])
    assert algebra.whiten(L, v).tolist() == [2.0, 0.0]
    assert algebra.whiten(L[..., None], v[:, None])[:, 0].tolist() == [2.0, 0.0]
    assert on_nodes(algebra.whiten, L, v).tolist() == [2.0, 0.0]


def test_a_choice_between_arrays_of_components_may_hang_on_one_node() -> None:
    def chosen(v: Array) -> Array:
        return where(less(v[0], 0.0), v, 2.0 * v)

    for v in (np.array([-1.0, 3.0]), np.array([1.0, 3.0])):
        assert on_nodes(chosen, v).tolist() == chosen(v).tolist()
