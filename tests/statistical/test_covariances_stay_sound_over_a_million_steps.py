"""Rounding errors must not add up: after 10^6 steps P is positive definite and exactly symmetric."""

import numpy as np
import pytest

import tracker as tk
from tracker.types import Array
from tracker_motion import constant_velocity
from tracker_sensors import azimuth, stack

PERIOD = 60.0
SIGMA = 0.01
STATIONS = ((0.0, 0.0), (3.0, 0.0))


@pytest.fixture(autouse=True)
def on_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled steps are held to the same in their own tests."""
    monkeypatch.setenv("TRACKER_COMPILE", "off")


def estimator(name: str) -> tk.Estimator:
    sensor = stack([azimuth(SIGMA).at(sx=x, sy=y) for x, y in STATIONS])
    return tk.estimator(name, motion=constant_velocity(0.1), sensor=sensor)


def steps_of(count: int) -> Array:
    """Seconds between measurements: irregular, and now and then two at the same instant."""
    dt = np.random.default_rng(1).choice(np.linspace(0.05, 0.15, 20), count)
    dt[::97] = 0.0
    return dt


def measured(dt: Array, lanes: tuple[int, ...], seed: int) -> tuple[Array, tk.Gaussian]:
    """Bearings of a target on a circle that twice a turn crosses the line through both stations.

    There they say nothing about its range, so that P grows long and thin and shrinks again.
    """
    rng = np.random.default_rng(seed)
    turn = 2.0 * np.pi * np.cumsum(dt) / PERIOD
    x, y = 5.0 * np.cos(turn), 5.0 * np.sin(turn)
    z = np.stack([np.arctan2(y - sy, x - sx) for sx, sy in STATIONS], axis=1)
    z = z.reshape(*z.shape, *(1,) * len(lanes)) + SIGMA * rng.standard_normal((*z.shape, *lanes))
    z[rng.random(z.shape) < 0.05] = np.nan
    speed = 2.0 * np.pi * 5.0 / PERIOD
    mean = np.array([5.0, 0.0, 0.0, speed]).reshape(-1, *(1,) * len(lanes))
    cov = np.diag([0.1, 0.1, 0.1, 0.1]).reshape(4, 4, *(1,) * len(lanes))
    return z, tk.Gaussian(np.broadcast_to(mean, (4, *lanes)), np.broadcast_to(cov, (4, 4, *lanes)))


def smallest_eigenvalue(cov: Array) -> float:
    return float(np.linalg.eigvalsh(np.moveaxis(cov, (0, 1), (-2, -1))).min())


def assert_sound_throughout(name: str, steps: int, lanes: tuple[int, ...], every: int) -> None:
    built, dt = estimator(name), steps_of(steps)
    z, state = measured(dt, lanes, seed=3)
    for k, seconds in enumerate(dt.tolist()):
        state, innovation = built.step(state, z[k], seconds)
        if k % every == 0 or k == steps - 1:
            asymmetry = np.abs(state.cov - np.swapaxes(state.cov, 0, 1)).max()
            assert asymmetry == 0.0, f"after {k} steps P differs from P' by {asymmetry:.1e}"
            least = smallest_eigenvalue(state.cov)
            assert least > 0.0, f"after {k} steps P has the eigenvalue {least:.1e}"
            assert np.all(innovation.ok), f"after {k} steps a lane is no longer finite"


@pytest.mark.slow
def test_one_run_of_a_million_steps() -> None:
    assert_sound_throughout("ekf1", 1_000_000, (), every=500)


@pytest.mark.parametrize("name", ["ekf1", "ekf1_joseph"])
def test_lanes_of_twenty_thousand_steps(name: str) -> None:
    assert_sound_throughout(name, 20_000, (8,), every=10)
