"""Square roots of covariances: three interpretations agree, and the products are what they should be."""

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
    return np.array(evaluate(np.ravel(out).tolist(), values), dtype=np.float64).reshape(out.shape)


def check(compute, *arguments):
    """Lanes, one run and nodes give the same."""
    lanes = compute(*arguments)
    for lane in range(LANES):
        own = [np.ascontiguousarray(a[..., lane]) for a in arguments]
        for found in (compute(*own), on_nodes(compute, *own)):
            np.testing.assert_allclose(found, lanes[..., lane], rtol=1e-9, atol=1e-9)


def product(L):
    return np.einsum("ik...,jk...->ij...", L, L)


def lower(rng, n, batch=(LANES,)):
    L = np.tril(rng.standard_normal((*batch, n, n)))
    L[..., range(n), range(n)] = np.abs(L[..., range(n), range(n)])
    return np.moveaxis(L, (-2, -1), (0, 1))


@given(seeds, sizes, st.integers(1, 9))
def test_the_interpretations_agree(seed, n, k):
    rng = np.random.default_rng(seed)
    # full row rank: below a diagonal that is zero but for rounding anything may stand
    check(algebra.triangularise, rng.standard_normal((n, n + k, LANES)))
    L, v = lower(rng, n), rng.standard_normal((n, LANES))
    bigger = algebra.triangularise(algebra.beside(L, v[:, None]))
    check(algebra.downdate, bigger, v)


@given(seeds, sizes, st.integers(1, 9), batches)
def test_a_triangle_has_the_same_square(seed, n, k, batch):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, k, *batch)) * (rng.random((n, 1, *batch)) < 0.8)
    L = algebra.triangularise(A)
    assert L.shape == (n, n, *batch)
    np.testing.assert_allclose(product(L), product(A), atol=1e-12)
    assert (np.einsum("ii...->i...", L) >= 0.0).all(), "the diagonal is not negative"
    above = np.triu_indices(n, 1)
    assert not L[above].any(), "nothing stands above the diagonal"


@given(seeds, sizes, st.integers(0, 3))
def test_a_triangle_keeps_digits_that_a_sum_of_squares_loses(seed, n, decades):
    rng = np.random.default_rng(seed)
    small = 10.0 ** -(8 + decades)
    A = np.ones((n, n)) + small * np.diag(rng.uniform(1.0, 2.0, n))
    L = algebra.triangularise(A)
    # |det| of a root is the product of its diagonal; of ones(n) + D it is known
    d = np.diag(A) - 1.0
    want = np.prod(d) * (1.0 + (1.0 / d).sum())
    np.testing.assert_allclose(np.prod(np.diag(L)), want, rtol=1e-2 if decades > 1 else 1e-5)


@given(seeds, sizes, batches)
def test_a_downdate_takes_an_outer_product_away(seed, n, batch):
    rng = np.random.default_rng(seed)
    L, v = lower(rng, n, batch), rng.standard_normal((n, *batch))
    bigger = algebra.triangularise(algebra.beside(L, v[:, None]))
    smaller = algebra.downdate(bigger, v)
    np.testing.assert_allclose(product(smaller), product(L), rtol=1e-6, atol=1e-6)


def test_a_downdate_that_leaves_no_covariance_is_nan_in_its_lane_alone():
    L = np.broadcast_to(np.eye(2)[..., None], (2, 2, 3))
    v = np.array([[0.5, 1.5, 0.0], [0.0, 0.0, 0.5]])
    with np.errstate(invalid="ignore"):
        out = algebra.downdate(L, v)
    assert np.isnan(out[..., 1]).any()
    assert np.isfinite(out[..., [0, 2]]).all()


def test_a_singular_root_may_be_downdated_along_what_it_spans():
    L = np.array([[2.0, 0.0], [0.0, 0.0]])
    np.testing.assert_allclose(
        algebra.downdate(L, np.array([1.0, 0.0])), [[3.0**0.5, 0.0], [0.0, 0.0]]
    )


@given(seeds, sizes, st.integers(1, 3))
def test_conditioning_a_root_is_conditioning(seed, n, m):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((m + n, m + n + 2, LANES))
    mean, v = rng.standard_normal((n, LANES)), rng.standard_normal((m, LANES))
    joint = product(A)
    S, cross, P = joint[:m, :m], joint[m:, :m], joint[m:, m:]
    want = algebra.condition(mean, P, v, S, cross)
    got = algebra.condition_root(mean, algebra.triangularise(A), v)
    for a, b in zip((got[0], product(got[1]), *got[2:]), want, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-7)
    check(
        lambda mean, A, v: algebra.condition_root(mean, algebra.triangularise(A), v)[0], mean, A, v
    )
