"""Late, missing and duplicated measurements: each gives what the same ones in time order give."""

import attrs
import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given
from linear_problems import SENSOR, agree, filtered, problem

import tracker as tk
from tracker.adaptation import with_noise
from tracker.errors import CapabilityError, DomainError, ShapeError
from tracker_kalman import FixedLagSmoother, FixedPoint
from tracker_motion import acceleration_input, constant_velocity
from tracker_sensors import azimuth, position, stack

MOTION = constant_velocity(0.5)
SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(params=["off", "on"], ids=["arrays", "compiled where possible"], autouse=True)
def interpretation(request, monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", request.param)


KF = tk.estimator("kf", motion=MOTION, sensor=SENSOR, smoother="rts")


def shuffled(rng, count, most):
    """An order of arrival in which no row is overtaken by more than ``most`` later ones."""
    return np.argsort(np.arange(count) + rng.uniform(0.0, most + 0.99, count), kind="stable")


@pytest.mark.parametrize("batch", [(), (7,), (3, 5)], ids=str)
@given(seed=SEEDS)
def test_late_measurements_give_what_the_filter_gives_in_time_order(batch, seed):
    task, rng = problem(seed, batch), np.random.default_rng(seed)
    record = task.record
    order = shuffled(rng, len(record), 4)
    window = tk.FixedLag.begin(KF, task.prior, float(record.t[0]), lag=6)
    for k in order:
        window = window.step(record.z[k], record.t[k])
    # Equal times may have been swapped: on linear problems that changes nothing but rounding.
    truth = filtered(task)
    scale = 1.0 + np.sqrt(np.einsum("tii...->ti...", truth.predicted.cov).max(axis=0))
    for name, gap in (
        ("mean", np.abs(window.state.mean - truth.filtered.mean[-1]) / scale),
        ("cov", np.abs(window.state.cov - truth.filtered.cov[-1]) / (scale * scale[:, None])),
    ):
        assert gap.max() < 1e-9, f"{name} of late measurements differs by {gap.max():.1e}"


@given(seed=SEEDS)
def test_with_a_nonlinear_filter_the_result_is_that_of_time_order_bit_for_bit(seed):
    rng = np.random.default_rng(seed)
    sensor = stack([azimuth(0.02).at(sx=0.0, sy=0.0), azimuth(0.02).at(sx=50.0, sy=0.0)])
    est = tk.estimator("ekf1", motion=MOTION, sensor=sensor)
    t = np.cumsum(rng.uniform(0.1, 2.0, 12))
    truth = np.stack([20.0 + t, 30.0 + 0.5 * t, 0 * t + 1.0, 0 * t + 0.5])
    z = sensor.h(truth).T + rng.normal(0.0, 0.02, (12, 2))
    prior = tk.Gaussian([20.0, 30.0, 0.0, 0.0], np.diag([25.0, 25.0, 4.0, 4.0]))
    straight = late = tk.FixedLag.begin(est, prior, lag=6)
    for k in range(12):
        straight = straight.step(z[k], t[k])
    for k in shuffled(rng, 12, 4):
        late = late.step(z[k], t[k])
    assert np.array_equal(late.state.mean, straight.state.mean)
    assert np.array_equal(late.state.cov, straight.state.cov)
    assert late.t == straight.t == t[-1]


@pytest.mark.parametrize("batch", [(), (3,)], ids=str)
@given(seed=SEEDS)
def test_of_equal_times_the_order_does_not_matter_and_each_counts(batch, seed):
    rng = np.random.default_rng(seed)
    z = rng.normal(0.0, 5.0, (3, 2, *batch))
    prior = tk.Gaussian(np.zeros((4, *batch)), np.diag([100.0, 100.0, 4.0, 4.0]))
    found = []
    for order in ([0, 1, 2], [2, 1, 0], [1, 2, 0]):
        window = tk.FixedLag.begin(KF, prior, 0.0, lag=5)
        for k in order:
            window = window.step(z[k], 1.5)
        found.append(window.state)
    for other in found[1:]:
        np.testing.assert_allclose(other.mean, found[0].mean, rtol=0, atol=1e-9)
        np.testing.assert_allclose(other.cov, found[0].cov, rtol=0, atol=1e-9)
    # Three measurements of one instant are one measurement: their mean, with a third of the variance.
    one = tk.estimator("kf", motion=MOTION, sensor=position(3.0 / np.sqrt(3.0)))
    state, _ = one.step(prior, z.mean(axis=0), 1.5)
    np.testing.assert_allclose(state.mean, found[0].mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(state.cov, found[0].cov, rtol=0, atol=1e-9)


@given(seed=SEEDS)
def test_a_measurement_of_nothing_changes_nothing_but_the_time(seed):
    task = problem(seed, steps=8)
    window = tk.FixedLag.begin(KF, task.prior, float(task.record.t[0]))
    for z, t in zip(task.record.z, task.record.t, strict=True):
        window = window.step(z, t)
    rng = np.random.default_rng(seed)
    late = float(rng.uniform(task.record.t[0], task.record.t[-1]))
    other = window.step([np.nan, np.nan], late)
    np.testing.assert_allclose(other.state.mean, window.state.mean, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(other.state.cov, window.state.cov, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("batch", [(), (3,)], ids=str)
@given(seed=SEEDS)
def test_on_line_a_fixed_lag_is_the_fixed_lag_smoother_of_the_record(batch, seed):
    task = problem(seed, batch)
    record, lag = task.record, 4
    truth = FixedLagSmoother(lag).smooth(filtered(task), MOTION).smoothed
    window = tk.FixedLag.begin(KF, task.prior, float(record.t[0]), lag=lag)
    for k in range(len(record)):
        window = window.step(record.z[k], record.t[k])
        if k >= lag:
            times, found = window.smoothed()
            assert times[0] == record.t[k - lag]
            scale = 1.0 + np.abs(truth.mean[k - lag]).max()
            assert np.abs(found.mean[0] - truth.mean[k - lag]).max() < 1e-8 * scale
            assert np.abs(found.cov[0] - truth.cov[k - lag]).max() < 1e-8 * scale**2


@given(seed=SEEDS)
def test_retrodiction_is_the_exact_estimate_of_a_past_time(seed):
    task, rng = problem(seed), np.random.default_rng(seed)
    record = task.record
    window = tk.FixedLag.begin(KF, task.prior, float(record.t[0]), lag=50)
    for z, t in zip(record.z, record.t, strict=True):
        window = window.step(z, t)
    past = float(rng.uniform(record.t[0], record.t[-1]))
    place = int(np.searchsorted(record.t, past, side="right"))
    with_row = attrs.evolve(
        task,
        record=tk.Record(np.insert(record.t, place, past), np.insert(record.z, place, np.nan, 0)),
        density=np.insert(task.density, place, 0.5, 0),
    )
    exact = FixedPoint.along(filtered(with_row), MOTION, place)  # checked against least squares
    found = window.at(past)
    np.testing.assert_allclose(found.mean, exact.mean[-1], rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(found.cov, exact.cov[-1], rtol=1e-8, atol=1e-7)
    ahead = window.at(window.t + 2.0)
    expected = KF.filter.predict(window.state, MOTION, 2.0)
    np.testing.assert_allclose(ahead.mean, expected.mean, rtol=1e-12)


# ------------------------------------------------------------------------ adapted and exchanged
@attrs.frozen
class Restless:
    """An adapter that doubles R with every step: no tuning anyone wants, but one that is known."""

    tunes = ("R",)

    def begin(self, motion, sensor, prior, pose):
        return Memory(np.array(1.0))

    def tuned(self, memory, motion, sensor):
        return motion, with_noise(sensor, memory.factor * 9.0 * np.eye(2))

    def adapt(self, memory, step, motion, sensor):
        return Memory(memory.factor * 2.0)


@attrs.frozen(eq=False)
class Memory:
    factor: np.ndarray


def test_what_an_adapter_learnt_is_learnt_again_in_time_order():
    est = attrs.evolve(KF, adapter=Restless())
    task = problem(5)
    record = tk.Record(np.arange(12.0), task.record.z)
    history = tk.smooth(est, record, task.prior)
    window = tk.FixedLag.begin(est, task.prior, 0.0, lag=12)
    for k in (0, 1, 3, 2, 4, 5, 8, 7, 6, 9, 11, 10):
        window = window.step(record.z[k], record.t[k])
    np.testing.assert_allclose(window.state.moments().mean, history.filtered.mean[-1], rtol=1e-9)
    _, found = window.smoothed()
    np.testing.assert_allclose(found.mean[1:], history.smoothed.mean, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(found.cov[1:], history.smoothed.cov, rtol=1e-8, atol=1e-8)


def test_steps_keep_the_estimator_that_they_were_made_with():
    task = problem(11, varied=True)
    record = task.record
    window = tk.FixedLag.begin(KF, task.prior, float(record.t[0]), lag=50)
    for k in range(len(record)):
        built = tk.estimator("kf", motion=task.motion(k), sensor=SENSOR, smoother="rts")
        window = attrs.evolve(window, estimator=built).step(record.z[k], record.t[k])
    _, found = window.smoothed()
    agree(tk.Trajectory(found.mean[1:], found.cov[1:]), task, (), "exchanged estimators")


# ------------------------------------------------------------------------------ what is refused
def test_what_is_older_than_the_window_is_refused_in_words():
    window = tk.FixedLag.begin(KF, tk.Gaussian(np.zeros(4), np.eye(4)), 0.0, lag=2)
    for t in (1.0, 2.0, 3.0):
        window = window.step([0.0, 0.0], t)
    assert window.begun == 1.0
    with pytest.raises(DomainError, match=r"0.5 s.*1.0 s on.*lag of more than 2 steps"):
        window.step([0.0, 0.0], 0.5)
    with pytest.raises(DomainError, match="nan"):
        window.step([0.0, 0.0], np.nan)
    with pytest.raises(ShapeError, match="one time for all lanes"):
        window.step([0.0, 0.0], np.array([4.0, 5.0]))
    with pytest.raises(DomainError, match=r"'lag'.*got 0"):
        tk.FixedLag.begin(KF, tk.Gaussian(np.zeros(4), np.eye(4)), lag=0)
    bare = attrs.evolve(window, estimator=attrs.evolve(KF, smoother=None))
    with pytest.raises(CapabilityError, match="smoother='rts'"):
        bare.smoothed()


PRIOR = tk.Gaussian(np.zeros(4), np.eye(4))


def test_what_is_older_than_the_prior_needs_an_older_prior_and_no_longer_lag():
    window = tk.FixedLag.begin(KF, PRIOR, 10.0, lag=1)
    older = r"9\.0 s; expected a time from 10\.0 s on, that of the prior.* prior of an earlier time"
    with pytest.raises(DomainError, match=older) as caught:
        window.step([0.0, 0.0], 9.0)
    assert "lag" not in str(caught.value).split("begin with")[1].split(":")[0]
    window = window.step([0.0, 0.0], 11.0).step([0.0, 0.0], 12.0)
    with pytest.raises(DomainError, match=r"10\.5 s.*11\.0 s on.*lag of more than 1 step\."):
        window.step([0.0, 0.0], 10.5)
    with pytest.raises(DomainError, match="that of the prior"):
        window.at(9.0)


@pytest.mark.parametrize("t", [np.nan, np.inf, -np.inf])
def test_a_time_that_is_not_finite_is_called_that(t):
    window = tk.FixedLag.begin(KF, PRIOR, lag=3)
    for refused in (
        lambda: window.step([0.0, 0.0], t),
        lambda: window.at(t),
        lambda: tk.FixedLag.begin(KF, PRIOR, t),
    ):
        with pytest.raises(DomainError, match="finite number of seconds") as caught:
            refused()
        assert "lag" not in str(caught.value)


@pytest.mark.parametrize("lag", [2.5, np.nan, "3", None, True, -1])
def test_a_lag_is_a_whole_number_of_steps_and_not_of_seconds(lag):
    words = r"'lag'.*whole number of steps.*not in seconds"
    for refused in (
        lambda: tk.FixedLag.begin(KF, PRIOR, lag=lag),
        lambda: attrs.evolve(tk.FixedLag.begin(KF, PRIOR), lag=lag),
        lambda: tk.smoothers.make("fixed_lag", lag=lag),
    ):
        with pytest.raises(DomainError, match=words):
            refused()
    assert tk.FixedLag.begin(KF, PRIOR, lag=np.int64(3)).lag == 3


def test_what_is_masked_was_not_measured():
    window = tk.FixedLag.begin(KF, PRIOR, lag=3)
    masked = window.step(np.ma.array([1.0, 2.0], mask=[False, True]), 1.0)
    missing = window.step([1.0, np.nan], 1.0)
    assert np.array_equal(masked.rows[0].z, [1.0, np.nan], equal_nan=True)
    assert np.array_equal(masked.state.mean, missing.state.mean)
    assert np.array_equal(masked.state.cov, missing.state.cov)
    with pytest.raises(DomainError, match=r"'z'.*texts"):
        window.step(["1", "2"], 1.0)


def test_an_input_or_a_pose_that_is_not_finite_is_refused():
    pushed = tk.estimator("kf", motion=acceleration_input(1.0), sensor=SENSOR)
    window = tk.FixedLag.begin(pushed, PRIOR, lag=3)
    for u in ([np.nan, 0.0], [0.0, np.inf], np.ma.array([0.0, 1.0], mask=[False, True])):
        with pytest.raises(DomainError, match=r"'u'.*finite numbers"):
            window.step([0.0, 0.0], 1.0, u=u)
    with pytest.raises(DomainError, match=r"'pose'.*finite numbers"):
        window.step([0.0, 0.0], 1.0, pose=[np.nan])
    u = np.array([1.0, 2.0])
    after = window.step([0.0, 0.0], 1.0, u=u)
    u[:] = 99.0
    assert after.rows[0].u.tolist() == [1.0, 2.0]


def test_a_window_is_a_value():
    window = tk.FixedLag.begin(KF, tk.Gaussian(np.zeros(4), np.eye(4)), lag=3)
    z = np.array([1.0, 2.0])
    after = window.step(z, 1.0)
    z[:] = 99.0
    assert (window.rows, window.t, window.innovation) == ((), 0.0, None)
    assert after.rows[0].z.tolist() == [1.0, 2.0]
    assert after.innovation is after.rows[-1].innovation
    assert float(after.innovation.count) == 2.0


# -------------------------------------------------------------------- filters of every kind
def test_late_measurements_of_modes_are_smoothed_as_those_in_time():
    motion = tk.motions.make(
        "switching",
        modes=[constant_velocity(0.01), constant_velocity(1.0)],
        transition=[[0.95, 0.05], [0.05, 0.95]],
    )
    est = tk.estimator("imm", motion=motion, sensor=position(2.0), smoother="imm_smoother")
    z = np.random.default_rng(0).normal(0.0, 3.0, (12, 2)) + np.arange(12.0)[:, None]
    prior = tk.Gaussian(np.zeros(4), 100.0 * np.eye(4))
    history = tk.smooth(est, tk.Record(np.arange(12.0), z), prior, start=0.0)
    window = tk.FixedLag.begin(est, prior, 0.0, lag=12)
    for k in (0, 1, 3, 2, 4, 6, 5, 7, 8, 9, 11, 10):
        window = window.step(z[k], float(k))
    found = window.smoothed()[1]
    last = history.filtered.mean[-1]
    np.testing.assert_allclose(window.state.moments().mean, last, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.mean[1:], history.smoothed.mean, rtol=1e-9, atol=1e-9)


def test_particles_that_are_late_draw_as_if_in_time():
    est = tk.estimator("bootstrap", motion=MOTION, sensor=position(2.0))
    prior = tk.Gaussian(np.zeros(4), 100.0 * np.eye(4))
    z = np.random.default_rng(0).normal(0.0, 3.0, (8, 2))
    found = []
    for order in (range(8), (0, 2, 1, 3, 6, 5, 4, 7)):
        window = tk.FixedLag.begin(est, prior, 0.0, lag=8, rng=np.random.default_rng(1))
        for k in order:
            window = window.step(z[k], float(k))
        found.append(window.state.moments())
    assert np.array_equal(found[0].mean, found[1].mean)
    assert np.array_equal(found[0].cov, found[1].cov)
