"""Verbs of the algebra against NumPy and SciPy; what they promise of symmetry, zeros and NaN."""

import math
from fractions import Fraction

import numpy as np
import pytest
import scipy.linalg
from hypothesis import example, given
from hypothesis import strategies as st

import tracker as tk
from tracker import algebra
from tracker.algebra.lanes import NEARLY_PI, wrap_in_place
from tracker.models import wrap
from tracker.types import Array

seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 6)
lanes = st.sampled_from([(), (1,), (4,), (2, 3)])
conditions = st.floats(0.0, 8.0).map(lambda power: 10.0**power)


def covariances(
    rng: np.random.Generator, n: int, batch: tuple[int, ...], condition: float
) -> Array:
    """Covariances ``(n, n, *batch)``, exactly symmetric, of the given condition."""
    out = np.empty((n, n, *batch))
    for lane in np.ndindex(*batch):
        basis, _ = np.linalg.qr(rng.standard_normal((n, n)))
        root = basis * np.sqrt(np.geomspace(1.0, 1.0 / condition, n))
        P = root @ root.T
        out[(..., *lane)] = np.tril(P) + np.tril(P, -1).T
    return out


def each(*arrays: Array, axes: tuple[int, ...]) -> list[tuple[Array, ...]]:
    """Lane by lane, for arrays with so many leading component axes."""
    batch = arrays[0].shape[axes[0] :]
    return [tuple(a[(..., *lane)] for a in arrays) for lane in np.ndindex(*batch)]


@given(seeds, sizes, lanes, conditions)
def test_a_factor_is_that_of_lapack(
    seed: int, n: int, batch: tuple[int, ...], condition: float
) -> None:
    P = covariances(np.random.default_rng(seed), n, batch, condition)
    L = algebra.factor(P)
    for own, ours in each(P, L, axes=(2,)):
        assert np.array_equal(ours, np.tril(ours))
        assert np.abs(ours @ ours.T - own).max() <= 1e-14 * n
        theirs = scipy.linalg.cholesky(own, lower=True)
        assert np.abs(ours - theirs).max() <= max(1e-12, 1e-15 * condition)


@given(seeds, st.integers(2, 6), lanes, st.integers(0, 5))
def test_a_singular_covariance_has_a_factor(
    seed: int, n: int, batch: tuple[int, ...], zero: int
) -> None:
    rng = np.random.default_rng(seed)
    P = covariances(rng, n, batch, 10.0)
    P[zero % n] = P[:, zero % n] = 0.0  # a component that is known exactly
    L = algebra.factor(P)
    for own, ours in each(P, L, axes=(2,)):
        assert np.abs(ours @ ours.T - own).max() <= 1e-13
    assert not algebra.factor(np.zeros((n, n, *batch))).any()


@given(seeds, sizes, sizes, lanes, conditions)
def test_a_gain_solves_its_equation(
    seed: int, n: int, m: int, batch: tuple[int, ...], condition: float
) -> None:
    rng = np.random.default_rng(seed)
    S = covariances(rng, m, batch, condition)
    cross, v = rng.standard_normal((n, m, *batch)), rng.standard_normal((m, *batch))
    K, distance = algebra.gain(cross, S), np.asarray(algebra.mahalanobis(v, S))
    for k, c, s in each(K, cross, S, axes=(2,)):
        theirs = scipy.linalg.solve(s, c.T, assume_a="pos").T
        assert np.abs(k - theirs).max() <= 1e-13 * condition * max(1.0, np.abs(theirs).max())
    for lane in np.ndindex(*batch):
        here, s = v[(..., *lane)], S[(..., *lane)]
        theirs = here @ scipy.linalg.solve(s, here, assume_a="pos")
        assert abs(distance[lane] - theirs) <= 1e-13 * condition * max(1.0, theirs)


@given(seeds, st.integers(2, 5), st.sampled_from([(), (4,)]))
def test_a_direction_without_variance_carries_no_information(
    seed: int, m: int, batch: tuple[int, ...]
) -> None:
    rng = np.random.default_rng(seed)
    S = covariances(rng, m, batch, 10.0)
    S[-1] = S[:, -1] = 0.0
    cross, v = rng.standard_normal((3, m, *batch)), rng.standard_normal((m, *batch))
    K = algebra.gain(cross, S)
    assert not K[:, -1].any()
    assert np.allclose(K[:, :-1], algebra.gain(cross[:, :-1], S[:-1, :-1]), atol=1e-12)
    assert np.allclose(
        algebra.mahalanobis(v, S), algebra.mahalanobis(v[:-1], S[:-1, :-1]), atol=1e-10
    )


@given(seeds, sizes, sizes, lanes, conditions)
def test_conditioning_is_the_textbook_update_of_what_was_measured(
    seed: int, n: int, m: int, batch: tuple[int, ...], condition: float
) -> None:
    rng = np.random.default_rng(seed)
    P, R = covariances(rng, n, batch, condition), covariances(rng, m, batch, 10.0)
    H, mean = rng.standard_normal((m, n, *batch)), rng.standard_normal((n, *batch))
    v = rng.standard_normal((m, *batch))
    v[rng.random(v.shape) < 0.3] = np.nan
    HP = algebra.product(H, P)
    S = algebra.symmetric_product(HP, H) + R
    x, cov, nis, loglik, count = algebra.condition(mean, P, v, S, algebra.transpose(HP))
    assert np.array_equal(cov, algebra.transpose(cov)), "P must be exactly symmetric"
    for lane in np.ndindex(*batch):
        at = (..., *lane)
        seen = np.flatnonzero(~np.isnan(v[at]))
        innovation, s, c = v[at][seen], S[at][np.ix_(seen, seen)], HP[at][seen].T
        K = np.linalg.solve(s, c.T).T if len(seen) else np.zeros((n, 0))
        assert np.allclose(x[at], mean[at] + K @ innovation, rtol=0, atol=1e-9)
        assert np.allclose(cov[at], P[at] - K @ c.T, rtol=0, atol=1e-9)
        assert np.linalg.eigvalsh(cov[at]).min() >= -1e-12
        square = innovation @ np.linalg.solve(s, innovation) if len(seen) else 0.0
        assert np.isclose(np.asarray(nis)[lane], square, rtol=1e-9, atol=1e-12)
        log = -0.5 * (square + np.linalg.slogdet(2 * np.pi * s)[1]) if len(seen) else 0.0
        assert np.isclose(np.asarray(loglik)[lane], log, rtol=1e-9, atol=1e-9)
        assert np.asarray(count)[lane] == len(seen)


@given(seeds, sizes, sizes, lanes, conditions)
def test_products_that_are_symmetric_are_so_exactly(
    seed: int, n: int, k: int, batch: tuple[int, ...], condition: float
) -> None:
    rng = np.random.default_rng(seed)
    P, F = covariances(rng, n, batch, condition), rng.standard_normal((k, n, *batch))
    shared = rng.standard_normal((k, n, *(1,) * len(batch)))
    for name, value in (
        ("F P F'", algebra.congruence(F, P)),
        ("F P F' with one F for all lanes", algebra.congruence(shared, P)),
        ("(H P) H'", algebra.symmetric_product(algebra.product(F, P), F)),
    ):
        assert np.array_equal(value, algebra.transpose(value)), f"{name} is not symmetric"


def test_a_covariance_that_is_not_positive_makes_its_lane_nan_and_no_other() -> None:
    mean, cov = np.ones((2, 3)), np.repeat(np.eye(2)[..., None], 3, axis=2)
    cross, v, S = np.ones((2, 1, 3)), np.ones((1, 3)), np.array([[[2.0, -1.0, 2.0]]])
    with np.errstate(all="ignore"):
        found, _, nis, _, _ = algebra.condition(mean, cov, v, S, cross)
    assert np.isnan(nis).tolist() == [False, True, False]
    assert np.isnan(found).any(axis=0).tolist() == [False, True, False]
    alone = algebra.condition(mean[:, 1], cov[..., 1], v[:, 1], S[..., 1], cross[..., 1])
    assert np.isnan(alone[0]).all()
    assert np.isnan(alone[2])


# ------------------------------------------------------------------------------------- bits
def test_bits_do_not_depend_on_how_many_lanes_are_filtered_on_arrays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("TRACKER_COMPILE", "off")
    scenario = tk.scenario("two_stations", steps=30, detection_probability=0.8)
    estimator = tk.estimator("ekf1", motion=scenario.motion, sensor=scenario.sensor, smoother="rts")
    simulation = scenario.simulate(3, 1000)
    whole = tk.smooth(estimator, simulation.record, simulation.prior, start=0.0)
    for count in (1, 2, 7, 8, 9, 31, 500):
        for first in (0, 300):
            some = slice(first, first + count)
            record = tk.Record(simulation.record.t, simulation.record.z[..., some])
            part = tk.smooth(estimator, record, simulation.prior[some], start=0.0)
            for name in ("predicted", "filtered", "smoothed"):
                ours, theirs = getattr(part, name), getattr(whole, name)
                told = f"{name} moments of lanes {first} to {first + count} depend on the batch"
                assert np.array_equal(ours.mean, theirs.mean[..., some]), told
                assert np.array_equal(ours.cov, theirs.cov[..., some]), told
            for name in ("nis", "loglik", "count"):
                ours, theirs = getattr(part.innovation, name), getattr(whole.innovation, name)
                assert np.array_equal(ours, theirs[..., some]), f"{name} depends on the batch"


# ------------------------------------------------------------------------------------- wrap
angles = st.floats(-1e6, 1e6)
PI = math.pi


def directed(angle: float) -> float:
    """The same direction in (-pi, pi] by exact arithmetic with the turn 2 * math.pi."""
    turn, exact = Fraction(2.0 * PI), Fraction(angle)
    least = exact - turn * math.floor(exact / turn)
    return float(least if least <= turn / 2 else least - turn)


@given(angles)
@example(PI)
@example(-PI)
@example(math.nextafter(PI, 4.0))
@example(math.nextafter(-PI, -4.0))
@example(math.nextafter(-PI, 0.0))
@example(0.0)
def test_wrap_keeps_the_direction_and_stays_in_its_interval(angle: float) -> None:
    found = wrap(angle)
    assert -PI < found <= PI
    gap = abs(found - directed(angle))
    assert min(gap, 2 * PI - gap) <= 4e-16 * max(1.0, abs(angle))
    if abs(angle) < NEARLY_PI or angle == PI:
        assert found == angle


@pytest.mark.parametrize("k", [*range(-40, 41), 1001, -1001, 12345, -99999, 10**6 + 1])
def test_wrap_of_whole_multiples_of_pi(k: int) -> None:
    found = wrap(k * PI)
    assert -PI < found <= PI
    expected = 0.0 if k % 2 == 0 else PI
    gap = abs(abs(found) - expected)
    assert gap <= 1e-15 * max(1, abs(k))
    if abs(k) <= 1:
        assert found == k * PI or (k, found) == (-1, PI)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_wrap_of_what_is_no_angle_is_nan(value: float) -> None:
    with np.errstate(all="ignore"):
        assert math.isnan(wrap(value))
        assert np.isnan(wrap(np.array([value]))).all()


EDGES = [PI, -PI, 3 * PI, -5 * PI, math.nextafter(-PI, 0.0), math.nextafter(PI, 4.0), math.nan]


@given(st.lists(angles | st.sampled_from(EDGES), min_size=1))
@example(EDGES)
def test_wrap_has_the_same_bits_on_floats_on_arrays_and_in_residuals(values: list[float]) -> None:
    single = np.array([wrap(v) for v in values])
    array = np.array(values)
    assert np.array_equal(wrap(array), single, equal_nan=True)
    in_place = array.copy()
    with np.errstate(invalid="ignore"):
        wrap_in_place(in_place)
    assert np.array_equal(in_place, single, equal_nan=True)
    zeros = np.zeros_like(array)
    assert np.array_equal(algebra.residual(array, zeros, True), single, equal_nan=True)
    pair = algebra.residual(np.stack([array, array]), np.zeros((2, 1)), (True, False))
    assert np.array_equal(pair[0], single, equal_nan=True)
    assert np.array_equal(pair[1], array, equal_nan=True)
