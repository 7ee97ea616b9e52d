"""Several targets, several sensors: the loop that turns scans of detections into tracks.

What a filter, a gate or an associator does is theirs; how tracks start and end, and how good they
are, is decided elsewhere. All tracks are lanes of one array computation.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import attrs
import numpy as np
import numpy.typing as npt

from tracker.algebra import mahalanobis
from tracker.errors import (
    CapabilityError,
    DomainError,
    ShapeError,
    TrackerError,
    a_or_an,
    wording,
)
from tracker.estimation import lacking
from tracker.protocols import Associator, Filter, Gate, MotionModel, SensorModel
from tracker.types import Array, Innovation, Projection, Scan, Tracks

Indices = npt.NDArray[np.intp]

_OFFERS = {
    "motion": ("space", "f", "Q"),
    "sensor": ("space", "pose_space", "state", "h", "R", "residual"),
    "filter": ("needs", "predict", "project", "update"),
    "gate": ("threshold", "admits"),
    "associator": ("associate",),
}


# -------------------------------------------------------------------------------------- values
@attrs.frozen(eq=False)
class ScanResult:
    """What one scan told every track.

    Shapes:
        detection ``(tracks, *batch)``: the slot of the scan that the track was given, -1 if it was
        missed; innovation with lanes ``(tracks, *batch)``, ``count`` 0 where missed.
    """

    t: float
    sensor: str
    detection: Indices
    innovation: Innovation


@attrs.frozen(eq=False)
class PipelineHistory:
    """Every track after every scan.

    Shapes:
        t ``(K,)``; sensor, K names; mean ``(K, n, tracks, *batch)``; cov ``(K, n, n, tracks,
        *batch)``; detection ``(K, tracks, *batch)``, -1 where missed; residual ``(K, m, tracks,
        *batch)``, measured minus predicted, NaN where missed and beyond a sensor's components; nis
        and count ``(K, tracks, *batch)``: normalised innovation squared, NaN where missed, and its
        degrees of freedom; seconds ``(K,)`` of CPU time; ids, one per track.
    Units:
        s, and those of the spaces.
    """

    t: Array
    sensor: tuple[str, ...]
    mean: Array
    cov: Array
    detection: Indices
    residual: Array
    nis: Array
    count: Array
    seconds: Array
    ids: tuple[str, ...]

    def __len__(self) -> int:
        return int(self.t.shape[0])

    def _repr_html_(self) -> str:
        used = float(np.mean(self.detection >= 0)) if self.detection.size else 0.0
        return (
            f"<p><b>PipelineHistory</b>: {len(self)} scans of {', '.join(sorted(set(self.sensor)))}; "
            f"tracks {', '.join(self.ids)}; {used:.0%} of the scans used</p>"
        )


# ------------------------------------------------------------------------------------ pipeline
@attrs.frozen(eq=False, kw_only=True)
class Pipeline:
    """Motion, sensors by name, filter, gate and associator, checked to fit together when built.

    Sensors that can (`over`) are bound to the motion's state space. An associator must give whole
    detections: its weights are 0 or 1.

    Raises:
        CapabilityError: when components do not fit together; every mismatch is listed.
    Laws:
        a permutation of tracks or of detections permutes the answer; a scan without detections
        equals a prediction; the tracks do not depend on tracks in other lanes of the batch.

    Example:
    >>> from tracker_association import ChiSquareGate, GlobalNearestNeighbour
    >>> from tracker_kalman import KalmanFilter
    >>> from tracker_motion import constant_velocity
    >>> from tracker_sensors import position
    >>> from tracker.types import Gaussian
    >>> pipeline = Pipeline(
    ...     motion=constant_velocity(0.1), sensors={"radar": position(1.0)}, filter=KalmanFilter(),
    ...     gate=ChiSquareGate(0.99), associator=GlobalNearestNeighbour())
    >>> start = Gaussian([[0.0, 9.0], [0.0, 9.0], [0.0, 0.0], [0.0, 0.0]], np.eye(4))
    >>> scan = Scan(1.0, [[9.5, 0.5, 50.0], [9.0, 0.0, 50.0]], sensor="radar")
    >>> tracks, result = pipeline.step(Tracks(0.0, start, ("a", "b")), scan)
    >>> result.detection.tolist()
    [1, 0]
    """

    motion: MotionModel
    sensors: Mapping[str, SensorModel]
    filter: Filter[Any]
    gate: Gate
    associator: Associator

    def __attrs_post_init__(self) -> None:
        bound = dict(self.sensors)
        wrong = _unfit(self, bound)
        if wrong:
            raise CapabilityError("these components do not fit together:\n- " + "\n- ".join(wrong))
        object.__setattr__(self, "sensors", bound)

    def predict(self, tracks: Tracks, t: float) -> Tracks:
        """The tracks at a time that is not before theirs.

        Raises:
            DomainError: if it is. ShapeError: if the tracks do not fit the motion.
        """
        _check(self, tracks, ())
        with np.errstate(all="ignore"):
            return Tracks(float(t), self._moved(tracks, float(t)), tracks.ids)

    def step(self, tracks: Tracks, scan: Scan) -> tuple[Tracks, ScanResult]:
        """The tracks after one scan, and what the scan told each of them.

        Raises:
            DomainError: if the scan is earlier than the tracks, or of an unknown sensor.
            ShapeError: if scan or tracks do not fit sensor and motion.
            CapabilityError: if the associator shares detections out in fractions.
        """
        _check(self, tracks, (scan,))
        with np.errstate(all="ignore"):
            return self._step(tracks, scan)

    def run(
        self,
        tracks: Tracks,
        scans: Iterable[Scan],
        *,
        skip_unknown: bool = False,
        progress: Callable[[int, int], None] | None = None,
    ) -> PipelineHistory:
        """The tracks after every scan, in the order given.

        ``skip_unknown`` passes over scans of sensors that the pipeline lacks. ``progress`` is called
        with the number of scans done and to be done.

        Raises:
            as `step`.
        """
        todo = [s for s in scans if not skip_unknown or s.sensor in self.sensors]
        _check(self, tracks, {scan.sensor: scan for scan in reversed(todo)}.values())
        history = _allocated(tracks, todo, self.sensors)
        with np.errstate(all="ignore"):
            for k, scan in enumerate(todo):
                before = time.process_time()
                tracks, result = self._step(tracks, scan)
                history.seconds[k] = time.process_time() - before
                _store(history, k, tracks, result)
                if progress is not None:
                    progress(k + 1, len(todo))
        return history

    # ---------------------------------------------------------------------------------- inside
    def _moved(self, tracks: Tracks, t: float) -> Any:
        dt = t - tracks.t
        if not dt >= 0.0:
            raise DomainError(
                wording(
                    "time of a scan",
                    got=f"t = {t:.15g} s, {-dt:.6g} s before the tracks' t = {tracks.t:.15g} s",
                    expected="scans that are not earlier than the tracks",
                    do="sort the scans by time, and drop those before the tracks start",
                )
            )
        return (
            self.filter.predict(tracks.state, self.motion, dt, None, tracks.t)
            if dt
            else tracks.state
        )

    def _step(self, tracks: Tracks, scan: Scan) -> tuple[Tracks, ScanResult]:
        sensor = _sensor_of(scan, self.sensors)
        pose = scan.pose if sensor.pose_space.size else None
        state = self._moved(tracks, scan.t)
        projection = self.filter.project(state, sensor, pose)
        slot = self._associated(sensor, scan, projection)
        unseen = np.full((scan.z.shape[0], 1, *scan.z.shape[2:]), np.nan)
        choices = np.concatenate([scan.z, unseen], axis=1)  # the last slot is a miss
        z = choices[:, slot] if slot.ndim == 1 else np.take_along_axis(choices, slot[None], axis=1)
        state, innovation = self.filter.update(state, sensor, z, pose, projection)
        detection = np.where(slot == scan.detections, -1, slot)
        return (
            Tracks(scan.t, state, tracks.ids),
            ScanResult(scan.t, scan.sensor, detection, innovation),
        )

    def _associated(self, sensor: SensorModel, scan: Scan, projection: Projection) -> Indices:
        """The slot of each track, ``(tracks, *batch)``; D means missed."""
        lanes = projection.z.shape[1:]
        if not scan.detections:
            return np.zeros(lanes, dtype=np.intp)
        distance, degrees = _distances(sensor, scan.z, projection)
        if degrees is None:
            admitted = self.gate.admits(distance, sensor.space.size)
        else:  # detections of which only some components were measured
            admitted = np.zeros(distance.shape, dtype=np.bool_)
            for m in range(1, sensor.space.size + 1):
                admitted |= (degrees == m) & self.gate.admits(distance, m)
        weights = self.associator.associate(distance, admitted & scan.mask).weights
        slot: Indices = weights.argmax(axis=1)
        if np.count_nonzero(weights) != slot.size:
            raise CapabilityError(
                wording(
                    f"associator {_name(self.associator)!r}",
                    got="weights that share a detection out in fractions",
                    expected="one detection or a miss for each track: weights of 0 and 1",
                    do="use an associator tagged 'hard' (tracker list associator --tag hard)",
                )
            )
        return slot


def _distances(
    sensor: SensorModel, z: Array, projection: Projection
) -> tuple[Array, npt.NDArray[np.intp] | None]:
    """Squared distances ``(tracks, D, *batch)``, and degrees of freedom where they are not all m."""
    v = sensor.residual(z[:, None], projection.z[:, :, None])
    S = projection.S[:, :, :, None]
    missing = np.isnan(z)
    if not missing.any():
        return mahalanobis(v, S), None
    # Row and column of a component that was not measured become those of a unit matrix.
    gone = missing[:, None] | missing[None]
    unit = np.eye(len(z)).reshape(len(z), len(z), *(1,) * (S.ndim - 2))
    S = np.where(gone[:, :, None], unit, S)
    degrees = len(z) - missing.sum(axis=0)
    return mahalanobis(np.where(missing[:, None], 0.0, v), S), degrees


# -------------------------------------------------------------------------------------- checks
def _name(component: Any) -> str:
    return str(getattr(component, "name", type(component).__name__))


def _unfit(pipeline: Pipeline, bound: dict[str, SensorModel]) -> list[str]:
    """Every mismatch in words; sensors that can be bound to the motion's space are replaced."""
    parts: list[tuple[str, str, Any]] = [
        (role, f"{role} {_name(getattr(pipeline, role))!r}", getattr(pipeline, role))
        for role in ("motion", "filter", "gate", "associator")
    ]
    parts += [("sensor", f"sensor {name!r}", sensor) for name, sensor in bound.items()]
    wrong = [
        wording(
            label,
            got=f"no {', '.join(lacks)}",
            expected=f"what tracker.protocols asks of {a_or_an(role)}",
            do=f"pass {a_or_an(role)}, or complete it",
        )
        for role, label, part in parts
        if (lacks := [name for name in _OFFERS[role] if not hasattr(part, name)])
    ]
    if not bound:
        wrong.append(
            wording(
                "argument 'sensors'",
                got="none",
                expected="at least one sensor by the name that its scans carry",
                do="pass for example {'radar': position(6.0)}",
            )
        )
    if wrong:
        return wrong
    needs = tuple(pipeline.filter.needs)
    for role, label, part in parts:
        if role in ("motion", "sensor"):
            words = lacking(f"filter {_name(pipeline.filter)!r}", needs, role, part)
            wrong += [f"{label}: {words}"] if words else []
    space = pipeline.motion.space
    for name, sensor in bound.items():
        if sensor.state == space:
            continue
        try:
            bound[name] = sensor.over(space)  # type: ignore[attr-defined]
        except (AttributeError, TrackerError) as error:
            wrong.append(
                wording(
                    f"sensor {name!r}",
                    got=f"a sensor that reads states ({sensor.state})",
                    expected=f"states of the motion ({space})",
                    do="build it with state=motion.space"
                    + (f" ({error})" if isinstance(error, TrackerError) else ""),
                )
            )
    return wrong


def _check(pipeline: Pipeline, tracks: Tracks, scans: Iterable[Scan]) -> None:
    """What need not be looked at again in every step."""
    motion = pipeline.motion
    moments = tracks.state.moments()
    mean, cov, n = moments.mean, moments.cov, motion.space.size
    if mean.shape[:2] != (n, len(tracks.ids)) or cov.shape != (n, *mean.shape):
        raise ShapeError(
            wording(
                "argument 'tracks'",
                got=f"a mean of shape {mean.shape} for {len(tracks.ids)} ids",
                expected=f"({n}, {len(tracks.ids)}, *batch): {motion.space}, one lane per track",
                do="give the state a tracks axis, also for one track, and one id per track",
            )
        )
    with np.errstate(all="ignore"):
        _check_noise(f"motion {_name(motion)!r}: Q", motion.Q(mean, 0.0), cov.ndim)
        for scan in scans:
            sensor = _sensor_of(scan, pipeline.sensors)
            pose = scan.pose if sensor.pose_space.size else None
            _check_noise(f"sensor {scan.sensor!r}: R", sensor.R(mean, pose), cov.ndim)


def _check_noise(label: str, noise: Array, axes: int) -> None:
    """A matrix without batch axes would be added to lanes along the wrong axes, unnoticed."""
    if noise.ndim != axes:
        raise ShapeError(
            wording(
                label,
                got=f"shape {noise.shape} for several lanes",
                expected=f"{axes} axes; those of the lanes may have length 1",
                do="return it reshaped to (n, n, 1, ...)",
            )
        )


def _sensor_of(scan: Scan, sensors: Mapping[str, SensorModel]) -> SensorModel:
    """The sensor of a scan that fits it."""
    sensor = sensors.get(scan.sensor)
    if sensor is None:
        raise DomainError(
            wording(
                f"a scan at t = {scan.t} s",
                got=f"sensor {scan.sensor!r}",
                expected=f"one of {', '.join(sensors)}",
                do="give the pipeline that sensor, or run with skip_unknown=True",
            )
        )
    if scan.z.shape[0] != sensor.space.size:
        raise ShapeError(
            wording(
                f"a scan of {scan.sensor!r} at t = {scan.t} s: z",
                got=f"shape {scan.z.shape}",
                expected=f"({sensor.space.size}, D, *batch): {sensor.space}",
                do="give one row per component of the sensor's space",
            )
        )
    size = sensor.pose_space.size
    if size and (scan.pose is None or scan.pose.shape[0] != size):
        raise ShapeError(
            wording(
                f"a scan of {scan.sensor!r} at t = {scan.t} s: pose",
                got="nothing" if scan.pose is None else f"shape {scan.pose.shape}",
                expected=f"({size}, *batch): {sensor.pose_space}",
                do="give the pose with the scan, or fix it once with sensor.at(...)",
            )
        )
    return sensor


# ------------------------------------------------------------------------------------- history
def _allocated(
    tracks: Tracks, scans: list[Scan], sensors: Mapping[str, SensorModel]
) -> PipelineHistory:
    n, *lanes = tracks.state.moments().mean.shape
    count = len(scans)
    widest = max(sensor.space.size for sensor in sensors.values())
    return PipelineHistory(
        t=np.array([scan.t for scan in scans], dtype=np.float64),
        sensor=tuple(scan.sensor for scan in scans),
        mean=np.empty((count, n, *lanes)),
        cov=np.empty((count, n, n, *lanes)),
        detection=np.empty((count, *lanes), dtype=np.intp),
        residual=np.full((count, widest, *lanes), np.nan),
        nis=np.empty((count, *lanes)),
        count=np.empty((count, *lanes), dtype=np.intp),
        seconds=np.empty(count),
        ids=tracks.ids,
    )


def _store(history: PipelineHistory, k: int, tracks: Tracks, result: ScanResult) -> None:
    moments, innovation = tracks.state.moments(), result.innovation
    history.mean[k], history.cov[k] = moments.mean, moments.cov
    history.detection[k] = result.detection
    history.residual[k, : len(innovation.residual)] = innovation.residual
    history.nis[k] = np.where(result.detection < 0, np.nan, innovation.nis)
    history.count[k] = innovation.count


__all__ = ["Pipeline", "PipelineHistory", "ScanResult"]
