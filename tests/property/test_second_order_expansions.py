"""Second derivatives by blocks, and what they add to means and covariances, in every interpretation."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker import algebra
from tracker.models import ComponentSensor
from tracker.models.linearise import expand, linearise
from tracker.testing.laws.filter import Traced
from tracker.types import Array, Block, Space
from tracker_motion import constant_velocity, coordinated_turn
from tracker_sensors import azimuth, range_rate, stack

seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 4)
batches = st.sampled_from([(), (1,), (3,), (2, 3)])


def hessians(rng: np.random.Generator, m: int, n: int, batch: tuple[int, ...]) -> Array:
    A = rng.standard_normal((m, n, n, *batch))
    return A + A.swapaxes(1, 2)


def covariance(rng: np.random.Generator, n: int, batch: tuple[int, ...]) -> Array:
    A = rng.standard_normal((n, n + 1, *batch))
    P = np.einsum("ik...,jk...->ij...", A, A)
    return P + P.swapaxes(0, 1)


def by_the_book(A: Array, P: Array) -> tuple[Array, Array]:
    """Traces, written out."""
    m, batch = len(A), P.shape[2:]
    bias, more = np.empty((m, *batch)), np.empty((m, m, *batch))
    for lane in np.ndindex(*batch):
        at: Any = (..., *lane)
        for i in range(m):
            bias[(i, *lane)] = 0.5 * np.trace(A[i][at] @ P[at])
            for j in range(m):
                more[(i, j, *lane)] = 0.5 * np.trace(A[i][at] @ P[at] @ A[j][at] @ P[at])
    return bias, more


@given(seeds, sizes, sizes, batches)
def test_curvature_is_made_of_traces(seed: int, m: int, n: int, batch: tuple[int, ...]) -> None:
    rng = np.random.default_rng(seed)
    A, P = hessians(rng, m, n, batch), covariance(rng, n, batch)
    for got, want in zip(algebra.curvature(A, P), by_the_book(A, P), strict=True):
        assert got.shape == want.shape
        assert np.allclose(got, want, rtol=0, atol=1e-12 * max(1.0, np.abs(want).max(initial=0)))
    more = algebra.curvature(A, P)[1]
    assert np.array_equal(more, more.swapaxes(0, 1)), "the covariance is not exactly symmetric"


@given(seeds, sizes, sizes)
def test_curvature_on_graph_nodes_is_that_of_arrays(seed: int, m: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    A, P = hessians(rng, m, n, ()), covariance(rng, n, ())
    traced = Traced()
    nodes = np.stack([traced.vector(f"A{i}_", a.ravel()).reshape(n, n) for i, a in enumerate(A)])
    found = algebra.curvature(nodes, traced.gaussian(algebra_gaussian(P)).cov)
    for got, want in zip(found, algebra.curvature(A, P), strict=True):
        assert np.allclose(traced.worth(got), want, rtol=1e-12, atol=1e-12 * np.abs(want).max())


def algebra_gaussian(P: Array) -> Any:
    from tracker.types import Gaussian

    return Gaussian.trusted(np.zeros(len(P)), P)


@given(seeds, sizes, st.sets(st.integers(0, 4)), batches)
def test_a_block_is_the_whole_matrix_with_zeros(
    seed: int, m: int, used: set[int], batch: tuple[int, ...]
) -> None:
    rng = np.random.default_rng(seed)
    columns = tuple(sorted(used))
    block = Block(hessians(rng, m, len(columns), batch), columns, 5)
    P = covariance(rng, 5, batch)
    found, whole = algebra.curvature(block, P), algebra.curvature(block.dense(), P)
    for got, want in zip(found, whole, strict=True):
        assert np.allclose(got, want, rtol=1e-12, atol=1e-12)


def test_curvature_has_the_moments_of_a_quadratic_form() -> None:
    """Mean and covariance of e' A_i e / 2, by 200,000 draws: within 6 standard errors (chance 1e-8)."""
    rng = np.random.default_rng(1968)
    A, P = hessians(rng, 2, 3, ()), covariance(rng, 3, ())
    e = np.linalg.cholesky(P) @ rng.standard_normal((3, 200_000))
    forms = 0.5 * np.einsum("aij,is,js->as", A, e, e)
    bias, more = algebra.curvature(A, P)
    error = forms.std(axis=1) / np.sqrt(forms.shape[1])
    assert (np.abs(forms.mean(axis=1) - bias) < 6 * error).all()
    centred = forms - bias[:, None]
    for i in range(2):
        for j in range(2):
            products = centred[i] * centred[j]
            limit = 6 * products.std() / np.sqrt(len(products))
            assert abs(products.mean() - more[i, j]) < limit


MODELS = [
    (stack([azimuth(0.1).at(sx=1.0, sy=1.0), range_rate(0.1).at(sx=0.0, sy=9.0, svx=0.0, svy=0.0)]), ()),
    (azimuth(0.1), (np.array([3.0, 4.0]),)),
    (coordinated_turn(0.1, 1e-4), (0.7,)),
    (constant_velocity(0.1), (0.7,)),
]  # fmt: skip


@pytest.mark.parametrize(("model", "arguments"), MODELS, ids=lambda m: getattr(m, "name", ""))
@pytest.mark.parametrize("batch", [(), (1,), (5,), (2, 3)])
def test_an_expansion_is_value_jacobian_and_hessian(
    model: Any, arguments: tuple[Any, ...], batch: tuple[int, ...]
) -> None:
    space = getattr(model, "state", model.space)
    x = np.random.default_rng(3).uniform(10.0, 20.0, (space.size, *batch))
    value, first, second = expand(model, x, *arguments)
    known, jacobian = linearise(model, x, *arguments)
    assert np.allclose(value, known, rtol=1e-14)
    assert np.allclose(algebra.dense(first), algebra.dense(jacobian), rtol=1e-13)
    want = model.hessian(x, *arguments)
    assert np.allclose(np.broadcast_to(second.dense(), want.shape), want, rtol=1e-12, atol=1e-15)


def test_a_model_without_an_expansion_of_its_own_gives_its_hessian() -> None:
    class ByHand:
        def h(self, x: Array, pose: Any = None) -> Array:
            return x[:1] ** 2

        def jacobian(self, x: Array, pose: Any = None) -> Array:
            return 2.0 * x[None, :1]

        def hessian(self, x: Array, pose: Any = None) -> Array:
            return np.full((1, 1, 1, *x.shape[1:]), 2.0)

    value, first, second = expand(ByHand(), np.array([3.0]), None)
    assert (value.tolist(), first.tolist(), second.tolist()) == ([9.0], [[6.0]], [[[2.0]]])


def test_a_derivative_by_hand_stands_in_the_expansion_too() -> None:
    """It says what the tracing would not: here, deliberately, something else."""
    sensor = ComponentSensor(
        name="square",
        measure=lambda x: (x * x,),
        noise=lambda: ((1.0,),),
        derivative=lambda x: ((3.0 * x,),),
        space=Space.of("z"),
    )
    for x in (np.array([2.0, 0.0, 0.0, 0.0]), np.array([[2.0], [0.0], [0.0], [0.0]])):
        value, first, second = sensor.expand(x)
        assert value.ravel().tolist() == [4.0]
        assert algebra.dense(first).ravel().tolist() == [6.0, 0.0, 0.0, 0.0]
        assert second.dense()[0, 0, 0] == 2.0
