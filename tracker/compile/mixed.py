"""Compiled predictions and updates around a sensor that only NumPy can evaluate.

Such a sensor (one that cannot be traced, with a derivative written by hand) is linearised at the
predicted mean by its own methods, between two calls of a program that updates and predicts. What
can be compiled whole is run by `tracker.compile.run`, and what asks for the sensor anywhere else
(sigma points, iterations) by the arrays.

Measured: extended Kalman filter, two bearings by np.arctan2, n = 4, histories kept, microseconds of CPU
time per step on a shared core with AVX-512, against the arrays: 1,000 lanes 288 against 415 (the sensor's own
share is 70), 8 lanes 55 against 133, one run 46 against 59.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any

import attrs
import numpy as np

from tracker.algebra import at_once, dense
from tracker.compile import objects
from tracker.compile.fuse import Layout, Linearised, around, why_not
from tracker.compile.llvm import Kernel
from tracker.compile.program import Program, Rate, allocate, tile
from tracker.compile.run import (
    FAILURES,
    MISSING,
    Parts,
    _flat,
    _hashable,
    _layout,
    _prior,
    _Problem,
    begins_otherwise,
    mode,
)
from tracker.compile.values import pack, unpack
from tracker.errors import ShapeError, wording
from tracker.models.linearise import linearise
from tracker.models.sensor import ComponentSensor
from tracker.types import Array, Columns, Gaussian, History, Innovation, Record, Trajectory

BYTES = 256 * 1024
"""Histories are moved to where users see them before they are larger than this."""

_KEEP = ("predicted", "filtered", "innovation")


def reason(estimator: Any) -> str:
    """Why an estimator's filter is not run this way, or '' if it is."""
    if mode() != "on":
        return f"TRACKER_COMPILE={mode()}"
    if not objects.available():
        return MISSING
    why = why_not(estimator.filter, estimator.motion, ())
    if why:
        return why
    if begins_otherwise(estimator):
        return "more than a Gaussian is carried from step to step"
    opaque = _opaque(estimator)
    if not opaque:
        return "no sensor is opaque"
    stand_ins = {
        i: _stand_in(estimator.sensors[i], tuple(range(estimator.motion.space.size)), estimator)
        for i in opaque
    }
    return _hashable(_trial, _layout(_parts(estimator, stand_ins), {}, 0, _KEEP))


def _opaque(estimator: Any) -> list[int]:
    """Places of the sensors that cannot be traced."""
    return [
        i
        for i, sensor in enumerate(estimator.sensors)
        if why_not(estimator.filter, estimator.motion, (sensor,))
    ]


def _stand_in(sensor: Any, columns: tuple[int, ...], estimator: Any) -> Linearised:
    # The residual of a component sensor follows from its space; a stranger's may follow from anything.
    key = sensor.space if type(sensor) is ComponentSensor else sensor
    return Linearised(key, columns, estimator.motion.space.size, sensor.space, sensor.residual)


def _parts(estimator: Any, stand_ins: Mapping[int, Linearised]) -> Parts:
    sensors = tuple(stand_ins.get(i, s) for i, s in enumerate(estimator.sensors))
    return Parts(estimator.filter, estimator.motion, sensors)


@functools.lru_cache(maxsize=128)
def _trial(layout: Layout) -> str:
    try:
        around(layout)
    except FAILURES as error:
        return f"filter {type(layout.filter).__name__} cannot be traced: {error}"
    return ""


@functools.lru_cache(maxsize=64)
def _kernel(layout: Layout) -> Kernel:
    return Kernel(around(layout))


def filtered(estimator: Any, record: Record, prior: Gaussian, start: float | None) -> History:
    """The history of a record: NumPy's linearisation between compiled steps."""
    with at_once():
        seeing = {i: _Seeing.of(estimator, i, record, prior) for i in _opaque(estimator)}
        longer = _with_idle_row(record, start, idle=next(iter(seeing)))
        parts = _parts(estimator, {i: seen.stand_in for i, seen in seeing.items()})
        problem = _Problem.of(parts, longer, None)
        made = _kernel(problem.layout(_KEEP))
        arrays = _time_first(problem, made.program)
        _prior(problem, prior, arrays)
        kept = _Kept.of(problem, made.program, arrays)
        run = made.bind_steps(arrays, problem.groups)
        run(0)
        for k, i in enumerate([0] * len(record) if record.sensor is None else record.sensor):
            if i in seeing:
                x = problem.lanes_of(arrays["x"])
                arrays[f"seen{i}"][0, :, 0] = tile(seeing[i].look(x, record, k))
            run(k + 1)
            kept.move(k + 1)
    return kept.history(record)


@attrs.frozen(eq=False)
class _Kept:
    """Histories on their way from the program's layout to that of users, a few steps at a time.

    Moved while they are in cache: written as a whole first, they would cost as much as the steps.
    """

    lanes: int
    rows: int
    few: Mapping[str, Array]
    whole: Mapping[str, Array]
    places: Mapping[str, Any]

    @classmethod
    def of(cls, problem: _Problem, program: Program, arrays: Mapping[str, Array]) -> _Kept:
        few = {name: arrays[name] for name in program.histories[0]}
        places = {}
        for name, nodes in program.histories[0].items():
            places[name] = np.arange(len(nodes))
            if name.endswith(("P", "S")):
                places[name] = unpack(
                    places[name].tolist(), (math.isqrt(8 * len(nodes) + 1) - 1) // 2
                ).astype(np.intp)
        rows = len(problem.record) - 1
        whole = {k: np.empty((rows, *place.shape, problem.lanes)) for k, place in places.items()}
        return cls(problem.lanes, rows, few, whole, places)

    def move(self, step: int) -> None:
        """After a step: if it was the last that fits, move it and those before it."""
        for name, few in self.few.items():
            slots = len(few)
            last = step % slots
            if last < slots - 1 and step < self.rows:
                return
            first = 1 if step == last else 0  # step 0 measured nothing
            source = few[first : last + 1, :, 0].swapaxes(1, 2)
            flat = source.reshape(*source.shape[:2], -1)[..., : self.lanes]
            rows = slice(step - last + first - 1, step)
            # Any mode but "raise" writes into out directly.
            np.take(flat, self.places[name], axis=1, out=self.whole[name][rows], mode="clip")

    def history(self, record: Record) -> History:
        """What was moved."""
        all_ = {k: v.reshape(*v.shape[:-1], *record.batch) for k, v in self.whole.items()}
        nis, loglik, count = (all_["score"][:, i] for i in range(3))
        return History(
            record.t,
            Trajectory(all_["predicted.x"], all_["predicted.P"]),
            Trajectory(all_["filtered.x"], all_["filtered.P"]),
            Innovation(all_["residual"], all_["S"], nis, loglik, count, np.isfinite(nis)),
            u=record.u,
        )


def _with_idle_row(record: Record, start: float | None, idle: int) -> Record:
    """The record after a row at the start in which nothing is measured.

    The program updates before it predicts: without a measurement it only predicts, to the first row.
    """

    def longer(values: Any) -> Any:
        return None if values is None else np.concatenate([values[:1], values])

    t, z, sensor = longer(record.t), longer(record.z), longer(record.sensor)
    t[0] = t[0] if start is None else start
    z[0] = np.nan
    if sensor is not None:
        sensor[0] = idle
    made = object.__new__(Record)
    pairs = (("u", longer(record.u)), ("pose", longer(record.pose)), ("sensor", sensor))
    for name, value in (("t", t), ("z", z), *pairs):
        object.__setattr__(made, name, value)
    return made


def _time_first(problem: _Problem, program: Program) -> dict[str, Array]:
    """The arrays of a program as `Kernel.bind_steps` takes them, all but the states filled in.

    What a prediction takes (dt, t and u) is given with the row that it starts from, one before.
    """
    record, histories = problem.record, program.histories[0]
    seen = [name for name in program.inputs if name.startswith("seen")]
    out = problem.arrays(program, but=(*histories, *seen))
    shapes = program.shapes(problem.groups, 1)
    slots = max(1, BYTES // (8 * sum(int(np.prod(shapes[name])) for name in histories)))
    out["z"][:] = tile(_flat(record.z, 2, record.batch)[:, : out["z"].shape[2]])
    for name, shape in shapes.items():
        rate = program.inputs[name][1] if name in program.inputs else Rate.LANE
        if name in seen:
            out[name] = allocate((1, *shape))
        elif name in histories:
            out[name] = allocate((slots, *shape))
        elif rate & Rate.STEP:
            axis = 1 if rate & Rate.LANE else 0
            moved = np.moveaxis(out[name], axis, 0)
            if name in ("dt", "t", "u"):
                moved = np.concatenate([moved[1:], moved[-1:]])
            out[name] = np.ascontiguousarray(np.expand_dims(moved, 1 + axis))
    return out


def _pose(sensor: Any, record: Record, k: int) -> Any:
    size = sensor.pose_space.size
    return None if record.pose is None or not size else record.pose[k, :size]


@attrs.define(eq=False)
class _Seeing:
    """An opaque sensor, and its latest answer ``(count, *batch)``."""

    sensor: Any
    stand_in: Linearised
    known: Array
    noise: Any = None

    @classmethod
    def of(cls, estimator: Any, i: int, record: Record, prior: Gaussian) -> _Seeing:
        """Asked once, about the prior, to learn which columns its Jacobian has."""
        sensor, n = estimator.sensors[i], estimator.motion.space.size
        _, H = linearise(sensor, prior.mean, _pose(sensor, record, 0))
        columns = H.columns if isinstance(H, Columns) else tuple(range(n))
        stand_in = _stand_in(sensor, columns, estimator)
        return cls(sensor, stand_in, np.empty((stand_in.size, *record.batch)))

    def look(self, x: Array, record: Record, k: int) -> Array:
        """Value, Jacobian and triangle of the noise at x, ``(count, lanes)``."""
        pose, columns = _pose(self.sensor, record, k), self.stand_in.columns
        h, H = linearise(self.sensor, x, pose)
        if isinstance(H, Columns) and H.columns == columns:
            entries = H.entries
        else:
            entries = dense(H)
            if len(columns) < entries.shape[1]:
                raise ShapeError(
                    wording(
                        f"sensor {getattr(self.sensor, 'name', type(self.sensor).__name__)!r}",
                        got="a Jacobian with other columns than before",
                        expected=f"columns {columns}",
                        do="return the whole Jacobian if its columns change",
                    )
                )
        m = len(h)
        end = m + m * len(columns)
        self.known[:m] = h
        self.known[m:end].reshape(entries.shape[:2] + x.shape[1:])[:] = entries
        R = self.sensor.R(x, pose)
        if R is not self.noise or R.flags.writeable:  # read-only, the same object is the same noise
            self.noise = R
            for row, entry in zip(range(end, len(self.known)), pack(R), strict=True):
                self.known[row] = entry
        return self.known.reshape(len(self.known), -1)
