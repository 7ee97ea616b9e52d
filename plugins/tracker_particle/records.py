"""Whole records of one cloud after the other as one call of machine code each; no filter lives here.

Between two steps nothing is left to Python: `machine.stepping` calls the passes of `kernels`, which
are those of single steps, so that the bits are the same. Where a pass steps aside, the loop stops,
the filter's own methods do that one step, and the loop goes on behind it.
"""

from __future__ import annotations

import ctypes
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import attrs
import numpy as np

from tracker.compile import objects
from tracker.compile.run import MISSING, mode
from tracker.models.parameters import numbers_of
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Array, Gaussian, History, Record
from tracker_particle import alone, kernels, machine
from tracker_particle.belief import Particles
from tracker_particle.propagation import factored, least_size, root
from tracker_particle.resampling import SYSTEMATIC, Scheme

_DOUBLE = np.dtype(np.float64)
_BYTES = 8


@attrs.frozen(eq=False)
class Rule:
    """What the loop is told of a filter: its methods for a step, and how it resamples.

    ``scheme`` is None where resampling is ``renewed`` alone.
    """

    predict: Callable[..., Particles]
    update: Callable[..., Any]
    renewed: Callable[[Particles], Particles]
    threshold: float
    scheme: Scheme | None


def why_not(motion: MotionModel, sensors: Sequence[SensorModel]) -> str:
    """In words, why records are filtered step by step with these models, or ''."""
    if mode() != "on":
        return f"TRACKER_COMPILE={mode()}"
    if not objects.available():
        return MISSING
    n = motion.space.size
    models: list[tuple[str, Any]] = [("motion", motion), *(("sensor", s) for s in sensors)]
    for role, model in models:
        if any(np.ndim(value) for value in numbers_of(model).values()):
            return f"{role} {_name(model)!r} differs from lane to lane"
    with np.errstate(all="ignore"):
        Q = motion.Q(np.zeros((n, 2)), 1.0)
    if Q.shape[2:] != (1,):
        return f"the noise of motion {_name(motion)!r} differs from particle to particle"
    inputs = getattr(motion, "input_space", None)
    found = kernels.moving(motion, n, root(Q).shape[1], 0 if inputs is None else inputs.size)
    if type(found) is str:
        return f"motion {_name(motion)!r}: {found}"
    for sensor in sensors:
        found = kernels.weighing(sensor, n, sensor.space.size, sensor.pose_space.size)
        if type(found) is str:
            return f"sensor {_name(sensor)!r}: {found}"
    return ""


def filtered(
    rule: Rule,
    state: Particles,
    motion: MotionModel,
    sensors: Sequence[SensorModel],
    record: Record,
    start: float | None,
    history: History,
) -> bool:
    """Fill in the history of a record, lane by lane, if that can be done: whether it was done."""
    made = _Loop.of(rule, state, motion, sensors, record, start)
    if made is None:
        return False
    for at in np.ndindex(*record.batch):
        made.run(alone.cut(state, at), at)
        made.told(history, at)
    return True


# ------------------------------------------------------------------------------------- inside
def _name(model: Any) -> str:
    return str(getattr(model, "name", type(model).__name__))


@functools.cache
def _stepping() -> tuple[Callable[[int], None], objects.Machine]:
    made = objects.compiled(machine.stepping())
    return ctypes.CFUNCTYPE(None, ctypes.c_void_p)(made.address), made


_PLACE = {name: i for i, name in enumerate(machine.NUMBERS)}


def _address(array: Array) -> int:
    return int(array.ctypes.data)


@attrs.define(eq=False)
class _Loop:
    """What the loop over the steps of a record works on: written anew for every lane.

    ``going`` and ``found`` have a row a step: what the passes leave of prediction and weighing.
    ``offsets`` say where in ``found`` the innovation of a sensor begins: behind the moments.
    """

    rule: Rule
    motion: MotionModel
    sensors: Sequence[SensorModel]
    record: Record
    times: Array
    which: Any
    rows: Array
    looks: list[Array]
    going: Array
    found: Array
    measured: Any
    numbers: Array
    centre: Array
    roots: tuple[Array, Any]
    clouds: dict[int, Array]
    kept: tuple[Any, ...]

    @classmethod
    def of(
        cls,
        rule: Rule,
        state: Particles,
        motion: MotionModel,
        sensors: Sequence[SensorModel],
        record: Record,
        start: float | None,
    ) -> _Loop | None:
        n, count = state.points.shape[:2]
        full, steps = kernels.filled(count), len(record)
        times = np.empty((steps + 1, *record.t.shape[1:]))
        times[0] = record.t[0] if start is None else start
        times[1:] = record.t
        roots = _roots(motion, times[1:] - times[:-1])
        if roots is None:
            return None
        k, q = roots[0].shape[2], 0 if record.u is None else record.u.shape[1]
        ahead = kernels.moving(motion, n, k, q)
        weighs = [kernels.weighing(s, n, s.space.size, s.pose_space.size) for s in sensors]
        if any(type(found) is str for found in (ahead, *weighs)):
            return None
        which = np.zeros(steps, np.int64) if record.sensor is None else record.sensor
        rows = np.empty((steps, 2 + q + len(ahead[1]) + n * k + n))
        rows[:, 2 + q : 2 + q + len(ahead[1])] = ahead[1]
        looks = []
        for sensor, (_, parameters) in zip(sensors, weighs, strict=True):
            m, p = sensor.space.size, sensor.pose_space.size
            look = np.empty((steps, m + p + len(parameters) + n))
            look[:, m + p : m + p + len(parameters)] = parameters
            looks.append(look)
        sizes = [ctypes.sizeof(done.left) // _BYTES for done, _ in (ahead, *weighs)]
        going, found = np.empty((steps, sizes[0])), np.empty((steps, max(sizes[1:])))
        clouds = [np.empty((n, full)) for _ in range(3)] + [np.empty(full) for _ in range(2)]
        scratch = np.empty(max(kernels.drawing(k), kernels.CHOOSING) * full)
        table = np.array([
            [done.machine.address, _address(look), look.shape[1], n + n * n + 1 + m + m * m + 1]
            for (done, _), look, m in zip(weighs, looks, (s.space.size for s in sensors), strict=True)
        ])  # fmt: skip
        measured = np.empty(steps, np.int64)
        numbers = np.zeros(len(_PLACE), np.int64)
        own = cls(
            rule, motion, sensors, record, times, np.ascontiguousarray(which, np.int64), rows, looks,
            going, found, measured, numbers, np.empty(n), roots, {_address(c): c for c in clouds},
            (ahead, weighs, scratch, table, kernels.even(count)),
        )  # fmt: skip
        choose = rule.scheme == SYSTEMATIC
        own.put(
            last=steps, count=count, N=full, n=n, scratch=_address(scratch),
            ahead=ahead[0].machine.address, sensors=_address(table), which=_address(own.which),
            measured=_address(measured), choose=kernels.choosing().machine.address if choose else 0,
            enough=least_size(rule.threshold, count), least=kernels.TINY,
        )  # fmt: skip
        own.put(**{
            "points.chosen": _address(clouds[2]),
            "weights.even": ctypes.addressof(kernels.even(count)),
            "ahead.given": _address(rows), "ahead.inputs": rows.shape[1],
            "ahead.left": _address(going), "ahead.found": going.shape[1],
            "weigh.left": _address(found), "weigh.found": found.shape[1],
        })  # fmt: skip
        return own

    def put(self, **values: Any) -> None:
        """Write numbers that the loop is given."""
        for name, value in values.items():
            kind = np.float64 if machine.NUMBERS[name] == "double" else np.int64
            self.numbers.view(kind)[_PLACE[name]] = value

    def got(self, name: str) -> Any:
        """What the loop was given, or left."""
        kind = np.float64 if machine.NUMBERS[name] == "double" else np.int64
        return self.numbers.view(kind)[_PLACE[name]].item()

    def run(self, state: Particles, at: tuple[int, ...]) -> None:
        """All steps of a lane that begins in this state."""
        self._given(at)
        call, _ = _stepping()
        places = list(self.clouds)
        k1, k2 = state.key.view(np.int64)
        self.put(k1=k1, k2=k2, first=0, weights=places[3])
        self.put(**{
            "points": places[0], "points.spare": places[1], "weights.spare": places[4],
        })  # fmt: skip
        self._begin(state, float(state.effective_sample_size))
        here = _address(self.numbers)
        while True:
            before = self.got("first")
            call(here)
            why, k = self.got("stopped"), self.got("first")
            if why == machine.DONE:
                return
            if k > before:
                state = self._state(state, k)
            if why == machine.DUE:
                # Whatever became of it, this step has been resampled.
                self._begin(self.rule.renewed(state), math.inf)
                continue
            state = self._step(state, k, at)
            self.put(first=k + 1)
            self._begin(state, float(state.effective_sample_size))

    def told(self, history: History, at: tuple[int, ...]) -> None:
        """Write what was found into a lane of the history."""
        n = self.motion.space.size
        here: Any = (slice(None), slice(None), *at)
        for trajectory, source in ((history.predicted, self.going), (history.filtered, self.found)):
            trajectory.mean[here] = source[:, :n]
            trajectory.cov[(slice(None), *here)] = source[:, n : n + n * n].reshape(-1, n, n)
        out = history.innovation
        for i, sensor in enumerate(self.sensors):
            m, begins = sensor.space.size, n + n * n + 1
            mine: Any = slice(None) if len(self.sensors) == 1 else self.which == i
            found = self.found[mine, begins:]
            out.residual[(mine, slice(m), *at)] = found[:, :m]
            out.S[(mine, slice(m), slice(m), *at)] = found[:, m : m + m * m].reshape(-1, m, m)
            nis, loglik = found[:, m + m * m], found[:, m + m * m + 1]
            out.nis[(mine, *at)], out.loglik[(mine, *at)] = nis, loglik
            out.ok[(mine, *at)] = np.isfinite(nis)
        out.count[(slice(None), *at)] = self.measured

    def _given(self, at: tuple[int, ...]) -> None:
        """Numbers of this lane."""
        record, n, rows = self.record, self.motion.space.size, self.rows
        times = self.times[(slice(None), *at)] if self.times.ndim > 1 else self.times
        rows[:, 0], rows[:, 1] = times[1:] - times[:-1], times[:-1]
        if record.u is not None:
            rows[:, 2 : 2 + record.u.shape[1]] = _of(record.u, at)
        roots, place = self.roots
        own = place[(slice(None), *at)] if place.ndim > 1 else place
        rows[:, rows.shape[1] - n - roots[0].size : -n] = roots[own].reshape(len(rows), -1)
        z = record.z[(slice(None), slice(None), *at)]
        for i, (sensor, look) in enumerate(zip(self.sensors, self.looks, strict=True)):
            m, p = sensor.space.size, sensor.pose_space.size
            look[:, :m] = z[:, :m]
            if p and record.pose is not None:
                look[:, m : m + p] = _of(record.pose, at)[:, :p]
            mine: Any = slice(None) if len(self.sensors) == 1 else self.which == i
            self.measured[mine] = np.count_nonzero(~np.isnan(look[mine, :m]), axis=1)

    def _begin(self, state: Particles, size: float) -> None:
        """Where the loop goes on: from this cloud."""
        points, weights = (self.clouds[self.got(name)] for name in ("points", "weights"))
        kernels.laid_out(state, points, weights)
        self.centre[:] = state.points[:, 0] if state.known is None else state.known.mean
        self.put(size=size, step=state.step, centre=_address(self.centre), apart=1)

    def _state(self, state: Particles, k: int) -> Particles:
        """The belief before row k, to which the loop has come from a state."""
        count, n = len(state.log_weights), len(state.points)
        points, weights = (self.clouds[self.got(name)] for name in ("points", "weights"))
        return Particles.known_as(
            points[:, :count].copy(),
            weights[:count].copy(),
            state.key,
            self.got("step"),
            tuple(self.sensors[self.which[k - 1]].state.circular),
            Gaussian.trusted(
                self.found[k - 1, :n].copy(), self.found[k - 1, n : n + n * n].reshape(n, n).copy()
            ),
            self.got("size"),
        )

    def _step(self, state: Particles, k: int, at: tuple[int, ...]) -> Particles:
        """One step of the filter's own methods, told as the passes tell it."""
        record, rows, n = self.record, self.rows, self.motion.space.size
        u = None if record.u is None else _of(record.u, at)[k]
        predicted = self.rule.predict(state, self.motion, float(rows[k, 0]), u, float(rows[k, 1]))
        sensor = self.sensors[self.which[k]]
        m, p = sensor.space.size, sensor.pose_space.size
        pose = _of(record.pose, at)[k, :p] if p and record.pose is not None else None
        z = record.z[(k, slice(m), *at)]
        after, innovation = self.rule.update(predicted, sensor, z, pose)
        for row, belief in ((self.going[k], predicted), (self.found[k], after)):
            moments = belief.moments()
            row[:n], row[n : n + n * n] = moments.mean, moments.cov.ravel()
        begins = n + n * n + 1
        self.found[k, begins : begins + m + m * m + 2] = [
            *innovation.residual, *innovation.S.ravel(), innovation.nis, innovation.loglik
        ]  # fmt: skip
        return after


def _of(values: Array, at: tuple[int, ...]) -> Array:
    """One lane of inputs or poses, which may be shared."""
    return values if values.ndim == 2 else values[(slice(None), slice(None), *at)]


def _roots(motion: MotionModel, dt: Array) -> tuple[Array, Any] | None:
    """Roots of the noise for every time step that there is, ``(F, n, k)``, and which step has which.

    They are those of `propagation.root`: which columns there are decides about the draws. None if
    columns come and go.
    """
    few, place = np.unique(dt, return_inverse=True)
    n = motion.space.size
    full = np.broadcast_to(factored(motion.Q(np.zeros((n, len(few))), few)), (n, n, len(few)))
    there = (full != 0.0).any(axis=0)
    some, columns = there.any(axis=0), there.any(axis=1)
    if not (columns == there[:, some].T).all():
        return None
    return np.ascontiguousarray(np.moveaxis(full[:, columns], 2, 0)), place.reshape(dt.shape)
