"""Backward simulation: the Rauch-Tung-Striebel smoother in the limit, paths that the motion allows.

Seeds are fixed; a stated false alarm is that of a seed drawn anew.
"""

from typing import Any

import attrs
import numpy as np
import pytest
from clouds import kalman, linear

import tracker as tk
from tracker.errors import CapabilityError
from tracker.models import ComponentMotion, ComponentSensor, diagonal
from tracker.simulation import stream
from tracker_particle import (
    AuxiliaryFilter,
    BackwardSimulation,
    BootstrapFilter,
    MarginalisedFilter,
)
from tracker_sensors import position


def smoothed(rule: Any, smoother: Any, problem: Any, rng: Any = None) -> tk.History:
    models, record, prior = problem
    estimator = tk.estimator(rule, **models, smoother=smoother)
    draws = np.random.default_rng(1) if rng is None else rng
    return tk.smooth(estimator, record, prior, start=0.0, rng=draws)


@pytest.mark.statistical
@pytest.mark.parametrize("filter_", [BootstrapFilter(), AuxiliaryFilter()])
def test_it_converges_to_the_smoother_of_rauch_tung_and_striebel(filter_: Any) -> None:
    models, record, prior = linear(steps=8, batch=(8,))
    exact = kalman(models, record, prior, "rts")
    sigma = np.sqrt(np.einsum("tii...->ti...", exact.smoothed.cov))
    size = sigma[:, :, None] * sigma[:, None]
    found = []
    for count, paths in ((200, 50), (3200, 200)):
        history = smoothed(
            attrs.evolve(filter_, particles=count),
            BackwardSimulation(paths),
            (models, record, prior),
        )
        mean = (history.smoothed.mean - exact.smoothed.mean) / sigma
        cov = (history.smoothed.cov - exact.smoothed.cov) / size
        found.append([np.sqrt(np.mean(e**2)) for e in (mean, cov)])
    # 16 times the particles: 4 times less error where there are many. It is known to some 15 % from
    # eight runs of 8 steps: a factor of less than 2 is a false alarm of about 1e-4.
    for few, many in zip(*found, strict=True):
        assert many < few / 2.0, f"from {few:.3f} only to {many:.3f}"
    assert found[1][0] < 0.2


@pytest.mark.statistical
def test_paths_are_draws_of_whole_trajectories() -> None:
    """Neighbouring states of a path are correlated as those of the exact smoother are."""
    runs = 30
    models, record, prior = linear(steps=8, batch=(runs,))
    exact, motion = kalman(models, record, prior, "rts"), models["motion"]
    rule, smoother = BootstrapFilter(particles=800), BackwardSimulation(100)
    estimator = tk.estimator(rule, **models, smoother=smoother)
    history = tk.filter(estimator, record, prior, start=0.0, rng=np.random.default_rng(1))
    paths = smoother.paths(history, motion)
    assert paths.shape == (8, 4, 100, runs)
    for k in (2, 5):
        F = motion.jacobian(np.zeros(4), float(record.t[k + 1] - record.t[k]))
        gap = np.empty((4, 4, runs))
        for run in range(runs):
            past, later = (exact.filtered.cov[k, ..., run], exact.predicted.cov[k + 1, ..., run])
            cross = past @ F.T @ np.linalg.solve(later, exact.smoothed.cov[k + 1, ..., run])
            a, b = (p - p.mean(axis=1, keepdims=True) for p in paths[k : k + 2, ..., run])
            sigma = [np.sqrt(np.diagonal(exact.smoothed.cov[i, ..., run])) for i in (k, k + 1)]
            gap[..., run] = (a @ b.T / 99 - cross) / np.outer(*sigma)
        # 32 means of 30 runs, 5.5 standard errors (Student's): false alarm 2e-4.
        error = gap.std(axis=-1, ddof=1) / np.sqrt(runs)
        assert (np.abs(gap.mean(axis=-1)) < 5.5 * error).all()
        assert error.max() < 0.2


def test_the_last_step_equals_the_filter() -> None:
    for batch in ((), (3,), (2, 2)):
        history = smoothed(
            BootstrapFilter(particles=80), BackwardSimulation(10), linear(batch=batch)
        )
        assert np.abs(history.smoothed.mean[-1] - history.filtered.mean[-1]).max() < 1e-9
        assert np.abs(history.smoothed.cov[-1] - history.filtered.cov[-1]).max() < 1e-9


def test_the_same_seed_gives_the_same_in_any_company() -> None:
    models, record, prior = linear(batch=(4,))

    def made(lanes: list[int]) -> tk.History:
        some = tk.Record(record.t, record.z[..., lanes])
        rng = [stream(3, lane, "filter") for lane in lanes]
        rule, smoother = BootstrapFilter(particles=64), BackwardSimulation(16)
        return smoothed(rule, smoother, (models, some, prior), rng)

    whole, few = made([0, 1, 2, 3]), made([3, 1])
    assert np.array_equal(whole.smoothed.mean[..., [3, 1]], few.smoothed.mean)
    assert np.array_equal(whole.smoothed.cov[..., [3, 1]], few.smoothed.cov)
    assert np.array_equal(whole.smoothed.mean, made([0, 1, 2, 3]).smoothed.mean)


def test_paths_go_back_to_parents_where_noise_does_not_reach() -> None:
    """Positions move without noise of their own, and one step takes no time."""
    motion = ComponentMotion(
        name="smooth", space=tk.types.PLANAR, noise=lambda *, dt: diagonal(0.0, 0.0, dt, dt),
        advance=lambda x, y, vx, vy, *, dt: (x + dt * vx, y + dt * vy, vx, vy),
    )  # fmt: skip
    record = tk.Record([1.0, 2.0, 2.0, 3.5], np.random.default_rng(1).standard_normal((4, 2)))
    prior = tk.Gaussian(np.zeros(4), np.eye(4))
    rule, smoother = BootstrapFilter(particles=200), BackwardSimulation(50)
    estimator = tk.estimator(rule, motion=motion, sensor=position(sigma=1.0), smoother=smoother)
    history = tk.filter(estimator, record, prior, start=0.0, rng=np.random.default_rng(1))
    paths = smoother.paths(history, motion)
    assert np.isfinite(paths).all()
    for k in range(3):
        dt = float(record.t[k + 1] - record.t[k])
        gap = paths[k + 1, :2] - paths[k, :2] - dt * paths[k, 2:]
        assert np.abs(gap).max() < 1e-9, "a path jumps where the motion has no noise"
    assert np.array_equal(paths[1], paths[2]), "a path moves although no time passes"


def test_headings_are_smoothed_across_the_cut() -> None:
    space = tk.Space.of("heading [rad] circular", "rate [rad/s]")
    motion = ComponentMotion(
        name="turning", advance=lambda heading, rate, *, dt: (heading + dt * rate, rate),
        noise=lambda *, dt: diagonal(0.01 * dt, 0.01 * dt), space=space,
    )  # fmt: skip
    compass = ComponentSensor(
        name="compass", measure=lambda heading: (heading,), noise=lambda: ((0.05,),),
        space=tk.Space.of("heading [rad] circular"), state=space,
    )  # fmt: skip
    found = []
    for turn in (0.0, np.pi):
        z = tk.algebra.wrap(turn + 0.1 * np.arange(-4.0, 4.0))[:, None]
        prior = tk.Gaussian(np.array([turn - 0.4, 0.1]), np.diag([0.1, 0.01]))
        problem = ({"motion": motion, "sensor": compass}, tk.Record(np.arange(1.0, 9.0), z), prior)
        found.append(
            smoothed(BootstrapFilter(particles=300), BackwardSimulation(50), problem).smoothed
        )
    assert np.abs(tk.algebra.wrap(found[1].mean[:, 0] - found[0].mean[:, 0] - np.pi)).max() < 1e-6
    assert np.abs(found[1].cov - found[0].cov).max() < 1e-6


def test_a_diverged_lane_harms_no_neighbour() -> None:
    models, record, prior = linear(batch=(3,))
    rng = [stream(3, lane, "filter") for lane in range(3)]
    rule, smoother = BootstrapFilter(particles=64), BackwardSimulation(16)
    well = smoothed(rule, smoother, (models, record, prior), rng)
    mean = np.repeat(prior.mean[:, None], 3, axis=1)
    mean[:, 1] = np.nan
    ill = tk.Gaussian.trusted(mean, np.repeat(prior.cov[..., None], 3, axis=2))
    gone = smoothed(
        rule, smoother, (models, record, ill), [stream(3, i, "filter") for i in range(3)]
    )
    assert np.isnan(gone.smoothed.mean[..., 1]).all()
    assert np.array_equal(gone.smoothed.mean[..., [0, 2]], well.smoothed.mean[..., [0, 2]])


def test_what_it_needs_is_said_in_words() -> None:
    models, record, prior = linear()
    past = kalman(models, record, prior)
    with pytest.raises(CapabilityError, match="without beliefs"):
        BackwardSimulation().smooth(past, models["motion"])
    with pytest.raises(CapabilityError, match="MarginalisedFilter"):
        smoothed(MarginalisedFilter(particles=8), BackwardSimulation(), (models, record, prior))
