"""Smoothers on linear problems: the exact solution to 1e-9, whatever the noise, the times, the gaps."""

import attrs
import hypothesis.strategies as st
import linear_problems
import numpy as np
import pytest
from hypothesis import given
from linear_problems import SENSOR, SHAPES, agree, filtered, problem, solution

import tracker as tk
from tracker.errors import DomainError
from tracker_kalman import FixedLagSmoother, FixedPoint, RauchTungStriebel
from tracker_motion import constant_velocity, coordinated_turn

SEEDS = st.integers(0, 2**32 - 1)
INTERVAL = ["rts", "square_root_rts", "two_filter", "fixed_lag"]
NOMINAL = constant_velocity(0.5)


def lanes(batch):
    return list(np.ndindex(*batch))


def smoothed(name, history, motion=NOMINAL):
    rule = FixedLagSmoother(lag=50) if name == "fixed_lag" else tk.smoothers.make(name)
    return rule.smooth(history, motion).smoothed


@pytest.mark.parametrize("batch", SHAPES, ids=str)
@pytest.mark.parametrize("name", INTERVAL)
@given(seed=SEEDS)
def test_a_fixed_interval_smoother_is_the_exact_solution(name, batch, seed):
    task = problem(seed, batch)
    found = smoothed(name, filtered(task))
    for lane in lanes(batch)[:3]:
        agree(found, task, lane, name)


@pytest.mark.parametrize("batch", SHAPES, ids=str)
@pytest.mark.parametrize("name", INTERVAL)
@given(seed=SEEDS)
def test_a_smoother_is_right_after_noise_that_differed_per_lane_and_step(name, batch, seed):
    # The smoother is given a motion with another density: the stored predictions know what was used.
    task = problem(seed, batch, varied=True)
    found = smoothed(name, filtered(task), constant_velocity(123.0))
    for lane in lanes(batch)[:3]:
        agree(found, task, lane, name)


@pytest.mark.parametrize("batch", SHAPES, ids=str)
@pytest.mark.parametrize("lag", [0, 1, 4, 11, 12])
@given(seed=SEEDS)
def test_with_a_fixed_lag_each_state_is_the_exact_solution_of_a_record_cut_later(lag, batch, seed):
    task = problem(seed, batch, varied=True)
    found = FixedLagSmoother(lag).smooth(filtered(task), NOMINAL).smoothed
    for lane in lanes(batch)[:2]:
        cut = [solution(task, lane, upto=k + lag + 1) for k in range(len(task.record))]
        rows = (
            np.stack([m[k] for k, (m, _) in enumerate(cut)]),
            np.stack([c[k] for k, (_, c) in enumerate(cut)]),
        )
        agree(found, task, lane, f"fixed lag of {lag}", rows)


@pytest.mark.parametrize("batch", SHAPES, ids=str)
@given(seed=SEEDS, step=st.integers(0, 11))
def test_a_fixed_point_is_the_exact_solution_of_every_record_so_far(batch, seed, step):
    task = problem(seed, batch, varied=True)
    found = FixedPoint.along(filtered(task), NOMINAL, step)
    assert len(found) == len(task.record) - step
    at = step - len(task.record)
    assert np.array_equal(found.mean, FixedPoint.along(filtered(task), NOMINAL, at).mean)
    for lane in lanes(batch)[:2]:
        for i, k in enumerate(range(step, len(task.record))):
            mean, cov = solution(task, lane, upto=k + 1)
            prior = np.sqrt(np.diag(solution(task, lane, upto=0)[1][step])) + 1.0
            now = found.at(i)[lane] if batch else found.at(i)
            assert (np.abs(now.mean - mean[step]) < 1e-9 * (prior + np.abs(mean[step]))).all()
            assert (np.abs(now.cov - cov[step]) < 1e-9 * np.outer(prior, prior)).all()


@attrs.frozen(eq=False)
class Doubts:
    """What the adapter below remembers: the density of the next step's noise."""

    density: np.ndarray


@attrs.frozen
class Doubting:
    """An adapter by which the process noise grows with every measurement, faster after surprising ones."""

    tunes = ("Q",)

    def begin(self, _motion, _sensor, prior, _pose):
        return Doubts(np.full(prior.mean.shape[1:], 0.5))

    def tuned(self, memory, _motion, sensor):
        density = memory.density
        return constant_velocity(density if density.ndim else float(density)), sensor

    def adapt(self, memory, step, _motion, _sensor):
        seen = np.isfinite(step.innovation.nis)
        surprising = np.where(seen, step.innovation.nis, 0.0) > 2.0
        return Doubts(memory.density * np.where(surprising, 1.9, 1.2))


@pytest.mark.parametrize("batch", SHAPES, ids=str)
@pytest.mark.parametrize("name", [*INTERVAL, "sigma_point_rts"])
@given(seed=SEEDS)
def test_after_an_adapter_of_the_process_noise_a_smoother_is_exact_with_what_was_used(
    name, batch, seed
):
    """An adapted run, smoothed: the exact solution of the densities that the adapter told the filter."""
    task = problem(seed, batch)
    rule = FixedLagSmoother(lag=50) if name == "fixed_lag" else tk.smoothers.make(name)
    est = tk.estimator("kf", motion=NOMINAL, sensor=SENSOR, smoother=rule, adapter=Doubting())
    history = tk.smooth(est, task.record, task.prior, start=float(task.record.t[0]))
    nis, used = history.innovation.nis, np.empty(task.density.shape)
    used[0] = 0.5
    for k in range(1, len(used)):
        used[k] = used[k - 1] * np.where(nis[k - 1] > 2.0, 1.9, 1.2)
    told = attrs.evolve(task, density=used)
    for lane in lanes(batch)[:3]:
        agree(history.smoothed, told, lane, name)
    assert used.max() > 2.0


def test_a_fixed_point_that_is_not_there_is_refused():
    history = filtered(problem(1))
    with pytest.raises(DomainError, match="0 to 11"):
        FixedPoint.along(history, NOMINAL, step=12)


def test_a_negative_lag_is_refused():
    with pytest.raises(DomainError, match=r"'lag'.*got -1"):
        FixedLagSmoother(-1)


# ------------------------------------------------------------------------- nonlinear motion
TURN = coordinated_turn(0.1, 0.01)


def turning(batch=(), steps=40):
    rng = np.random.default_rng(8)
    t = np.cumsum(rng.uniform(0.2, 1.5, steps))
    truth = np.stack([50.0 * np.cos(0.2 * t), 50.0 * np.sin(0.2 * t)], axis=1)
    z = truth.reshape(steps, 2, *(1,) * len(batch)) + rng.normal(0.0, 1.0, (steps, 2, *batch))
    z[rng.uniform(size=z.shape) < 0.1] = np.nan
    est = tk.estimator("ekf1", motion=TURN, sensor=tk.sensors.make("position", sigma=1.0))
    prior = tk.Gaussian([50.0, 0.0, 0.0, 10.0, 0.1], np.diag([25.0, 25.0, 9.0, 9.0, 0.04]))
    return tk.filter(est, tk.Record(t, z), prior)


@pytest.mark.parametrize("batch", SHAPES, ids=str)
def test_with_nonlinear_motion_all_forms_are_the_same_smoother(batch):
    history = turning(batch)
    rts = RauchTungStriebel().smooth(history, TURN).smoothed
    for name in INTERVAL:
        found = smoothed(name, history, TURN)
        np.testing.assert_allclose(found.mean, rts.mean, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.cov, rts.cov, rtol=1e-9, atol=1e-10)
    for step in (0, 17):
        fixed = FixedPoint.along(history, TURN, step)
        np.testing.assert_allclose(fixed.mean[-1], rts.mean[step], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(fixed.cov[-1], rts.cov[step], rtol=1e-9, atol=1e-10)


def test_a_fixed_lag_is_the_fixed_interval_smoother_of_the_record_cut_later():
    history = turning()
    found = FixedLagSmoother(5).smooth(history, TURN).smoothed
    for k in (0, 10, 34, 38, 39):
        end = min(k + 6, len(history))
        cut = attrs.evolve(
            history,
            t=history.t[:end],
            filtered=tk.Trajectory(history.filtered.mean[:end], history.filtered.cov[:end]),
            predicted=tk.Trajectory(history.predicted.mean[:end], history.predicted.cov[:end]),
        )
        whole = RauchTungStriebel().smooth(cut, TURN).smoothed
        np.testing.assert_allclose(found.mean[k], whole.mean[k], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.cov[k], whole.cov[k], rtol=1e-9, atol=1e-10)


def test_a_state_that_is_known_exactly_stays_so():
    # A prior without uncertainty in velocity, and motion without noise: P is singular throughout.
    task = problem(3)
    prior = tk.Gaussian([0.0, 0.0, 1.0, -1.0], np.diag([100.0, 100.0, 0.0, 0.0]))
    still = attrs.evolve(task, prior=prior, density=np.zeros_like(task.density))
    history = filtered(still)
    for name in INTERVAL:
        found = smoothed(name, history, constant_velocity(0.0))
        agree(found, still, (), name)
        assert (found.mean[:, 2:] == [1.0, -1.0]).all()


def test_the_problems_here_are_hard_enough():
    told = [problem(seed, (3,), varied=True) for seed in range(50)]
    assert any((np.diff(p.record.t) == 0).any() for p in told)
    assert any(np.isnan(p.record.z[5]).all(axis=0).any() for p in told)
    assert linear_problems.SENSOR is SENSOR
