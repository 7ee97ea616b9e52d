"""Sensors that fall silent are told of; detections at random, slow sensors and lanes of their own are not."""

from __future__ import annotations

import numpy as np
import pytest

import tracker as tk
from tracker.metrics.silence import Silences
from tracker.types import Gaussian, Record
from tracker_motion.constant_velocity import constant_velocity
from tracker_sensors.position import position
from tracker_sensors.range_azimuth import range_azimuth

PRIOR = Gaussian([0.0, 500.0, 1.0, 0.0], np.diag([9.0, 9.0, 1.0, 1.0]))


def told(z, sensors=None, sensor=None, t=None):
    """What is said of silence when these measurements of a target at rest are filtered."""
    est = tk.estimator("ekf1", motion=constant_velocity(0.1), sensor=sensors or position(3.0))
    t = np.arange(float(len(z))) if t is None else t
    history = tk.filter(est, Record(t, z, sensor=sensor), PRIOR)
    return [words for words in history.warnings() if "measured" in words]


def fixes(steps=120, lanes=()):
    rng = np.random.default_rng(5)
    place = np.array([0.0, 500.0]).reshape(2, *(1,) * len(lanes))
    return place + 3.0 * rng.standard_normal((steps, 2, *lanes))


def test_a_sensor_that_dies_is_told_of_with_its_last_time():
    z = fixes()
    z[80:] = np.nan
    (words,) = told(z, t=np.arange(120.0) / 2.0)
    assert words.startswith(
        "all components: last measured at t=39.5, 40 of 120 steps before the end;"
    )
    assert words.endswith("rest on the motion model and on what else is measured.")
    z[:80] = fixes()[:80]
    z[80:, 1] = fixes()[80:, 1]
    (words,) = told(z)
    assert words.startswith("component 'x': last measured at t=79, 40 of 120 steps")
    summary = tk.filter(
        tk.estimator("kf", motion=constant_velocity(0.1), sensor=position(3.0)),
        Record(np.arange(120.0), z), PRIOR,
    ).summary()  # fmt: skip
    assert f"Warning: {words}" in summary


def test_a_long_gap_is_told_of_and_so_is_what_was_never_measured():
    z = fixes()
    z[30:45], z[70:85] = np.nan, np.nan
    assert told(z) == [
        "all components: not measured for 15 steps in a row (t=30 to 44), and so once more."
    ]
    z = fixes()
    z[:, 1] = np.nan
    assert told(z) == ["component 'y': never measured."]


def test_lanes_are_counted():
    z = fixes(lanes=(2, 3))
    z[60:, :, 1, 2] = np.nan
    z[90:, :, 0, 0] = np.nan
    (words,) = told(z)
    assert words.startswith(
        "all components: last measured at t=59, 60 of 120 steps before the end in 2 of 6"
    )


@pytest.mark.statistical
@pytest.mark.parametrize("rate", [0.9, 0.5, 0.2, 0.05])
def test_detections_at_random_are_no_silence(rate):
    """200 records of four columns and 200 steps: by the rule one in 500 is called silent at most, and
    seven or more of 200 have a probability below 1e-6.
    """
    rng = np.random.default_rng(8)
    found = [Silences.of(rng.random((200, 4)) < rate) for _ in range(200)]
    assert sum(bool(s.ends.any() or s.gaps.any()) for s in found) < 7


def test_detections_at_random_of_a_run_are_no_silence():
    z = fixes(200, (50,))
    z[np.random.default_rng(2).random(z.shape) > 0.9] = np.nan
    assert told(z) == []


def test_a_slow_sensor_between_fast_ones_is_not_silent():
    which = np.tile([0] * 12 + [1], 12)[:-8]
    z = fixes(len(which))
    slow = which == 1
    z[slow] = [500.0, np.pi / 2]
    sensors = [position(3.0), range_azimuth(3.0, 0.02).at(sx=0.0, sy=0.0)]
    assert told(z, sensors, which) == []
    # The fast one fails, and the log goes on without it.
    kept = (np.arange(len(which)) < 100) | slow
    times = np.arange(float(len(which)))[kept]
    assert told(z[kept], sensors, which[kept], times) == []  # a few steps of the other: not yet
    longer = np.concatenate([which[:100], np.ones(30, dtype=int)])
    z = fixes(len(longer))
    z[longer == 1] = [500.0, np.pi / 2]
    words = " ".join(told(z, sensors, longer))
    assert (
        "component 'x' of sensor 0 and component 'y' of sensor 0: last measured at t=99, 30 of 130"
        in words
    )


def test_few_steps_are_no_silence():
    z = fixes(12)
    z[3:] = np.nan
    assert told(z) == []
    assert told(fixes(0)) == []
