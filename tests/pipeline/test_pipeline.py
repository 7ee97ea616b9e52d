"""The pipeline: equal to filters run by hand, indifferent to order and batch, clear when it refuses."""

import pickle
from typing import Any

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.errors import CapabilityError, DomainError, ShapeError
from tracker.models import ComponentSensor
from tracker.pipeline import Pipeline, PipelineHistory
from tracker.types import PLANAR, Array, Association, Gaussian, Scan, Space, Tracks
from tracker_association import ChiSquareGate, GlobalNearestNeighbour, NearestNeighbour
from tracker_kalman import ExtendedKalmanFilter, KalmanFilter
from tracker_motion import constant_velocity
from tracker_sensors import azimuth, position, relative_position

MOTION = constant_velocity(0.1)
START = np.array([[0.0, 60.0, 200.0], [0.0, -40.0, 90.0], [1.0, 0.0, -1.0], [0.0, 2.0, 1.0]])
COV = np.diag([4.0, 4.0, 1.0, 1.0])
IDS = ("a", "b", "c")


def pipeline(**changed: Any) -> Pipeline:
    parts: dict[str, Any] = {
        "motion": MOTION,
        "sensors": {
            "radar": relative_position(2.0),
            "eye": azimuth(0.02, convention="north"),
        },
        "filter": ExtendedKalmanFilter(),
        "gate": ChiSquareGate(0.999),
        "associator": GlobalNearestNeighbour(),
    }
    return Pipeline(**{**parts, **changed})


def tracks(*columns: int, batch: tuple[int, ...] = ()) -> Tracks:
    chosen = list(columns) or [0, 1, 2]
    mean = START[:, chosen].reshape(4, -1, *(1,) * len(batch))
    mean = np.broadcast_to(mean, (4, len(chosen), *batch))
    return Tracks(0.0, Gaussian(mean, COV), tuple(IDS[i] for i in chosen))


def scans(seed: int, batch: tuple[int, ...] = (), count: int = 6) -> list[Scan]:
    """Radar and eye in turn, from a moving pose, with misses, clutter and equal times."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(count):
        t = 0.7 * (k // 2 + 1)
        pose = np.array([-30.0 + t, -50.0])
        places = START[:2] + t * START[2:]
        kept = places[:, rng.random(3) < 0.8]
        clutter = rng.uniform(-100.0, 200.0, (2, rng.integers(0, 4)))
        seen = np.concatenate([kept, clutter], axis=1)[..., *(None,) * len(batch)]
        seen = seen - pose.reshape(2, 1, *(1,) * len(batch))
        seen = seen + rng.normal(0.0, 1.0, (*seen.shape[:2], *batch))
        if k % 2 == 0:
            out.append(Scan(t, seen, pose=pose, sensor="radar"))
        else:
            out.append(Scan(t, np.arctan2(seen[:1], seen[1:]), pose=pose, sensor="eye"))
    return out


def same(one: PipelineHistory, other: PipelineHistory, rtol: float = 0.0) -> None:
    for name in ("t", "mean", "cov", "detection", "residual", "nis", "count"):
        mine, theirs = getattr(one, name), getattr(other, name)
        np.testing.assert_allclose(mine, theirs, rtol=rtol, err_msg=name)


# ---------------------------------------------------------------------------------- what it is
def test_one_target_without_clutter_equals_the_filter_run_by_hand() -> None:
    rule, sensor = ExtendedKalmanFilter(), relative_position(2.0)
    state = Gaussian(START[:, :1], COV)
    pose, t = np.array([5.0, 6.0]), 0.0
    history = pipeline().run(
        tracks(0),
        [Scan(k / 2, [[k / 2 - 5.0], [-6.0]], pose=pose, sensor="radar") for k in range(1, 6)],
    )
    for k in range(5):
        state = rule.predict(state, MOTION, history.t[k] - t)
        t = float(history.t[k])
        state, innovation = rule.update(state, sensor, np.array([[t - 5.0], [-6.0]]), pose)
        np.testing.assert_array_equal(history.mean[k], state.mean)
        np.testing.assert_array_equal(history.cov[k], state.cov)
        np.testing.assert_array_equal(history.nis[k], innovation.nis)
        np.testing.assert_array_equal(history.residual[k], innovation.residual)
    assert (history.count == 2).all()


def test_a_scan_without_detections_equals_a_prediction() -> None:
    empty = Scan(1.5, np.empty((2, 0)), pose=np.zeros(2), sensor="radar")
    after, result = pipeline().step(tracks(), empty)
    predicted = pipeline().predict(tracks(), 1.5)
    np.testing.assert_array_equal(after.state.mean, predicted.state.mean)
    np.testing.assert_array_equal(after.state.cov, predicted.state.cov)
    assert after.t == predicted.t == 1.5
    assert result.detection.tolist() == [-1, -1, -1]
    assert result.innovation.count.tolist() == [0, 0, 0]


def test_scans_of_equal_time_are_used_one_after_the_other() -> None:
    first, second = scans(3)[:2]
    assert first.t == second.t
    history = pipeline().run(tracks(), [first, second])
    assert history.sensor == ("radar", "eye")
    rule = ExtendedKalmanFilter()
    between = Gaussian(history.mean[0], history.cov[0])
    seen = rule.project(between, pipeline().sensors["eye"], second.pose)
    z = np.append(second.z, np.nan)[history.detection[1]][None]
    expected, _ = rule.update(between, pipeline().sensors["eye"], z, second.pose, seen)
    np.testing.assert_array_equal(history.mean[1], expected.mean)


def test_what_was_missed_is_marked_and_history_has_the_promised_shapes() -> None:
    history = pipeline().run(tracks(), scans(1))
    assert history.mean.shape == (6, 4, 3)
    assert history.cov.shape == (6, 4, 4, 3)
    assert history.residual.shape == (6, 2, 3)
    assert history.ids == IDS
    missed = history.detection < 0
    assert missed.any()
    assert not missed.all()
    np.testing.assert_array_equal(np.isnan(history.nis), missed)
    np.testing.assert_array_equal(history.count == 0, missed)
    np.testing.assert_array_equal(np.isnan(history.residual[:, 0]), missed)
    assert np.isnan(history.residual[1::2, 1]).all(), "an azimuth has no second component"
    assert (history.seconds >= 0).all()
    assert "6 scans of eye, radar" in history._repr_html_()


def test_stepping_equals_running() -> None:
    history, state = pipeline().run(tracks(), scans(2)), tracks()
    for k, scan in enumerate(scans(2)):
        state, result = pipeline().step(state, scan)
        np.testing.assert_array_equal(history.mean[k], state.state.mean)
        np.testing.assert_array_equal(history.detection[k], result.detection)


# ------------------------------------------------------------------------------------- its laws
@given(st.integers(0, 2**32 - 1), st.permutations(range(3)))
def test_a_permutation_of_tracks_and_detections_permutes_the_answer(
    seed: int, order: list[int]
) -> None:
    plain = pipeline().run(tracks(), scans(seed))
    rng = np.random.default_rng(seed)
    mixed_scans, orders = [], []
    for scan in scans(seed):
        orders.append(rng.permutation(scan.detections))
        mixed_scans.append(Scan(scan.t, scan.z[:, orders[-1]], None, scan.pose, scan.sensor))
    mixed = pipeline().run(tracks(*order), mixed_scans)
    np.testing.assert_array_equal(mixed.mean, plain.mean[:, :, order])
    for k, columns in enumerate(orders):
        back = np.append(columns, -1)
        np.testing.assert_array_equal(back[mixed.detection[k]], plain.detection[k, order])


@pytest.mark.parametrize("associator", [GlobalNearestNeighbour(), NearestNeighbour()])
def test_lanes_of_a_batch_are_tracked_each_on_its_own(associator: Any) -> None:
    batch = (2, 2)
    here = pipeline(associator=associator)
    together = here.run(tracks(batch=batch), scans(5, batch))
    assert together.mean.shape == (6, 4, 3, *batch)
    for lane in np.ndindex(*batch):
        cut = [
            attrs.evolve(s, z=s.z[(..., *lane)], mask=s.mask[(..., *lane)]) for s in scans(5, batch)
        ]
        alone = here.run(tracks(), cut)
        np.testing.assert_allclose(together.mean[(..., *lane)], alone.mean, rtol=1e-12)
        np.testing.assert_array_equal(together.detection[(..., *lane)], alone.detection)


@given(st.integers(0, 2**32 - 1))
def test_empty_and_masked_slots_change_nothing(seed: int) -> None:
    padded = []
    for scan in scans(seed):
        m = len(scan.z)
        ghost = np.zeros((m, 1)) if m == 1 else START[:2, :1] - np.array([[-30.0], [-50.0]])
        z = np.concatenate([scan.z, np.full((m, 2), np.nan), ghost], axis=1)
        mask = np.ones(z.shape[1], dtype=np.bool_)
        mask[-1] = False
        padded.append(Scan(scan.t, z, mask, scan.pose, scan.sensor))
    same(pipeline().run(tracks(), padded), pipeline().run(tracks(), scans(seed)), rtol=1e-12)


def test_a_detection_measured_in_part_is_gated_and_used_for_what_it_has() -> None:
    gate = ChiSquareGate(0.95)
    here = pipeline(sensors={"radar": position(2.0)}, gate=gate, filter=KalmanFilter())
    deviation = float(np.sqrt(5.0 * (4.0 + 4.0)))
    assert gate.threshold(1) < 5.0 < gate.threshold(2)
    z = np.array([[deviation, 60.0], [np.nan, np.nan]])
    _, result = here.step(tracks(0, 1), Scan(0.0, z, sensor="radar"))
    assert result.detection.tolist() == [-1, 1], "one component, one degree of freedom"
    after, result = here.step(tracks(1), Scan(0.0, z[:, 1:], sensor="radar"))
    assert result.innovation.count.tolist() == [1.0]
    expected, _ = KalmanFilter().update(tracks(1).state, here.sensors["radar"], z[:, 1:])
    np.testing.assert_array_equal(after.state.mean, expected.mean)


def test_a_track_that_is_no_longer_finite_is_missed_and_harms_no_neighbour() -> None:
    mean = START.copy()
    mean[:, 1] = np.nan
    sick = Tracks(0.0, Gaussian(mean, COV), IDS)
    history, healthy = (pipeline().run(t, scans(4)) for t in (sick, tracks(0, 2)))
    assert (history.detection[:, 1] == -1).all()
    assert np.isnan(history.mean[:, :, 1]).all()
    np.testing.assert_array_equal(history.mean[:, :, [0, 2]], healthy.mean)


def test_nothing_given_is_modified_and_read_only_arrays_will_do() -> None:
    given, state = scans(6), tracks()
    arrays: list[Array] = [state.state.mean, state.state.cov, *(s.z for s in given)]
    arrays += [s.pose for s in given if s.pose is not None]
    for array in arrays:
        array.flags.writeable = False
    same(pipeline().run(state, given), pipeline().run(tracks(), scans(6)))


def test_no_scans_and_no_tracks_are_values_like_others() -> None:
    assert len(pipeline().run(tracks(), [])) == 0
    nobody = Tracks(0.0, Gaussian(np.empty((4, 0)), np.empty((4, 4, 0))), ())
    history = pipeline().run(nobody, scans(0))
    assert history.mean.shape == (6, 4, 0)


def test_a_pipeline_travels_to_worker_processes() -> None:
    there = pickle.loads(pickle.dumps(pipeline()))
    same(there.run(tracks(), scans(7)), pipeline().run(tracks(), scans(7)))


def test_progress_is_told_after_every_scan() -> None:
    told: list[tuple[int, int]] = []
    pipeline().run(tracks(), scans(0), progress=lambda done, total: told.append((done, total)))
    assert told == [(k, 6) for k in range(1, 7)]


# ----------------------------------------------------------------------------- what it refuses
def test_scans_of_unknown_sensors_are_an_error_or_passed_over() -> None:
    here = pipeline(sensors={"radar": relative_position(2.0)})
    with pytest.raises(DomainError, match=r"t = 0.7 s: got sensor 'eye'; expected one of radar"):
        here.run(tracks(), scans(0))
    history = here.run(tracks(), scans(0), skip_unknown=True)
    assert set(history.sensor) == {"radar"}


def test_a_late_scan_says_how_late_it_is() -> None:
    late = [*scans(0), *scans(0)[:1]]
    with pytest.raises(DomainError, match=r"t = 0.7 s, 1.4 s before the tracks' t = 2.1 s"):
        pipeline().run(tracks(), late)
    with pytest.raises(DomainError, match="not earlier than the tracks"):
        pipeline().predict(tracks(), -1.0)


def test_a_scan_must_fit_its_sensor() -> None:
    with pytest.raises(ShapeError, match=r"'radar' at t = 1.0 s: z: got shape \(1, 2\)"):
        pipeline().step(tracks(), Scan(1.0, [[0.0, 1.0]], pose=[0.0, 0.0], sensor="radar"))
    for pose in (None, [0.0]):
        with pytest.raises(ShapeError, match=r"pose: got .* fix it once with sensor\.at"):
            pipeline().step(tracks(), Scan(1.0, [[0.0], [1.0]], pose=pose, sensor="radar"))


def test_tracks_need_a_lane_and_an_id_each() -> None:
    single = Tracks(0.0, Gaussian(START[:, 0], COV), ("a",))
    for wrong in (single, attrs.evolve(tracks(), ids=("a", "b"))):
        with pytest.raises(ShapeError, match=r"expected \(4, \d, \*batch\)"):
            pipeline().run(wrong, scans(0))


def test_noise_without_lane_axes_is_refused_before_it_is_added_to_the_wrong_ones() -> None:
    class Flat:
        space, f, jacobian = MOTION.space, MOTION.f, MOTION.jacobian

        def Q(self, x: Array, dt: Any) -> Array:
            return np.eye(4)

    with pytest.raises(ShapeError, match=r"'Flat': Q: got shape \(4, 4\)"):
        pipeline(motion=Flat()).run(tracks(), scans(0))


def test_shared_out_detections_are_refused() -> None:
    class Soft:
        def associate(self, distance: Array, admitted: Any) -> Association:
            tracks, detections = distance.shape
            return Association(np.full((tracks, detections + 1), 1.0 / (detections + 1)))

    with pytest.raises(CapabilityError, match="'Soft': got weights that share"):
        pipeline(associator=Soft()).step(tracks(), scans(0)[0])


# -------------------------------------------------------------------------- what fits together
def test_sensors_are_bound_to_the_state_of_the_motion() -> None:
    solid = pipeline(motion=constant_velocity(0.1, axes=3))
    assert all(sensor.state == solid.motion.space for sensor in solid.sensors.values())


def test_every_mismatch_is_listed_at_once() -> None:
    line = constant_velocity(0.1, axes=1)
    with pytest.raises(CapabilityError) as caught:
        pipeline(motion=line, filter=KalmanFilter())
    message = str(caught.value)
    assert "sensor 'eye': filter 'KalmanFilter' needs a linear model" in message
    assert "such as 'ekf1'" in message
    for name in ("radar", "eye"):
        assert f"sensor '{name}': got a sensor that reads states (x [m], y [m]" in message


def test_a_sensor_that_cannot_be_traced_says_why_it_has_no_jacobian() -> None:
    def measure(x: Any, y: Any) -> Any:
        return (np.interp(x, [0.0, 1.0], [0.0, 1.0]),)

    def noise() -> Any:
        return ((1.0,),)

    table = ComponentSensor(
        name="table", measure=measure, noise=noise, space=Space.of("height [m]"), state=PLANAR
    )
    with pytest.raises(CapabilityError, match=r"sensor 'table': .* needs a Jacobian.*\(.+\)"):
        pipeline(sensors={"table": table})


@pytest.mark.parametrize("role", ["motion", "filter", "gate", "associator"])
def test_what_is_no_component_is_told_what_it_lacks(role: str) -> None:
    with pytest.raises(CapabilityError, match=f"{role} 'object': got no .*pass an? {role}"):
        pipeline(**{role: object()})


def test_a_pipeline_without_sensors_is_refused() -> None:
    with pytest.raises(CapabilityError, match="'sensors': got none"):
        pipeline(sensors={})
