"""Smoothers that carry beliefs of their own run backwards in compiled steps, and agree with the arrays."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np
import pytest

import tracker as tk
from tracker.compile import objects, run
from tracker.errors import CapabilityError
from tracker.estimation import smoothed
from tracker.models.graph import Graph, evaluate
from tracker_kalman import (
    FixedLagSmoother,
    SigmaPointRauchTungStriebel,
    SquareRootRauchTungStriebel,
    TwoFilterSmoother,
)
from tracker_kalman.fixed_lag import MOST
from tracker_kalman.two_filter import singular_root
from tracker_motion import acceleration_input, constant_velocity, coordinated_turn
from tracker_sensors import position

compiled = pytest.mark.skipif(not objects.available(), reason="llvmlite is not installed")

RULES = {
    "square root": SquareRootRauchTungStriebel(),
    "two filters": TwoFilterSmoother(),
    "lag 0": FixedLagSmoother(0),
    "lag 4": FixedLagSmoother(4),
    "lag 4 of points": FixedLagSmoother(4, SigmaPointRauchTungStriebel()),
    "lag 4 of roots": FixedLagSmoother(4, SquareRootRauchTungStriebel()),
    "lag 4 of two filters": FixedLagSmoother(4, TwoFilterSmoother()),
    "lag beyond the record": FixedLagSmoother(30),
}
EVERY = pytest.mark.parametrize("rule", RULES.values(), ids=RULES)


def problem(
    rule: Any, batch: tuple[int, ...] = (), steps: int = 25, motion: Any = None
) -> tuple[tk.Estimator, tk.Record, tk.Gaussian]:
    """Uneven times, some equal, components missing; motion in the plane on a turn."""
    rng = np.random.default_rng(9)
    gaps = rng.uniform(0.2, 1.5, steps) * rng.choice([0.0, 1.0, 1.0], steps)
    t = np.cumsum(gaps)
    truth = np.stack([50.0 * np.cos(0.2 * t), 50.0 * np.sin(0.2 * t)], axis=1)
    z = truth.reshape(steps, 2, *(1,) * len(batch)) + rng.normal(0.0, 1.0, (steps, 2, *batch))
    z[rng.uniform(size=z.shape) < 0.2] = np.nan
    motion = coordinated_turn(0.1, 0.01) if motion is None else motion
    est = tk.estimator("ekf1", motion=motion, sensor=position(1.0), smoother=rule)
    prior = tk.Gaussian([50.0, 0.0, 0.0, 10.0, 0.1], np.diag([25.0, 25.0, 9.0, 9.0, 0.04]))
    n = motion.space.size
    return est, tk.Record(t, z), tk.Gaussian(prior.mean[:n], prior.cov[:n, :n])


def both(monkeypatch: Any, est: tk.Estimator, history: tk.History) -> list[tk.Trajectory]:
    out = []
    for mode in ("require", "off"):
        monkeypatch.setenv("TRACKER_COMPILE", mode)
        out.append(smoothed(est, history).smoothed)
    return out


def agree(monkeypatch: Any, est: tk.Estimator, history: tk.History) -> None:
    found, arrays = both(monkeypatch, est, history)
    np.testing.assert_allclose(found.mean, arrays.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.cov, arrays.cov, rtol=1e-9, atol=1e-9)


@compiled
@EVERY
@pytest.mark.parametrize("batch", [(), (1,), (11,), (2, 3)], ids=str)
def test_a_compiled_smoother_agrees_with_the_arrays(monkeypatch, rule, batch):
    est, record, prior = problem(rule, batch)
    agree(monkeypatch, est, tk.filter(est, record, prior))


@compiled
@EVERY
def test_so_it_does_with_numbers_per_lane_and_known_inputs(monkeypatch, rule):
    each = constant_velocity(np.linspace(0.1, 2.0, 9))
    est, record, prior = problem(rule, (9,), motion=each)
    agree(monkeypatch, est, tk.filter(est, record, prior))
    est, record, prior = problem(rule, (9,), motion=acceleration_input(sigma=0.1))
    u = np.random.default_rng(1).normal(size=(len(record), 2, 9))
    agree(monkeypatch, est, tk.filter(est, attrs.evolve(record, u=u), prior))


@compiled
@EVERY
@pytest.mark.parametrize("steps", [1, 2])
def test_the_last_step_of_a_short_record_is_the_filter_s(monkeypatch, rule, steps):
    est, record, prior = problem(rule, (3,), steps)
    history = tk.filter(est, record, prior)
    found, _ = both(monkeypatch, est, history)
    assert np.array_equal(found.mean[-1], history.filtered.mean[-1])
    assert np.array_equal(found.cov[-1], history.filtered.cov[-1])


@compiled
@EVERY
def test_bits_do_not_depend_on_how_many_lanes_there_are(monkeypatch, rule):
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    est, record, prior = problem(rule, (70,))
    history = tk.filter(est, record, prior)
    whole = smoothed(est, history, workers=2).smoothed
    for lanes in (slice(0, 1), slice(3, 20), slice(69, 70)):
        some = smoothed(est, tk.filter(est, tk.Record(record.t, record.z[..., lanes]), prior))
        assert np.array_equal(some.smoothed.mean, whole.mean[..., lanes])
        assert np.array_equal(some.smoothed.cov, whole.cov[..., lanes])


@compiled
@EVERY
def test_a_lane_that_diverged_stays_nan_and_harms_no_neighbour(monkeypatch, rule):
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    est, record, prior = problem(rule, (9,))
    history = tk.filter(est, record, prior)
    ill = [a.copy() for t in (history.predicted, history.filtered) for a in (t.mean, t.cov)]
    for a in ill:
        a[5:, ..., 4] = np.nan
    bad = attrs.evolve(history, predicted=tk.Trajectory(*ill[:2]), filtered=tk.Trajectory(*ill[2:]))
    one, other = smoothed(est, history).smoothed, smoothed(est, bad).smoothed
    rest = [i for i in range(9) if i != 4]
    assert np.array_equal(one.mean[..., rest], other.mean[..., rest])
    assert np.array_equal(one.cov[..., rest], other.cov[..., rest])
    assert np.isnan(other.mean[5:, ..., 4]).all()
    assert np.isnan(other.cov[5:, ..., 4]).all()


@compiled
@EVERY
def test_a_campaign_scores_the_same_compiled_and_on_arrays(monkeypatch, rule):
    scene = tk.scenario("two_stations", steps=30)
    est = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor, smoother=rule)
    found = []
    for mode in ("require", "off"):
        monkeypatch.setenv("TRACKER_COMPILE", mode)
        campaign = tk.monte_carlo(est, scene, runs=40, seed=1)
        found.append(campaign.scores["estimator"]["smoother"])
    for part in ("per_run", "per_step"):
        one, other = (getattr(scores, part) for scores in found)
        for name in one:
            np.testing.assert_allclose(one[name], other[name], rtol=1e-7, err_msg=name)


# ------------------------------------------------------------------------------ what cannot be
@attrs.frozen
class Stranger:
    """A smoother whose belief is no value that could be carried."""

    needs = ()

    def begin(self, filtered):
        return {"mean": filtered.mean}

    def step(self, *_known):
        raise NotImplementedError

    def smooth(self, history, _motion):
        return attrs.evolve(history, smoothed=history.filtered)


@attrs.frozen
class Whole:
    """A smoother that takes the record as a whole."""

    needs = ()

    def smooth(self, history, _motion):
        return attrs.evolve(history, smoothed=history.filtered)


@compiled
@pytest.mark.parametrize(
    ("rule", "why"),
    [
        (FixedLagSmoother(MOST + 1), f"a lag of {MOST + 1} steps is too long to unroll"),
        (FixedLagSmoother(3, Stranger()), "cannot be carried: .*carries dict"),
        (Stranger(), "cannot be carried: .*carries dict"),
        (Whole(), "no step over components"),
    ],
)
def test_what_cannot_be_compiled_says_why(monkeypatch, rule, why):
    est = problem(rule)[0]
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    with pytest.raises(CapabilityError, match=why):
        run.why_not_backwards(est)


# -------------------------------------------------------------------- roots of singular matrices
@pytest.mark.parametrize("rank", range(5))
def test_a_root_of_a_singular_matrix_is_one_on_lanes_on_one_run_and_on_nodes(rank):
    rng = np.random.default_rng(rank)
    half = rng.normal(size=(4, rank, 6)) * np.array([1e3, 1.0, 1e-3, 10.0])[:, None, None]
    P = np.einsum("ikl,jkl->ijl", half, half)
    scale = np.einsum("iil->il", P) * 10.0
    size = np.sqrt(scale[:, None] * scale)
    lanes = singular_root(P, scale)
    assert (np.abs(np.einsum("ikl,jkl->ijl", lanes, lanes) - P) <= 1e-14 * size).all()
    assert (np.abs(lanes).max(axis=0) > 0.0).sum(axis=0).tolist() == [rank] * 6
    graph = Graph()
    nodes = np.empty((4, 4), dtype=object)
    for i, j in np.ndindex(4, 4):
        nodes[i, j] = graph.input(f"{min(i, j)}{max(i, j)}")
    traced = singular_root(nodes, 10.0 * np.diagonal(nodes))
    for lane in range(6):
        one = singular_root(P[..., lane], scale[..., lane])
        told = {f"{i}{j}": P[i, j, lane] for i in range(4) for j in range(i, 4)}
        worth = np.reshape(evaluate(list(traced.ravel()), told), (4, 4)).astype(float)
        for root in (one, worth):
            assert (np.abs(root @ root.T - P[..., lane]) <= 1e-14 * size[..., lane]).all()


def test_what_subtraction_leaves_of_a_variance_is_nothing():
    P = np.array([[1e-17, 3e-17, 0.0], [3e-17, -2e-17, 0.0], [0.0, 0.0, 0.25]])
    assert np.array_equal(singular_root(P, np.ones(3))[:, 0], [0.0, 0.0, 0.5])
    assert not singular_root(P, np.ones(3))[:, 1:].any()


def test_a_root_of_what_is_lost_is_lost():
    for bad in (np.nan, np.inf):
        P = np.stack([np.eye(2), np.eye(2)], axis=-1)
        P[1, 1, 0] = bad
        with np.errstate(all="ignore"):
            root = singular_root(P, np.ones((2, 2)))
        assert np.isnan(root[..., 0]).all()
        assert np.array_equal(root[..., 1], np.eye(2))
