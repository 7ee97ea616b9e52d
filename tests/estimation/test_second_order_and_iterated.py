"""The second-order and the iterated extended filter: what they promise, and what the printed form loses."""

import itertools
from typing import Any

import attrs
import numpy as np
import pytest
import scipy.optimize
import scipy.special

import tracker as tk
from tracker.errors import CapabilityError, DomainError
from tracker.models import ComponentMotion, ComponentSensor, diagonal, log
from tracker.types import PLANAR, Array
from tracker_kalman import (
    ExtendedKalmanFilter,
    IteratedExtendedKalmanFilter,
    SecondOrderExtendedKalmanFilter,
)
from tracker_motion import constant_velocity, linear
from tracker_sensors import azimuth, position, range_azimuth, stack

PLANE = tk.Space.of("x [m]", "y [m]")
CURVED = ComponentMotion(
    name="curved",
    advance=lambda x, y, *, dt: (x + dt * (0.3 * x * y - y * y), y + dt * (0.2 * x * x + x)),
    noise=lambda *, dt: diagonal(0.1 * dt, 0.2 * dt),
    space=PLANE,
)
BOWL = ComponentSensor(
    name="bowl",
    measure=lambda x, y: (x * x + 0.5 * x * y - y, x - y * y),
    noise=lambda: diagonal(0.3, 0.4),
    space=tk.Space.of("a", "b"),
    state=PLANE,
)
STATE = tk.Gaussian([0.7, -0.4], [[0.5, 0.2], [0.2, 0.3]])


def exactly(function: Any, state: tk.Gaussian) -> tuple[Array, Array, Array]:
    """Mean, covariance and cross covariance under a Gaussian, by quadrature exact to degree nine."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(5)
    weights = weights / weights.sum()
    L = np.linalg.cholesky(state.cov)
    places, share = [], []
    for pick in itertools.product(range(5), repeat=2):
        places.append(state.mean + L @ nodes[list(pick)])
        share.append(np.prod(weights[list(pick)]))
    x, w = np.array(places).T, np.array(share)
    value = function(x)
    mean = value @ w
    centred, about = value - mean[:, None], x - state.mean[:, None]
    return mean, (centred * w) @ centred.T, (about * w) @ centred.T


# ------------------------------------------------------------------------------ second order
def test_a_prediction_through_a_quadratic_motion_has_the_exact_moments() -> None:
    ahead = SecondOrderExtendedKalmanFilter().predict(STATE, CURVED, 0.8)
    mean, cov, _ = exactly(lambda x: CURVED.f(x, 0.8), STATE)
    np.testing.assert_allclose(ahead.mean, mean, rtol=1e-12)
    np.testing.assert_allclose(ahead.cov, cov + CURVED.Q(STATE.mean, 0.8), rtol=1e-12)
    first = ExtendedKalmanFilter().predict(STATE, CURVED, 0.8)
    assert np.abs(first.mean - mean).max() > 0.1, "the problem is not curved enough to tell"


def test_a_quadratic_measurement_has_the_exact_moments() -> None:
    seen = SecondOrderExtendedKalmanFilter().project(STATE, BOWL)
    mean, cov, cross = exactly(BOWL.h, STATE)
    np.testing.assert_allclose(seen.z, mean, rtol=1e-12)
    np.testing.assert_allclose(seen.S, cov + BOWL.R(STATE.mean), rtol=1e-12)
    np.testing.assert_allclose(seen.cross, cross, rtol=1e-12)


def test_eq_10_as_printed_takes_the_innovation_for_smaller_than_it_is() -> None:
    complete = SecondOrderExtendedKalmanFilter().project(STATE, BOWL)
    printed = SecondOrderExtendedKalmanFilter(second_order_innovation=False).project(STATE, BOWL)
    np.testing.assert_array_equal(printed.z, complete.z)
    _, cov, _ = exactly(BOWL.h, STATE)
    missing = cov + BOWL.R(STATE.mean) - printed.S
    assert (np.linalg.eigvalsh(missing) > 0.05).all()


@pytest.mark.statistical
def test_eq_10_as_printed_makes_the_filter_overconfident() -> None:
    """NIS of 4,000 updates with bearings of a target close to a station, whose place is poorly known.

    The bound is left by chance with probability 1e-6. The complete form keeps it; the printed one
    does not.
    """
    rng, runs = np.random.default_rng(10), 4000
    sensor = stack([azimuth(0.03).at(sx=1.0, sy=1.0), azimuth(0.03).at(sx=4.0, sy=1.1)])
    prior = tk.Gaussian([1.9, 1.6, 0.3, 0.0], np.diag([0.1, 0.1, 1.0, 1.0]))
    x = prior.sample(runs, rng=rng)
    z = sensor.h(x) + 0.03 * rng.standard_normal((2, runs))
    many = tk.Gaussian(np.repeat(prior.mean[:, None], runs, axis=1), prior.cov)
    nis = {}
    for complete in (True, False):
        rule = SecondOrderExtendedKalmanFilter(second_order_innovation=complete)
        nis[complete] = float(np.mean(rule.update(many, sensor, z)[1].nis))
    bound = scipy.special.chdtri(2 * runs, 1e-6) / runs
    assert nis[True] < bound < nis[False], (nis, bound)


def test_where_both_models_are_linear_it_is_the_first_order_filter() -> None:
    motion, sensor = constant_velocity(0.1), position(2.0)
    rng = np.random.default_rng(2)
    record = tk.Record(np.arange(1.0, 9.0), rng.standard_normal((8, 2, 5)))
    prior = tk.Gaussian(np.zeros(4), np.eye(4))
    found = [
        tk.filter(tk.estimator(name, motion=motion, sensor=sensor), record, prior).filtered
        for name in ("ekf1", "ekf2")
    ]
    np.testing.assert_array_equal(found[0].mean, found[1].mean)
    np.testing.assert_array_equal(found[0].cov, found[1].cov)


@attrs.frozen(eq=False)
class Straight:
    """A linear motion by hand, without second derivatives."""

    inner: Any
    linear = True

    @property
    def space(self) -> tk.Space:
        return PLANAR

    def f(self, x: Array, dt: Any, u: Any = None, t: Any = None) -> Array:
        return self.inner.f(x, dt)

    def jacobian(self, x: Array, dt: Any, u: Any = None, t: Any = None) -> Array:
        return self.inner.jacobian(x, dt)

    def Q(self, x: Array, dt: Any) -> Array:
        return self.inner.Q(x, dt)


BEARINGS = stack([azimuth(0.02).at(sx=-1.0, sy=-2.0), azimuth(0.02).at(sx=1.0, sy=1.0)])
PRIOR = tk.Gaussian([0.0, 0.0, 1.0, 0.0], np.diag([0.1, 0.1, 1.0, 1.0]))


def a_record(steps: int = 10, batch: tuple[int, ...] = ()) -> tk.Record:
    rng = np.random.default_rng(3)
    t = 0.1 * np.arange(1, steps + 1)
    x = np.stack([0.3 * t, 0.1 * t, 0 * t + 0.3, 0 * t + 0.1])
    z = BEARINGS.h(x).T.reshape(steps, 2, *(1,) * len(batch))
    return tk.Record(t, z + 0.02 * rng.standard_normal((steps, 2, *batch)))


def test_a_linear_motion_is_not_asked_for_second_derivatives() -> None:
    motion = constant_velocity(0.1)
    found = [
        tk.filter(tk.estimator("ekf2", motion=m, sensor=BEARINGS), a_record(), PRIOR).filtered.mean
        for m in (motion, Straight(motion))
    ]
    np.testing.assert_allclose(found[0], found[1], rtol=1e-12)


def test_a_linear_motion_that_cannot_be_traced_serves_extended_filters_too() -> None:
    drag = np.kron([[0.0, 1.0], [0.0, -0.5]], np.eye(2))
    motion = linear(PLANAR, drag, Qc=np.diag([0.0, 0.0, 0.1, 0.1]))
    assert motion.why_opaque
    for name in ("ekf1", "ekf2"):
        history = tk.filter(tk.estimator(name, motion=motion, sensor=BEARINGS), a_record(), PRIOR)
        assert np.isfinite(history.filtered.mean).all()


def test_a_sensor_without_second_derivatives_is_refused_in_words() -> None:
    @attrs.frozen(eq=False)
    class First:
        inner: Any

        def __getattr__(self, name: str) -> Any:
            if name in {"hessian", "expand", "linear", "why_opaque", "over"}:
                raise AttributeError(name)
            return getattr(self.inner, name)

    with pytest.raises(CapabilityError, match="a Hessian, which sensor 'stack' does not provide"):
        tk.estimator("ekf2", motion=constant_velocity(0.1), sensor=First(BEARINGS))


# ---------------------------------------------------------------------------------- iterated
def most_probable(state: tk.Gaussian, sensor: Any, z: Array, start: Array) -> Array:
    """The maximum of the posterior density, by a general optimiser."""

    def cost(x: Array) -> float:
        d, e = x - state.mean, sensor.residual(z, sensor.h(x))
        return float(d @ np.linalg.solve(state.cov, d) + e @ np.linalg.solve(sensor.R(x), e))

    return scipy.optimize.minimize(cost, start, method="Nelder-Mead", options={
        "xatol": 1e-10, "fatol": 1e-14, "maxiter": 20_000, "maxfev": 20_000}).x  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_many_iterations_reach_the_most_probable_state(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sensor = range_azimuth(0.5, 0.02).at(sx=0.0, sy=0.0)
    # West of the sensor, so that bearings cross the cut.
    state = tk.Gaussian([-20.0, rng.uniform(-1, 1), 0.0, 0.0], np.diag([9.0, 9.0, 1.0, 1.0]))
    truth = state.sample(rng=rng)
    z = sensor.residual(sensor.h(truth) + rng.normal(size=2) * [0.5, 0.02], np.zeros(2))
    found, _ = IteratedExtendedKalmanFilter(iterations=30).update(state, sensor, z)
    best = most_probable(state, sensor, z, found.mean)
    np.testing.assert_allclose(found.mean, best, atol=1e-5)
    first, _ = ExtendedKalmanFilter().update(state, sensor, z)
    assert np.abs(first.mean - best).max() > 10 * np.abs(found.mean - best).max()


@attrs.frozen(eq=False)
class Unlabelled:
    """A sensor that does not say that it is linear."""

    inner: Any

    def __getattr__(self, name: str) -> Any:
        if name in {"linear", "linearise", "expand"}:
            raise AttributeError(name)
        return getattr(self.inner, name)


@pytest.mark.parametrize("batch", [(), (7,), (3, 5)])
@pytest.mark.parametrize("missing", [False, True])
def test_iterating_a_linear_update_changes_nothing(batch: tuple[int, ...], missing: bool) -> None:
    rng = np.random.default_rng(4)
    sensor = Unlabelled(position(0.01))  # good measurements of a poor prediction
    state = tk.Gaussian(100.0 * rng.standard_normal((4, *batch)), 1e4 * np.eye(4))
    z = rng.standard_normal((2, *batch))
    if missing:
        z[0] = np.nan
    once, told = IteratedExtendedKalmanFilter(iterations=1).update(state, sensor, z)
    often, again = IteratedExtendedKalmanFilter(iterations=6).update(state, sensor, z)
    np.testing.assert_allclose(often.mean, once.mean, rtol=0, atol=1e-9 * 100)
    np.testing.assert_allclose(often.cov, once.cov, rtol=0, atol=1e-9 * 1e4)
    np.testing.assert_array_equal(told.nis, again.nis)


def test_a_lane_that_diverges_while_iterating_is_lost_and_harms_no_other() -> None:
    state = tk.Gaussian.trusted(
        np.repeat(PRIOR.mean[:, None], 3, axis=1), np.repeat(PRIOR.cov[..., None], 3, axis=2)
    )
    cov = state.cov.copy()
    cov[0, 0, 1] = -50.0  # not a covariance: S is negative
    z = np.repeat(BEARINGS.h(PRIOR.mean)[:, None] + 0.01, 3, axis=1)
    rule = IteratedExtendedKalmanFilter()
    with np.errstate(all="ignore"):
        ill, told = rule.update(tk.Gaussian.trusted(state.mean, cov), BEARINGS, z)
        well, _ = rule.update(state, BEARINGS, z)
    assert told.ok.tolist() == [True, False, True]
    assert np.isnan(ill.mean[:, 1]).any()
    np.testing.assert_array_equal(ill.mean[:, [0, 2]], well.mean[:, [0, 2]])


@pytest.mark.parametrize("iterations", [0, -1, 2.0, True, "3"])
def test_a_number_of_iterations_that_is_none_is_refused(iterations: Any) -> None:
    with pytest.raises(DomainError, match="'iterations' of filter 'iekf'"):
        IteratedExtendedKalmanFilter(iterations=iterations)


@pytest.mark.parametrize("name", ["ekf2", "iekf"])
@pytest.mark.parametrize("batch", [(), (1,), (7,), (3, 5)])
def test_lanes_are_alike_in_any_company(name: str, batch: tuple[int, ...]) -> None:
    estimator = tk.estimator(name, motion=constant_velocity(0.1), sensor=BEARINGS, smoother="rts")
    record = a_record(12, batch)
    whole = tk.smooth(estimator, record, PRIOR)
    assert whole.innovation.ok.all()
    for lane in itertools.islice(np.ndindex(*batch), 3):
        alone = tk.smooth(estimator, tk.Record(record.t, record.z[(..., *lane)]), PRIOR)
        for part in ("filtered", "smoothed"):
            a, b = getattr(whole, part), getattr(alone, part)
            np.testing.assert_allclose(a.mean[(..., *lane)], b.mean, rtol=1e-9, atol=1e-11)
            np.testing.assert_allclose(a.cov[(..., *lane)], b.cov, rtol=1e-8, atol=1e-11)


@pytest.mark.parametrize("batch", [(), (2,)])
def test_an_iterate_where_the_sensor_has_no_answer_is_not_ok(batch: tuple[int, ...]) -> None:
    """NaN there must not pass for a measurement that is missing: the first one was used."""
    depth = ComponentSensor(
        name="depth",
        measure=lambda x, y: (log(x) + 0.0 * y,),
        noise=lambda: ((1e-4,),),
        space=tk.Space.of("z"),
        state=PLANE,
    )
    state = tk.Gaussian(np.ones((2, *batch)), np.diag([3.0, 1.0]))
    z = np.full((1, *batch), -5.0)  # the first step leads to a negative x
    for iterations, ok in ((1, True), (2, False), (3, False)):
        with np.errstate(all="ignore"):
            _, told = IteratedExtendedKalmanFilter(iterations).update(state, depth, z)
        assert np.all(told.ok) == ok, f"{iterations} iterations"
        assert np.isfinite(told.loglik).all() == ok
