"""Particle filters: right where the answer is known, reproducible, robust to what is missing.

Seeds are fixed; a stated false alarm is that of a seed drawn anew.
"""

import pickle
from typing import Any

import attrs
import numpy as np
import pytest
from clouds import PLANE, kalman, linear, ran

import tracker as tk
from tracker.errors import CapabilityError, DomainError
from tracker.models import ComponentMotion, ComponentSensor, atan2, cos, diagonal, sin
from tracker.simulation import stream
from tracker_motion import constant_velocity
from tracker_particle import (
    AuxiliaryFilter,
    BootstrapFilter,
    MarginalisedFilter,
    Particles,
    RegularisedFilter,
)
from tracker_sensors import azimuth, position

FILTERS = {
    "bootstrap": BootstrapFilter(particles=200),
    "multinomial": BootstrapFilter(particles=200, resampling="multinomial", threshold=1.0),
    "auxiliary": AuxiliaryFilter(particles=200),
    "regularised": RegularisedFilter(particles=200),
    "gaussian kernel": RegularisedFilter(particles=200, kernel="gaussian"),
    "marginalised": MarginalisedFilter(particles=200),
    # Lanes of so few particles are worked together.
    "few": BootstrapFilter(particles=64, resampling="stratified"),
    "few, auxiliary": AuxiliaryFilter(particles=61),
    "few, regularised": RegularisedFilter(particles=64),
    "few, marginalised": MarginalisedFilter(particles=61),
}
every = pytest.mark.parametrize("name", list(FILTERS))


def errors(history: tk.History, exact: tk.History) -> Any:
    """Of the means, in standard deviations, and of the covariances, relative: one number a run."""
    sigma = np.sqrt(np.einsum("tii...->ti...", exact.filtered.cov))
    mean = ((history.filtered.mean - exact.filtered.mean) / sigma) ** 2
    size = sigma[:, :, None] * sigma[:, None]
    cov = ((history.filtered.cov - exact.filtered.cov) / size) ** 2
    return np.sqrt(mean.mean(axis=(0, 1))), np.sqrt(cov.mean(axis=(0, 1, 2)))


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("rule", "largest", "rate"),
    [
        (BootstrapFilter(), 12.0, 0.5),
        (BootstrapFilter(resampling="residual"), 12.0, 0.5),
        (AuxiliaryFilter(), 8.0, 0.5),
        (MarginalisedFilter(), 8.0, 0.5),
        (RegularisedFilter(), 2.0, 0.25),
        (RegularisedFilter(kernel="gaussian"), 2.0, 0.25),
    ],
    ids=["bootstrap", "residual", "auxiliary", "marginalised", "regularised", "gaussian kernel"],
)
def test_it_converges_to_the_kalman_filter(rule: Any, largest: float, rate: float) -> None:
    models, record, prior = linear()
    runs = 24
    many = tk.Record(record.t, np.repeat(record.z[..., None], runs, axis=-1))
    exact = kalman(models, many, prior)
    found = {}
    for count in (250, 4000):
        history = ran(attrs.evolve(rule, particles=count), (models, many, prior))
        mean, cov = errors(history, exact)
        found[count] = mean.mean(), cov.mean()
        assert mean.mean() * count**rate < largest, (
            f"{count} particles are {mean.mean():.3f} sigma off"
        )
    # 16 times as many particles: 4 times less error at 1/sqrt(N). 24 runs know it to some 10 %, so
    # that a factor 30 % short is a false alarm of about 1e-3 for each of the six.
    for before, after in zip(found[250], found[4000], strict=True):
        assert before / after > 0.7 * 16.0**rate, f"from {before:.3f} only to {after:.3f}"


@pytest.mark.parametrize("batch", [(), (5,), (2, 3)])
def test_with_every_component_linear_the_marginalised_filter_is_the_kalman_filter(
    batch: tuple[int, ...],
) -> None:
    problem = linear(batch=batch)
    exact = kalman(*problem)
    for count in (1, 7, 64):
        history = ran(MarginalisedFilter(linear=PLANE, particles=count), problem)
        for name in ("mean", "cov"):
            for stage in ("predicted", "filtered"):
                ours, theirs = (getattr(getattr(h, stage), name) for h in (history, exact))
                assert np.abs(ours - theirs).max() < 1e-9 * np.abs(theirs).max()
        for name in ("S", "nis", "loglik", "count"):
            ours, theirs = (getattr(h.innovation, name) for h in (history, exact))
            assert np.abs(ours - theirs).max() < 1e-9, name


def test_the_marginalised_filter_is_the_kalman_filter_where_particles_have_no_choice() -> None:
    """Position is known at the start and moves without noise: its particles are all the same."""

    def advance(x: Any, v: Any, a: Any, *, dt: Any) -> Any:
        return (x + 3.0 * dt, v + dt * x * a, a)

    models = {
        "motion": ComponentMotion(
            name="driven", advance=advance, space=tk.Space.of("x [m]", "v [m/s]", "a [1/s^2]"),
            noise=lambda *, dt: diagonal(0.0, 0.3 * dt, 0.1 * dt),
        ),
        "sensor": ComponentSensor(
            name="v", measure=lambda v: (v,), noise=lambda: ((0.5,),), space=tk.Space.of("z"),
            state=tk.Space.of("x [m]", "v [m/s]", "a [1/s^2]"),
        ),
    }  # fmt: skip
    z = np.random.default_rng(1).standard_normal((15, 1))
    record = tk.Record(0.2 * np.arange(1, 16), z)
    prior = tk.Gaussian(np.array([1.0, 0.0, 0.2]), np.diag([0.0, 2.0, 1.0]))
    exact = tk.filter(tk.estimator("ekf1", **models), record, prior, start=0.0)
    history = ran(MarginalisedFilter(linear=("v", "a"), particles=50), (models, record, prior))
    assert np.abs(history.filtered.mean - exact.filtered.mean).max() < 1e-9
    assert np.abs(history.filtered.cov - exact.filtered.cov).max() < 1e-9
    assert np.abs(history.innovation.loglik - exact.innovation.loglik).max() < 1e-9


def test_the_marginalised_filter_refuses_what_is_not_linear() -> None:
    record = tk.Record([1.0, 2.0], np.full((2, 1), 0.3))
    prior = tk.Gaussian([100.0, 50.0, 1.0, 2.0], np.eye(4))
    bearing = azimuth(0.1).at(sx=0.0, sy=0.0)
    motion = constant_velocity(density=0.1)
    rule = MarginalisedFilter(linear=("x", "vx"))
    with pytest.raises(CapabilityError, match="linear in x, vx"):
        ran(rule, ({"motion": motion, "sensor": bearing}, record, prior))
    space = tk.Space.of("x [m]", "y [m]", "vx [m/s]", "vy [m/s]", "turn [rad/s]")

    def turned(x: Any, y: Any, vx: Any, vy: Any, turn: Any, *, dt: Any) -> Any:
        c, s = cos(turn * dt), sin(turn * dt)
        return (x + dt * vx, y + dt * vy, c * vx - s * vy, s * vx + c * vy, turn)

    turn = ComponentMotion(
        name="turn", advance=turned, space=space,
        noise=lambda *, dt: diagonal(dt, dt, dt, dt, 0.01 * dt),
    )  # fmt: skip
    five = tk.Gaussian(np.array([100.0, 50.0, 1.0, 2.0, 0.1]), np.eye(5))
    models = {"motion": turn, "sensor": position(sigma=1.0).over(space)}
    both = tk.Record([1.0, 2.0], np.full((2, 2), 0.3))
    with pytest.raises(CapabilityError, match="linear in turn"):
        ran(MarginalisedFilter(linear=("turn",)), (models, both, five))
    still = tk.Record([0.0, 1.0], np.full((2, 2), 0.3))
    with pytest.raises(CapabilityError, match="linear in turn"):  # over no time all is linear
        tk.filter(
            tk.estimator(MarginalisedFilter(linear=("turn",)), **models), still, five,
            rng=np.random.default_rng(1),
        )  # fmt: skip
    velocities = ran(MarginalisedFilter(), (models, both, five))  # linear, given the rate of turn
    assert velocities.innovation.ok.all()


@every
def test_the_same_seed_gives_the_same_in_any_company(name: str) -> None:
    models, record, prior = linear(batch=(5,))
    rule = FILTERS[name]

    def generators(lanes: Any) -> Any:
        return [stream(3, int(lane), "filter") for lane in lanes]

    whole = ran(rule, (models, record, prior), rng=generators(range(5)))
    again = ran(rule, (models, record, prior), rng=generators(range(5)))
    assert np.array_equal(whole.filtered.mean, again.filtered.mean)
    for lanes in ([3, 1], [4, 0, 2]):
        some = tk.Record(record.t, record.z[..., lanes])
        few = ran(rule, (models, some, prior), rng=generators(lanes))
        for stage in ("predicted", "filtered"):
            ours, theirs = getattr(few, stage), getattr(whole, stage)
            assert np.array_equal(ours.mean, theirs.mean[..., lanes]), stage
            assert np.array_equal(ours.cov, theirs.cov[..., lanes]), stage
        assert np.array_equal(few.innovation.loglik, whole.innovation.loglik[..., lanes])
    alone = ran(
        rule, (models, tk.Record(record.t, record.z[..., 2]), prior), rng=stream(3, 2, "filter")
    )
    assert np.abs(alone.filtered.mean - whole.filtered.mean[..., 2]).max() < 1e-9


@every
def test_models_may_differ_from_lane_to_lane(name: str) -> None:
    models, record, prior = linear(batch=(3,))
    density, rng = np.array([0.1, 0.5, 3.0]), [stream(3, lane, "filter") for lane in range(3)]
    several = {**models, "motion": constant_velocity(density=density)}
    whole = ran(FILTERS[name], (several, record, prior), rng=rng)
    for lane in range(3):
        own = {**models, "motion": constant_velocity(density=float(density[lane]))}
        row = tk.Record(record.t, record.z[..., lane])
        alone = ran(FILTERS[name], (own, row, prior), rng=stream(3, lane, "filter"))
        assert np.abs(alone.filtered.mean - whole.filtered.mean[..., lane]).max() < 1e-8
        assert np.abs(alone.filtered.cov - whole.filtered.cov[..., lane]).max() < 1e-8


@every
def test_tiles_and_threads_change_no_bit(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    models, record, prior = linear(steps=5, batch=(12,))
    estimator = tk.estimator(FILTERS[name], **models)

    def means(workers: int) -> Any:
        rng = np.random.default_rng(2)
        return tk.filter(estimator, record, prior, start=0.0, rng=rng, workers=workers).filtered

    whole = means(1)
    monkeypatch.setattr(tk.estimation, "LANE_BYTES", 8 * 16 * 3)
    for workers in (1, 3):
        tiled = means(workers)
        assert np.array_equal(whole.mean, tiled.mean)
        assert np.array_equal(whole.cov, tiled.cov)


@every
def test_predict_and_update_are_pure_and_beliefs_travel(name: str) -> None:
    models, record, prior = linear()
    rule, motion = FILTERS[name], models["motion"]
    state = rule.begin(prior, rng=np.random.default_rng(1), motion=motion)
    assert rule.begin(state, rng=None) is state
    ahead = rule.predict(state, motion, 1.0)
    copy = pickle.loads(pickle.dumps(ahead))
    first, told = rule.update(ahead, models["sensor"], record.z[0])
    for other in (ahead, copy):
        second, same = rule.update(other, models["sensor"], record.z[0])
        for a, b in (
            (first, second),
            (rule.predict(first, motion, 0.5), rule.predict(second, motion, 0.5)),
        ):
            assert np.array_equal(a.moments().mean, b.moments().mean)
            assert np.array_equal(a.moments().cov, b.moments().cov)
        assert told.loglik == same.loglik


@every
def test_a_row_without_measurement_changes_no_weight(name: str) -> None:
    models, _, prior = linear()
    rule = FILTERS[name]
    for batch in ((), (3,)):
        many = prior if not batch else tk.Gaussian(
            np.repeat(prior.mean[:, None], 3, 1), np.repeat(prior.cov[..., None], 3, 2)
        )  # fmt: skip
        state = rule.begin(many, rng=np.random.default_rng(1), motion=models["motion"])
        ahead = rule.predict(state, models["motion"], 1.0)
        before = getattr(ahead, "particles", ahead)
        after, told = rule.update(ahead, models["sensor"], np.full((2, *batch), np.nan))
        assert np.array_equal(after.log_weights, before.log_weights)
        assert np.array_equal(after.points, before.points)
        assert np.all(told.loglik == 0.0)
        assert np.all(told.nis == 0.0)
        assert np.all(told.ok)


def test_a_diverged_lane_is_flagged_and_a_particle_without_an_answer_is_impossible() -> None:
    def half_blind(x: Any) -> Any:
        with np.errstate(invalid="ignore"):
            return (np.sqrt(x),)

    sensor = ComponentSensor(
        name="root", measure=half_blind, noise=lambda: ((0.01,),), space=tk.Space.of("z")
    )
    rule = BootstrapFilter(particles=400)
    prior = tk.Gaussian(np.zeros(4), np.eye(4))
    state = rule.begin(prior, rng=np.random.default_rng(1))
    after, told = rule.update(state, sensor, np.array([0.5]))
    assert told.ok
    assert (after.log_weights[state.points[0] < 0.0] == -np.inf).all()
    assert abs(np.exp(after.log_weights).sum() - 1.0) < 1e-12
    nowhere = attrs.evolve(
        state, points=np.where([[True], [False], [False], [False]], -1.0, state.points)
    )
    with np.errstate(all="ignore"):
        lost, told = rule.update(nowhere, sensor, np.array([0.5]))
    assert not told.ok
    assert np.isnan(lost.log_weights).all()


def test_noise_that_does_not_reach_all_components_is_a_source_less() -> None:
    """White acceleration held over a step: rank 2 of 4."""
    dt = 1.3
    G = np.kron(np.array([[dt * dt / 2.0], [dt]]), np.eye(2))
    Q = 0.7 * G @ G.T
    motion = ComponentMotion(
        name="held", noise=lambda: tuple(map(tuple, Q.tolist())), space=tk.types.PLANAR,
        advance=lambda x, y, vx, vy, *, dt: (x + dt * vx, y + dt * vy, vx, vy),
    )  # fmt: skip
    start = tk.Gaussian(np.array([1.0, 2.0, 3.0, 4.0]), np.zeros((4, 4)))
    rule = BootstrapFilter(particles=4000)
    state = rule.begin(start, rng=np.random.default_rng(1))
    assert np.ptp(state.points, axis=1).max() == 0.0
    ahead = rule.predict(state, motion, dt)
    d = ahead.points - motion.f(start.mean, dt)[:, None]
    assert np.abs(d[:2] - dt / 2.0 * d[2:]).max() < 1e-12, "noise where there is none"
    scale = np.sqrt(np.diagonal(Q))
    gap = (ahead.moments().cov - Q) / np.outer(scale, scale)
    assert np.abs(gap).max() < 6.0 * np.sqrt(2.0 / 4000)


@every
def test_noise_that_differs_from_particle_to_particle(name: str) -> None:
    """R grows with range, Q with speed: against the same filter's arithmetic, one particle at a time."""
    if "marginalised" in name:
        pytest.skip("its noise must not depend on what is linear")
    motion = ComponentMotion(
        name="gusty", space=tk.types.PLANAR,
        advance=lambda x, y, vx, vy, *, dt: (x + dt * vx, y + dt * vy, vx, vy),
        noise=lambda vx, *, dt: diagonal(0.0, 0.1 * dt, dt * (0.1 + vx * vx), 0.2 * dt),
    )  # fmt: skip
    sensor = ComponentSensor(
        name="faint", measure=lambda x, y: (atan2(y, x), x), space=tk.Space.of("a [rad] circular", "x [m]"),
        noise=lambda x, y: ((0.01 * (x * x + y * y), 0.02), (0.02, 1.0 + 0.1 * x * x)),
    )  # fmt: skip
    rule = FILTERS[name]
    prior = tk.Gaussian(np.array([3.0, 4.0, 1.0, 0.0]), 0.1 * np.eye(4))
    state = rule.begin(prior, rng=np.random.default_rng(1))
    ahead = rule.predict(state, motion, 1.0)
    z = np.array([0.9, 3.5])
    after, told = rule.update(ahead, sensor, z)
    assert told.ok
    if isinstance(ahead, Particles):
        cloud = ahead
        for i in range(0, len(cloud.log_weights), 17):
            x = cloud.points[:, i]
            v, R = z - sensor.h(x), sensor.R(x)
            density = -0.5 * (v @ np.linalg.solve(R, v) + np.linalg.slogdet(2 * np.pi * R)[1])
            own = after.log_weights[i] - cloud.log_weights[i] + told.loglik
            assert abs(own - density) < 1e-9
    many = tk.Gaussian(np.repeat(prior.mean[:, None], 2, 1), np.repeat(prior.cov[..., None], 2, 2))
    lanes = rule.begin(many, rng=[np.random.default_rng(1), np.random.default_rng(2)])
    both, also = rule.update(rule.predict(lanes, motion, 1.0), sensor, np.repeat(z[:, None], 2, 1))
    assert np.abs(both.moments().mean[:, 0] - after.moments().mean).max() < 1e-9
    assert abs(also.loglik[0] - told.loglik) < 1e-9


def test_circular_components_have_circular_moments() -> None:
    space = tk.Space.of("heading [rad] circular", "rate [rad/s]")
    motion = ComponentMotion(
        name="turning", advance=lambda heading, rate, *, dt: (heading + dt * rate, rate),
        noise=lambda *, dt: diagonal(0.01 * dt, 0.01 * dt), space=space,
    )  # fmt: skip
    compass = ComponentSensor(
        name="compass", measure=lambda heading: (heading,), noise=lambda: ((0.05,),),
        space=tk.Space.of("heading [rad] circular"), state=space,
    )  # fmt: skip
    rule = BootstrapFilter(particles=4000)
    found = []
    for turn in (0.0, np.pi):
        state = rule.begin(
            tk.Gaussian(np.array([turn, 0.0]), np.diag([0.2, 0.1])),
            rng=np.random.default_rng(1), motion=motion,
        )  # fmt: skip
        ahead = rule.predict(state, motion, 1.0)
        after, told = rule.update(ahead, compass, np.array([turn + 0.3]))
        found.append((ahead.moments(), after.moments(), told))
    for a, b in zip(*found, strict=True):
        if isinstance(a, tk.Gaussian):
            gap = tk.algebra.wrap(b.mean[0] - a.mean[0] - np.pi)
            assert abs(gap) < 1e-9, "turning everything turns the mean"
            assert -np.pi < b.mean[0] <= np.pi
            assert np.abs(a.cov - b.cov).max() < 1e-9
        else:
            assert abs(a.nis - b.nis) < 1e-9
            assert abs(a.loglik - b.loglik) < 1e-9


def test_the_likelihood_is_unbiased() -> None:
    """The mean of exp(loglik) over many runs is the likelihood of the Kalman filter."""
    models, record, prior = linear(steps=4)
    runs = 3000
    many = tk.Record(record.t, np.repeat(record.z[..., None], runs, axis=-1))
    exact = kalman(models, record, prior).innovation.loglik.sum()
    for rule in (BootstrapFilter(particles=32), AuxiliaryFilter(particles=32)):
        ratio = np.exp(ran(rule, (models, many, prior)).innovation.loglik.sum(axis=0) - exact)
        # 3,000 runs, 5 standard errors: false alarm 1e-6, were the ratios normal.
        assert abs(ratio.mean() - 1.0) < 5.0 * ratio.std() / np.sqrt(runs)


def test_parameters_are_refused_in_words() -> None:
    with pytest.raises(DomainError, match="positive whole number"):
        BootstrapFilter(particles=0)
    with pytest.raises(DomainError, match=r"from 0 .* to 1"):
        BootstrapFilter(threshold=1.5)
    with pytest.raises(DomainError, match="gaussian"):
        RegularisedFilter(kernel="box")
    with pytest.raises(DomainError, match="positive number"):
        RegularisedFilter(bandwidth=0.0)
    models, record, prior = linear()
    with pytest.raises(DomainError, match="heading"):
        ran(MarginalisedFilter(linear=("heading",)), (models, record, prior))
    with pytest.raises(CapabilityError, match="rng"):
        BootstrapFilter().begin(prior)
    with pytest.raises(CapabilityError, match="motion"):
        MarginalisedFilter().begin(prior, rng=np.random.default_rng(1))
    with pytest.raises(CapabilityError, match="generator"):
        tk.filter(tk.estimator("bootstrap", **models), record, prior)


def test_names_and_registry_give_the_same_filters() -> None:
    assert tk.filters.make(
        "regularised", kernel="gaussian", resampling="residual"
    ) == RegularisedFilter(kernel="gaussian", resampling="residual")
    assert str(BootstrapFilter().resampling) == "systematic"
