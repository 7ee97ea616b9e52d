"""Filtering and smoothing records: shapes, missing data, time, sensors, and what a user reads when wrong."""

import math

import attrs
import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

import tracker as tk
from tracker.errors import CapabilityError, DomainError, ShapeError, UnknownComponent
from tracker.estimation import tiles
from tracker.models import ComponentSensor, diagonal
from tracker_motion.constant_velocity import constant_velocity
from tracker_sensors.azimuth import azimuth
from tracker_sensors.position import position
from tracker_sensors.stack import stack

MOTION = constant_velocity(density=0.1)
BEARINGS = stack([azimuth(0.02).at(sx=-1.0, sy=-2.0), azimuth(0.02).at(sx=1.0, sy=1.0)])
PRIOR = tk.Gaussian([0.0, 0.0, 1.0, 0.0], np.diag([0.1, 0.1, 1.0, 1.0]))


def bearings(steps: int, batch: tuple[int, ...] = (), seed: int = 3) -> tk.Record:
    rng = np.random.default_rng(seed)
    t = 0.1 * np.arange(1, steps + 1)
    x = np.stack([0.3 * t, 0.1 * t, 0 * t + 0.3, 0 * t + 0.1])
    z = BEARINGS.h(x).T.reshape(steps, 2, *(1,) * len(batch))
    return tk.Record(t, z + 0.02 * rng.standard_normal((steps, 2, *batch)))


def estimator(**changes) -> tk.Estimator:
    return tk.estimator(**{"motion": MOTION, "sensor": BEARINGS, "smoother": "rts"} | changes)


def test_any_batch_shape_gives_each_lane_what_it_gets_alone():
    est = estimator()
    whole = tk.smooth(est, record := bearings(20, (2, 3)), PRIOR)
    for lane in np.ndindex(2, 3):
        alone = tk.smooth(est, tk.Record(record.t, record.z[(..., *lane)]), PRIOR)
        for a, b in (
            (whole.filtered, alone.filtered),
            (whole.smoothed, alone.smoothed),
            (whole.predicted, alone.predicted),
        ):
            np.testing.assert_allclose(a.mean[(..., *lane)], b.mean, rtol=1e-9, atol=1e-12)
            np.testing.assert_allclose(a.cov[(..., *lane)], b.cov, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(
            whole.innovation.nis[(..., *lane)], alone.innovation.nis, rtol=1e-8
        )


def test_an_empty_batch_and_an_empty_record_give_empty_histories():
    history = tk.smooth(estimator(), bearings(5, (2, 0)), PRIOR)
    assert history.smoothed.mean.shape == (5, 4, 2, 0)
    history = tk.smooth(estimator(), tk.Record(np.zeros(0), np.zeros((0, 2))), PRIOR)
    assert history.filtered.mean.shape == (0, 4)


def test_a_thousand_and_three_lanes_in_tiles_equal_the_same_lanes_in_small_groups_bit_for_bit():
    est = estimator()
    record = bearings(6, (2300,))
    whole = tk.smooth(est, record, PRIOR)
    for lanes in (slice(0, 2), slice(1100, 1109), slice(2293, 2300)):
        part = tk.smooth(est, tk.Record(record.t, record.z[..., lanes]), PRIOR)
        np.testing.assert_array_equal(part.smoothed.mean, whole.smoothed.mean[..., lanes])
        np.testing.assert_array_equal(part.filtered.cov, whole.filtered.cov[..., lanes])


def test_a_missing_component_equals_a_sensor_without_it():
    record = bearings(12)
    z = record.z.copy()
    z[:, 1] = np.nan
    masked = tk.filter(estimator(), tk.Record(record.t, z), PRIOR)
    alone = estimator(sensor=azimuth(0.02).at(sx=-1.0, sy=-2.0))
    plain = tk.filter(alone, tk.Record(record.t, record.z[:, :1]), PRIOR)
    np.testing.assert_allclose(masked.filtered.mean, plain.filtered.mean, atol=1e-12)
    np.testing.assert_allclose(masked.innovation.loglik, plain.innovation.loglik, atol=1e-9)
    assert (masked.innovation.count == 1).all()
    assert np.isnan(masked.innovation.residual[:, 1]).all()


def test_a_row_where_nothing_was_measured_is_a_prediction():
    record = bearings(8, (3,))
    z = record.z.copy()
    z[4] = np.nan
    history = tk.filter(estimator(), tk.Record(record.t, z), PRIOR)
    np.testing.assert_array_equal(history.filtered.mean[4], history.predicted.mean[4])
    np.testing.assert_array_equal(history.filtered.cov[4], history.predicted.cov[4])
    assert (history.innovation.nis[4] == 0).all()
    assert history.innovation.ok[4].all()


@given(st.integers(0, 2**32 - 1))
def test_times_of_its_own_in_each_lane_equal_separate_runs(seed):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.choice([0.0, 0.05, 0.1, 0.4], size=(8, 3)), axis=0)
    z = bearings(8, (3,)).z
    est = estimator()
    whole = tk.smooth(est, tk.Record(t, z), PRIOR, start=0.0)
    for lane in range(3):
        alone = tk.smooth(est, tk.Record(t[:, lane], z[..., lane]), PRIOR, start=0.0)
        np.testing.assert_allclose(whole.smoothed.mean[..., lane], alone.smoothed.mean, atol=1e-9)


def test_two_measurements_at_one_time_equal_one_stacked_measurement():
    sensors = [position(1.0), position(2.0)]
    z = np.array([[0.3, 0.2], [0.5, -0.1]])
    stacked = tk.estimator("kf", motion=MOTION, sensor=stack(sensors))
    one = tk.filter(stacked, tk.Record([0.4], z.reshape(1, 4)), PRIOR, start=0.0)
    apart = tk.estimator("kf", motion=MOTION, sensor=sensors)
    two = tk.filter(apart, tk.Record([0.4, 0.4], z, sensor=[0, 1]), PRIOR, start=0.0)
    np.testing.assert_allclose(two.filtered.mean[-1], one.filtered.mean[-1], atol=1e-12)
    np.testing.assert_allclose(two.filtered.cov[-1], one.filtered.cov[-1], atol=1e-12)
    np.testing.assert_allclose(two.innovation.nis.sum(), one.innovation.nis[0])


def test_sensors_of_different_size_share_a_record_padded_with_nan():
    sensors = [position(1.0), azimuth(0.02)]
    est = tk.estimator(motion=MOTION, sensor=sensors)
    z = np.array([[1.0, 2.0], [0.5, np.nan], [1.2, 2.1]])
    pose = np.array([[0.0, 0.0], [3.0, 3.0], [0.0, 0.0]])
    history = tk.filter(est, tk.Record([1.0, 2.0, 3.0], z, pose=pose, sensor=[0, 1, 0]), PRIOR)
    assert history.innovation.count.tolist() == [2.0, 1.0, 2.0]
    assert np.isfinite(history.filtered.mean).all()


def test_a_lane_that_diverges_stays_nan_and_harms_no_neighbour():
    record = bearings(10, (4,))
    prior = tk.Gaussian(np.repeat(PRIOR.mean[:, None], 4, 1), PRIOR.cov)
    broken = prior.mean.copy()
    broken[0, 2] = np.nan
    whole = tk.smooth(estimator(), record, tk.Gaussian(broken, PRIOR.cov))
    clean = tk.smooth(estimator(), record, prior)
    assert not whole.innovation.ok[:, 2].any()
    assert np.isnan(whole.filtered.mean[:, 0, 2]).all()
    assert np.isnan(whole.innovation.nis[:, 2]).all()
    keep = [0, 1, 3]
    np.testing.assert_array_equal(whole.smoothed.mean[..., keep], clean.smoothed.mean[..., keep])
    assert whole.innovation.ok[:, keep].all()


def test_parameters_may_differ_from_lane_to_lane():
    record = bearings(10, (3,))
    density, sigma = np.array([0.01, 0.1, 1.0]), np.array([0.01, 0.02, 0.05])
    sensor = BEARINGS.with_parameters(sigma_1=sigma, sigma_2=sigma)
    whole = tk.smooth(
        estimator(motion=constant_velocity(density=density), sensor=sensor), record, PRIOR
    )
    for lane in range(3):
        own = BEARINGS.with_parameters(sigma_1=sigma[lane], sigma_2=sigma[lane])
        est = estimator(motion=constant_velocity(density=density[lane]), sensor=own)
        alone = tk.smooth(est, tk.Record(record.t, record.z[..., lane]), PRIOR)
        np.testing.assert_allclose(whole.smoothed.mean[..., lane], alone.smoothed.mean, atol=1e-10)


def test_per_lane_parameters_follow_their_lanes_into_tiles():
    record = bearings(3, (2300,))
    density = np.linspace(0.01, 1.0, 2300)
    whole = tk.filter(estimator(motion=constant_velocity(density=density)), record, PRIOR)
    lanes = slice(2290, 2300)
    est = estimator(motion=constant_velocity(density=density[lanes]))
    part = tk.filter(est, tk.Record(record.t, record.z[..., lanes]), PRIOR)
    np.testing.assert_array_equal(part.filtered.cov, whole.filtered.cov[..., lanes])


def test_on_line_steps_equal_the_record_filtered_at_once():
    est, record = estimator(), bearings(10)
    history = tk.filter(est, record, PRIOR, start=0.0)
    state = PRIOR
    for k in range(10):
        dt = float(record.t[k] - (record.t[k - 1] if k else 0.0))
        state, innovation = est.step(state, record.z[k], dt)
        np.testing.assert_allclose(state.mean, history.filtered.mean[k], atol=1e-12)
        assert innovation.nis == pytest.approx(history.innovation.nis[k], abs=1e-12)


def test_a_known_input_moves_the_target():
    from tracker_motion.acceleration_input import acceleration_input

    motion = acceleration_input(sigma=0.1)
    est = tk.estimator("kf", motion=motion, sensor=position(100.0))
    t = np.arange(1.0, 6.0)
    u = np.tile([1.0, 0.0], (5, 1))
    record = tk.Record(t, np.full((5, 2), np.nan), u=u)
    prior = tk.Gaussian(np.zeros(4), np.eye(4))
    history = tk.filter(est, record, prior, start=0.0)
    np.testing.assert_allclose(history.filtered.mean[:, 0], 0.5 * t**2)


def test_angles_pass_through_the_cut_without_a_jump():
    sensor = azimuth(0.01).at(sx=0.0, sy=0.0)
    t = np.arange(1.0, 41.0)
    x = np.stack([-100.0 + 0 * t, 20.0 - t, 0 * t, 0 * t - 1.0])
    record = tk.Record(t, sensor.h(x).T)
    assert np.ptp(record.z) > 6.0  # it does cross
    est = tk.estimator(motion=MOTION, sensor=sensor)
    prior = tk.Gaussian([-100.0, 20.0, 0.0, -1.0], np.diag([1.0, 1.0, 0.01, 0.01]))
    history = tk.filter(est, record, prior, start=0.0)
    np.testing.assert_allclose(history.filtered.mean, x.T, atol=1e-6)
    assert (history.innovation.nis < 1e-6).all()


# ----------------------------------------------------------------------------- words for mistakes
def opaque(x, y, *, sx, sy):
    return (np.arctan2(y - sy, x - sx),)


def test_an_opaque_sensor_is_refused_by_a_filter_that_needs_its_jacobian():
    sensor = ComponentSensor(
        name="foreign",
        measure=opaque,
        noise=lambda: ((1.0,),),
        space=tk.Space.of("azimuth [rad] circular"),
        pose_space=tk.Space.of("sx [m]", "sy [m]"),
    )
    with pytest.raises(CapabilityError, match=r"a Jacobian.*'foreign'.*tracker\.models"):
        tk.estimator("ekf1", motion=MOTION, sensor=sensor)


def test_the_kalman_filter_refuses_a_nonlinear_sensor_and_names_it():
    with pytest.raises(CapabilityError, match=r"a linear model.*sensor 'stack'"):
        estimator(filter="kf")


def test_smoothing_without_a_smoother_says_how_to_get_one():
    with pytest.raises(CapabilityError, match="smoother='rts'"):
        tk.smooth(estimator(smoother=None), bearings(3), PRIOR)


def test_an_unknown_filter_suggests_the_nearest():
    with pytest.raises(UnknownComponent, match="ekf1"):
        estimator(filter="ekf_1")


def test_a_sensor_that_needs_components_the_motion_lacks_is_refused():
    from tracker_sensors.azimuth_elevation import azimuth_elevation

    with pytest.raises(CapabilityError, match="z"):
        estimator(sensor=azimuth_elevation(0.1, 0.1))


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"z": np.full((3, 2), np.inf)}, DomainError, "replace inf by NaN"),
        ({"t": [3.0, 2.0, 1.0]}, DomainError, "sort the record"),
        ({"t": [1.0, 2.0]}, ShapeError, "one time per measurement row"),
        ({"z": np.zeros(3)}, ShapeError, r"\(T, m, \*batch\)"),
        ({"z": [["a", "b"]] * 3}, DomainError, "real numbers"),
        ({"pose": np.zeros((2, 2))}, ShapeError, "one row per measurement row"),
        ({"sensor": [0.0, 1.0, 2.0]}, ShapeError, "integers"),
    ],
)
def test_a_wrong_record_says_what_came_and_what_to_do(change, error, words):
    with pytest.raises(error, match=words):
        tk.Record(**{"t": [1.0, 2.0, 3.0], "z": np.zeros((3, 2))} | change)


@pytest.mark.parametrize(
    ("record", "prior", "words"),
    [
        (bearings(3), tk.Gaussian([0.0], [[1.0]]), "4: x"),
        (bearings(3, (4,)), tk.Gaussian(np.zeros((4, 3)), np.eye(4)), r"\(\) or \(4,\)"),
        (tk.Record([1.0], np.zeros((1, 1))), PRIOR, "one column per component"),
        (tk.Record([1.0], np.zeros((1, 3))), PRIOR, "got 3 measurement components"),
        (tk.Record([1.0], np.zeros((1, 2)), pose=np.zeros((1, 2))), PRIOR, "no pose"),
        (tk.Record([1.0], np.zeros((1, 2)), u=np.zeros((1, 1))), PRIOR, "no input"),
    ],
)
def test_record_and_prior_that_do_not_fit_are_refused_before_anything_runs(record, prior, words):
    with pytest.raises(ShapeError, match=words):
        tk.filter(estimator(), record, prior)


def test_a_missing_pose_says_which_components_it_has():
    est = tk.estimator(motion=MOTION, sensor=azimuth(0.1))
    with pytest.raises(ShapeError, match=r"sx \[m\], sy \[m\].*\.at\("):
        tk.filter(est, tk.Record([1.0], np.zeros((1, 1))), PRIOR)


def test_a_prior_later_than_the_record_is_refused():
    with pytest.raises(DomainError, match="start"):
        tk.filter(estimator(), bearings(3), PRIOR, start=99.0)


def test_a_third_partys_matrix_without_batch_axes_is_refused_instead_of_broadcast():
    @attrs.frozen(eq=False)
    class Careless:
        space = MOTION.space

        def f(self, x, dt, u=None, t=None):
            return MOTION.f(x, dt)

        def jacobian(self, x, dt, u=None, t=None):
            return MOTION.jacobian(x, dt)

        def Q(self, x, dt):
            return np.eye(4)

    est = tk.estimator(motion=Careless(), sensor=BEARINGS)
    with pytest.raises(ShapeError, match=r"Q.*length 1"):
        tk.filter(est, bearings(3, (4,)), PRIOR)


@pytest.mark.parametrize(
    ("z", "dt", "error", "words"),
    [
        ([0.1], 0.1, ShapeError, "one row per component"),
        ([np.inf, 0.1], 0.1, DomainError, "NaN"),
        ([0.1, 0.1], -1.0, DomainError, "not negative"),
        ([[0.1, 0.1], [0.1, 0.1]], 0.1, ShapeError, "one measurement per lane"),
    ],
)
def test_a_wrong_on_line_step_leaves_nothing_half_done(z, dt, error, words):
    with pytest.raises(error, match=words):
        estimator().step(PRIOR, z, dt)


def test_a_hand_given_jacobian_serves_an_opaque_sensor():
    def derivative(x, y, *, sx, sy):
        r2 = (x - sx) ** 2 + (y - sy) ** 2
        return ((-(y - sy) / r2, (x - sx) / r2),)

    sensor = ComponentSensor(
        name="foreign",
        measure=opaque,
        derivative=derivative,
        noise=lambda *, sigma: diagonal(sigma**2),
        parameters={"sigma": 0.02},
        space=tk.Space.of("azimuth [rad] circular"),
        pose_space=tk.Space.of("sx [m]", "sy [m]"),
    ).at(sx=-1.0, sy=-2.0)
    record = tk.Record(bearings(5, (3,)).t, bearings(5, (3,)).z[:, :1])
    mine = tk.filter(tk.estimator(motion=MOTION, sensor=sensor), record, PRIOR)
    own = tk.estimator(motion=MOTION, sensor=azimuth(0.02).at(sx=-1.0, sy=-2.0))
    np.testing.assert_allclose(mine.filtered.mean, tk.filter(own, record, PRIOR).filtered.mean)


def test_a_measurement_of_one_target_is_not_spread_over_as_many_lanes_as_it_has_components():
    pair = tk.Gaussian(np.zeros((4, 2)), np.eye(4))
    with pytest.raises(ShapeError, match=r"expected \(2, 2\)"):
        estimator().step(pair, [0.1, 0.2], 0.1)


@pytest.mark.parametrize("place", [-1, 1])
def test_an_on_line_step_of_a_sensor_that_is_not_there_is_refused(place):
    with pytest.raises(DomainError, match="0 to 0"):
        estimator().step(PRIOR, [0.1, 0.1], 0.1, sensor=place)


def test_a_record_for_several_sensors_must_say_which_one_measured():
    est = estimator(sensor=[position(1.0), position(9.0)])
    with pytest.raises(DomainError, match="which of the 2 sensors"):
        tk.filter(est, bearings(3), PRIOR)


def test_a_state_that_is_not_finite_is_flagged_alike_alone_and_among_lanes():
    broken = tk.Gaussian.trusted(np.array([0.0, 0.0, np.nan, 0.0]), np.diag([1.0, 1.0, 0.0, 1.0]))
    est = estimator(sensor=position(1.0))
    _, alone = est.step(broken, [0.1, 0.2], 0.0)
    _, lanes = est.step(broken[..., None][..., [0, 0]], np.full((2, 2), 0.1), 0.0)
    assert not alone.ok
    assert not lanes.ok.any()


def test_no_tile_holds_one_lane_alone():
    for lanes in range(2, 40):
        widths = [len(range(lanes)[tile]) for tile in tiles((lanes,), 75)]
        assert min(widths) > 1
        assert sum(widths) == lanes


def test_a_bare_name_that_needs_parameters_says_how_to_give_them():
    with pytest.raises(CapabilityError, match=r"motions\.make\('constant_velocity'"):
        tk.estimator(motion="constant_velocity", sensor=BEARINGS)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"motion": BEARINGS, "sensor": MOTION}, "no method 'f'"),
        ({"sensor": []}, "needs a sensor"),
        ({"filter": object()}, "no method 'predict'"),
    ],
)
def test_parts_that_play_no_part_are_refused_by_name(change, words):
    with pytest.raises(CapabilityError, match=words):
        estimator(**change)


@pytest.mark.parametrize(
    ("record", "prior", "words"),
    [
        (np.zeros((3, 2)), PRIOR, r"tk\.Record"),
        (bearings(3), (np.zeros(4), np.eye(4)), r"tk\.Gaussian"),
    ],
)
def test_what_is_no_record_or_prior_is_told_what_to_make(record, prior, words):
    with pytest.raises(CapabilityError, match=words):
        tk.filter(estimator(), record, prior)


def test_nan_is_no_time_step_and_no_start():
    with pytest.raises(DomainError, match="not negative"):
        estimator().step(PRIOR, np.zeros(2), math.nan)
    with pytest.raises(DomainError, match="start"):
        tk.filter(estimator(), bearings(3), PRIOR, start=math.nan)


def test_threads_share_the_lanes_and_change_no_bit():
    est, record = estimator(), bearings(6, (2300,))
    alone = tk.smooth(est, record, PRIOR)
    for workers in (2, 3):
        shared = tk.smooth(est, record, PRIOR, workers=workers)
        np.testing.assert_array_equal(shared.smoothed.mean, alone.smoothed.mean)
        np.testing.assert_array_equal(shared.innovation.loglik, alone.innovation.loglik)
    with pytest.raises(DomainError, match="workers"):
        tk.smooth(est, record, PRIOR, workers=0)


def test_a_record_cut_in_two_resumes_where_it_was_left():
    est, record = estimator(smoother=None), bearings(20, (9,))
    whole = tk.filter(est, record, PRIOR, start=0.0)
    first = tk.filter(est, tk.Record(record.t[:8], record.z[:8]), PRIOR, start=0.0)
    rest = tk.filter(
        est, tk.Record(record.t[8:], record.z[8:]), first.filtered.at(-1), start=record.t[7]
    )
    np.testing.assert_array_equal(rest.filtered.mean, whole.filtered.mean[8:])
    np.testing.assert_array_equal(rest.filtered.cov, whole.filtered.cov[8:])
