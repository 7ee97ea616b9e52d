"""Laws of metrics, on histories that are drawn: no filter is run for them."""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.estimation import estimator
from tracker.testing.calls import Call, Given, calls_of
from tracker.testing.law import Case, law
from tracker.testing.textbook import MOTION, POSITION
from tracker.types import Array, Gaussian, History, Innovation, Record, Run, Trajectory

_STEPS = 30


def _history(z: Array, mean: Array, residual: Array) -> History:
    """As a filter of the textbook's models would leave it, with these numbers in it."""
    batch, t = z.shape[2:], np.arange(float(len(z)))

    def alike(matrix: Array) -> Array:
        n = len(matrix)
        return np.tile(matrix.reshape(1, n, n, *(1,) * len(batch)), (len(t), 1, 1, *batch))

    prior = Gaussian.trusted(mean[0], alike(np.diag([25.0, 25.0, 4.0, 4.0]))[0])
    found = Trajectory(mean, alike(prior_cov()))
    good = np.ones((len(t), *batch))
    innovation = Innovation(
        residual, alike(np.diag([30.0, 40.0])), good, -good, 2.0 * good, good > 0
    )
    run = Run(estimator("kf", motion=MOTION, sensor=POSITION), Record(t, z), prior, 0.0)
    return History(t, found, found, innovation, run=run)


def prior_cov() -> Array:
    """The covariance that every estimate has here."""
    return np.diag([25.0, 16.0, 4.0, 1.0])


def _drawn(case: Case, batch: tuple[int, ...]) -> tuple[Array, Array, Array, Array]:
    """Truth, and what was measured, estimated and not expected of it; some was not measured."""
    truth = np.asarray(100.0 * case.rng.standard_normal((_STEPS, 4, *batch)))
    z = truth[:, :2] + 5.0 * case.rng.standard_normal((_STEPS, 2, *batch))
    mean = truth + 4.0 * case.rng.standard_normal(truth.shape)
    residual = 6.0 * case.rng.standard_normal(z.shape)
    missing = case.rng.uniform(size=z.shape) < 0.1
    return truth, np.where(missing, np.nan, z), mean, np.where(missing, np.nan, residual)


def _judge(metric: Any, truth: Array, z: Array, mean: Array, residual: Array) -> tuple[Any, ...]:
    return (metric.score(_history(z, mean, residual), truth),)


@calls_of("metric")
def metric_calls(_metric: Any, case: Case, batch: tuple[int, ...]) -> list[Call]:
    """How a metric is called."""
    names = ("truth", "z", "mean", "residual")
    given = tuple(Given(n, v, 2) for n, v in zip(names, _drawn(case, batch), strict=True))
    return [Call("score", _judge, given, (1,), batch)]


@law("metric", name="nothing beats the truth")
def nothing_beats_the_truth(metric: Any, case: Case) -> None:
    """An estimate that is the truth scores no more than any other, in every number of the score."""
    truth, z, mean, residual = _drawn(case, (20,))
    score = np.asarray(metric.score(_history(z, mean, residual), truth))
    best = np.asarray(metric.score(_history(z, truth, residual), truth))
    assert np.isfinite(score).all(), "the score of finite numbers is not finite"
    assert (best <= score + 1e-12 * np.abs(score)).all(), (
        f"the truth scores {best.max():.6g} where an estimate scores {score.max():.6g}: less is better"
    )


@law("metric", name="a lost run is told")
def lost_run(metric: Any, case: Case) -> None:
    """A run that diverged never scores as if it were a good one: NaN in, NaN out, or no difference."""
    truth, z, mean, residual = _drawn(case, (3,))
    lost = np.array(mean)
    lost[10:, :, 1] = np.nan
    before = np.asarray(metric.score(_history(z, mean, residual), truth))
    after = np.asarray(metric.score(_history(z, lost, residual), truth))
    assert np.array_equal(before[:, [0, 2]], after[:, [0, 2]]), "a lost run changes others' scores"
    worse = np.isnan(after[:, 1]) | (after[:, 1] >= before[:, 1])
    assert worse.all(), "a run that is lost after ten steps scores better than one that is not"
