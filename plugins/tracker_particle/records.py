"""Whole records of one cloud after the other as one call of machine code each; no filter lives here.

Between two steps nothing is left to Python: `machine.stepping` calls the passes of `kernels`, which
are those of single steps, so that the bits are the same. Where a pass steps aside, the loop stops,
the filter's own methods do that one step, and the loop goes on behind it.
"""

from __future__ import annotations

import ctypes
import functools
import math
import operator
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
from tracker_particle.belief import Particles, effective_sample_size
from tracker_particle.propagation import factored, least_size
from tracker_particle.resampling import SYSTEMATIC, Scheme

AT_ONCE = 2**25
"""Steps times particles in one call, about a second: an interruption by the user is heard between calls."""


@attrs.frozen(eq=False)
class Passes:
    """A pass for the motion and one for each sensor, each with its parameters.

    ``noise`` are the numbers that a prediction is given of the process noise: for every time step
    that there is, ``(F, c)``, and which step of the record has which, ``(T, *batch)``. ``columns``
    are the normals that a particle draws, None for one of each component; ``more`` are the numbers that belong to a cloud as a whole;
    passes need room for ``rows`` rows and take ``pace`` steps of a belief.
    """

    ahead: tuple[kernels.Pass, list[float], Any]
    weighs: Sequence[tuple[kernels.Pass, list[float], Any]]
    noise: tuple[Array, Any]
    columns: int | None
    more: int = 0
    rows: int = 1
    pace: int = 1


@attrs.frozen(eq=False)
class Form:
    """How a cloud of one lane is laid out: rows ``(n, N)``, numbers of the cloud ``(more,)``, and back.

    ``made(state, rows, log_weights, step, circular, more, known, size)`` is a later belief than ``state``.
    """

    rows: Callable[[Any], Array]
    more: Callable[[Any], Array]
    made: Callable[..., Any]


@attrs.frozen(eq=False)
class Rule:
    """What the loop is told of a filter: its methods for a step, how it resamples, and its passes.

    ``scheme`` is None where resampling is ``renewed`` alone. ``passes(motion, sensors, dt, inputs)`` are
    those for time steps ``(T, *batch)``, or in words why there are none.
    """

    predict: Callable[..., Any]
    update: Callable[..., Any]
    renewed: Callable[[Any], Any]
    threshold: float
    scheme: Scheme | None
    passes: Callable[..., Passes | str]
    form: Form


def why_not(passes: Callable[..., Passes | str], motion: Any, sensors: Sequence[Any]) -> str:
    """In words, why records are filtered step by step with these models, or ''."""
    if mode() != "on":
        return f"TRACKER_COMPILE={mode()}"
    if not objects.available():
        return MISSING
    models: list[tuple[str, Any]] = [("motion", motion), *(("sensor", s) for s in sensors)]
    for role, model in models:
        if any(np.ndim(value) for value in numbers_of(model).values()):
            return f"{role} {name_of(model)!r} differs from lane to lane"
        space = model.space if role == "motion" else model.state
        if any(space.circular):
            return f"a component of the state of {role} {name_of(model)!r} lives on a circle"
    inputs = getattr(motion, "input_space", None)
    found = passes(motion, sensors, np.ones(1), 0 if inputs is None else inputs.size)
    return found if isinstance(found, str) else ""


def filtered(
    rule: Rule,
    state: Any,
    motion: MotionModel,
    sensors: Sequence[SensorModel],
    record: Record,
    start: float | None,
    history: History,
) -> bool:
    """Fill in the history of a record, lane by lane, if that can be done: whether it was done."""
    times = np.empty((len(record) + 1, *record.t.shape[1:]))
    times[0] = record.t[0] if start is None else start
    times[1:] = record.t
    inputs = 0 if record.u is None else record.u.shape[1]
    passes = rule.passes(motion, sensors, times[1:] - times[:-1], inputs)
    if isinstance(passes, str) or (passes.columns is None and state.log_weights.shape[0] == 1):
        return False  # a single particle's noise is that of all
    made = _Loop.of(rule, passes, motion, sensors, record, times, state.log_weights.shape[0])
    for at in np.ndindex(*record.batch):
        made.run(alone.cut(state, at), at)
        made.told(history, at)
    return True


def passes_of(motion: Any, sensors: Sequence[Any], found: Any, seen: Sequence[Any]) -> str:
    """In words, which of these passes there are not, or ''."""
    models = (("motion", motion), *(("sensor", s) for s in sensors))
    for (role, model), each in zip(models, (found, *seen), strict=True):
        if isinstance(each, str):
            return f"{role} {name_of(model)!r}: {each}"
    return ""


def usual_passes(
    motion: MotionModel, sensors: Sequence[SensorModel], dt: Array, inputs: int
) -> Passes | str:
    """Those of particles alone."""
    found = roots(motion, dt)
    if isinstance(found, str):
        return found
    columns, noise = found
    n = motion.space.size
    ahead = kernels.moving(motion, n, columns, inputs)
    weighs = [kernels.weighing(s, n, s.space.size, s.pose_space.size) for s in sensors]
    why = passes_of(motion, sensors, ahead, weighs)
    if why:
        return why
    return Passes(ahead, weighs, noise, columns)


def _later(
    state: Particles,
    rows: Array,
    log_weights: Array,
    step: int,
    circular: tuple[bool, ...],
    _more: Array,
    known: Gaussian,
    size: float,
) -> Particles:
    return Particles.known_as(rows, log_weights, state.key, step, circular, known, size)


PARTICLES = Form(operator.attrgetter("points"), lambda _: np.empty(0), _later)


def name_of(model: Any) -> str:
    """What a model is called."""
    return str(getattr(model, "name", type(model).__name__))


def by_time_step(dt: Array, compute: Callable[[Array, Array], Array], n: int) -> tuple[Array, Any]:
    """``compute(x, dt)`` for every time step that there is, last axis, and which step has which."""
    few, place = np.unique(dt, return_inverse=True)
    found = compute(np.zeros((n, len(few))), few)
    return np.broadcast_to(found, (*found.shape[:-1], len(few))), place.reshape(dt.shape)


def differs(motion: MotionModel) -> bool:
    """Whether the noise of a motion differs from particle to particle."""
    with np.errstate(all="ignore"):
        return motion.Q(np.zeros((motion.space.size, 2)), 1.0).shape[2:] != (1,)


def roots(motion: MotionModel, dt: Array) -> tuple[int | None, tuple[Array, Any]] | str:
    """How many columns a root of the noise has, and its entries, ``(F, n k)``, as `Passes.noise` has them.

    They are those of `propagation.root`: which columns there are decides about the draws. In words why
    not if columns come and go; None, and no entries, where particles have noise of their own.
    """
    if differs(motion):
        return None, (np.empty((1, 0)), np.zeros(dt.shape, np.intp))
    full, place = by_time_step(dt, lambda x, few: factored(motion.Q(x, few)), motion.space.size)
    there = (full != 0.0).any(axis=0)
    some, columns = there.any(axis=0), there.any(axis=1)
    if (there[:, some] != columns[:, None]).any():
        return f"the columns of the noise of motion {name_of(motion)!r} come and go"
    kept = np.moveaxis(full[:, columns], 2, 0)
    return int(kept.shape[2]), (kept.reshape(len(kept), -1), place)


# ------------------------------------------------------------------------------------- inside
@functools.cache
def _stepping() -> tuple[Callable[[int], None], objects.Machine]:
    made = objects.compiled(machine.stepping())
    return ctypes.CFUNCTYPE(None, ctypes.c_void_p)(made.address), made


_PLACE = {name: i for i, name in enumerate(machine.NUMBERS)}


def _address(array: Any) -> int:
    return int(array.ctypes.data)


@attrs.define(eq=False)
class _Loop:
    """What the loop over the steps of a record works on: written anew for every lane.

    ``going`` and ``found`` have a row a step: what the passes leave of prediction and weighing.
    """

    rule: Rule
    passes: Passes
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
    clouds: dict[int, Array]
    kept: tuple[Any, ...]

    @classmethod
    def of(
        cls,
        rule: Rule,
        passes: Passes,
        motion: MotionModel,
        sensors: Sequence[SensorModel],
        record: Record,
        times: Array,
        count: int,
    ) -> _Loop:
        n, more, full, steps = motion.space.size, passes.more, kernels.filled(count), len(record)
        which = np.zeros(steps, np.int64) if record.sensor is None else record.sensor
        own = np.ascontiguousarray(which, np.int64)
        q = 0 if record.u is None else record.u.shape[1]
        parameters, noise = passes.ahead[1], passes.noise[0].shape[1]
        rows = np.empty((steps, 2 + q + len(parameters) + noise + n + more))
        rows[:, 2 + q : 2 + q + len(parameters)] = parameters
        looks = []
        for sensor, (_, parameters, _) in zip(sensors, passes.weighs, strict=True):
            given = sensor.space.size + sensor.pose_space.size
            look = np.empty((steps, given + len(parameters) + n + more))
            look[:, given : given + len(parameters)] = parameters
            looks.append(look)
        sizes = [done.size for done, _, _ in (passes.ahead, *passes.weighs)]
        going, found = np.empty((steps, sizes[0])), np.empty((steps, max(sizes[1:])))
        room = max(n, passes.rows)
        clouds = [np.empty((room, full)) for _ in range(3)] + [np.empty(full) for _ in range(2)]
        scratch = np.empty(
            max(
                kernels.drawing(n if passes.columns is None else passes.columns),
                kernels.CHOOSING + n + 1,
            )
            * full
        )
        begins = n + more + n * n + 1
        table = np.array([
            [done.machine.address, _address(look), look.shape[1], begins + m + m * m + 1]
            for (done, _, _), look, m in zip(
                passes.weighs, looks, (s.space.size for s in sensors), strict=True
            )
        ])  # fmt: skip
        measured, even = np.empty(steps, np.int64), kernels.even(count)
        made = cls(
            rule, passes, motion, sensors, record, times, own, rows, looks, going, found, measured,
            np.zeros(len(_PLACE), np.int64), np.empty(n + more), {_address(c): c for c in clouds},
            (scratch, table, even),
        )  # fmt: skip
        choose = kernels.choosing().machine.address if rule.scheme == SYSTEMATIC else 0
        made.put(
            count=count, N=full, n=n, more=more, pace=passes.pace, scratch=_address(scratch),
            ahead=passes.ahead[0].machine.address, sensors=_address(table), which=_address(own),
            measured=_address(measured), choose=choose, enough=least_size(rule.threshold, count),
            least=kernels.TINY,
        )  # fmt: skip
        made.put(**{
            "points.chosen": _address(clouds[2]), "weights.even": ctypes.addressof(even),
            "ahead.given": _address(rows), "ahead.inputs": rows.shape[1],
            "ahead.left": _address(going), "ahead.found": going.shape[1],
            "weigh.left": _address(found), "weigh.found": found.shape[1],
        })  # fmt: skip
        return made

    def put(self, **values: Any) -> None:
        """Write numbers that the loop is given."""
        for name, value in values.items():
            kind = np.float64 if machine.NUMBERS[name] == "double" else np.int64
            self.numbers.view(kind)[_PLACE[name]] = value

    def got(self, name: str) -> Any:
        """What the loop was given, or left."""
        kind = np.float64 if machine.NUMBERS[name] == "double" else np.int64
        return self.numbers.view(kind)[_PLACE[name]].item()

    def run(self, state: Any, at: tuple[int, ...]) -> None:
        """All steps of a lane that begins in this state."""
        self._given(at)
        call, _ = _stepping()
        places = list(self.clouds)
        k1, k2 = np.ascontiguousarray(state.key).view(np.int64)
        self.put(k1=k1, k2=k2, first=0, weights=places[3])
        self.put(**{
            "points": places[0], "points.spare": places[1], "weights.spare": places[4],
        })  # fmt: skip
        self._begin(state, _size(state))
        here, some = _address(self.numbers), max(1, AT_ONCE // self.got("N"))
        while (before := self.got("first")) < len(self.record):
            self.put(last=min(before + some, len(self.record)))
            call(here)
            why, k = self.got("stopped"), self.got("first")
            if why == machine.DONE:
                state = self._state(state, k) if k < len(self.record) else state
                continue
            if k > before:
                state = self._state(state, k)
            if why == machine.DUE:
                # Whatever became of it, this step has been resampled.
                self._begin(self.rule.renewed(state), math.inf)
                continue
            state = self._step(state, k, at)
            self.put(first=k + 1)
            self._begin(state, _size(state))

    def told(self, history: History, at: tuple[int, ...]) -> None:
        """Write what was found into a lane of the history."""
        n = self.motion.space.size
        known = n + self.passes.more
        begins = known + n * n + 1
        for trajectory, source in ((history.predicted, self.going), (history.filtered, self.found)):
            _of(trajectory.mean, 2, at)[:] = source[:, :n]
            _of(trajectory.cov, 3, at)[:] = source[:, known : begins - 1].reshape(-1, n, n)
        out = history.innovation
        for i, sensor in enumerate(self.sensors):
            m = sensor.space.size
            mine: Any = slice(None) if len(self.sensors) == 1 else self.which == i
            found = self.found[mine, begins:]
            _of(out.residual, 2, at)[mine, :m] = found[:, :m]
            _of(out.S, 3, at)[mine, :m, :m] = found[:, m : m + m * m].reshape(-1, m, m)
            for values, number in ((out.nis, m + m * m), (out.loglik, m + m * m + 1)):
                _of(values, 1, at)[mine] = found[:, number]
            _of(out.ok, 1, at)[mine] = np.isfinite(found[:, m + m * m])
        _of(out.count, 1, at)[:] = self.measured

    def _given(self, at: tuple[int, ...]) -> None:
        """Numbers of this lane."""
        record, rows = self.record, self.rows
        times = _of(self.times, 1, at)
        rows[:, 0], rows[:, 1] = times[1:] - times[:-1], times[:-1]
        if record.u is not None:
            rows[:, 2 : 2 + record.u.shape[1]] = _of(record.u, 2, at)
        noise, place = self.passes.noise
        end = rows.shape[1] - len(self.centre)
        rows[:, end - noise.shape[1] : end] = noise[_of(place, 1, at)]
        z = _of(record.z, 2, at)
        for i, (sensor, look) in enumerate(zip(self.sensors, self.looks, strict=True)):
            m, p = sensor.space.size, sensor.pose_space.size
            look[:, :m] = z[:, :m]
            if p and record.pose is not None:
                look[:, m : m + p] = _of(record.pose, 2, at)[:, :p]
            mine: Any = slice(None) if len(self.sensors) == 1 else self.which == i
            self.measured[mine] = np.count_nonzero(~np.isnan(look[mine, :m]), axis=1)

    def _begin(self, state: Any, size: float) -> None:
        """Where the loop goes on: from this cloud."""
        points, weights = (self.clouds[self.got(name)] for name in ("points", "weights"))
        rows, known = self.rule.form.rows(state), getattr(state, "known", None)
        kernels.laid_out(rows, state.log_weights, points, weights)
        n = len(rows)
        self.centre[:n] = rows[:, 0] if known is None else known.mean
        self.centre[n:] = self.rule.form.more(state)
        self.put(size=size, step=state.step, centre=_address(self.centre), apart=1)

    def _state(self, state: Any, k: int) -> Any:
        """The belief before row k, to which the loop has come from a state."""
        count, n = len(state.log_weights), self.motion.space.size
        known = n + self.passes.more
        points, weights = (self.clouds[self.got(name)] for name in ("points", "weights"))
        found = self.found[k - 1].copy()
        return self.rule.form.made(
            state,
            points[:n, :count].copy(),
            weights[:count].copy(),
            self.got("step"),
            tuple(self.sensors[self.which[k - 1]].state.circular),
            found[n:known],
            Gaussian.trusted(found[:n], found[known : known + n * n].reshape(n, n)),
            self.got("size"),
        )

    def _step(self, state: Any, k: int, at: tuple[int, ...]) -> Any:
        """One step of the filter's own methods, told as the passes tell it."""
        record, rows, n = self.record, self.rows, self.motion.space.size
        u = None if record.u is None else _of(record.u, 2, at)[k]
        predicted = self.rule.predict(state, self.motion, float(rows[k, 0]), u, float(rows[k, 1]))
        sensor = self.sensors[self.which[k]]
        m, p = sensor.space.size, sensor.pose_space.size
        pose = _of(record.pose, 2, at)[k, :p] if p and record.pose is not None else None
        z = _of(record.z, 2, at)[k, :m]
        after, innovation = self.rule.update(predicted, sensor, z, pose)
        known = n + self.passes.more
        for row, belief in ((self.going[k], predicted), (self.found[k], after)):
            moments = belief.moments()
            row[:n], row[known : known + n * n] = moments.mean, moments.cov.ravel()
        begins = known + n * n + 1
        self.found[k, begins : begins + m + m * m + 2] = [
            *innovation.residual, *innovation.S.ravel(), innovation.nis, innovation.loglik
        ]  # fmt: skip
        return after


def _size(state: Any) -> float:
    own = getattr(state, "effective_sample_size", None)
    return float(effective_sample_size(state.weights) if own is None else own)


def _of(values: Any, lead: int, at: tuple[int, ...]) -> Any:
    """One lane of what has a batch behind some axes of its own, or is shared: a view."""
    index: Any = (*(slice(None),) * lead, *at)
    return values if values.ndim == lead else values[index]
