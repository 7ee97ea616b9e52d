"""A sensor that only NumPy can evaluate, between compiled steps: the arrays' results, sooner."""

import attrs
import numpy as np
import pytest

import tracker as tk
from tracker.compile import mixed, objects, run
from tracker.errors import ShapeError
from tracker.estimation import smoothed
from tracker.models import ComponentSensor, diagonal
from tracker.types import Columns
from tracker_kalman import ExtendedKalmanFilter, JosephFilter, RauchTungStriebel
from tracker_motion.acceleration_input import acceleration_input
from tracker_motion.constant_velocity import constant_velocity
from tracker_sensors.range_azimuth import range_azimuth

pytestmark = pytest.mark.skipif(not objects.available(), reason="llvmlite is not installed")


def measure(x, y, *, sx, sy):
    return np.hypot(x - sx, y - sy), np.arctan2(y - sy, x - sx)


def derivative(x, y, *, sx, sy):
    dx, dy = x - sx, y - sy
    r = np.hypot(dx, dy)
    return (dx / r, dy / r), (-dy / r**2, dx / r**2)


def opaque(far=0.1, near=0.02):
    return ComponentSensor(
        name="opaque",
        measure=measure,
        derivative=derivative,
        noise=lambda *, far, near: diagonal(far**2, near**2),
        space=tk.Space.of("range [m]", "azimuth [rad] circular"),
        pose_space=tk.Space.of("sx [m]", "sy [m]"),
        parameters={"far": far, "near": near},
    )


@attrs.frozen
class Stranger:
    """A sensor that inherits nothing; its noise depends on the state."""

    space = tk.Space.of("azimuth [rad] circular")
    pose_space = tk.Space.of("sx [m]", "sy [m]")

    def h(self, x, pose):
        return np.arctan2(x[1] - pose[1], x[0] - pose[0])[None]

    def jacobian(self, x, pose):
        dx, dy = x[0] - pose[0], x[1] - pose[1]
        out = np.zeros((1, *x.shape))
        out[0, 0], out[0, 1] = -dy / (dx**2 + dy**2), dx / (dx**2 + dy**2)
        return out

    def R(self, x, pose):
        return (0.02 + 0.001 * x[2] ** 2)[None, None]

    def residual(self, z, zhat):
        return tk.algebra.residual(z, zhat, True)


def problem(sensors, batch, *, rule=None, motion=None, lanes_of_time=False):
    motion = motion or constant_velocity(density=np.float64(0.1))
    est = tk.estimator(rule or ExtendedKalmanFilter(), motion=motion, sensor=sensors)
    rng, steps = np.random.default_rng(3), 30
    t = np.cumsum(rng.uniform(0.02, 0.1, (steps, *batch) if lanes_of_time else steps), axis=0)
    most = max(s.space.size for s in est.sensors)
    z = 3.0 + 0.05 * rng.standard_normal((steps, most, *batch))
    z[rng.random(z.shape) < 0.1] = np.nan
    which = rng.integers(0, len(sensors), steps) if len(sensors) > 1 else None
    pose = np.array([3.0, 0.0]) + 0.1 * rng.standard_normal((steps, 2))
    u = rng.standard_normal((steps, 2)) if motion.input_space.axes else None
    record = tk.Record(t, z, pose=pose, sensor=which, u=u)
    return est, record, tk.Gaussian([0.1, 0.2, 1.0, 0.3], np.eye(4) * 0.01)


def agree(monkeypatch, est, record, prior, *, start=0.0):
    monkeypatch.setenv("TRACKER_COMPILE", "off")
    arrays = tk.filter(est, record, prior, start=start)
    monkeypatch.setenv("TRACKER_COMPILE", "on")
    assert not mixed.reason(est)
    assert "compiled steps around a sensor on arrays" in est.explain()
    found = tk.filter(est, record, prior, start=start)
    for ours, theirs in ((arrays.predicted, found.predicted), (arrays.filtered, found.filtered)):
        np.testing.assert_allclose(theirs.mean, ours.mean, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(theirs.cov, ours.cov, rtol=1e-9, atol=1e-9)
    for name in ("residual", "S", "nis", "loglik", "count", "ok"):
        ours, theirs = getattr(arrays.innovation, name), getattr(found.innovation, name)
        np.testing.assert_allclose(theirs, ours, rtol=1e-8, atol=1e-9, err_msg=name)
    return found


@pytest.mark.parametrize("batch", [(), (1,), (9,), (16,), (2, 3)])
@pytest.mark.parametrize("sensor", [opaque(), Stranger()])
def test_an_opaque_sensor_agrees_with_the_arrays(monkeypatch, batch, sensor):
    agree(monkeypatch, *problem([sensor], batch))


@pytest.mark.parametrize("start", [None, 0.0])
@pytest.mark.parametrize("batch", [(), (9,)])
def test_opaque_and_traced_sensors_take_turns(monkeypatch, batch, start):
    sensors = [range_azimuth(0.1, 0.02), opaque(), Stranger()]
    agree(monkeypatch, *problem(sensors, batch, lanes_of_time=True), start=start)


def test_noise_per_lane_known_inputs_and_other_filters(monkeypatch):
    sensor = opaque(near=np.linspace(0.01, 0.1, 9))
    motion = acceleration_input(sigma=0.1)
    agree(monkeypatch, *problem([sensor], (9,), rule=JosephFilter(), motion=motion))


@pytest.mark.parametrize("batch", [(), (9,)])
def test_smoothing_does_not_depend_on_what_can_be_traced_of_the_filter(monkeypatch, batch):
    est, record, prior = problem([opaque()], batch, rule=Undecided())
    smoothing = attrs.evolve(est, smoother=RauchTungStriebel())
    monkeypatch.setenv("TRACKER_COMPILE", "on")
    history = tk.filter(est, record, prior)
    assert not run.why_not_backwards(smoothing)
    found = smoothed(smoothing, history).smoothed
    monkeypatch.setenv("TRACKER_COMPILE", "off")
    arrays = smoothed(smoothing, history).smoothed
    np.testing.assert_allclose(found.mean, arrays.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.cov, arrays.cov, rtol=1e-9, atol=1e-9)


def test_a_lane_that_diverges_stays_nan_and_harms_no_neighbour(monkeypatch):
    est, record, prior = problem([opaque()], (9,))
    mean = np.repeat(prior.mean[:, None], 9, axis=1)
    mean[1, 5] = np.nan
    found = agree(monkeypatch, est, record, tk.Gaussian(mean, prior.cov))
    assert found.innovation.ok.all(axis=0).tolist() == [i != 5 for i in range(9)]


def test_bits_do_not_depend_on_how_many_lanes_there_are(monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", "on")
    est, record, prior = problem([opaque(), Stranger()], (1000,))
    whole = tk.filter(est, record, prior)
    for lanes in (1, 7, 8, 9):
        z = record.z[..., :lanes]
        part = tk.filter(est, tk.Record(record.t, z, pose=record.pose, sensor=record.sensor), prior)
        np.testing.assert_array_equal(part.filtered.mean, whole.filtered.mean[..., :lanes])
        np.testing.assert_array_equal(part.filtered.cov, whole.filtered.cov[..., :lanes])


class Undecided(ExtendedKalmanFilter):
    """A filter without a step over components: it looks at the numbers."""

    def update(self, state, sensor, z, pose=None, projection=None):
        if np.max(state.cov[0, 0]) > 1e6:
            z = z * np.nan
        return super().update(state, sensor, z, pose, projection)


class Elsewhere(ExtendedKalmanFilter):
    def update(self, state, sensor, z, pose=None, projection=None):
        first, _ = super().update(state, sensor, z, pose, projection)
        return super().update(state, sensor, z, pose, self.project(first, sensor, pose))


@pytest.mark.parametrize(
    ("rule", "words"), [(Undecided(), "cannot be traced"), (Elsewhere(), "elsewhere than")]
)
def test_a_filter_that_asks_for_more_stays_on_arrays_and_says_why(monkeypatch, rule, words):
    monkeypatch.setenv("TRACKER_COMPILE", "on")
    est, record, prior = problem([opaque()], (9,), rule=rule)
    assert words in mixed.reason(est)
    assert "runs on arrays" in est.explain()
    assert tk.filter(est, record, prior).innovation.ok.all()
    est, *_ = problem([range_azimuth(0.1, 0.02)], (9,), rule=Undecided())
    assert "runs on arrays: filter Undecided cannot be traced" in est.explain()


def test_a_jacobian_whose_columns_change_is_refused(monkeypatch):
    columns = iter([(0, 1), (0, 1), (1, 2)])

    class Fickle(Stranger):
        def linearise(self, x, pose):
            used = next(columns)
            return self.h(x, pose), Columns(self.jacobian(x, pose)[:, list(used)], used, 4)

    monkeypatch.setenv("TRACKER_COMPILE", "on")
    with pytest.raises(ShapeError, match="other columns"):
        tk.filter(*problem([Fickle()], (9,)))
