"""The sensor as a user meets it: by name, and in an estimator."""

import numpy as np
import pytest

import tracker as tk


def test_its_name_is_found_in_the_registry():
    assert "relative_bearing" in tk.sensors


def test_a_target_on_the_starboard_beam_is_at_a_quarter_turn():
    sensor = tk.sensors.make("relative_bearing", sigma=0.02)
    north, east = [0.0, 0.0, 0.0], [0.0, 0.0, np.pi / 2]
    target = [100.0, 0.0, 0.0, 0.0]  # to the east
    assert sensor.h(target, pose=north) == pytest.approx([np.pi / 2])
    assert sensor.h(target, pose=east) == pytest.approx([0.0])


def test_two_targets_are_told_apart():
    motion = tk.motions.make("constant_velocity", density=1e-4)
    pipeline = tk.Pipeline(
        motion=motion,
        sensors={"mast": tk.sensors.make("relative_bearing", sigma=0.02)},
        filter=tk.filters.make("ekf1"),
        gate=tk.gates.make("chi_square"),
        associator=tk.associators.make("global_nearest_neighbour"),
    )
    state = np.array([[4000.0, -3000.0], [4000.0, 2000.0], [0.0, 0.0], [0.0, 0.0]])
    belief = tk.Gaussian(state, np.diag([200.0, 200.0, 2.0, 2.0]) ** 2)
    ship = [0.0, 0.0, 0.3]
    seen = pipeline.sensors["mast"].h(state, pose=ship)[:, ::-1]
    scan = tk.Scan(10.0, seen, pose=ship, sensor="mast")
    _, result = pipeline.step(tk.Tracks(0.0, belief, ("a", "b")), scan)
    assert result.detection.tolist() == [1, 0]


def test_a_turning_observer_tracks_a_target():
    """Truth is drawn from the prior, so an honest filter has a mean NEES of n = 4."""
    t = np.arange(10.0, 601.0, 10.0)
    heading = np.where(t < 300.0, 0.0, np.pi / 2)
    path = np.cumsum(50.0 * np.stack([np.sin(heading), np.cos(heading)]), axis=1)
    motion = tk.motions.make("constant_velocity", density=1e-4)
    sensor = tk.sensors.make("relative_bearing", sigma=0.005)
    scene = tk.Scenario(
        name="turn",
        motion=motion,
        sensor=sensor,
        prior=tk.Gaussian([4000.0, 4000.0, 3.0, -2.0], np.diag([200.0, 200.0, 2.0, 2.0]) ** 2),
        t=t,
        pose=np.stack([*path, heading], axis=1),
    )
    estimator = tk.estimator("ekf1", motion=motion, sensor=sensor)
    scores = tk.monte_carlo(estimator, scene, runs=200, seed=1).scores["estimator"]["filter"]
    assert scores.mean_nees == pytest.approx(4.0, rel=0.15)
    assert np.sqrt(scores.per_step["squared_error"][-1]) < 400.0  # 1700 m without measurements
