"""Steps on line refuse what records refuse, and never answer from what was not given."""

import attrs
import numpy as np
import pytest

import tracker as tk
from tracker.algebra.gaussian import conditioned, predicted, projected
from tracker.errors import CapabilityError, DomainError, ShapeError
from tracker.models import ComponentMotion, diagonal, sin
from tracker.types import PLANAR
from tracker_motion import constant_velocity
from tracker_sensors import azimuth, position

PRIOR = tk.Gaussian(np.zeros(4), np.eye(4))
Z = np.array([1.0, 2.0])


@pytest.fixture(params=["on", "off"])
def est(request, monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", request.param)
    return tk.estimator("kf", motion=constant_velocity(0.1), sensor=position(1.0))


def test_what_is_masked_was_not_measured(est):
    masked, _ = est.step(PRIOR, np.ma.masked_array([1.0, 999.0], [False, True]), 1.0)
    missing, _ = est.step(PRIOR, np.array([1.0, np.nan]), 1.0)
    np.testing.assert_array_equal(masked.mean, missing.mean)


@pytest.mark.parametrize(
    ("error", "arguments"),
    [
        (DomainError, {"dt": np.inf}),
        (DomainError, {"dt": np.nan}),
        (DomainError, {"dt": "soon"}),
        (DomainError, {"dt": None}),
        (ShapeError, {"dt": np.ones(3)}),
        (ShapeError, {"u": [1.0]}),
        (ShapeError, {"pose": [1.0, 2.0]}),
        (CapabilityError, {"state": np.zeros(4)}),
        (CapabilityError, {"state": "here"}),
    ],
)
def test_wrong_arguments_are_named(est, error, arguments):
    given = {"state": PRIOR, "z": Z, "dt": 1.0} | arguments
    with pytest.raises(error, match=f"argument '{next(iter(arguments))}'"):
        est.step(**given)


@pytest.mark.parametrize("compiled", ["on", "off"])
def test_a_pose_that_is_not_finite_is_refused(compiled, monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", compiled)
    est = tk.estimator("ekf1", motion=constant_velocity(0.1), sensor=azimuth(0.1))
    prior = tk.Gaussian([5.0, 5.0, 0.0, 0.0], np.eye(4))
    with pytest.raises(DomainError, match="'pose'"):
        est.step(prior, np.array([0.7]), 1.0, pose=[np.nan, 0.0])


@pytest.mark.parametrize("compiled", ["on", "off"])
def test_a_motion_that_reads_the_time_must_be_told_it(compiled, monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", compiled)
    motion = ComponentMotion(
        name="pushed",
        advance=lambda x, y, vx, vy, *, dt, t: (x + dt * vx, y + dt * vy, vx + dt * sin(t), vy),
        noise=lambda *, dt: diagonal(dt, dt, dt, dt),
        space=PLANAR,
    )
    est = tk.estimator("ekf1", motion=motion, sensor=position(1.0))
    with pytest.raises(DomainError, match=r"'t'.*'pushed' reads"):
        est.step(PRIOR, Z, 1.0)
    at_five, _ = est.step(PRIOR, Z, 1.0, t=5.0)
    at_zero, _ = est.step(PRIOR, Z, 1.0, t=0.0)
    assert abs(at_five.mean[2] - at_zero.mean[2]) > 0.1


@pytest.mark.parametrize("rng", [3, [np.random.default_rng(1)] * 3, ["a"]])
def test_generators_are_one_or_one_per_lane(rng):
    scene = tk.scenario("two_stations", steps=3)
    runs = scene.simulate(seed=1, runs=2)
    est = tk.estimator("bootstrap", motion=scene.motion, sensor=scene.sensor)
    with pytest.raises(CapabilityError, match="'rng'"):
        tk.filter(est, runs.record, runs.prior, start=runs.start, rng=rng)


def test_a_random_filter_is_begun_with_a_generator():
    scene = tk.scenario("two_stations", steps=3)
    est = tk.estimator("bootstrap", motion=scene.motion, sensor=scene.sensor)
    with pytest.raises(CapabilityError, match=r"estimator\.begin\(prior, rng="):
        est.step(scene.prior, np.array([0.5, 0.7]), 0.1)


@pytest.mark.parametrize(
    "parts",
    [{"smoother": object()}, {"adapter": object()}, {"filter": type(tk.filters.make("kf"))}],
)
def test_parts_that_are_none_are_refused_when_the_estimator_is_built(parts):
    with pytest.raises(CapabilityError, match=f"argument '{next(iter(parts))}'"):
        tk.estimator(**{"motion": constant_velocity(0.1), "sensor": position(1.0)} | parts)


def test_noise_that_is_no_covariance_is_refused():
    motion = ComponentMotion(
        name="lopsided",
        advance=lambda x, v, *, dt: (x + dt * v, v),
        noise=lambda *, dt: ((dt, 0.1 * dt), (0.9 * dt, dt)),
        space=tk.Space.of("x [m]", "v [m/s]"),
    )
    est = tk.estimator("kf", motion=motion, sensor=position(1.0, axes=1).over(motion.space))
    record = tk.Record(np.arange(3.0), np.zeros((3, 1)))
    with pytest.raises(DomainError, match=r"'lopsided': Q.*not symmetric"):
        tk.filter(est, record, tk.Gaussian(np.zeros(2), np.eye(2)))


def test_a_list_of_estimators_is_no_mapping(est):
    with pytest.raises(CapabilityError, match="'estimators'"):
        tk.monte_carlo([est], tk.scenario("line"), runs=2)


def test_a_filter_may_return_a_plain_gaussian_and_be_compiled(monkeypatch):
    @attrs.frozen
    class Plain:
        needs = ("jacobian",)

        def predict(self, state, motion, dt, u=None, t=None):
            ahead = predicted(state, motion, dt, u, t)
            return tk.Gaussian(ahead.mean, ahead.cov)

        def project(self, state, sensor, pose=None):
            return projected(state, sensor, pose)

        def update(self, state, sensor, z, pose=None, projection=None):
            after, innovation = conditioned(state, sensor, z, self.project(state, sensor, pose))
            return tk.Gaussian(after.mean, after.cov), innovation

    monkeypatch.setenv("TRACKER_COMPILE", "on")
    est = tk.estimator(Plain(), motion=constant_velocity(0.1), sensor=position(1.0))
    assert "one compiled step" in est.explain() or "llvmlite" in est.explain()


def test_a_campaign_tells_of_absurd_certainty_even_if_it_is_rare():
    scene = tk.scenario("growth")
    est = tk.estimator(
        tk.filters.make("bootstrap", particles=300), motion=scene.motion, sensor=scene.sensor
    )
    campaign = tk.monte_carlo(est, scene, runs=40, seed=1)
    assert campaign.rows()[0]["nees"] > 1e3
    assert any("certain" in words or "overconfident" in words for words in campaign.warnings())
