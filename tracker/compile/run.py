"""Records, histories and scores through compiled step programs: arrays in, arrays out.

What a program computes is composed in `tracker.compile.fuse`. Whether to use one is decided here,
from TRACKER_COMPILE (``on``: when possible, the default; ``off``; ``require``) and from what the
components allow; the answer is always one that can be said in words.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Collection, Mapping
from typing import Any

import attrs
import numpy as np

from tracker.algebra import at_once
from tracker.compile import objects
from tracker.compile.fuse import EARLIER, LAST, Layout, backward, forward, structure, why_not
from tracker.compile.llvm import Kernel
from tracker.compile.program import BLOCK, WIDTH, Program, Rate, allocate, tile, tile_into, untile
from tracker.compile.values import (
    Form,
    Tree,
    arrays_of,
    built,
    entries,
    form_of,
    leaves,
    triangle,
)
from tracker.errors import CapabilityError, ConfigError, TraceError
from tracker.models.parameters import numbers_of
from tracker.recursion import begin, is_random
from tracker.threads import each, shares
from tracker.types import Array, Beliefs, Gaussian, History, Innovation, Record, Trajectory

MISSING = "llvmlite is not installed (pip install 'tracker-lab[fast]')"
MODES = ("on", "off", "require")


def mode() -> str:
    """TRACKER_COMPILE.

    Raises:
        ConfigError: if it is none of the three.
    """
    value = os.environ.get("TRACKER_COMPILE", "on")
    if value not in MODES:
        raise ConfigError(
            f"environment variable TRACKER_COMPILE: got {value!r}; expected one of {', '.join(MODES)}. "
            "Do this: unset it, or set one of these."
        )
    return value


def reason(estimator: Any) -> str:
    """Why an estimator runs on arrays, or '' if it is compiled.

    Raises:
        CapabilityError: if TRACKER_COMPILE=require and it cannot be.
    """
    wanted = mode()
    if wanted == "off":
        return "TRACKER_COMPILE=off"
    if not objects.available():
        why = MISSING
    else:
        why = why_not(estimator.filter, estimator.motion, estimator.sensors) or _begins(estimator)
    return _required(why, wanted)


FAILURES = (TraceError, TypeError, AttributeError, ValueError, IndexError)
"""What a component may raise that was not written for graph nodes."""


def _begins(estimator: Any) -> str:
    try:
        layout = _layout(estimator, {}, 0, ("scores",))  # as a campaign's, most often
    except FAILURES as error:
        return f"what {_by_name(estimator)} begins with cannot be carried: {error}"
    return _hashable(_trial, layout)


def _by_name(parts: Any) -> str:
    """The filter of an estimator or a layout, and the adapter beside it: either may be to blame."""
    name = f"filter {type(parts.filter).__name__}"
    beside = "" if parts.adapter is None else f" with adapter {type(parts.adapter).__name__}"
    return name + beside


def _hashable(trial: Callable[[Layout], str], layout: Layout) -> str:
    try:
        hash(layout)
    except TypeError as error:
        return f"a component holds what cannot be a key for its compiled step ({error})"
    return trial(layout)


@functools.lru_cache(maxsize=128)
def _trial(layout: Layout) -> str:
    """Whether the filter's own methods run on graph nodes."""
    try:
        _composed(layout, "forward")
    except FAILURES as error:
        return f"{_by_name(layout)} cannot be traced: {error}"
    return ""


@attrs.frozen(eq=False)
class Parts:
    """What a layout asks of an estimator."""

    filter: Any
    motion: Any
    sensors: tuple[Any, ...] = ()
    smoother: Any = None
    adapter: Any = None
    believed: Form | None = None


def _afterwards(estimator: Any) -> Parts:
    """What a smoother depends on: not what was measured with, and of the filter its beliefs at most."""
    smoother, form = estimator.smoother, None
    if "beliefs" in smoother.needs:
        form = _carried(estimator)
        if estimator.adapter is not None and isinstance(form, Tree):
            form = dict(form.parts)["belief"]
    return Parts(None, estimator.motion, (), smoother, believed=form)


def told_enough(estimator: Any, history: History) -> bool:
    """Whether a history holds what the compiled smoother takes: beliefs of the filter, if it needs them."""
    form, kept = _afterwards(estimator).believed, history.beliefs
    if form is None or kept is None:
        return form is None
    name = "" if estimator.adapter is None else "carried.belief"
    some = (*kept.predicted[:1], *kept.predicted[-1:], *kept.filtered[:1], *kept.filtered[-1:])
    try:
        return all(form_of(belief, len(history.filtered.batch), name) == form for belief in some)
    except TraceError:
        return False


def why_not_backwards(estimator: Any) -> str:
    """Why an estimator's smoother runs on arrays, or ''.

    Raises:
        CapabilityError: if TRACKER_COMPILE=require and it cannot be compiled.
    """
    wanted, smoother = mode(), estimator.smoother
    if wanted == "off":
        return "TRACKER_COMPILE=off"
    if not objects.available():
        why = MISSING
    elif not hasattr(smoother, "step"):
        why = f"smoother {type(smoother).__name__} has no step over components"
    elif opaque := getattr(smoother, "why_opaque", ""):
        why = f"smoother {type(smoother).__name__} is opaque: {opaque}"
    elif "beliefs" in smoother.needs and is_random(estimator.filter):
        why = f"filter {type(estimator.filter).__name__} draws random numbers"
    else:
        why = why_not(None, estimator.motion, ()) or _begins_backwards(estimator)
    return _required(why, wanted)


def _begins_backwards(estimator: Any) -> str:
    try:
        layout = _layout(_afterwards(estimator), {}, 0, ("scores",))
    except FAILURES as error:
        name = type(estimator.smoother).__name__
        return f"what smoother {name} carries cannot be carried: {error}"
    return _hashable(_trial_backwards, layout)


def _required(why: str, wanted: str) -> str:
    if why and wanted == "require":
        raise CapabilityError(f"TRACKER_COMPILE=require, but this cannot be compiled: {why}.")
    return why


@functools.lru_cache(maxsize=128)
def _trial_backwards(layout: Layout) -> str:
    try:
        _composed(layout, "backward")
    except FAILURES as error:
        return f"smoother {type(layout.smoother).__name__} cannot be traced: {error}"
    return ""


@functools.lru_cache(maxsize=64)
def kernel(layout: Layout, direction: str) -> Kernel:
    """The compiled program of a layout; made once per process, its object once per machine."""
    return Kernel(_composed(layout, direction))


@functools.lru_cache(maxsize=64)
def _composed(layout: Layout, direction: str) -> Program:
    """The program of a layout; asking whether it can be compiled has made it already."""
    return forward(layout) if direction == "forward" else backward(layout)


# ------------------------------------------------------------------------------------ layout
def _layout(
    estimator: Any, rates: Mapping[str, Rate], inputs: int, keep: tuple[str, ...]
) -> Layout:
    given = {"dt": Rate.STEP, "u": Rate.STEP}
    given |= {f"pose{i}": Rate.STEP for i in range(len(estimator.sensors))}
    for owner, component in owners(estimator).items():
        for name, value in numbers_of(component).items():
            given[f"{owner}.{name}"] = Rate.LANE if np.ndim(value) else Rate.CALL
    given |= rates
    whole = (
        estimator.filter,
        estimator.smoother,
        estimator.adapter,
        estimator.motion,
        *estimator.sensors,
    )
    return Layout(
        structure=tuple(structure(c) for c in whole),
        rates=tuple(sorted(given.items())),
        inputs=inputs,
        keep=keep,
        filter=estimator.filter,
        motion=estimator.motion,
        sensors=estimator.sensors,
        smoother=estimator.smoother,
        adapter=estimator.adapter,
        carried=_carried(estimator),
        told=_told(estimator) if estimator.filter is None else None,
    )


def _told(after: Parts) -> Form:
    return after.believed or _gaussian(after.motion.space.size)


def owners(estimator: Any) -> dict[str, Any]:
    """The components that offer numbers, by what their inputs' names begin with."""
    own = {
        "motion": estimator.motion,
        "filter": estimator.filter,
        "adapter": estimator.adapter,
    }
    return own | {f"sensor{i}": s for i, s in enumerate(estimator.sensors)}


def begins_otherwise(estimator: Any) -> bool:
    """Whether more, or something else, is carried from step to step than a Gaussian."""
    return estimator.adapter is not None or hasattr(estimator.filter, "begin")


def _carried(estimator: Any) -> Form:
    n = estimator.motion.space.size
    backwards = estimator.filter is None  # then it is the smoother that begins
    begins = hasattr(estimator.smoother, "begin") if backwards else begins_otherwise(estimator)
    if not begins:
        return _told(estimator) if backwards else _gaussian(n)
    prior = Gaussian.trusted(np.zeros((n, 1)), np.eye(n)[..., None])
    if backwards:
        if estimator.believed is not None:
            prior = built(estimator.believed, lambda leaf: np.zeros((*leaf.shape, 1)))
        return form_of(estimator.smoother.begin(prior), 1)
    pose = np.zeros((max(s.pose_space.size for s in estimator.sensors), 1))
    with at_once():
        return form_of(_begun(estimator, prior, pose), 1)


@functools.cache
def _gaussian(n: int) -> Form:
    return form_of(Gaussian.trusted(np.zeros(n), np.eye(n)), 0)


def _begun(estimator: Any, prior: Gaussian, pose: Any) -> Any:
    return begin(
        estimator.filter, estimator.adapter, estimator.motion, estimator.sensors, prior, pose
    )


def _flat(values: Any, lead: int, batch: tuple[int, ...]) -> Array:
    """An array over lanes: the batch axes, broadcast and made one."""
    array = np.asarray(values, dtype=np.float64)
    full = np.broadcast_to(array, array.shape[:lead] + batch)
    return full.reshape(*array.shape[:lead], -1)


@attrs.frozen(eq=False)
class _Problem:
    """A record's times, inputs, poses and the models' parameters, as a program takes them."""

    estimator: Any
    record: Record
    start: float | None
    lanes: int
    groups: int

    @classmethod
    def of(cls, estimator: Any, record: Record, start: float | None) -> _Problem:
        lanes = int(np.prod(record.batch, dtype=np.intp))
        return cls(estimator, record, start, lanes, -(-lanes // WIDTH))

    def layout(self, keep: tuple[str, ...]) -> Layout:
        record, rates = self.record, {}
        if record.t.ndim > 1:
            rates["dt"] = Rate.BOTH
        if record.u is not None and record.u.ndim > 2:
            rates["u"] = Rate.BOTH
        if record.pose is not None and record.pose.ndim > 2:
            rates |= {f"pose{i}": Rate.BOTH for i in range(len(self.estimator.sensors))}
        inputs = 0 if record.u is None else record.u.shape[1]
        return _layout(self.estimator, rates, inputs, keep)

    def arrays(self, program: Program, but: Collection[str] = ()) -> dict[str, Array]:
        """All arrays of a program, with everything filled in but states and measurements."""
        shapes = program.shapes(self.groups, len(self.record))
        out = {k: allocate(s) for k, s in shapes.items() if k not in but}
        t = self.record.t
        first = t[:1] if self.start is None else np.full_like(t[:1], self.start)
        before = np.concatenate([first, t[:-1]])
        self._put(program, out, "dt", (t - before)[:, None], 2)
        self._put(program, out, "t", before[:, None], 2)
        if self.record.u is not None:
            self._put(program, out, "u", self.record.u, 2)
        for i, sensor in enumerate(self.estimator.sensors):
            if f"pose{i}" in out and self.record.pose is not None:
                size = sensor.pose_space.size
                self._put(program, out, f"pose{i}", self.record.pose[:, :size], 2)
        for owner, component in owners(self.estimator).items():
            for name, value in numbers_of(component).items():
                if f"{owner}.{name}" in out:
                    self._put(program, out, f"{owner}.{name}", np.asarray(value)[None], 1)
        if "variant" in out and self.record.sensor is not None:
            out["variant"][:, 0] = self.record.sensor
        if "counted" in out:
            out["counted"].reshape(-1)[: self.lanes] = 1.0
        return out

    def _put(
        self, program: Program, out: dict[str, Array], name: str, values: Any, lead: int
    ) -> None:
        rate = program.inputs[name][1]
        if rate & Rate.LANE:
            out[name][:] = tile(_flat(values, lead, self.record.batch))
        else:
            out[name][:] = np.asarray(values).reshape(out[name].shape)

    def lanes_of(self, array: Array) -> Array:
        """Kernel layout ``(groups, [T,] count, WIDTH)`` as ``([T,] count, *batch)``."""
        flat = untile(array, self.lanes)
        return flat.reshape(*flat.shape[:-1], *self.record.batch)

    def matrices(self, array: Array) -> Array:
        """Upper triangles in kernel layout as ``(T, n, n, *batch)``."""
        count = array.shape[-2]
        n = int((np.sqrt(8 * count + 1) - 1) // 2)
        place = np.zeros((n, n), dtype=np.intp)
        upper = np.triu_indices(n)
        place[upper] = place.T[upper] = np.arange(triangle(n))
        return self.lanes_of(array)[:, place]


def _prior(problem: _Problem, prior: Gaussian, arrays: dict[str, Array]) -> None:
    """The states as they are before the first step."""
    record, carried, form = problem.record, prior, _carried(problem.estimator)
    if begins_otherwise(problem.estimator):
        with at_once():
            first = None if record.pose is None else record.pose[0]
            carried = _begun(problem.estimator, prior, first)
    lead = {leaf.name: 1 if leaf.length else 0 for leaf in leaves(form)}
    for name, values in entries(form, carried).items():
        flat = [_flat(v, lead[name], record.batch) for v in values]
        arrays[name][:] = tile(np.stack(flat))


def _prepared(
    estimator: Any, record: Record, prior: Gaussian, start: float | None, keep: tuple[str, ...]
) -> tuple[_Problem, Kernel, dict[str, Array]]:
    """The forward program of a problem and its arrays, filled in: all but what is scored against."""
    problem = _Problem.of(estimator, record, start)
    made = kernel(problem.layout(keep), "forward")
    arrays = problem.arrays(made.program)
    _prior(problem, prior, arrays)
    arrays["z"][:] = tile(_flat(record.z, 2, record.batch)[:, : arrays["z"].shape[2]])
    return problem, made, arrays


# ----------------------------------------------------------------------------- what is offered
@attrs.frozen(eq=False)
class Prepared:
    """A bound forward program and its arrays: what a benchmark times without the arrays' making."""

    program: Program
    arrays: dict[str, Array]
    groups: int
    _call: Callable[[int, int], None]
    _first: dict[str, Array]
    _problem: _Problem
    _prior: Gaussian

    def __call__(self) -> None:
        """Run all steps of all lanes from the prior."""
        for name, values in self._first.items():
            self.arrays[name][:] = values
        self._call(0, self.groups)

    def put(self, name: str, values: Array) -> None:
        """Other values ``(lanes,)`` of a number that differs per lane, such as "motion.density"."""
        # Lanes lie in a row; what fills up the last group is nobody's, and may keep its numbers.
        self.arrays[name].reshape(-1)[: len(values)] = values

    def begin(self, estimator: Any) -> None:
        """Begin as this estimator does, which differs from the first in numbers alone."""
        _prior(attrs.evolve(self._problem, estimator=estimator), self._prior, self._first)

    def totals(self) -> Array:
        """Sums over time, ``(count, lanes)``."""
        return untile(self.arrays["totals"], self._problem.lanes)


def prepared(
    estimator: Any,
    record: Record,
    prior: Gaussian,
    start: float | None,
    keep: tuple[str, ...] = (),
    truth: Any = None,
) -> Prepared:
    """The forward program of a problem, ready to be run many times.

    Keep: as in `tracker.compile.fuse.forward`; "scores" and totals of errors need the truth.
    """
    problem, made, arrays = _prepared(estimator, record, prior, start, keep)
    if truth is not None:
        arrays["truth"][:] = tile(_flat(truth, 2, record.batch))
    first = {name: arrays[name].copy() for name in (*made.program.states, *made.program.delays)}
    call = made.bind(arrays, problem.groups, len(record))
    return Prepared(made.program, arrays, problem.groups, call, first, problem, prior)


def _call(
    kernel_: Kernel, arrays: Mapping[str, Array], groups: int, steps: int, workers: int
) -> None:
    """Run over all groups of lanes; threads take whole blocks of groups, so no bit depends on them."""
    run = kernel_.bind(arrays, groups, steps)
    each(lambda share: run(*share), shares(groups, workers, BLOCK), workers)


def filtered(
    estimator: Any, record: Record, prior: Gaussian, start: float | None, workers: int = 1
) -> History:
    """The history of a record, by the compiled forward program."""
    keep: tuple[str, ...] = ("predicted", "filtered", "innovation")
    if estimator.smoother is not None and "beliefs" in estimator.smoother.needs:
        keep = (*keep, "beliefs")
    problem, made, arrays = _prepared(estimator, record, prior, start, keep)
    _call(made, arrays, problem.groups, len(record), workers)
    score = problem.lanes_of(arrays["score"])
    innovation = Innovation(
        problem.lanes_of(arrays["residual"]),
        problem.matrices(arrays["S"]),
        score[:, 0],
        score[:, 1],
        score[:, 2],
        np.isfinite(score[:, 0]),
    )

    def trajectory(name: str) -> Trajectory:
        return Trajectory(
            problem.lanes_of(arrays[f"{name}.x"]), problem.matrices(arrays[f"{name}.P"])
        )

    return History(
        record.t,
        trajectory("predicted"),
        trajectory("filtered"),
        innovation,
        u=record.u,
        beliefs=_beliefs(problem, arrays, problem.layout(keep)) if "beliefs" in keep else None,
    )


def _beliefs(problem: _Problem, arrays: Mapping[str, Array], layout: Layout) -> Beliefs:
    """What the filter believed at each step."""
    predicted, filtered = (
        _over_time(problem, arrays, layout.belief, when) for when in ("predicted", "filtered")
    )
    return Beliefs(predicted, filtered)


def _over_time(
    problem: _Problem, arrays: Mapping[str, Array], form: Form, when: str
) -> tuple[Any, ...]:
    """Beliefs of every step, from the histories of their entries."""
    whole: dict[str, Array] = {}
    for leaf in leaves(form):
        kept = problem.lanes_of(arrays[f"{when}.{leaf.name}"])
        array = np.zeros((len(kept), *leaf.shape, *kept.shape[2:]))
        for i, place in enumerate(leaf.places()):
            for where in (place, leaf.mirrored(place)):
                key: tuple[Any, ...] = (slice(None), *where)
                array[key] = kept[:, i]
        whole[leaf.name] = array
    return tuple(_belief(form, whole, k) for k in range(len(problem.record)))


def _belief(form: Form, whole: Mapping[str, Array], step: int) -> Any:
    return built(form, lambda leaf: whole[leaf.name][step])


def _begin_backwards(arrays: dict[str, Array]) -> None:
    """A record's last step comes first, and begins the smoother's belief."""
    arrays["variant"][:] = EARLIER
    arrays["variant"][-1:] = LAST
    if "final" in arrays:
        arrays["final"][:] = np.nan


def smoothed(estimator: Any, history: History, workers: int = 1) -> History:
    """A filtered history with its smoothed trajectory, by the compiled backward program."""
    shape = history.filtered.mean.shape
    record = object.__new__(Record)
    empty = np.broadcast_to(0.0, (shape[0], 0, *shape[2:]))
    for name, value in (("t", history.t), ("z", empty), ("u", history.u), ("pose", None)):
        object.__setattr__(record, name, value)
    object.__setattr__(record, "sensor", None)
    after, kept = _afterwards(estimator), history.beliefs
    problem = _Problem.of(after, record, None)
    layout = problem.layout(("smoothed",) if after.believed is None else ("smoothed", "beliefs"))
    made = kernel(layout, "backward")
    arrays = problem.arrays(made.program)
    for name in ("filtered", "predicted"):
        if after.believed is None:
            source: Trajectory = getattr(history, name)
            arrays[f"{name}.x"][:] = tile(_flat(source.mean, 2, record.batch))
            upper = np.triu_indices(shape[1])
            triangles = source.cov[:, upper[0], upper[1]]
            arrays[f"{name}.P"][:] = tile(_flat(triangles, 2, record.batch))
            continue
        each = [arrays_of(after.believed, belief) for belief in getattr(kept, name)]
        for leaf in leaves(after.believed):
            whole = np.stack([one[leaf.name] for one in each])
            places: list[Any] = [(slice(None), *place) for place in leaf.places()]
            rows = np.stack([whole[place] for place in places], axis=1)
            arrays[f"{name}.{leaf.name}"][:] = tile(_flat(rows, 2, record.batch))
    _begin_backwards(arrays)
    _call(made, arrays, problem.groups, shape[0], workers)
    out = Trajectory(problem.lanes_of(arrays["out.x"]), problem.matrices(arrays["out.P"]))
    if kept is not None and after.believed is not None:
        out.mean[-1], out.cov[-1] = history.filtered.mean[-1], history.filtered.cov[-1]
        known = _over_time(problem, arrays, layout.carried, "known")
        kept = attrs.evolve(kept, smoothed=known)
    return attrs.evolve(history, smoothed=out, beliefs=kept)


@attrs.frozen(eq=False)
class Sums:
    """Scores of a chunk of runs, summed: per run over time, per step over blocks of runs.

    Shapes:
        totals ``(count, runs)``; final ``(3, runs)``, see `tracker.compile.fuse.scores`; partial ``(count, T, blocks)``.
    """

    totals: Array
    final: Array
    partial: Array


def scored(
    estimator: Any, record: Record, prior: Gaussian, start: float | None, truth: Array
) -> dict[str, Sums]:
    """Squared position error, NEES, (filter only:) NIS, its degrees, log-likelihood; no histories.

    The last of ``partial`` is the number of finite runs. Keys: "filter" and, with a smoother,
    "smoother".
    """
    smooth, steps = estimator.smoother is not None, len(record)
    keep: tuple[str, ...] = ("scores",)
    if smooth:
        beliefs = "beliefs" in estimator.smoother.needs
        keep = ("scores", "beliefs") if beliefs else ("scores", "predicted", "filtered")
    problem = _Problem.of(estimator, record, start)
    made = kernel(problem.layout(keep), "forward")
    passing = {"z", "truth", *made.program.histories[0]}
    arrays = problem.arrays(made.program, passing)
    _prior(problem, prior, arrays)
    calls = [(made, arrays)]
    if smooth:
        behind = attrs.evolve(problem, estimator=_afterwards(estimator))
        again = kernel(behind.layout(("scores",)), "backward")
        back = behind.arrays(again.program, passing | {"counted"})
        back["counted"] = arrays["counted"]
        _begin_backwards(back)
        calls.append((again, back))
    # A tile of lanes at a time, in the same memory: what passes through stays in the cache.
    shapes = made.program.shapes(1, steps)
    line = 8 * sum(int(np.prod(shapes[name])) for name in passing)
    size = max(BLOCK, _TILE_BYTES // line // BLOCK * BLOCK)
    shapes = made.program.shapes(min(size, problem.groups), steps)
    rooms = {name: allocate(shapes[name]) for name in passing}
    given = {"z": _flat(record.z, 2, record.batch)[:, : shapes["z"][2]]}
    given["truth"] = _flat(truth, 2, record.batch)
    for first in range(0, problem.groups, size):
        count = min(size, problem.groups - first)
        for name, values in given.items():
            lanes = values[..., first * WIDTH : (first + count) * WIDTH]
            tile_into(rooms[name][:count], lanes)
        for step, whole in calls:
            part = _some_groups(step.program, whole, first, count)
            part |= {name: room[:count] for name, room in rooms.items()}
            step.bind(part, count, steps)(0, count)
    stages = ("filter", "smoother")
    return {stage: _sums(problem, of) for stage, (_, of) in zip(stages, calls, strict=False)}


_TILE_BYTES = 1_000_000
"""Of measurements, truth and moments that pass through the cache at a time."""


def _some_groups(
    program: Program, arrays: Mapping[str, Array], first: int, count: int
) -> dict[str, Array]:
    """Views of some groups, the first of which begins a block."""
    out = {}
    for name, array in arrays.items():
        if name in program.curves[0]:
            out[name] = array[first // BLOCK : -(-(first + count) // BLOCK)]
        elif name in program.inputs and not program.inputs[name][1] & Rate.LANE:
            out[name] = array
        else:
            out[name] = array[first : first + count]
    return out


def _sums(problem: _Problem, arrays: Mapping[str, Array]) -> Sums:
    curves = arrays["curves"]
    lanes = curves[..., 0]
    for i in range(
        1, WIDTH
    ):  # one at a time: a sum along eight neighbours takes five times as long
        lanes = lanes + curves[..., i]
    return Sums(
        untile(arrays["totals"], problem.lanes),
        untile(arrays["final"], problem.lanes),
        np.moveaxis(lanes, 0, -1).swapaxes(0, 1),
    )
