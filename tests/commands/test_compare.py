"""``tracker compare``: one table for several filters, and numbers that a campaign would give."""

import json

import numpy as np
import pytest
from click.testing import CliRunner, Result

import tracker as tk
from tracker.cli import main


def tell(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["compare", *map(str, arguments)])


def test_it_prints_a_row_per_filter_and_stage_and_writes_the_same_numbers(tmp_path):
    result = tell(
        "ekf1", "ukf", "--scenario", "line", "--smoother", "rts", "--runs", 20, "--out", tmp_path
    )
    assert result.exit_code == 0, result.output
    lines = result.output.splitlines()
    assert lines[0].startswith("line: 20 runs")
    assert [line.split("  ")[0] for line in lines[2:6]] == [
        "ekf1",
        "ekf1 smoothed",
        "ukf",
        "ukf smoothed",
    ]
    written = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    scene = tk.scenario("line")
    est = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor)
    expected = tk.monte_carlo(est, scene, runs=20, seed=0).rows()[0]["rmse"]
    assert written["rows"][0]["rmse"] == pytest.approx(expected, rel=1e-12)
    assert written["rows"][0]["cost_us"] > 0


def test_without_names_it_tries_all_and_says_who_was_left_out():
    result = tell("--scenario", "growth", "--runs", 2)
    assert result.exit_code == 0, result.output
    assert "Left out: kf: filter KalmanFilter needs a linear model" in result.output
    rows = [line.split()[0] for line in result.output.splitlines()[2:]]
    assert {"ekf1", "ukf", "bootstrap"} <= set(rows)


def test_a_filter_that_most_runs_lose_is_lost_and_not_underconfident():
    result = tell("ekf2", "ukf", "--scenario", "growth", "--runs", 20)
    said = {
        line.split()[0]: line.split("  ")[-1].strip() for line in result.output.splitlines()[2:]
    }
    assert said == {"ekf2": "lost", "ukf": "underconfident"}


def test_a_named_filter_that_does_not_fit_is_an_error():
    result = tell("kf", "--scenario", "growth", "--runs", 2)
    assert result.exit_code != 0
    assert "needs a linear model" in result.output


@pytest.mark.parametrize("name", ["growth", "reentry", "turning_target"])
def test_classical_scenarios_simulate_what_their_models_say(name):
    """Innovations of the truth itself have the sensor's covariance: 99.99 % band of their chi-square."""
    scene = tk.scenario(name)
    runs = scene.simulate(seed=1, runs=50)
    rows = range(0, len(scene.t), max(1, len(scene.t) // 100))
    total, count = 0.0, 0
    for k in rows:
        v = scene.sensor.residual(runs.record.z[k], scene.sensor.h(runs.truth[k]))
        variance = np.einsum("ii...->i...", scene.sensor.R(runs.truth[k]))
        total += float((v**2 / variance).sum())
        count += v.size
    from scipy.stats import chi2

    low, high = chi2.ppf([5e-5, 1 - 5e-5], count)
    assert low < total < high, "false alarm of each problem: 1e-4"


def test_a_falling_body_slows_down_in_the_air_and_not_above_it():
    scene = tk.scenario("reentry")
    motion = scene.truth_motion
    state = np.array([6_374_000.0 + 30_000.0, 0.0, -6000.0, 0.0, 0.0])
    high = state.copy()
    high[0] += 400_000.0
    gravity = 3.986e14 / state[0] ** 2
    drag = 0.59783e-3 * np.exp(-30_000.0 / 13_406.0) * 6000.0**2
    change = motion.f(state, 0.1)[2] - state[2]
    np.testing.assert_allclose(change, 0.1 * (drag - gravity), rtol=1e-9)
    assert abs(motion.f(high, 0.1)[2] - high[2] + 0.1 * 3.986e14 / high[0] ** 2) < 1e-5
