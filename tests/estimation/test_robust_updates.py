"""Huber's and Student's updates: outliers pull a little or not at all, and nothing else changes."""

from typing import Any

import numpy as np
import pytest
import scipy.optimize

import tracker as tk
from tracker.errors import CapabilityError, DomainError
from tracker.testing import check_component
from tracker.types import Array
from tracker_kalman import HuberUpdate, StudentTUpdate
from tracker_motion import constant_velocity
from tracker_sensors import azimuth, position, stack

MOTION = constant_velocity(0.1)
BEARINGS = stack([azimuth(0.02).at(sx=-1.0, sy=-2.0), azimuth(0.02).at(sx=1.0, sy=1.0)])
PRIOR = tk.Gaussian([0.0, 0.0, 1.0, 0.0], np.diag([0.1, 0.1, 1.0, 1.0]))
ALMOST_INFINITE = 1e16
GENTLE = [
    HuberUpdate(threshold=ALMOST_INFINITE),
    StudentTUpdate(degrees_of_freedom=ALMOST_INFINITE),
]


def spread_state(rng: np.random.Generator, scale: float = 1.0) -> tk.Gaussian:
    A = rng.standard_normal((4, 4))
    return tk.Gaussian(rng.standard_normal(4), scale * (A @ A.T + np.eye(4)))


# ------------------------------------------------------------------- what they are the solution of
@pytest.mark.parametrize("seed", range(6))
def test_huber_minimises_his_cost(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state, sensor, threshold = spread_state(rng, 10.0), position(0.7), 1.345
    z = state.mean[:2] + rng.choice([0.3, 3.0, 60.0], 2) * rng.choice([-1.0, 1.0], 2)

    def cost(x: Array) -> float:
        d, e = x - state.mean, np.abs(z - x[:2]) / 0.7
        rho = np.where(e < threshold, 0.5 * e**2, threshold * e - 0.5 * threshold**2)
        return float(0.5 * d @ np.linalg.solve(state.cov, d) + rho.sum())

    found, told = HuberUpdate(reweightings=40).update(state, sensor, z)
    best = scipy.optimize.minimize(cost, found.mean + 0.1, method="Nelder-Mead", options={
        "xatol": 1e-9, "fatol": 1e-13, "maxiter": 20_000, "maxfev": 20_000}).x  # fmt: skip
    np.testing.assert_allclose(found.mean, best, atol=1e-5)
    usual, _ = HuberUpdate().update(state, sensor, z)
    sigma = np.sqrt(np.diag(found.cov))
    assert (np.abs(usual.mean - best) < 0.25 * sigma).all(), "five turns are not nearly enough"
    assert told.ok


@pytest.mark.parametrize("seed", range(6))
def test_student_t_is_a_fixed_point_of_its_equations(seed: int) -> None:
    """The expected square of the noise, under the updated moments, gives the weight they came from."""
    rng = np.random.default_rng(seed)
    state, nu, R = spread_state(rng), 4.0, 0.49 * np.eye(2)
    z = state.mean[:2] + rng.choice([0.3, 3.0, 60.0]) * rng.standard_normal(2)
    rule = StudentTUpdate(degrees_of_freedom=nu, reweightings=200)
    found, _ = rule.update(state, position(0.7), z)
    e = z - found.mean[:2]
    Psi = np.outer(e, e) + found.cov[:2, :2]
    weight = (nu + 2.0) / (nu + np.trace(Psi @ np.linalg.inv(R)))  # noqa: TID251 - as printed
    H = np.eye(2, 4)
    S = H @ state.cov @ H.T + R / weight
    K = np.linalg.solve(S, H @ state.cov).T
    np.testing.assert_allclose(found.mean, state.mean + K @ (z - H @ state.mean), atol=1e-9)
    np.testing.assert_allclose(found.cov, state.cov - K @ S @ K.T, atol=1e-9)


# -------------------------------------------------------------------------------- what must hold
@pytest.mark.parametrize("rule", GENTLE, ids=lambda r: type(r).__name__)
def test_without_suspicion_every_law_of_filters_holds(rule: Any) -> None:
    report = check_component(rule, "filter")
    assert report.ok, str(report)


@pytest.mark.parametrize("name", ["huber", "student_t"])
@pytest.mark.parametrize("inner", ["ekf1", "ekf2", "ukf"])
@pytest.mark.parametrize("batch", [(), (7,), (3, 5)])
def test_without_suspicion_it_is_its_inner_filter(
    name: str, inner: str, batch: tuple[int, ...]
) -> None:
    rng = np.random.default_rng(1)
    t = 0.1 * np.arange(1, 11)
    x = np.stack([0.3 * t, 0.1 * t, 0 * t + 0.3, 0 * t + 0.1])
    z = BEARINGS.h(x).T.reshape(10, 2, *(1,) * len(batch)) + 0.02 * rng.standard_normal(
        (10, 2, *batch)
    )
    z[4], z[5, 1] = np.nan, np.nan
    record = tk.Record(t, z)
    option = {"huber": "threshold", "student_t": "degrees_of_freedom"}[name]
    rule = tk.filters.make(name, inner=inner, **{option: ALMOST_INFINITE})
    found = [
        tk.filter(tk.estimator(r, motion=MOTION, sensor=BEARINGS), record, PRIOR)
        for r in (inner, rule)
    ]
    np.testing.assert_allclose(found[1].filtered.mean, found[0].filtered.mean, atol=1e-9)
    np.testing.assert_allclose(found[1].filtered.cov, found[0].filtered.cov, atol=1e-9)
    np.testing.assert_allclose(
        found[1].innovation.nis, found[0].innovation.nis, rtol=1e-8, atol=1e-9
    )
    np.testing.assert_array_equal(found[1].innovation.count, found[0].innovation.count)


@pytest.mark.parametrize("rule", [HuberUpdate(), StudentTUpdate()], ids=lambda r: type(r).__name__)
def test_an_outlier_pulls_no_more_the_farther_it_is(rule: Any) -> None:
    state, sensor = tk.Gaussian(np.zeros(4), np.eye(4)), position(0.5)
    moved = []
    for far in (1e2, 1e4, 1e6):
        after, told = rule.update(state, sensor, np.array([far, 0.2]))
        moved.append(float(after.mean[0]))
        assert told.nis > 0.5 * far**2, "the innovation tells of the outlier"
    plain, _ = tk.filters.make("ekf1").update(state, sensor, np.array([1e6, 0.2]))
    assert plain.mean[0] > 1e5
    # Huber's force is threshold / sigma, through P = 1.
    bound = 1.345 / 0.5 if isinstance(rule, HuberUpdate) else 0.1
    assert all(abs(step) <= bound * 1.001 for step in moved), moved


def test_huber_suspects_a_component_and_student_t_the_whole_measurement() -> None:
    state, sensor = tk.Gaussian(np.zeros(4), np.eye(4)), position(0.5)
    z = np.array([1e4, 0.4])
    plain, _ = tk.filters.make("ekf1").update(state, sensor, z)
    one, _ = HuberUpdate().update(state, sensor, z)
    all_of_it, _ = StudentTUpdate().update(state, sensor, z)
    assert one.mean[1] == pytest.approx(plain.mean[1], rel=1e-9)
    assert abs(all_of_it.mean[1]) < 0.01 * plain.mean[1]


def test_correlated_noise_is_whitened_before_it_is_judged() -> None:
    """Turning the axes of a measurement with independent errors turns what Huber makes of it."""
    from tracker.models import ComponentSensor

    def sensor(c: float, s: float) -> ComponentSensor:
        # Rows of R = T diag(0.01, 4) T' for a lower triangular T, whose factor is T diag(0.1, 2).
        return ComponentSensor(
            name="slanted",
            measure=lambda x, y: (c * x, s * x + y),
            noise=lambda: ((0.01 * c * c, 0.01 * c * s), (0.01 * c * s, 0.01 * s * s + 4.0)),
            space=tk.Space.of("a [m]", "b [m]"),
        )

    state, z = spread_state(np.random.default_rng(9)), np.array([5.0, -30.0])
    straight, _ = HuberUpdate().update(state, sensor(1.0, 0.0), z)
    slanted, _ = HuberUpdate().update(
        state, sensor(3.0, 7.0), np.array([3.0 * z[0], 7.0 * z[0] + z[1]])
    )
    np.testing.assert_allclose(slanted.mean, straight.mean, atol=1e-9)
    np.testing.assert_allclose(slanted.cov, straight.cov, atol=1e-9)


@pytest.mark.statistical
@pytest.mark.parametrize("name", ["huber", "student_t"])
@pytest.mark.parametrize("inner", ["ekf1", "ukf"])
def test_with_outliers_it_is_better_and_without_hardly_worse(name: str, inner: str) -> None:
    """Root mean square position error over 300 runs; a tenth of the bearings have 10 times the noise.

    The gain is more than 25 %, the loss on clean bearings at most 10 %; standard errors are below 3 %.
    """
    rng = np.random.default_rng(5)
    runs, steps, dt = 300, 60, 0.5
    sensor = stack([azimuth(0.02).at(sx=0.0, sy=0.0), azimuth(0.02).at(sx=100.0, sy=0.0)])
    prior = tk.Gaussian([40.0, 60.0, 1.0, 0.0], np.diag([4.0, 4.0, 1.0, 1.0]))
    x = tk.Gaussian(np.repeat(prior.mean[:, None], runs, axis=1), prior.cov).sample(rng=rng)
    root = np.linalg.cholesky(MOTION.Q(np.zeros(4), dt))
    truth, clean, dirty = [], [], []
    for _ in range(steps):
        x = MOTION.f(x, dt) + root @ rng.standard_normal((4, runs))
        noise = 0.02 * rng.standard_normal((2, runs))
        truth.append(x)
        clean.append(sensor.h(x) + noise)
        dirty.append(sensor.h(x) + noise * np.where(rng.uniform(size=noise.shape) < 0.1, 10.0, 1.0))
    t = dt * np.arange(1, steps + 1)

    def error(rule: Any, z: list[Array]) -> float:
        estimator = tk.estimator(rule, motion=MOTION, sensor=sensor)
        mean = tk.filter(estimator, tk.Record(t, np.stack(z)), prior, start=0.0).filtered.mean
        return float(np.sqrt(((mean - np.stack(truth))[10:, :2] ** 2).sum(axis=1).mean()))

    robust = tk.filters.make(name, inner=inner)
    assert error(robust, dirty) < 0.75 * error(inner, dirty)
    assert error(robust, clean) < 1.10 * error(inner, clean)


# ------------------------------------------------------------------------------------ refusals
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, "much"])
def test_parameters_that_mean_nothing_are_refused(value: Any) -> None:
    with pytest.raises(DomainError, match="'threshold' of filter 'huber'"):
        HuberUpdate(threshold=value)
    with pytest.raises(DomainError, match="'degrees_of_freedom' of filter 'student_t'"):
        StudentTUpdate(degrees_of_freedom=value)


def test_a_robust_filter_may_consider_biases() -> None:
    """Composed filters compose: what is inside one may be made by name there."""
    rule = tk.filters.make("huber", inner=tk.filters.make("ekf2", second_order_innovation=False))
    assert rule.needs == ("jacobian", "hessian")
    assert tk.filters.make("schmidt", considered=["vx"], inner="ukf").needs == ()


@pytest.mark.parametrize("outer", ["huber", "student_t", "schmidt"])
@pytest.mark.parametrize("inner", ["iekf", "iplf", "ekf1_joseph", "huber", "student_t"])
def test_an_update_of_its_own_is_not_dropped_without_a_word(outer, inner):
    with pytest.raises(CapabilityError, match="whose update is its own"):
        tk.filters.make(outer, inner=inner)
