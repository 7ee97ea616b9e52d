"""Noise adapters and beliefs of other kinds run inside compiled steps, and agree with the arrays.

The adapters are textbook ones, written as a stranger would write them, over arrays and verbs alone.
"""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np
import pytest

import tracker as tk
from tracker.adaptation import Window, with_noise, with_process_noise
from tracker.algebra import apply, congruence, factor, product, transpose
from tracker.algebra.gaussian import conditioned, predicted, projected
from tracker.compile import objects, run
from tracker.errors import CapabilityError
from tracker.models import isnan, less, maximum, where
from tracker.types import LOWER, PARAMETER, SYMMETRIC, Gaussian
from tracker_kalman.ekf1 import ExtendedKalmanFilter
from tracker_motion.constant_velocity import constant_velocity
from tracker_sensors.azimuth import azimuth
from tracker_sensors.position import position
from tracker_sensors.stack import stack

compiled = pytest.mark.skipif(not objects.available(), reason="llvmlite is not installed")


# ---------------------------------------------------------------------------------- adapters
@attrs.frozen(eq=False)
class Forgetting:
    """Memory of `Exponential`."""

    R: Any = attrs.field(metadata=SYMMETRIC)


@attrs.frozen(eq=False)
class Exponential:
    """Mehra's covariance matching with a forgetting factor (1972), diagonal and floored."""

    keep: Any = attrs.field(default=0.95, metadata=PARAMETER)

    tunes = ("R",)

    def begin(self, motion, sensor, prior, pose):
        return Forgetting(sensor.R(prior.mean, pose))

    def tuned(self, memory, motion, sensor):
        return motion, with_noise(sensor, memory.R)

    def adapt(self, memory, step, motion, sensor):
        v, S = step.innovation.residual, step.innovation.S
        rows = []
        for i in range(len(v)):
            row = [0.0 * S[i, j] for j in range(len(v))]
            found = v[i] * v[i] - S[i, i] + memory.R[i, i]
            old = memory.R[i, i]
            new = maximum(self.keep * old + (1.0 - self.keep) * found, 1e-6)
            row[i] = where(isnan(v[i]), old, new)
            rows.append(row)
        return Forgetting(stacked(rows))


def stacked(rows):
    whole = np.empty(
        (len(rows), len(rows[0]), *np.shape(rows[0][0])), dtype=np.asarray(rows[0][0]).dtype
    )
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            whole[i, j] = entry
    return whole


@attrs.frozen(eq=False)
class Matching:
    """Memory of `Windowed`."""

    window: Window
    total: Any
    count: Any


@attrs.frozen(eq=False)
class Windowed:
    """Thesis eq. 3-3 to 3-6 in their plainest form: scales R by how surprising a window was."""

    length: int = 7

    tunes = ("R",)

    def begin(self, motion, sensor, prior, pose):
        zero = np.zeros((1, *prior.mean.shape[1:]))
        return Matching(Window.of(self.length, zero), zero, zero)

    def tuned(self, memory, motion, sensor):
        mean = memory.total / maximum(memory.count, 1.0)
        scale = where(less(memory.count, float(self.length)), 1.0, maximum(mean, 0.1))
        return motion, _Scaled(sensor, scale[0])

    def adapt(self, memory, step, motion, sensor):
        surprise = step.innovation.nis / maximum(step.innovation.count, 1.0)
        new = np.asarray(surprise)[None] if not isinstance(surprise, np.ndarray) else surprise[None]
        new = where(isnan(new), 1.0, new)
        count = where(less(memory.count, float(self.length)), memory.count + 1.0, memory.count)
        return Matching(memory.window.pushed(new), memory.total + new - memory.window.oldest, count)


@attrs.frozen(eq=False)
class _Scaled:
    sensor: Any
    scale: Any

    def __getattr__(self, name):
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.sensor, name)

    def R(self, x, pose=None):
        return self.sensor.R(x, pose) * self.scale


@attrs.frozen(eq=False)
class Motions:
    """Memory of `ProcessNoise`."""

    Q: Any = attrs.field(metadata=SYMMETRIC)


@attrs.frozen(eq=False)
class ProcessNoise:
    """Q from the corrections that were needed: ``K v v' K'`` with a forgetting factor."""

    tunes = ("Q",)

    def begin(self, motion, sensor, prior, pose):
        return Motions(motion.Q(prior.mean, 0.1) + 0.0 * prior.cov)

    def tuned(self, memory, motion, sensor):
        return with_process_noise(motion, memory.Q), sensor

    def adapt(self, memory, step, motion, sensor):
        correction = (step.filtered.mean - step.predicted.mean)[:, None]
        return Motions(0.98 * memory.Q + 0.02 * product(correction, transpose(correction)))


# ------------------------------------------------------------------------------------ beliefs
@attrs.frozen(eq=False)
class Rooted:
    """Belief of `Root`."""

    mean: Any
    factor: Any = attrs.field(metadata=LOWER)

    def moments(self):
        return Gaussian.trusted(self.mean, product(self.factor, transpose(self.factor)))


@attrs.frozen
class Root:
    """A filter that carries a factor (squaring it each time: what counts here is what is carried)."""

    needs = ("jacobian",)

    def begin(self, prior):
        return prior if isinstance(prior, Rooted) else Rooted(prior.mean, factor(prior.cov))

    def predict(self, state, motion, dt, u=None, t=None):
        ahead = predicted(state.moments(), motion, dt, u, t)
        return Rooted(ahead.mean, factor(ahead.cov))

    def project(self, state, sensor, pose=None):
        return projected(state.moments(), sensor, pose)

    def update(self, state, sensor, z, pose=None, projection=None):
        seen = self.project(state, sensor, pose) if projection is None else projection
        after, innovation = conditioned(state.moments(), sensor, z, seen)
        return Rooted(after.mean, factor(after.cov)), innovation


# ------------------------------------------------------------------------------------ problem
STATIONS = [azimuth(0.03).at(sx=1.0, sy=1.0), azimuth(0.03).at(sx=4.0, sy=1.1)]


def problem(batch=(5,), steps=40, several=False, **parts):
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.05, 0.2, steps))
    path = np.stack([0.5 * t, 0.3 * t])[(..., *[None] * len(batch))]
    angles = [np.arctan2(path[1] - y, path[0] - x) for x, y in ((1.0, 1.0), (4.0, 1.1))]
    z = np.stack(angles, axis=1) + 0.05 * rng.standard_normal((steps, 2, *batch))
    z[rng.random(z.shape) < 0.1] = np.nan
    sensor: Any = stack(STATIONS)
    which = None
    if several:
        which = rng.integers(0, 2, steps)
        sensor = STATIONS
        z = np.stack([np.stack([z[k, w], np.full(batch, np.nan)])[:1] for k, w in enumerate(which)])
    est = tk.estimator(
        parts.pop("filter", "ekf1"), motion=constant_velocity(density=0.1), sensor=sensor, **parts
    )
    prior = Gaussian([0.0, 0.0, 0.5, 0.3], np.diag([0.1, 0.1, 1.0, 1.0]))
    return est, tk.Record(t, z, sensor=which), prior


def both(est, record, prior, monkeypatch, run_=tk.filter):
    monkeypatch.setenv("TRACKER_COMPILE", "off")
    arrays = run_(est, record, prior)
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    return arrays, run_(est, record, prior)


def agree(a, b):
    for one, other in (
        (a.filtered.mean, b.filtered.mean),
        (a.filtered.cov, b.filtered.cov),
        (a.predicted.cov, b.predicted.cov),
        (a.innovation.S, b.innovation.S),
        (a.innovation.loglik, b.innovation.loglik),
    ):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


KINDS = {
    "forgetting": {"adapter": Exponential()},
    "window": {"adapter": Windowed()},
    "process noise": {"adapter": ProcessNoise()},
    "factor": {"filter": Root()},
    "factor and window": {"filter": Root(), "adapter": Windowed(3)},
}


@compiled
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("batch", [(), (1,), (11,), (2, 3)])
def test_both_interpretations_agree(kind, batch, monkeypatch):
    est, record, prior = problem(batch, **KINDS[kind])
    agree(*both(est, record, prior, monkeypatch))


@compiled
@pytest.mark.parametrize("kind", KINDS)
def test_smoothing_and_scores_agree_after_adapted_noise(kind, monkeypatch):
    est, record, prior = problem((9,), smoother="rts", **KINDS[kind])
    a, b = both(est, record, prior, monkeypatch, tk.smooth)
    np.testing.assert_allclose(a.smoothed.mean, b.smoothed.mean, rtol=1e-8, atol=1e-10)
    scene = tk.scenario("two_stations", steps=30)
    est = attrs.evolve(est, motion=scene.motion, sensors=(scene.sensor,))
    monkeypatch.setenv("TRACKER_COMPILE", "off")
    slow = tk.monte_carlo(est, scene, runs=40, seed=1).scores["estimator"]["smoother"]
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    fast = tk.monte_carlo(est, scene, runs=40, seed=1).scores["estimator"]["smoother"]
    np.testing.assert_allclose(fast.per_run["nees"], slow.per_run["nees"], rtol=1e-7)


@compiled
def test_each_sensor_has_its_own_memory(monkeypatch):
    est, record, prior = problem((4,), several=True, adapter=Exponential(0.9))
    agree(*both(est, record, prior, monkeypatch))
    assert len(est.begin(prior[..., [0, 0]] if prior.batch else prior).memories) == 2


@compiled
def test_windows_of_several_sensors_run_on_arrays_and_say_why(monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", "on")
    est, record, prior = problem((4,), several=True, adapter=Windowed(3))
    assert "keeps a window for each of several sensors" in est.explain()
    assert tk.filter(est, record, prior).innovation.ok.all()


@compiled
def test_a_number_of_an_adapter_may_differ_per_lane(monkeypatch):
    keep = np.linspace(0.5, 0.99, 6)
    est, record, prior = problem((6,), adapter=Exponential(keep))
    agree(*both(est, record, prior, monkeypatch))
    whole = tk.filter(est, record, prior)
    for lane in range(6):
        alone, _, _ = problem((6,), adapter=Exponential(float(keep[lane])))
        assert run._layout(alone, {}, 0, ()).structure == run._layout(est, {}, 0, ()).structure
        part = tk.filter(alone, record, prior).filtered.mean[..., lane]
        np.testing.assert_array_equal(part, whole.filtered.mean[..., lane])


def test_lanes_are_cut_with_their_numbers(monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", "off")
    lanes = 2100  # more than a tile
    keep = np.linspace(0.5, 0.99, lanes)
    est, record, prior = problem((lanes,), steps=3, adapter=Exponential(keep))
    whole = tk.filter(est, record, prior)
    part = tk.filter(
        attrs.evolve(est, adapter=Exponential(keep[-2:])),
        tk.Record(record.t, record.z[..., -2:]),
        prior,
    )
    np.testing.assert_array_equal(whole.filtered.mean[..., -2:], part.filtered.mean)


@pytest.mark.parametrize("kind", KINDS)
def test_a_step_on_line_equals_the_step_of_a_record(kind):
    est, record, prior = problem((), **KINDS[kind])
    history = tk.filter(est, record, prior)
    state: Any = prior
    before = record.t[0]
    for k, now in enumerate(record.t):
        state, _ = est.step(state, record.z[k], float(now - before))
        np.testing.assert_allclose(state.moments().mean, history.filtered.mean[k], rtol=1e-9)
        before = now


def test_the_window_remembers_what_fell_out_of_it():
    window = Window.of(3, np.zeros((1, 2)))
    seen = []
    for k in range(7):
        seen.append(float(window.oldest[0, 0]))
        window = window.pushed(np.full((1, 2), float(k)))
    assert seen == [0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0]


def test_process_noise_needs_every_measurement():
    with pytest.raises(CapabilityError, match="got 2 sensors"):
        problem((4,), several=True, adapter=ProcessNoise())


@compiled
def test_a_window_that_is_not_fed_says_so(monkeypatch):
    class Idle(Windowed):
        def adapt(self, memory, step, motion, sensor):
            return memory

    monkeypatch.setenv("TRACKER_COMPILE", "on")
    est, _, _ = problem((4,), adapter=Idle())
    assert "a window must be given a value at every step" in est.explain()


def test_adapted_noise_finds_the_true_variance():
    # Position fixes with sigma 3 where 1 is assumed; over 60 lanes and the last 200 of 400 steps the
    # mean of the adapted R has a standard error below 0.2: 9 +- 1 is missed with probability < 1e-5.
    rng = np.random.default_rng(5)
    steps, lanes = 400, 60
    z = 3.0 * rng.standard_normal((steps, 2, lanes))
    est = tk.estimator(
        ExtendedKalmanFilter(),
        motion=constant_velocity(density=1e-4),
        sensor=position(1.0),
        adapter=Exponential(0.98),
    )
    record = tk.Record(np.arange(1.0, steps + 1), z)
    history = tk.filter(est, record, Gaussian(np.zeros(4), np.diag([1.0, 1, 1e-4, 1e-4])))
    S = history.innovation.S[200:, 0, 0].mean() - history.predicted.cov[200:, 0, 0].mean()
    assert abs(S - 9.0) < 1.0
    gains = apply(history.filtered.cov[-1], np.ones((4, lanes)))
    assert np.isfinite(gains).all()
    assert congruence(np.eye(4)[..., None], history.filtered.cov[-1]).shape == (4, 4, lanes)
