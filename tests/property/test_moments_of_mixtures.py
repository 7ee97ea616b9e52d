"""The verb `mix` against sums written out, in all interpretations; what it promises of order and angles."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.algebra import mix
from tracker.models import wrap
from tracker.models.graph import Graph, evaluate
from tracker.types import Array

seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 4)
counts = st.integers(1, 5)
lanes = st.sampled_from([(), (3,), (2, 3), (0,)])


def members(
    rng: np.random.Generator, n: int, count: int, batch: tuple[int, ...]
) -> tuple[Array, Array, Array]:
    root = rng.standard_normal((n, n, count, *batch))
    cov = np.einsum("ik...,jk...->ij...", root, root)
    weights = rng.dirichlet(np.ones(count), batch)
    mean = 100.0 + rng.standard_normal((n, count, *batch))
    return mean, (cov + cov.swapaxes(0, 1)) / 2.0, np.moveaxis(weights, -1, 0)


def on_nodes(mean: Array, cov: Array, weights: Array, flags: Any) -> tuple[Array, Array]:
    """The same on graph nodes, evaluated afterwards."""
    graph, values = Graph(), {}

    def symbols(name: str, array: Array) -> Any:
        out = np.empty(array.shape, dtype=object)
        for place, value in np.ndenumerate(array):
            out[place], values[f"{name}{place}"] = graph.input(f"{name}{place}"), float(value)
        return out

    found = mix(symbols("x", mean), symbols("P", cov), symbols("w", weights), flags)
    return tuple(
        np.array(evaluate(part.ravel().tolist(), values)).reshape(part.shape) for part in found
    )


@given(seeds, sizes, counts, lanes)
def test_moments_are_the_sums_of_the_textbook(
    seed: int, n: int, count: int, batch: tuple[int, ...]
) -> None:
    mean, cov, weights = members(np.random.default_rng(seed), n, count, batch)
    centre, spread = mix(mean, cov, weights)
    want = (weights * mean).sum(axis=1)
    second = (weights * (cov + mean[:, None] * mean)).sum(axis=2)
    np.testing.assert_allclose(centre, want, rtol=1e-13)
    np.testing.assert_allclose(spread, second - want[:, None] * want, rtol=0, atol=1e-10)
    assert np.array_equal(spread, spread.swapaxes(0, 1))


@given(seeds, sizes, counts, st.data())
def test_all_interpretations_and_any_order_agree(
    seed: int, n: int, count: int, data: st.DataObject
) -> None:
    rng = np.random.default_rng(seed)
    flags = data.draw(st.tuples(*[st.booleans()] * n), label="which components are angles")
    mean, cov, weights = members(rng, n, count, (3,))
    order = rng.permutation(count)
    together = mix(mean, cov, weights, flags)
    turned = mix(mean[:, order], cov[:, :, order], weights[order], flags)
    for lane in range(3):
        own = mean[..., lane], cov[..., lane], weights[..., lane]
        for found in (mix(*own, flags), on_nodes(*own, flags), [v[..., lane] for v in turned]):
            for ours, theirs in zip(found, together, strict=True):
                np.testing.assert_allclose(ours, theirs[..., lane], rtol=0, atol=1e-11)


@given(seeds, counts)
def test_one_member_and_equal_members_are_themselves(seed: int, count: int) -> None:
    mean, cov, _ = members(np.random.default_rng(seed), 3, 1, (4,))
    same = np.repeat(mean, count, axis=1), np.repeat(cov, count, axis=2)
    centre, spread = mix(*same, np.full((count, 4), 1.0 / count))
    np.testing.assert_allclose(centre, mean[:, 0], rtol=1e-14)
    np.testing.assert_allclose(spread, cov[:, :, 0], rtol=1e-13, atol=1e-13)


@given(seeds, st.floats(-20.0, 20.0))
def test_turning_all_angles_turns_their_mean_and_no_more(seed: int, turn: float) -> None:
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-1.0, 1.0, (1, 4))  # the cut is far from all, until they are turned
    cov, weights = np.full((1, 1, 4), 0.01), rng.dirichlet(np.ones(4))
    want, spread = mix(angles, cov, weights, True)
    for found, again in (
        mix(wrap(angles + turn), cov, weights, True),
        on_nodes(wrap(angles + turn), cov, weights, True),
    ):
        assert abs(wrap(float(found[0] - want[0]) - turn)) < 1e-12
        np.testing.assert_allclose(again, spread, rtol=1e-9)


def test_members_a_million_sigma_apart_leave_a_covariance() -> None:
    mean = np.array([[0.0, 1e6, -1e6], [0.0, 1e6, 2e6]])
    cov = np.repeat(np.eye(2)[:, :, None], 3, axis=2)
    _, spread = mix(mean, cov, np.array([1.0, 1e-13, 1e-13]))
    assert np.linalg.eigvalsh(spread)[0] >= 1.0 - 1e-9


@pytest.mark.parametrize("batch", [(), (3,)])
def test_spread_can_be_taken_from_elsewhere(batch: tuple[int, ...]) -> None:
    mean, cov, weights = members(np.random.default_rng(1), 2, 3, batch)
    centre, spread = mix(mean, cov, weights)
    shift = np.ones((2, *batch))
    told, about = mix(mean, cov, weights, about=centre + shift)
    assert told is not centre
    np.testing.assert_allclose(about, spread + shift[:, None] * shift, rtol=1e-9)
