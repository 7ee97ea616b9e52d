"""Sensors and filters written by others run fused, and agree with the arrays; none names the compiler."""

import ast
import importlib
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest

import tracker as tk
from tracker.algebra import (
    congruence,
    factor,
    product,
    residual,
    spread,
    transpose,
    weighted,
    weighted_mean,
)
from tracker.algebra.gaussian import conditioned
from tracker.compile import objects
from tracker.models import ComponentSensor, atan2, wrap
from tracker.models.linearise import linearise
from tracker.types import Gaussian, Projection
from tracker_motion.constant_velocity import constant_velocity
from tracker_motion.coordinated_turn import coordinated_turn
from tracker_sensors.position import position

pytestmark = pytest.mark.skipif(not objects.available(), reason="llvmlite is not installed")

TEMPLATE = Path(__file__).parents[2] / "contrib" / "tracker-template" / "src"

ITERATED = '''\
"""An iterated extended Kalman filter: the update repeated about its own result."""
import attrs
from tracker.algebra import apply, congruence, product, symmetric_product, transpose
from tracker.algebra.gaussian import conditioned
from tracker.models.linearise import linearise
from tracker.types import Gaussian, Projection

@attrs.frozen
class IteratedFilter:
    iterations: int = 3
    needs = ("jacobian",)

    def predict(self, state, motion, dt, u=None, t=None):
        mean, F = linearise(motion, state.mean, dt, u, t)
        return Gaussian.trusted(mean, congruence(F, state.cov) + motion.Q(state.mean, dt))

    def update(self, state, sensor, z, pose=None, projection=None):
        about = state.mean
        for _ in range(self.iterations):
            h, H = linearise(sensor, about, pose)
            ahead, HP = h + apply(H, state.mean - about), product(H, state.cov)
            S = symmetric_product(HP, H) + sensor.R(about, pose)
            result = conditioned(state, sensor, z, Projection(ahead, S, transpose(HP)))
            about = result[0].mean
        return result
'''


def imported(source: str) -> set[str]:
    """Modules that a source imports from."""
    nodes = list(ast.walk(ast.parse(source)))
    names = {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
    return names | {a.name for node in nodes if isinstance(node, ast.Import) for a in node.names}


def test_the_sensor_of_the_template_runs_fused(monkeypatch):
    monkeypatch.syspath_prepend(TEMPLATE)
    module = importlib.import_module("tracker_template.relative_bearing")
    for path in (TEMPLATE / "tracker_template").glob("*.py"):
        assert not any(name.startswith("tracker.compile") for name in imported(path.read_text()))
    rng = np.random.default_rng(1)
    pose = np.cumsum(rng.uniform(0.0, 0.3, (40, 3)), axis=0)  # the heading turns over +-pi
    agree(monkeypatch, "ekf1", module.relative_bearing(0.02), pose=pose)


def test_a_filter_of_25_lines_runs_fused(monkeypatch, tmp_path):
    lines = [line for line in ITERATED.splitlines() if line.strip()]
    assert len(lines) <= 25
    allowed = {"tracker.algebra", "tracker.algebra.gaussian", "tracker.models.linearise"}
    assert imported(ITERATED) <= allowed | {"tracker.types", "attrs"}
    (tmp_path / "iterated_filter.py").write_text(ITERATED)
    monkeypatch.syspath_prepend(tmp_path)
    made = importlib.import_module("iterated_filter").IteratedFilter
    several = agree(monkeypatch, made(3))
    once = agree(monkeypatch, made(1))
    np.testing.assert_allclose(once.filtered.mean, agree(monkeypatch, "ekf1").filtered.mean)
    assert np.abs(several.filtered.mean - once.filtered.mean).max() > 1e-6


# --------------------------------------------------------------------------- sigma points
@attrs.frozen
class Points:
    """Unit points ``(n, s)``, and the weights of mean and covariance ``(s,)``."""

    places: Any
    mean: Any
    cov: Any

    @classmethod
    def symmetric(cls, n: int) -> "Points":
        places = np.sqrt(n) * np.concatenate([np.eye(n), -np.eye(n)], axis=1)
        weights = np.full(2 * n, 0.5 / n)
        return cls(places, weights, weights)

    @classmethod
    def scaled(cls, n: int, alpha: float = 1.0, beta: float = 2.0, kappa: float = 1.0) -> "Points":
        c = alpha**2 * (n + kappa)
        unit = np.concatenate([np.zeros((n, 1)), np.eye(n), -np.eye(n)], axis=1)
        mean = np.r_[1.0 - n / c, np.full(2 * n, 0.5 / c)]
        cov = mean.copy()
        cov[0] += 1.0 - alpha**2 + beta
        return cls(np.sqrt(c) * unit, mean, cov)


@attrs.frozen
class SigmaPointFilter:
    """The unscented filter, in differences about ``h(x)``: they may cross the cut of an angle."""

    points: Any
    needs = ()

    def predict(self, state, motion, dt, u=None, t=None):
        if motion.linear:
            mean, F = linearise(motion, state.mean, dt, u, t)
            return Gaussian.trusted(mean, congruence(F, state.cov) + motion.Q(state.mean, dt))
        rule = self.points(len(state.mean))
        centre = motion.f(state.mean, dt, u, t)
        places = spread(state.mean, factor(state.cov), rule.places)
        d = motion.f(places, dt, u, t) - centre[:, None]
        mean = weighted_mean(d, rule.mean)
        cov = weighted(d - mean[:, None], rule.cov) + motion.Q(state.mean, dt)
        return Gaussian.trusted(centre + mean, cov)

    def update(self, state, sensor, z, pose=None, projection=None):
        rule, L = self.points(len(state.mean)), factor(state.cov)
        centre = sensor.h(state.mean, pose)
        places = sensor.h(spread(state.mean, L, rule.places), pose)
        d = residual(places, centre[:, None], sensor.space.circular)
        mean = weighted_mean(d, rule.mean)
        d = d - mean[:, None]
        S = weighted(d, rule.cov) + sensor.R(state.mean, pose)
        cross = product(L, transpose(weighted_mean(d, (rule.places * rule.cov).T)))
        return conditioned(state, sensor, z, Projection(centre + mean, S, cross))


@pytest.mark.parametrize("points", [Points.symmetric, Points.scaled])
@pytest.mark.parametrize("motion", [constant_velocity(0.1), coordinated_turn(0.1, 0.01)])
def test_a_sigma_point_filter_runs_fused(monkeypatch, points, motion):
    agree(monkeypatch, SigmaPointFilter(points), motion=motion)


def test_sigma_points_may_lie_on_both_sides_of_the_cut_of_an_angle(monkeypatch):
    def away(angle):
        return ComponentSensor(
            name="turned",
            measure=lambda x, y: (wrap(atan2(y + 0.1, x - 5.0) + angle),),
            noise=lambda: ((0.02**2,),),
            space=tk.Space.of("azimuth [rad] circular"),
        )

    rule = SigmaPointFilter(Points.symmetric)
    straddling, ahead = agree(monkeypatch, rule, away(0.0)), agree(monkeypatch, rule, away(3.0))
    np.testing.assert_allclose(straddling.filtered.mean, ahead.filtered.mean, rtol=1e-7)


def test_sigma_points_are_exact_where_everything_is_linear(monkeypatch):
    unscented = agree(monkeypatch, SigmaPointFilter(Points.scaled), position(0.2))
    kalman = agree(monkeypatch, "kf", position(0.2))
    np.testing.assert_allclose(unscented.filtered.mean, kalman.filtered.mean, atol=1e-9)
    np.testing.assert_allclose(unscented.filtered.cov, kalman.filtered.cov, atol=1e-9)


def test_bits_of_sigma_points_on_arrays_do_not_depend_on_the_batch(monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", "off")
    est, record, prior = problem(SigmaPointFilter(Points.scaled), None, None, (500,), None)
    whole = tk.filter(est, record, prior, start=0.0)
    for lanes in (1, 2, 7, 8, 9):
        part = tk.filter(est, tk.Record(record.t, record.z[..., :lanes]), prior, start=0.0)
        np.testing.assert_array_equal(part.filtered.mean, whole.filtered.mean[..., :lanes])
        np.testing.assert_array_equal(part.innovation.nis, whole.innovation.nis[..., :lanes])


# -------------------------------------------------------------------------------- agreement
def problem(rule, sensor, motion, batch, pose):
    motion = motion or constant_velocity(0.1)
    sensor = sensor or tk.scenario("two_stations").sensor
    est = tk.estimator(rule, motion=motion, sensor=sensor)
    rng, steps, n = np.random.default_rng(4), 40, motion.space.size
    t = np.cumsum(rng.uniform(0.02, 0.08, steps))
    start = np.r_[0.1, -0.2, 1.0, 0.3, np.full(n - 4, 0.05)]
    x = start[:, None] + np.r_[start[2:4], np.zeros(n - 2)][:, None] * t
    placed = None if pose is None else pose.T
    z = est.sensors[0].h(x, placed).T.reshape(steps, -1, *(1,) * len(batch))
    z = z + 0.02 * rng.standard_normal((*z.shape[:2], *batch))
    z[rng.random(z.shape) < 0.1] = np.nan
    return est, tk.Record(t, z, pose=pose), tk.Gaussian(start, np.eye(n) * 0.01)


def agree(monkeypatch, rule, sensor=None, *, motion=None, pose=None):
    """The compiled history of some lanes, after comparing it with that of the arrays."""
    found = {}
    for batch in ((), (9,)):
        est, record, prior = problem(rule, sensor, motion, batch, pose)
        for choice in ("off", "require"):
            monkeypatch.setenv("TRACKER_COMPILE", choice)
            found[choice] = tk.filter(est, record, prior, start=0.0)
        a, b = found["off"], found["require"]
        assert a.innovation.ok.all(), "the example diverges: agreement would say nothing"
        for ours, theirs in ((a.predicted, b.predicted), (a.filtered, b.filtered)):
            np.testing.assert_allclose(theirs.mean, ours.mean, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(theirs.cov, ours.cov, rtol=1e-9, atol=1e-9)
        for name in ("nis", "loglik"):
            ours, theirs = getattr(a.innovation, name), getattr(b.innovation, name)
            np.testing.assert_allclose(theirs, ours, rtol=1e-8, atol=1e-9, err_msg=name)
    return found["require"]
