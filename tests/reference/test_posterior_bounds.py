"""The posterior Cramér-Rao bound against another program, closed forms and the printed recursion."""

import json
from pathlib import Path

import attrs
import numpy as np
import pytest

import tracker as tk
from tracker.errors import DomainError, ShapeError
from tracker.metrics.bounds import posterior_bound, scenario_bound
from tracker.models import ComponentMotion, ComponentSensor, sin
from tracker_motion import constant_velocity, coordinated_turn
from tracker_sensors import azimuth, position, range_azimuth, stack

CASES = json.loads((Path(__file__).parent / "data" / "pcrlb" / "bounds.json").read_text())


def known_path(case):
    """Times, noise-free path ``(T, 4, 1)``, prior covariance, all in our order (x, y, vx, vy)."""
    x, vx, y, vy = case["x0"]
    t = case["dt"] * np.arange(1, case["n"] + 1)
    path = np.stack([x + vx * t, y + vy * t, 0 * t + vx, 0 * t + vy], axis=1)
    px, pvx, py, pvy = case["P0_diag"]
    return t, path[..., None], np.diag([px, py, pvx, pvy]).astype(float)


def compare(case, sensor):
    t, path, prior = known_path(case)
    bound = posterior_bound(constant_velocity(case["q"]), sensor, t, path, prior, start=0.0)
    for row in case["bound"]:
        k = row["k"] - 1
        x, vx, y, vy = row["diag"]
        ours = np.diag(bound.cov[k])
        assert ours == pytest.approx([x, y, vx, vy], rel=1e-9), f"step {row['k']}"
        assert bound.position[k] == pytest.approx(row["pos_rmse_bound"], rel=1e-9)


def test_two_bearings_agree_with_another_program():
    case = CASES["two_sensor_bearings"]
    sigma = np.deg2rad(case["sigma_b_deg"])
    compare(case, stack([azimuth(sigma).at(sx=x, sy=y) for x, y in case["sensors"]]))


def test_bearing_and_range_agree_with_another_program():
    case = CASES["one_sensor_bearing_range"]
    ((x, y),) = case["sensors"]
    compare(case, range_azimuth(case["sigma_r"], np.deg2rad(case["sigma_b_deg"])).at(sx=x, sy=y))


@pytest.mark.parametrize("batch", [(), (3,), (2, 2)], ids=str)
def test_on_a_linear_problem_the_bound_is_the_kalman_filter_s_covariance(batch):
    rng = np.random.default_rng(4)
    motion, sensor = constant_velocity(0.3), position(2.0)
    t = np.cumsum(rng.uniform(0.0, 2.0, 15))
    truth = rng.normal(0.0, 100.0, (15, 4, *batch, 6))
    root = rng.normal(0.0, 3.0, (4, 4, *batch))
    prior = np.einsum("ik...,jk...->ij...", root, root)
    bound = posterior_bound(motion, sensor, t, truth, prior, start=0.0)
    kf = tk.estimator("kf", motion=motion, sensor=sensor)
    z = rng.normal(0.0, 1.0, (15, 2, *batch))
    history = tk.filter(kf, tk.Record(t, z), tk.Gaussian(np.zeros((4, *batch)), prior), start=0.0)
    np.testing.assert_allclose(bound.cov, history.filtered.cov, rtol=1e-9, atol=1e-10)


def printed_recursion(motion, sensor, t, truth, prior, start, first):
    """Tichavský's eq. 21 and 34-36 as printed, with inverses; one batch of runs."""
    J, out, x, before = np.linalg.solve(prior, np.eye(len(prior))), [], first, start
    runs = truth.shape[-1]
    for k, now in enumerate(t):
        dt = now - before
        D11, D12, D22 = np.zeros((3, *prior.shape))
        for i in range(runs):
            F = motion.jacobian(x[:, i], dt)
            W = np.linalg.solve(motion.Q(x[:, i], dt), np.eye(len(x)))
            D11 += F.T @ W @ F / runs
            D12 -= F.T @ W / runs
            D22 += W / runs
            H = sensor.jacobian(truth[k, :, i])
            D22 += H.T @ np.linalg.solve(sensor.R(truth[k, :, i]), H) / runs
        J = D22 - D12.T @ np.linalg.solve(J + D11, D12)
        out.append(np.linalg.solve(J, np.eye(len(J))))
        x, before = truth[k], now
    return np.array(out)


def wandering() -> ComponentMotion:
    """Nonlinear, with noise that depends on the state: nothing that a linear shortcut would survive."""
    return ComponentMotion(
        name="wandering",
        advance=lambda x, v, *, dt: (x + dt * v, v + dt * sin(x)),
        noise=lambda x, *, dt: ((0.5 * dt + 0.1 * dt * sin(x) ** 2, 0.0), (0.0, 0.3 * dt)),
        space=tk.Space.of("x [m]", "v [m/s]"),
    )


def test_with_nonlinear_motion_and_noise_the_bound_is_the_printed_recursion():
    motion = wandering()
    sensor = ComponentSensor(
        name="square",
        measure=lambda x, v: (x * x / 20.0 + v,),
        noise=lambda: ((0.25,),),
        space=tk.Space.of("z"),
        state=motion.space,
    )
    rng = np.random.default_rng(1)
    t = np.array([0.5, 1.0, 1.2, 2.0])
    first = rng.normal(0.0, 1.0, (2, 40))
    states, x, before = [], first, 0.0
    for now in t:
        dt = now - before
        x = motion.f(x, dt)
        states.append(x)
        before = now
    truth = np.stack(states)  # without noise, so that the state at the start is known to the bound
    prior = np.diag([1.0, 2.0])
    expected = printed_recursion(motion, sensor, t, truth, prior, 0.0, first)
    found = posterior_bound(motion, sensor, t, truth, prior, start=0.0)
    np.testing.assert_allclose(found.cov, expected, rtol=1e-8)


def test_a_filter_comes_close_to_the_bound_and_never_below():
    # Truth from the prior, as the bound assumes; so near that linearising costs little.
    near = tk.Gaussian([2.5, 3.0, 0.5, 0.0], np.diag([0.05, 0.05, 0.1, 0.1]))
    scene = tk.scenario("two_stations", steps=100)
    scene = attrs.evolve(scene, initial="truth from prior", start=None, prior=near)
    bound = scenario_bound(scene, runs=64, seed=2)
    made = scene.simulate(2, 1000)
    est = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor)
    history = tk.filter(est, made.record, made.prior, start=made.start)
    error = history.filtered.mean - made.truth
    rmse = np.sqrt((error[:, :2] ** 2).sum(axis=1).mean(axis=1))
    # Relative standard error of an RMSE over 1,000 runs: about 2 %. Four of them, at ten times.
    ratio = rmse[9::10] / bound.position[9::10]
    assert (ratio > 0.92).all(), f"an estimator cannot beat the bound: {ratio}"
    assert (ratio < 1.12).all(), f"nor is this one far from it: {ratio}"


def test_what_is_missed_says_nothing():
    motion, sensor = constant_velocity(0.3), position(2.0)
    t, truth = np.arange(1.0, 9.0), np.zeros((8, 4, 1))
    seen = np.ones((8, 2, 1), dtype=bool)
    seen[2] = False
    seen[5, 1] = False
    bound = posterior_bound(motion, sensor, t, truth, np.eye(4), start=0.0, measured=seen)
    z = np.where(seen[..., 0], 0.0, np.nan)
    est = tk.estimator("kf", motion=motion, sensor=sensor)
    history = tk.filter(est, tk.Record(t, z), tk.Gaussian(np.zeros(4), np.eye(4)), start=0.0)
    np.testing.assert_allclose(bound.cov, history.filtered.cov, rtol=1e-9, atol=1e-12)


def test_paths_that_differ_where_there_is_no_noise_are_refused():
    motion = coordinated_turn(0.0, 0.01)
    truth = np.random.default_rng(0).normal(0.0, 1.0, (3, 5, 4))
    with pytest.raises(DomainError, match="singular in component"):
        posterior_bound(motion, position(1.0).over(motion.space), np.arange(3.0), truth, np.eye(5))
    with pytest.raises(ShapeError, match="runs"):
        posterior_bound(motion, position(1.0), np.arange(3.0), truth[..., 0], np.eye(5))
