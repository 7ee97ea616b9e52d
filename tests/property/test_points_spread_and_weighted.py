"""Spreading points about a mean and weighting them: three interpretations agree, and the laws hold."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tracker import algebra
from tracker.models.graph import Graph, evaluate

LANES = 3
seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 6)
batches = st.sampled_from([(), (LANES,), (2, 0), (2, 3)])


def on_nodes(compute, *arguments):
    """A result on graph nodes, which are then worth the arguments' numbers."""
    graph, values, symbols = Graph(), {}, []
    for i, array in enumerate(arguments):
        symbol = np.empty(array.shape, dtype=object)
        for place, value in np.ndenumerate(array):
            symbol[place], values[f"{i} {place}"] = graph.input(f"{i} {place}"), float(value)
        symbols.append(symbol)
    out = compute(*symbols)
    worth = evaluate(np.ravel(out).tolist(), values)
    return np.array(worth, dtype=np.float64).reshape(out.shape)


def check(compute, *arguments):
    """Lanes, one run, floats and nodes give the same."""
    lanes = compute(*arguments)
    for lane in range(LANES):
        own = [np.ascontiguousarray(a[..., lane]) for a in arguments]
        floats = [a.astype(object) for a in own]
        for found in (compute(*own), compute(*floats), on_nodes(compute, *own)):
            np.testing.assert_allclose(
                found.astype(np.float64), lanes[..., lane], rtol=1e-9, atol=1e-9
            )


@given(seeds, sizes, sizes)
def test_the_interpretations_agree(seed, n, m):
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((n, 2 * n)) * (rng.random((n, 2 * n)) < 0.5)
    weights, several = rng.standard_normal(2 * n), rng.standard_normal((2 * n, n))
    mean, L = rng.standard_normal((n, LANES)), rng.standard_normal((n, n, LANES))
    d = rng.standard_normal((m, 2 * n, LANES))
    check(lambda mean, L: algebra.spread(mean, L, points), mean, L)
    check(lambda d: algebra.weighted_mean(d, weights), d)
    check(lambda d: algebra.weighted_mean(d, several), d)
    check(lambda d: algebra.weighted(d, weights), d)


@given(seeds, sizes, batches)
def test_symmetric_points_have_the_moments_they_were_spread_with(seed, n, batch):
    rng = np.random.default_rng(seed)
    mean, root = rng.standard_normal((n, *batch)), rng.standard_normal((n, n, *batch))
    P = algebra.congruence(
        root, np.broadcast_to(np.eye(n).reshape(n, n, *(1,) * len(batch)), root.shape)
    )
    points = np.sqrt(n) * np.concatenate([np.eye(n), -np.eye(n)], axis=1)
    weights = np.full(2 * n, 0.5 / n)
    spread = algebra.spread(mean, algebra.factor(P), points)
    assert spread.shape == (n, 2 * n, *batch)
    np.testing.assert_allclose(algebra.weighted_mean(spread, weights), mean, atol=1e-9)
    found = algebra.weighted(spread - mean[:, None], weights)
    np.testing.assert_allclose(found, P, atol=1e-9)
    assert np.array_equal(found, algebra.transpose(found)), "a covariance is exactly symmetric"
