"""Expectation maximisation climbs the likelihood to its maximum, whatever is missing."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tracker as tk
from tracker.errors import CapabilityError, DomainError
from tracker.models import ComponentSensor, diagonal
from tracker_adaptive.fuzzy_measurement_noise import FuzzyMeasurementNoise
from tracker_motion.linear import linear
from tracker_sensors.azimuth import azimuth

F = [[0.77, 0.20, 0.00], [0.25, 0.75, 0.25], [0.05, 0.00, 0.75]]


def direct(sigma_x, sigma_v):
    """Position and velocity, as the thesis measures them."""
    return ComponentSensor(
        name="direct",
        measure=lambda x, vx: (x, vx),
        noise=lambda *, sigma_x, sigma_v: diagonal(sigma_x**2, sigma_v**2),
        space=tk.Space.of("x [m]", "vx [m/s]"),
        state=tk.Space.of("x [m]", "vx [m/s]", "ax [m/s^2]"),
        parameters={"sigma_x": float(sigma_x), "sigma_v": float(sigma_v)},
    )


def plane(seed, steps=80, runs=3, missing=0.15):
    """Position fixes of something in the plane, some components missing; a filter told otherwise."""
    scene = tk.scenario("line", axes=2, steps=steps)
    simulation = scene.simulate(seed, runs)
    z = simulation.record.z.copy()
    z[np.random.default_rng(seed).random(z.shape) < missing] = np.nan
    est = tk.estimator(
        "kf",
        motion=scene.motion.with_parameters(density=1.0),
        sensor=scene.sensor.with_parameters(sigma=7.0),
    )
    return est, tk.Record(simulation.record.t, z), simulation


@pytest.mark.parametrize("process", ["full", "diagonal", "scaled", "fixed"])
@pytest.mark.parametrize("measurement", ["full", "diagonal", "scaled", "fixed"])
@given(seed=st.integers(0, 1000), missing=st.sampled_from([0.0, 0.3]), together=st.booleans())
def test_the_likelihood_never_falls(process, measurement, seed, missing, together):
    est, record, simulation = plane(seed, steps=15, runs=2, missing=missing)
    found = tk.expectation_maximisation(
        est, record, simulation.prior, start=simulation.start, process=process,
        measurement=measurement, together=together, iterations=4, tolerance=0.0,
    )  # fmt: skip
    climbed = np.diff(found.loglik, axis=0)
    assert (climbed >= -1e-8 * np.abs(found.loglik[1:])).all(), climbed.min()


def test_scaled_noise_is_what_a_search_of_the_likelihood_finds():
    est, record, simulation = plane(3)
    given_ = {"prior": simulation.prior, "start": simulation.start}
    found = tk.expectation_maximisation(
        est,
        record,
        **given_,
        process="scaled",
        measurement="scaled",
        iterations=1000,
        tolerance=1e-9,
    )
    bounds = {"motion.density": (1e-3, 10.0, "log"), "sensor.sigma": (0.3, 30.0, "log")}
    searched = tk.tune(
        est, record, bounds, "likelihood", held_out=0, evaluations=3000, seed=1, **given_
    )
    assert found.converged
    top = searched.training["tuned"].totals["loglik"].sum()
    assert found.loglik[-1] == pytest.approx(top, abs=0.01)
    assert np.sqrt(found.R[0, 0]) == pytest.approx(searched.values["sensor.sigma"], rel=0.01)
    x = np.zeros(4)
    Q = searched.estimator.motion.Q(x, 1.0)
    np.testing.assert_allclose(found.Q, Q, rtol=0.05, atol=1e-12)


def test_it_finds_the_noise_of_the_thesis_example():
    # 20 runs of 400 steps: an empirical variance of 8,000 samples has a standard error of 1.6 %, that of
    # noise seen through a filter some times more; 25 % is missed with probability below 1e-6.
    space = tk.Space.of("x [m]", "vx [m/s]", "ax [m/s^2]")
    true_Q, R0 = np.diag([0.02, 0.05, 0.02]), np.diag([8.0, 1.0])
    sensor = direct(0.9, 3.0)
    motion = linear(space, F, Q=true_Q)
    scene = tk.Scenario(
        name="thesis", motion=motion, sensor=sensor, prior=tk.Gaussian(np.zeros(3), 0.01 * np.eye(3)),
        t=np.arange(1.0, 401.0),
    )  # fmt: skip
    simulation = scene.simulate(2, 20)
    wrong = direct(*np.sqrt(np.diag(R0)))
    est = tk.estimator("kf", motion=motion, sensor=wrong)
    found = tk.expectation_maximisation(
        est, simulation.record, simulation.prior, start=0.0, process="fixed", measurement="diagonal"
    )
    np.testing.assert_allclose(np.diag(found.R), [0.81, 9.0], rtol=0.25)
    assert found.converged
    assert "converged; log-likelihood" in str(found)


def test_the_estimator_that_comes_back_has_the_likelihood_that_was_told(monkeypatch):
    est, record, simulation = plane(5)
    found = tk.expectation_maximisation(
        est, record, simulation.prior, start=simulation.start, iterations=20, together=True
    )
    for mode in ("off", "on"):
        monkeypatch.setenv("TRACKER_COMPILE", mode)
        history = tk.filter(found.estimator, record, simulation.prior, start=simulation.start)
        assert history.innovation.loglik.sum() == pytest.approx(float(found.loglik[-1]), rel=1e-9)


def test_runs_by_themselves_are_estimated_as_if_alone():
    est, record, simulation = plane(6, runs=3)
    options = {"start": simulation.start, "iterations": 5, "tolerance": 0.0}
    each = tk.expectation_maximisation(est, record, simulation.prior, together=False, **options)
    assert each.Q.shape == (4, 4, 3)
    for run in range(3):
        alone = tk.expectation_maximisation(
            est, tk.Record(record.t, record.z[..., run]), simulation.prior[run], **options
        )
        np.testing.assert_allclose(each.Q[..., run], alone.Q, rtol=1e-9)
        np.testing.assert_allclose(each.loglik[:, run], alone.loglik, rtol=1e-9)
    history = tk.filter(each.estimator, record, simulation.prior, start=simulation.start)
    told = history.innovation.loglik.sum(axis=0)
    np.testing.assert_allclose(told, each.loglik[-1], rtol=1e-9)


def test_what_is_never_measured_changes_no_estimate():
    est, record, simulation = plane(7)
    options = {"start": simulation.start, "iterations": 5, "tolerance": 0.0}
    whole = tk.expectation_maximisation(est, record, simulation.prior, **options)
    # Rows without measurements, at the times of others, add nothing.
    t = np.repeat(record.t, 2)
    z = np.full((2 * len(t) // 2, *record.z.shape[1:]), np.nan)
    z[::2] = record.z
    again = tk.expectation_maximisation(est, tk.Record(t, z), simulation.prior, **options)
    # A step of no time must have no noise: Q belongs to steps that take time.
    np.testing.assert_allclose(again.R, whole.R, rtol=1e-9)
    np.testing.assert_allclose(again.Q, whole.Q, rtol=1e-9)


def test_a_sensor_that_is_not_linear_is_linearised_at_the_smoothed_states():
    # 10 runs of 300 steps: 3,000 squares have a standard error of 2.6 %; 20 % is missed with probability
    # below 1e-6, linearisation aside. The noise told is a tenth of the true one.
    for name in ("underwater_angles", "underwater_multipath"):
        told = tk.scenario(name, steps=300)
        right = tk.scenario(name, steps=300, told=True)
        simulation = told.simulate(2, 10)
        ekf = tk.estimator("ekf1", motion=told.motion, sensor=told.sensor)
        found = tk.expectation_maximisation(
            ekf, simulation.record, simulation.prior, start=simulation.start, process="fixed",
            measurement="diagonal",
        )  # fmt: skip
        pose = None if told.pose is None else told.pose[0]
        R = np.asarray(right.sensor.R(told.prior.mean, pose))
        np.testing.assert_allclose(np.diag(found.R), np.diag(R), rtol=0.2)
        assert found.converged
        assert found.loglik[-1] > found.loglik[0]


def test_angles_on_either_side_of_the_cut_are_one_another_s_neighbours():
    est, *_ = plane(8, steps=40)
    sensor = azimuth(0.2).at(sx=0.0, sy=0.0)
    sim = attrs.evolve(
        tk.scenario("line", axes=2, steps=40), sensor=sensor, start=np.array([-500.0, -40.0, 0.0, 2.0]),
        initial="prior around truth",
    ).simulate(3, 4)  # fmt: skip
    assert np.ptp(sim.record.z) > 5.0  # both sides occur
    ekf = tk.estimator("ekf1", motion=est.motion, sensor=sensor.with_parameters(sigma=0.05))
    found = tk.expectation_maximisation(
        ekf, sim.record, sim.prior, start=sim.start, process="fixed"
    )
    # 160 squares: a standard error of 11 %; 60 % is missed with probability below 1e-6
    assert found.R[0, 0] == pytest.approx(0.04, rel=0.6)


def test_what_it_cannot_do_is_refused():
    est, record, simulation = plane(1, steps=5)
    prior = simulation.prior
    turning = tk.scenario("turning_target")
    bent = tk.estimator("ekf1", motion=turning.motion, sensor=turning.sensor)
    turns = turning.simulate(1, 2)
    with pytest.raises(CapabilityError, match="linear"):
        tk.expectation_maximisation(bent, turns.record, turns.prior)
    adapted = attrs.evolve(est, adapter=FuzzyMeasurementNoise())
    with pytest.raises(CapabilityError, match="noise that nobody else adapts"):
        tk.expectation_maximisation(adapted, record, prior)
    uneven = tk.Record(record.t**2, record.z)
    with pytest.raises(DomainError, match="equal ones, as Q belongs to one of them"):
        tk.expectation_maximisation(est, uneven, prior)
    fixed = tk.expectation_maximisation(est, uneven, prior, process="fixed", iterations=3)
    np.testing.assert_array_equal(
        fixed.estimator.motion.Q(np.zeros(4), 2.0), est.motion.Q(np.zeros(4), 2.0)
    )
    with pytest.raises(DomainError, match="at least one iteration"):
        tk.expectation_maximisation(est, record, prior, iterations=0)
    with pytest.raises(DomainError, match="one of"):
        tk.expectation_maximisation(est, record, prior, process="any")
    still = attrs.evolve(est, motion=est.motion.with_parameters(density=0.0))
    with pytest.raises(DomainError, match="rank 0"):
        tk.expectation_maximisation(still, record, prior, process="scaled")
