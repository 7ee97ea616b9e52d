"""Sensors that fail: no NaN in a track, no covariance that is not one, whatever adapts to it."""

from __future__ import annotations

import numpy as np
import pytest

import tracker as tk
from tracker.types import Gaussian, Record
from tracker_adaptive import InnovationAdaptive, SageHusa, StrongTracking
from tracker_motion.constant_velocity import constant_velocity
from tracker_sensors.azimuth import azimuth
from tracker_sensors.position import position
from tracker_sensors.stack import stack

STEPS, LANES = 200, 8
WAYS = {
    "fuzzy_measurement_noise": {"adapter": "fuzzy_measurement_noise"},
    "fuzzy_process_noise": {"adapter": "fuzzy_process_noise"},
    "neural_measurement_noise": {"adapter": "neural_measurement_noise"},
    "joint_noise": {"adapter": "joint_noise"},
    "innovation_matching": {"adapter": "innovation_matching"},
    "innovation_adaptive": {"adapter": "innovation_adaptive"},
    "innovation_adaptive both": {"adapter": InnovationAdaptive(tunes=("R", "Q"))},
    "sage_husa": {"adapter": "sage_husa"},
    "sage_husa both": {"adapter": SageHusa(tunes=("R", "Q"))},
    "variational_bayes": {"filter": "variational_bayes"},
    "strong_tracking": {"filter": "strong_tracking"},
    "STF-UKF": {"filter": StrongTracking(inner="ukf")},
    "smooth_variable_structure": {"filter": "smooth_variable_structure"},
}
PLAIN = [name for name, parts in WAYS.items() if name == parts.get("adapter")]
FAULTS = {
    "none": "",
    "dies": "all components: last measured at t=74.5538, 100 of 200 steps before the end",
    "one component dies": "component '{}': last measured at t=74.5538, 100 of 200 steps before the end",
    "sticks": "innovations are not white",
    "noise doubles": "overconfident",
    "bursts of NaN": "all components: not measured for 15 steps in a row (t=15.4714 to 25.3262)",
    "an outlier in a hundred": "overconfident",
}
"""What a person is told of each, where nothing adapts."""


def faulty(fault, z, spread, rng):
    """Measurements with a fault; spread is the noise's standard deviation."""
    z = z.copy()
    if fault == "dies":
        z[100:] = np.nan
    elif fault == "one component dies":
        z[100:, 0] = np.nan
    elif fault == "sticks":
        z[100:, 0] = z[99, 0]
    elif fault == "noise doubles":
        z[100:] += np.sqrt(3.0) * spread * rng.standard_normal(z[100:].shape)
    elif fault == "bursts of NaN":
        for start in range(20, STEPS, 45):
            z[start : start + 15] = np.nan
    elif fault == "an outlier in a hundred":
        hit = rng.random(z.shape) < 0.01
        z = np.where(hit, z + 100.0 * spread * rng.standard_normal(z.shape), z)
    return z


def problem(kind, fault, wrong=1.0):
    """A linear and a bearings problem, with uneven and some zero time steps."""
    rng = np.random.default_rng(7)
    dt = rng.uniform(0.5, 1.5, STEPS) * rng.choice([0.0, 1.0, 1.0, 1.0], STEPS)
    t = np.cumsum(dt)
    path = np.stack([2.0 * t, 300.0 + 1.0 * t])
    prior = Gaussian(np.array([0.0, 300.0, 2.0, 1.0]), np.diag([100.0, 100.0, 1.0, 1.0]))
    if kind == "linear":
        spread, z = 3.0, path
        sensor = position(spread * np.sqrt(wrong))
    else:
        spread = 0.01
        places = ((-200.0, 0.0), (600.0, 50.0))
        z = np.stack([np.arctan2(path[1] - y, path[0] - x) for x, y in places])
        sigma = spread * np.sqrt(wrong)
        sensor = stack([azimuth(sigma).at(sx=x, sy=y) for x, y in places])
    z = z.T[..., None] + spread * rng.standard_normal((STEPS, 2, LANES))
    return (
        constant_velocity(density=1e-3),
        sensor,
        Record(t, faulty(fault, z, spread, rng)),
        prior,
        path,
    )


def sound(history):
    """No NaN, every covariance symmetric and positive semi-definite."""
    assert history.innovation.ok.all()
    for trajectory in (history.predicted, history.filtered):
        assert np.isfinite(trajectory.mean).all()
        assert np.isfinite(trajectory.cov).all()
        P = np.moveaxis(trajectory.cov, (1, 2), (-2, -1))
        np.testing.assert_array_equal(P, P.swapaxes(-1, -2))
        scale = np.sqrt(np.einsum("...ii->...i", P))
        relative = P / (scale[..., :, None] * scale[..., None, :])
        assert np.linalg.eigvalsh(relative).min() > -1e-9
    S = np.moveaxis(history.innovation.S, (1, 2), (-2, -1))
    assert np.linalg.eigvalsh(S).min() > 0.0


@pytest.mark.parametrize("kind", ["linear", "bearings"])
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("way", WAYS)
def test_a_failing_sensor_leaves_a_sound_track(way, fault, kind):
    motion, sensor, record, prior, path = problem(kind, fault)
    parts = dict(WAYS[way])
    est = tk.estimator(parts.pop("filter", "ekf1"), motion=motion, sensor=sensor, **parts)
    history = tk.filter(est, record, prior)
    sound(history)
    if fault in {"none", "noise doubles", "bursts of NaN"}:
        # Still on the target: the plain filter's errors are some metres.
        gap = history.filtered.mean[60:, :2] - path.T[60:, :, None]
        assert np.sqrt((gap**2).sum(axis=1).mean()) < 60.0, "the track is lost"


@pytest.mark.parametrize("kind", ["linear", "bearings"])
@pytest.mark.parametrize("factor", [1e-4, 1e-2, 1e2, 1e4])
@pytest.mark.parametrize("way", WAYS)
def test_a_wrong_noise_leaves_a_sound_track(way, factor, kind):
    motion, sensor, record, prior, _ = problem(kind, "bursts of NaN", wrong=factor)
    parts = dict(WAYS[way])
    est = tk.estimator(parts.pop("filter", "ekf1"), motion=motion, sensor=sensor, **parts)
    sound(tk.filter(est, record, prior))


@pytest.mark.parametrize("fault", ["bursts of NaN", "an outlier in a hundred"])
@pytest.mark.parametrize("rule", ["ukf", "ckf"])
@pytest.mark.parametrize("adapter", PLAIN)
def test_a_failing_sensor_leaves_a_sound_track_of_sigma_points(adapter, rule, fault):
    motion, sensor, record, prior, _ = problem("bearings", fault, wrong=1e-2)
    est = tk.estimator(rule, motion=motion, sensor=sensor, adapter=adapter)
    sound(tk.filter(est, record, prior))


def test_every_adapter_meets_every_fault():
    assert sorted(PLAIN) == sorted(tk.adapters.names())


@pytest.mark.parametrize("kind", ["linear", "bearings"])
@pytest.mark.parametrize("fault", FAULTS)
def test_a_person_is_told_of_every_fault(fault, kind):
    motion, sensor, record, prior, _ = problem(kind, fault)
    est = tk.estimator("ekf1", motion=motion, sensor=sensor)
    told = tk.filter(est, record, prior).warnings()
    if fault == "none":
        assert told == []
    else:
        assert FAULTS[fault].format(sensor.space.names[0]) in " ".join(told)


@pytest.mark.parametrize("way", [*PLAIN, "variational_bayes"])
def test_a_person_is_told_of_a_silence_whatever_adapts(way):
    """An adapter may explain noise away, but not that there is nothing."""
    motion, sensor, record, prior, _ = problem("bearings", "one component dies")
    parts = dict(WAYS[way])
    est = tk.estimator(parts.pop("filter", "ekf1"), motion=motion, sensor=sensor, **parts)
    told = tk.filter(est, record, prior).warnings()
    assert FAULTS["one component dies"].format("azimuth_1") in " ".join(told)


@pytest.mark.parametrize("kind", ["linear", "bearings"])
@pytest.mark.parametrize("factor", [1e-4, 1e-2, 1e2, 1e4])
def test_a_person_is_told_of_a_wrong_noise(factor, kind):
    motion, sensor, record, prior, _ = problem(kind, "none", wrong=factor)
    est = tk.estimator("ekf1", motion=motion, sensor=sensor)
    told = tk.filter(est, record, prior).warnings()
    assert told[0].startswith("overconfident" if factor < 1.0 else "underconfident")


def test_a_person_is_told_of_a_noise_that_nobody_adapts():
    motion, sensor, record, prior, _ = problem("linear", "none", wrong=1e-4)
    est = tk.estimator("ekf1", motion=motion, sensor=sensor)
    told = " ".join(tk.filter(est, record, prior).warnings())
    assert "innovation" in told.lower() or "nis" in told.lower()
    better = tk.estimator("variational_bayes", motion=motion, sensor=sensor)
    nis = [tk.filter(e, record, prior).innovation.nis[100:].mean() for e in (est, better)]
    assert nis[0] > 100.0  # confident and wrong
    assert nis[1] < 4.0


def test_a_sensor_that_doubles_its_noise_is_trusted_less():
    for adapter in (
        "fuzzy_measurement_noise",
        "innovation_adaptive",
        "innovation_matching",
        "sage_husa",
    ):
        motion, sensor, record, prior, _ = problem("linear", "noise doubles")
        est = tk.estimator("ekf1", motion=motion, sensor=sensor, adapter=adapter)
        S = tk.filter(est, record, prior).innovation.S
        before, after = S[60:100, 0, 0].mean(), S[160:, 0, 0].mean()
        assert after > 1.8 * before, adapter
