"""Lanes, one run and components (floats and graph nodes) give the same for every verb and filter."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker import algebra
from tracker.models.graph import Graph, evaluate
from tracker.types import Array, Columns, Gaussian
from tracker_kalman import ExtendedKalmanFilter, JosephFilter, KalmanFilter, RauchTungStriebel
from tracker_motion import constant_velocity
from tracker_sensors import azimuth, position, stack

LANES = 3
TOLERANCE = 1e-9
seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 5)
conditions = st.floats(0.0, 8.0).map(lambda power: 10.0**power)
scales = st.floats(-8.0, 8.0).map(lambda power: 10.0**power)


def covariance(rng: np.random.Generator, n: int, condition: float, scale: float = 1.0) -> Array:
    """A random covariance whose eigenvalues span ``condition``, exactly symmetric."""
    basis, _ = np.linalg.qr(rng.standard_normal((n, n)))
    root = basis * np.sqrt(scale * np.geomspace(1.0, 1.0 / condition, n))
    P = root @ root.T
    return np.tril(P) + np.tril(P, -1).T


def stacked(make: Callable[[], Array]) -> Array:
    return np.stack([make() for _ in range(LANES)], axis=-1)


def flat(result: Any) -> list[Any]:
    """The arrays of a result, one after the other."""
    if isinstance(result, Gaussian):
        return [result.mean, result.cov]
    if isinstance(result, tuple):
        return [array for part in result for array in flat(part)]
    return [result]


def as_floats(array: Array) -> Any:
    out = np.empty(array.shape, dtype=object)
    out[...] = array.tolist()
    return out


def through_nodes(compute: Callable[..., Any], arguments: list[Array]) -> list[Any]:
    """The result on graph nodes, which are then worth the arguments' numbers."""
    graph, values, symbols = Graph(), {}, []
    for i, array in enumerate(arguments):
        symbol = np.empty(array.shape, dtype=object)
        for place, value in np.ndenumerate(array):
            name = f"argument {i} {place}"
            symbol[place], values[name] = graph.input(name), float(value)
        symbols.append(symbol)
    out = []
    with np.errstate(all="ignore"):
        for part in flat(compute(*symbols)):
            shape = np.shape(part)
            worth = evaluate(np.ravel(np.asarray(part, dtype=object)).tolist(), values)
            out.append(np.array(worth, dtype=np.float64).reshape(shape))
    return out


def check_agreement(
    compute: Callable[..., Any], arguments: list[Array], tolerance: float = TOLERANCE
) -> None:
    """The four ways to compute something differ by at most ``tolerance`` of its largest entry."""
    with np.errstate(all="ignore"):
        lanes = flat(compute(*arguments))
    for lane in range(LANES):
        own = [np.ascontiguousarray(a[..., lane]) for a in arguments]
        with np.errstate(all="ignore"):
            found = {
                "one run": flat(compute(*own)),
                "components, floats": flat(compute(*map(as_floats, own))),
                "components, nodes": through_nodes(compute, own),
            }
        for name, parts in found.items():
            for i, (ours, theirs) in enumerate(zip(parts, lanes, strict=True)):
                expected = theirs[..., lane]
                got = np.asarray(ours, dtype=np.float64)
                scale = float(np.nanmax(np.abs(expected), initial=1e-300))
                assert np.allclose(
                    got, expected, rtol=0.0, atol=tolerance * scale, equal_nan=True
                ), f"part {i} of {name} is {got}, and {expected} in a lane"


def without_some(rng: np.random.Generator, v: Array, share: float = 0.3) -> Array:
    v[rng.random(v.shape) < share] = np.nan
    return v


# ------------------------------------------------------------------------------------ verbs
@given(seeds, sizes, sizes, conditions, scales)
def test_products_and_congruences(
    seed: int, n: int, m: int, condition: float, scale: float
) -> None:
    rng = np.random.default_rng(seed)
    P = stacked(lambda: covariance(rng, n, condition, scale))
    H = stacked(lambda: rng.standard_normal((m, n)))
    v = stacked(lambda: rng.standard_normal(n))
    check_agreement(algebra.congruence, [H, P])
    check_agreement(algebra.product, [H, P])
    check_agreement(lambda H, P: algebra.symmetric_product(algebra.product(H, P), H), [H, P])
    check_agreement(algebra.apply, [H, v])
    check_agreement(algebra.transpose, [H])


@given(seeds, sizes, conditions, scales)
def test_a_matrix_that_all_lanes_share_is_that_matrix_in_each(
    seed: int, n: int, condition: float, scale: float
) -> None:
    rng = np.random.default_rng(seed)
    P, F = stacked(lambda: covariance(rng, n, condition, scale)), rng.standard_normal((n, n, 1))
    repeated = np.repeat(F, LANES, axis=2)
    bound = TOLERANCE * np.abs(P).max() * np.abs(F).max() ** 2 * n**2
    assert np.abs(algebra.congruence(F, P) - algebra.congruence(repeated, P)).max() <= bound
    assert np.abs(algebra.product(F, P) - algebra.product(repeated, P)).max() <= bound


@given(seeds, sizes, st.sets(st.integers(0, 4)), conditions)
def test_a_jacobian_by_columns_is_the_whole_matrix_with_zeros(
    seed: int, m: int, used: set[int], condition: float
) -> None:
    rng = np.random.default_rng(seed)
    n, columns = 5, tuple(sorted(used))
    P = stacked(lambda: covariance(rng, n, condition))
    H = Columns(rng.standard_normal((m, len(columns), LANES)), columns, n)
    whole = H.dense()
    HP = algebra.product(H, P)
    assert np.allclose(HP, algebra.product(whole, P), rtol=0, atol=1e-13)
    S = algebra.symmetric_product(HP, H)
    assert np.allclose(S, algebra.symmetric_product(HP, whole), rtol=0, atol=1e-13)
    assert np.allclose(algebra.congruence(H, P), algebra.congruence(whole, P), rtol=0, atol=1e-13)


@given(seeds, sizes, st.data())
def test_residuals(seed: int, m: int, data: st.DataObject) -> None:
    rng = np.random.default_rng(seed)
    flags = data.draw(
        st.booleans() | st.tuples(*[st.booleans()] * m), label="which components are angles"
    )
    z = without_some(rng, rng.uniform(-20.0, 20.0, (m, LANES)))
    zhat = rng.uniform(-20.0, 20.0, (m, LANES))
    check_agreement(lambda z, zhat: algebra.residual(z, zhat, flags), [z, zhat])


@given(seeds, sizes, conditions, scales)
def test_factors(seed: int, n: int, condition: float, scale: float) -> None:
    rng = np.random.default_rng(seed)
    P = stacked(lambda: covariance(rng, n, condition, scale))
    # An entry of a factor is as sensitive as the condition of its matrix says.
    check_agreement(algebra.factor, [P], max(TOLERANCE, 1e-15 * condition))


@given(seeds, sizes, sizes, conditions, scales)
def test_gains_and_distances(seed: int, n: int, m: int, condition: float, scale: float) -> None:
    rng = np.random.default_rng(seed)
    S = stacked(lambda: covariance(rng, m, condition, scale))
    cross = stacked(lambda: rng.standard_normal((n, m)))
    v = stacked(lambda: rng.standard_normal(m))
    tolerance = max(TOLERANCE, 1e-14 * condition)  # the forward error of any solver
    check_agreement(algebra.gain, [cross, S], tolerance)
    check_agreement(algebra.mahalanobis, [v, S], tolerance)


def measured(
    rng: np.random.Generator, n: int, m: int, condition: float
) -> tuple[Array, Array, Array, Array, Array]:
    """Mean, P, v, S and cross of a state seen through a random linear sensor."""
    mean = stacked(lambda: rng.standard_normal(n))
    P = stacked(lambda: covariance(rng, n, condition))
    H = stacked(lambda: rng.standard_normal((m, n)))
    R = stacked(lambda: covariance(rng, m, 10.0))
    HP = algebra.product(H, P)
    S = algebra.symmetric_product(HP, H) + R
    v = without_some(rng, stacked(lambda: rng.standard_normal(m)))
    return mean, P, v, S, algebra.transpose(HP)


@given(seeds, sizes, sizes, conditions)
def test_conditioning_with_missing_components(seed: int, n: int, m: int, condition: float) -> None:
    mean, P, v, S, cross = measured(np.random.default_rng(seed), n, m, condition)
    check_agreement(algebra.condition, [mean, P, v, S, cross])
    check_agreement(algebra.without_missing, [S, cross, v])


# ---------------------------------------------------------------------------------- filters
MOTION = constant_velocity(0.5)
BEARINGS = stack([azimuth(0.02).at(sx=-30.0, sy=0.0), azimuth(0.03).at(sx=30.0, sy=5.0)])
FILTERS = [
    (KalmanFilter(), position(2.0)),
    (ExtendedKalmanFilter(), BEARINGS),
    (JosephFilter(), BEARINGS),
    (ExtendedKalmanFilter(), stack([position(2.0), azimuth(0.02).at(sx=0.0, sy=-40.0)])),
]


def beliefs(rng: np.random.Generator, condition: float) -> tuple[Array, Array]:
    mean = stacked(lambda: np.array([0.0, 50.0, 1.0, -1.0]) + rng.standard_normal(4))
    return mean, stacked(lambda: covariance(rng, 4, condition, 10.0))


@pytest.mark.parametrize(("rule", "sensor"), FILTERS)
@given(seeds, conditions, st.floats(0.0, 2.0))
def test_a_step_of_a_filter(rule: Any, sensor: Any, seed: int, condition: float, dt: float) -> None:
    rng = np.random.default_rng(seed)
    mean, cov = beliefs(rng, condition)
    z = sensor.h(mean) + 0.01 * rng.standard_normal((sensor.space.size, LANES))

    def step(mean: Any, cov: Any, z: Any) -> Any:
        predicted = rule.predict(Gaussian.trusted(mean, cov), MOTION, dt)
        filtered, innovation = rule.update(predicted, sensor, z)
        return predicted, filtered, innovation.S, innovation.nis, innovation.loglik

    check_agreement(step, [mean, cov, without_some(rng, z)])


@given(seeds, st.floats(0.0, 4.0).map(lambda power: 10.0**power), st.floats(0.1, 2.0))
def test_a_step_of_the_smoother(seed: int, condition: float, dt: float) -> None:
    rng = np.random.default_rng(seed)
    mean, cov = beliefs(rng, condition)
    later, smaller = beliefs(rng, 10.0)
    rule, smoother = KalmanFilter(), RauchTungStriebel()

    def step(mean: Any, cov: Any, later: Any, smaller: Any) -> Any:
        filtered = Gaussian.trusted(mean, cov)
        predicted = rule.predict(filtered, MOTION, dt)
        return smoother.step(filtered, predicted, Gaussian.trusted(later, smaller), MOTION, dt)

    check_agreement(step, [mean, cov, later, 0.01 * smaller], 1e-9)
