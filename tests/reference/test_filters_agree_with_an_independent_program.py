"""Kalman filters, extended filters of both orders and their smoothers against another program, to 1e-9.

The data are described in ``data/*/README.md``. Two of its numbers are not reached, on purpose:

* Its second-order filter on bearings uses a wrong Hessian (as paper 0 prints it in eq. 33), and angles
  subtracted without wrapping. With both given by hand ours agrees to 1e-9; with the right Hessian the
  errors are smaller.
* Its filter on the re-entry drifts from the exact answer by 6e-7, because its covariances lose their
  symmetry; ours is as exact as 1e-10. Both are held against the same recursion in extended precision.
"""

from collections.abc import Callable
from typing import Any

import attrs
import numpy as np
import pytest
from problems import (
    DATA,
    Problem,
    accelerating,
    four_bearings,
    moments,
    read,
    reentry,
    sine,
    two_bearings,
)

import tracker as tk
from tracker.models.component import Trace
from tracker.models.graph import evaluate
from tracker.types import Array
from tracker_kalman.ekf2 import SecondOrderExtendedKalmanFilter
from tracker_kalman.iterated import IteratedExtendedKalmanFilter
from tracker_motion import constant_velocity

SEEDS = ["seed1", "seed2", "seed3"]


@pytest.fixture(params=["off", "on"], ids=["arrays", "compiled where possible"])
def interpretation(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TRACKER_COMPILE", request.param)


both = pytest.mark.usefixtures("interpretation")


def smoothed(history: tk.History) -> tk.Trajectory:
    assert history.smoothed is not None
    return history.smoothed


def as_it_is(record: tk.Record) -> tk.Record:
    return record


def spread(batch: tuple[int, ...]) -> Callable[[tk.Record], tk.Record]:
    """The same measurements in the last lane; other ones in the others."""

    def over_lanes(record: tk.Record) -> tk.Record:
        rng = np.random.default_rng(5)
        z = record.z.reshape(*record.z.shape, *(1,) * len(batch))
        z = z + 0.01 * rng.standard_normal((*record.z.shape, *batch))
        z[(..., *(-1,) * len(batch))] = record.z
        return tk.Record(record.t, z)

    return over_lanes


SHAPES = {
    "one run": (as_it_is, ()),
    "one of eight lanes": (spread((8,)), (-1,)),
    "one of a grid of lanes": (spread((2, 3)), (-1, -1)),
}
shapes = pytest.mark.parametrize("shape", SHAPES)


# ------------------------------------------------------------------------------- first order
@both
@pytest.mark.parametrize("seed", SEEDS)
@shapes
def test_ekf1_and_rts_on_two_bearings_agree(seed: str, shape: str) -> None:
    problem = two_bearings(seed)
    change, lane = SHAPES[shape]
    history = problem.run("ekf1", "rts", change(problem.record))
    problem.agrees(history.filtered, "ekf1", lane=lane)
    problem.agrees(smoothed(history), "ekf1_rts", lane=lane)


@both
@pytest.mark.parametrize("name", ["ekf1_joseph", "square_root", "information", "schmidt"])
def test_other_forms_of_the_extended_filter_agree_with_its_tables(name: str) -> None:
    problem = two_bearings()
    history = problem.run(name, "rts")
    problem.agrees(history.filtered, "ekf1")
    problem.agrees(smoothed(history), "ekf1_rts")


def test_one_iteration_is_the_extended_filter() -> None:
    problem = two_bearings()
    problem.agrees(problem.run(IteratedExtendedKalmanFilter(1)).filtered, "ekf1")


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("program", ["filterpy", "stonesoup"])
def test_ekf1_and_rts_agree_with_further_programs(program: str, seed: str) -> None:
    problem = two_bearings(seed)
    other = attrs.evolve(problem, folder=problem.folder / program)
    history = problem.run("ekf1", "rts")
    other.agrees(history.filtered, "ekf1")
    other.agrees(smoothed(history), "ekf1_rts")


@both
def test_ekf1_and_rts_on_four_bearings_agree() -> None:
    problem = four_bearings()
    history = problem.run("ekf1", "rts")
    problem.agrees(history.filtered, "ekf_cv")
    problem.agrees(smoothed(history), "ekf_cv_rts")


@both
@shapes
def test_kf_and_rts_on_an_accelerating_target_agree(shape: str) -> None:
    problem = accelerating()
    change, lane = SHAPES[shape]
    history = problem.run("kf", "rts", change(problem.record))
    problem.agrees(history.filtered, "kf", lane=lane)
    problem.agrees(smoothed(history), "kf_rts", lane=lane)
    problem.agrees(smoothed(history), "kf_tf", lane=lane)


@both
@pytest.mark.parametrize(
    "name", ["ekf1", "ekf1_joseph", "ekf2", "iekf", "square_root", "information", "schmidt"]
)
def test_an_extended_filter_on_a_linear_problem_is_the_kalman_filter(name: str) -> None:
    problem = accelerating()
    problem.agrees(problem.run(name).filtered, "kf")


# ------------------------------------------------------------------------------ second order
@both
@shapes
def test_ekf1_and_ekf2_on_a_sine_agree(shape: str) -> None:
    problem = sine()
    change, lane = SHAPES[shape]
    record = change(problem.record)
    problem.agrees(problem.run("ekf1", record=record).filtered, "ekf1", lane=lane)
    problem.agrees(problem.run("ekf2", record=record).filtered, "ekf2", lane=lane)


def test_the_other_program_has_the_complete_innovation_covariance() -> None:
    """Paper 0's eq. 10 as printed is off by far more than rounding."""
    problem = sine()
    printed = SecondOrderExtendedKalmanFilter(second_order_innovation=False)
    assert min(problem.differences(problem.run(printed).filtered, "ekf2")) > 0.5


@attrs.frozen(eq=False)
class AsPrinted:
    """The two azimuths with the second derivatives of eq. 33 as printed, by hand.

    The other program subtracts angles without wrapping; with the wrong second derivatives its
    predictions are off by more than half a turn in seed3.
    """

    sensor: Any
    wrapped: bool = True
    stations: tuple[tuple[float, float], ...] = ((-1.0, -2.0), (1.0, 1.0))

    def __getattr__(self, name: str) -> Any:
        if name in {"expand", "why_opaque", "over"}:
            raise AttributeError(name)
        return getattr(self.sensor, name)

    def residual(self, z: Array, zhat: Array) -> Any:
        return self.sensor.residual(z, zhat) if self.wrapped else z - zhat

    def hessian(self, x: Array, pose: Any = None) -> Array:
        out = np.zeros((2, 4, 4, *x.shape[1:]))
        for i, (sx, sy) in enumerate(self.stations):
            dx, dy = x[0] - sx, x[1] - sy
            r4 = (dx**2 + dy**2) ** 2
            out[i, 0, 0], out[i, 1, 1] = -2.0 * dx / r4, -2.0 * dy / r4
            out[i, 0, 1] = out[i, 1, 0] = (dy**2 - dx**2) / r4
        return out


@pytest.mark.parametrize("seed", SEEDS)
@shapes
def test_ekf2_on_two_bearings_agrees_given_the_wrong_hessian(seed: str, shape: str) -> None:
    right = two_bearings(seed)
    wrong = attrs.evolve(right, sensor=AsPrinted(right.sensor, wrapped=False))
    change, lane = SHAPES[shape]
    history = wrong.run("ekf2", "rts", change(wrong.record))
    wrong.agrees(history.filtered, "ekf2", lane=lane)
    wrong.agrees(smoothed(history), "ekf2_rts", lane=lane)


def test_the_right_hessian_makes_smaller_errors_than_the_wrong_one() -> None:
    """Median of the position error over 400 runs at ten times the step; the prior mean is drawn."""
    rng = np.random.default_rng(33)
    problem = two_bearings()
    runs, steps, dt = 400, 50, 0.1
    motion = constant_velocity(0.1)
    root = np.linalg.cholesky(motion.Q(np.zeros(4), dt))
    x = np.repeat([[0.0], [0.0], [1.0], [0.0]], runs, axis=1)
    around = np.sqrt(problem.prior.cov) @ rng.standard_normal((4, runs))
    prior = tk.Gaussian(x + around, problem.prior.cov)
    truth, z = [], []
    for _ in range(steps):
        x = motion.f(x, dt) + root @ rng.standard_normal((4, runs))
        truth.append(x)
        z.append(problem.sensor.h(x) + 0.05 * rng.standard_normal((2, runs)))
    record = tk.Record(dt * np.arange(1, steps + 1), np.stack(z))
    error = {}
    for name, sensor in (("right", problem.sensor), ("wrong", AsPrinted(problem.sensor))):
        own = attrs.evolve(problem, sensor=sensor, prior=prior)
        mean = own.run("ekf2", record=record).filtered.mean
        squared = ((mean - np.stack(truth))[:, :2] ** 2).sum(axis=1)
        error[name] = float(np.median(np.sqrt(squared.mean(axis=0))))
    assert error["right"] < 0.5 * error["wrong"], error


# --------------------------------------------------------------------------------- re-entry
def textbook(problem: Problem, number: type, *, mirrored: bool = True) -> tuple[Array, Array]:
    """The extended filter as books print it, on the problem's own functions, in any precision."""
    advance, measure = Trace(problem.motion.advance), Trace(problem.sensor.measure)

    def linearised(trace: Trace, x: Array, **given: Any) -> tuple[Array, Array]:
        roots = [*trace.roots, *(entry for row in trace.first for entry in row)]
        values = dict(zip(trace.positional, x, strict=False)) | given
        out = np.array([number(v) for v in evaluate(roots, values)], dtype=number)
        m = len(trace.roots)
        return out[:m], out[m:].reshape(m, -1)

    x, P = problem.prior.mean.astype(number), problem.prior.cov.astype(number)
    n = len(x)
    Q = np.asarray(problem.motion.Q(problem.prior.mean, 0.1)).astype(number)
    R = np.asarray(problem.sensor.R(problem.prior.mean)).astype(number)
    means, covs, before = [], [], problem.start
    for t, z in zip(problem.record.t, problem.record.z, strict=True):
        x, F = linearised(advance, x, dt=number(t) - number(before))
        P, before = F @ P @ F.T + Q, t
        zhat, partial = linearised(measure, x)
        H = np.zeros((len(z), n), dtype=number)
        H[:, : partial.shape[1]] = partial
        S = H @ P @ H.T + R
        adjugate = np.array([[S[1, 1], -S[0, 1]], [-S[1, 0], S[0, 0]]], dtype=number)
        K = P @ H.T @ (adjugate / (S[0, 0] * S[1, 1] - S[0, 1] * S[1, 0]))
        x, P = x + K @ (z.astype(number) - zhat), P - K @ S @ K.T
        if mirrored:
            P = (P + P.T) / 2
        means.append(x)
        covs.append(P)
    return np.array(means), np.array(covs)


@both
def test_ekf1_and_rts_on_the_reentry_agree_as_far_as_rounding_lets_them() -> None:
    problem = reentry()
    history = problem.run("ekf1", "rts")
    problem.agrees(history.filtered, "ekf", 1e-6)
    problem.agrees(smoothed(history), "ekf_rts", 1e-6)


@pytest.mark.skipif(np.finfo(np.longdouble).eps > 1e-18, reason="no extended precision here")
@both
@pytest.mark.parametrize("name", ["ekf1", "ekf1_joseph", "square_root"])
def test_on_the_reentry_ours_is_the_exact_answer_and_the_other_program_drifts(name: str) -> None:
    problem = reentry()
    exact, spread = textbook(problem, np.longdouble)
    filtered = problem.run(name).filtered
    assert np.abs(filtered.mean - exact).max() < 1e-9
    assert np.abs(filtered.cov - spread).max() < 1e-9
    t, theirs, _ = moments(DATA / "reentry" / "ekf.csv.gz", 5)
    rows = np.searchsorted(problem.record.t, t - 1e-9)
    assert 1e-7 < np.abs(theirs - exact[rows]).max() < 1e-6


def test_what_drifts_on_the_reentry_is_a_covariance_that_loses_its_symmetry() -> None:
    problem = reentry()
    exact, _ = textbook(problem, np.float64)
    drifted, P = textbook(problem, np.float64, mirrored=False)
    assert np.abs(P - P.swapaxes(1, 2)).max() > 0.0
    assert np.abs(drifted - exact).max() > 1e-8
    ours = problem.run("ekf1").filtered
    assert np.abs(ours.mean - exact).max() < 1e-9


# ----------------------------------------------------------------------------- other matters
def test_on_arrays_the_step_on_line_is_the_filter_of_the_record(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("TRACKER_COMPILE", "off")
    problem = two_bearings()
    estimator = tk.estimator("ekf1", motion=problem.motion, sensor=problem.sensor)
    history = problem.run("ekf1")
    state, before = problem.prior, problem.start
    for k, now in enumerate(problem.record.t.tolist()):
        state, innovation = estimator.step(state, problem.record.z[k], now - before)
        before = now
        assert np.array_equal(state.mean, history.filtered.mean[k]), f"means differ at step {k}"
        assert np.array_equal(state.cov, history.filtered.cov[k]), f"covariances differ at step {k}"
        assert innovation.nis == history.innovation.nis[k], f"NIS differs at step {k}"


def test_the_motion_models_are_those_of_the_other_program() -> None:
    for motion, dt, folder in (
        (constant_velocity(0.1), 0.01, "bot_reference"),
        (accelerating().motion, 0.5, "kfcwpa"),
        (sine().motion, 0.01, "sine"),
    ):
        x = np.zeros(motion.space.size)
        for name, ours in (("A", motion.jacobian(x, dt)), ("Q", motion.Q(x, dt))):
            theirs = read(DATA / folder / f"{name}.csv")
            assert np.allclose(ours, theirs, rtol=0, atol=1e-15), f"{folder}: {name} differs"
