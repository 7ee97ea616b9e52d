"""One compiled step on line, for `Estimator.step`: binding, calling, and results that are values.

What the step computes is the program that `tracker.compile.run` runs over a record, so the bits are
the same; histories, records and the decision what can be compiled stay there. Whatever is unusual
here (an argument that is wrong, a shape that only broadcasts) is left to the arrays and their words.
"""

from __future__ import annotations

import ctypes
import functools
import math
import os
import struct
import threading
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import attrs
import numpy as np

from tracker.compile import objects, run
from tracker.compile.fuse import Layout, forward
from tracker.compile.llvm import emit
from tracker.compile.program import WIDTH, Program, Rate
from tracker.errors import TraceError
from tracker.models.graph import needed
from tracker.models.parameters import numbers_of
from tracker.types import Array, Gaussian, Innovation

# The mapping inside os.environ: asking os.environ itself costs as much as half of a step.
_ENVIRONMENT: Mapping[Any, Any] = getattr(os.environ, "_data", os.environ)
_NAME = getattr(os.environ, "encodekey", str)("TRACKER_COMPILE")
_ON = getattr(os.environ, "encodevalue", str)("on")

_DOUBLE = np.dtype(np.float64)
_INFINITIES = (math.inf, -math.inf)
_KEEP = ("predicted", "filtered", "innovation")
"""What `tk.filter` keeps: another choice would be another program, and might round differently."""

_SHAPES = 64
"""Bound steps that an estimator remembers; a batch that grows all the time starts again."""

_BYTES = 8
_MANY = 64
"""From so many lanes on, how a result lies in memory matters more than the simplest way to get it."""

_V = f"<{WIDTH} x double>"


# -------------------------------------------------------------------------------- machine code
@attrs.frozen(eq=False)
class _Entry:
    """A compiled step in the layout that users have: components first, lanes last."""

    call: Callable[..., None]
    machine: objects.Machine
    program: Program
    timed: bool
    foreign: bool


class _Text:
    """Lines of the function that moves one group of lanes after the other through the step."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.count = 0

    def value(self, text: str) -> str:
        self.count += 1
        self.lines.append(f"  %w{self.count} = {text}")
        return f"%w{self.count}"

    def at(self, base: str, *offsets: str | int) -> str:
        for offset in offsets:
            base = self.value(f"getelementptr inbounds double, ptr {base}, i64 {offset}")
        return base

    def rows(self, pairs: Iterable[tuple[str, str]], *, masked: bool, out: bool) -> None:
        """Move vectors from first to second; what lies in lanes is masked in the last group."""
        mask = f"<{WIDTH} x i1> %mask"
        for source, target in pairs:
            if masked and not out:
                value = self.value(
                    f"call {_V} @llvm.masked.load.v{WIDTH}f64.p0(ptr {source}, i32 8, {mask}, "
                    f"{_V} zeroinitializer)"
                )
            else:
                value = self.value(f"load {_V}, ptr {source}, align 8")
            if masked and out:
                self.lines.append(
                    f"  call void @llvm.masked.store.v{WIDTH}f64.p0({_V} {value}, ptr {target}, "
                    f"i32 8, {mask})"
                )
            else:
                self.lines.append(f"  store {_V} {value}, ptr {target}, align 8")


@attrs.frozen(eq=False)
class _Place:
    """Where an entry's inputs lie: a buffer begins with scalars and goes on with rows over lanes."""

    buffer: str
    scalars: int
    row: int


def _given(name: str) -> bool:
    """Whether an input comes with every step; parameters and the sensor's index do not."""
    return name in {"dt", "t", "u", "z"} or name.startswith("pose")


def _places(program: Program) -> dict[str, _Place]:
    """For every input its buffer, its scalars or the number of all scalars, and its row.

    All poses share one place: only that of the sensor that measured is read. z comes last.
    """
    out = {}
    for buffer in ("given", "fixed"):
        mine = [name for name in program.inputs if _given(name) is (buffer == "given")]
        mine.sort(key="z".__eq__)
        sizes: dict[str, int] = {}
        for name in mine:
            shared = "pose" if name.startswith("pose") and buffer == "given" else name
            sizes[shared] = max(program.inputs[name][0], sizes.get(shared, 0))
        used, first = [0, 0], {}
        for name in mine:
            lane = bool(program.inputs[name][1] & Rate.LANE)
            shared = "pose" if name.startswith("pose") and buffer == "given" else name
            if shared not in first:
                first[shared] = used[lane]
                used[lane] += sizes[shared]
            out[name] = (buffer, lane, first[shared], used)
    return {
        name: _Place(buffer, used[0] if lane else start, start if lane else 0)
        for name, (buffer, lane, start, used) in out.items()
    }


def _moved(program: Program) -> str:
    """LLVM text of ``void run(fixed, given, before, after)``: groups of lanes through the step.

    Every array of the step is one group on the stack; what nobody asked for stays there.
    """
    w = _Text()
    shapes, places = program.shapes(1, 1), _places(program)
    n = len(program.states["x"])
    m = int((math.isqrt(8 * len(program.histories[0]["S"]) + 1) - 1) // 2)
    scalars = [k for k, (_, rate) in program.inputs.items() if not rate & Rate.LANE]
    for name, shape in shapes.items():
        if name not in scalars:
            w.lines.append(f"  %a.{name} = alloca [{math.prod(shape)} x double], align 64")
    w.lines.append("  %lanes = load i64, ptr %fixed, align 8")
    w.lines.append(f"  %pitch = load i64, ptr {w.at('%fixed', 1)}, align 8")
    values = w.at("%fixed", 2)
    start = {"given": "%given", "fixed": values}
    arguments = {name: f"%a.{name}" for name in shapes}
    for name in scalars:
        arguments[name] = w.at(start[places[name].buffer], places[name].scalars)

    def row(base: str, i: int) -> str:
        pitch = "%pitch" if base in {"%before", "%after"} else "%lanes"
        return w.at(base, w.value(f"mul i64 {pitch}, {i}"))

    def local(name: str, i: int) -> str:
        return w.at(f"%a.{name}", i * WIDTH)

    entering, leaving = [], []
    for name, (count, rate) in program.inputs.items():
        if rate & Rate.LANE:
            base = w.at(start[places[name].buffer], places[name].scalars)
            entering += [(row(base, places[name].row + i), local(name, i)) for i in range(count)]
    entering += [(row("%before", i), local("x", i)) for i in range(n)]
    leaving += [(local("filtered.x", i), row("%after", i)) for i in range(n)]
    for size, first, source in ((n, n, "filtered.P"), (m, n + n * n + m, "S")):
        k = 0
        for i in range(size):
            for j in range(i, size):
                if source == "filtered.P":
                    entering.append((row("%before", n + i * n + j), local("P", k)))
                for place in {i * size + j, j * size + i}:
                    leaving.append((local(source, k), row("%after", first + place)))
                k += 1
    leaving += [(local("residual", i), row("%after", n + n * n + i)) for i in range(m)]
    leaving += [(local("score", i), row("%after", n + n * n + m + m * m + i)) for i in range(3)]
    numbers, lanes = ", ".join(f"i64 {i}" for i in range(WIDTH)), f"<{WIDTH} x i64>"
    w.lines += [
        "  br label %group",
        "group:",
        "  %at = phi i64 [0, %entry], [%next, %done]",
        "  %left = sub i64 %lanes, %at",
        f"  %whole = icmp sge i64 %left, {WIDTH}",
        f"  %one = insertelement {lanes} poison, i64 %left, i32 0",
        f"  %all = shufflevector {lanes} %one, {lanes} poison, <{WIDTH} x i32> zeroinitializer",
        f"  %mask = icmp slt {lanes} <{numbers}>, %all",
        "  br i1 %whole, label %in.whole, label %in.part",
    ]

    def both(direction: str, pairs: list[tuple[str, str]], then: str) -> None:
        out = direction == "out"
        for kind in ("whole", "part"):
            w.lines.append(f"{direction}.{kind}:")
            here = [(s, w.at(t, "%at")) if out else (w.at(s, "%at"), t) for s, t in pairs]
            w.rows(here, masked=kind == "part", out=out)
            w.lines.append(f"  br label %{then}")

    both("in", entering, "ready")
    pointers = ", ".join(f"ptr {arguments[name]}" for name in shapes)
    w.lines += [
        "ready:",
        f"  call void @step(i64 0, i64 1, i64 1, {pointers})",
        "  br i1 %whole, label %out.whole, label %out.part",
    ]
    both("out", leaving, "done")
    w.lines += [
        "done:",
        f"  %next = add i64 %at, {WIDTH}",
        "  %more = icmp slt i64 %next, %lanes",
        "  br i1 %more, label %group, label %exit",
        "exit:",
        "  ret void",
        "}",
    ]
    head = [
        f"declare {_V} @llvm.masked.load.v{WIDTH}f64.p0(ptr, i32, <{WIDTH} x i1>, {_V})",
        f"declare void @llvm.masked.store.v{WIDTH}f64.p0({_V}, ptr, i32, <{WIDTH} x i1>)",
        "define void @run(ptr %fixed, ptr %given, ptr %before, ptr %after) {",
        "entry:",
    ]
    return "\n".join([*head, *w.lines]) + "\n"


@functools.lru_cache(maxsize=64)
def _entry(layout: Layout) -> _Entry:
    kinds: set[type] = set()
    program = forward(attrs.evolve(layout, filter=_Watched(layout.filter, kinds)))
    # The step is the very text that records are filtered with; the name run is for our own.
    text = emit(program).replace("define void @run(", "define internal void @step(", 1)
    machine = objects.compiled(text + _moved(program))
    call = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 4)(machine.address)
    nodes = (n for v in range(program.variants) for n in needed(program.roots(v)))
    return _Entry(
        call=call,
        machine=machine,
        program=program,
        timed=any(n.op == "input" and n.value == "t.0" for n in nodes),
        foreign=kinds != {Gaussian, Innovation},
    )


class _Watched:
    """A filter that tells of what kind its results are: another state than a Gaussian says more."""

    def __init__(self, rule: Any, kinds: set[type]) -> None:
        self._rule, self._kinds = rule, kinds

    def __getattr__(self, name: str) -> Any:
        return getattr(self._rule, name)

    def update(self, *arguments: Any) -> Any:
        state, innovation = self._rule.update(*arguments)
        self._kinds |= {type(state), type(innovation)}
        return state, innovation


# ------------------------------------------------------------------------------------- results
class _Estimate(Gaussian):
    """What a compiled step returns: a Gaussian whose arrays are made when first asked for.

    They look into memory that the step was given for this result alone, so that what a user writes
    into them counts in the next step, as it does in any Gaussian.

    Laws:
        a value like any other: no later step writes into its memory; copied and pickled as a plain
        Gaussian.
    """

    __slots__ = ("_source",)
    _source: tuple[Any, _Bound]

    def __new__(cls, *arguments: Any, **named: Any) -> Any:
        """A changed copy (`attrs.evolve`) is a plain Gaussian: it was not made by a step."""
        return Gaussian(*arguments, **named)

    @classmethod
    def trusted(cls, mean: Array, cov: Array) -> Gaussian:
        """A plain Gaussian, for the same reason."""
        return Gaussian.trusted(mean, cov)

    def __getattr__(self, name: str) -> Any:
        # Python comes here for a slot that is still empty.
        if name not in {"mean", "cov"}:
            raise AttributeError(name)
        buffer, bound = self._source
        made = bound.read(buffer, name)
        object.__setattr__(self, name, made)
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        return Gaussian.trusted, (self.mean, self.cov)

    def __repr__(self) -> str:
        return repr(Gaussian.trusted(self.mean, self.cov))


class _Surprise(Innovation):
    """The innovation of a compiled step; its arrays, too, are made when first asked for."""

    __slots__ = ("_source",)
    _source: tuple[Any, _Bound]

    def __new__(cls, *arguments: Any, **named: Any) -> Any:
        """As with an estimate."""
        return Innovation(*arguments, **named)

    def __getattr__(self, name: str) -> Any:
        if name not in _FIELDS:
            raise AttributeError(name)
        buffer, bound = self._source
        made = bound.read(buffer, name)
        object.__setattr__(self, name, made)
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        return Innovation, tuple(getattr(self, name) for name in _FIELDS)

    def __repr__(self) -> str:
        return repr(Innovation(*(getattr(self, name) for name in _FIELDS)))


_FIELDS = tuple(field.name for field in attrs.fields(Innovation))
_new = object.__new__
# A frozen class refuses assignment, and object.__setattr__ costs twice what a slot's setter does.
_fill_estimate = vars(_Estimate)["_source"].__set__
_fill_surprise = vars(_Surprise)["_source"].__set__


# ------------------------------------------------------------------------------------- binding
@attrs.frozen(eq=False)
class _View:
    """Some rows of a result's buffer as an array over the batch; without axes it is one number."""

    shape: tuple[int, ...]
    row: int
    start: int
    strides: tuple[int, ...]

    def of(self, buffer: Any) -> Array:
        """The array; it keeps the buffer alive."""
        return np.ndarray(self.shape, _DOUBLE, buffer, self.start, self.strides)


def _views(n: int, m: int, most: int, batch: tuple[int, ...], pitch: int) -> dict[str, _View]:
    """Where everything lies in a result, by its name; see `_Bound`."""
    inner = tuple(_BYTES * math.prod(batch[i + 1 :]) for i in range(len(batch)))

    def view(row: int, *axes: tuple[int, int]) -> _View:
        lengths = tuple(length for length, _ in axes)
        strides = tuple(_BYTES * pitch * rows for _, rows in axes)
        return _View((*lengths, *batch), row, _BYTES * pitch * row, strides + inner)

    first = n + n * n
    last = first + most + most * most
    return {
        "mean": view(0, (n, 1)),
        "cov": view(n, (n, n), (n, 1)),
        "residual": view(first, (m, 1)),
        "S": view(first + most, (m, most), (m, 1)),
        "nis": view(last),
        "ok": view(last),  # finite or not
        "loglik": view(last + 1),
        "count": view(last + 2),
    }


def _pitch(lanes: int) -> int:
    """From one row of a result to the next: many rows a power of two apart evict each other."""
    return lanes if lanes < _MANY else WIDTH * (-(-lanes // WIDTH) | 1)


def _allocation(size: int) -> Callable[[], Any]:
    """How to get memory for a result: ctypes' own is cheap while clearing it costs nothing."""
    buffer, larger = ctypes.c_double * size, ctypes.c_double * (size + WIDTH)
    if size < _MANY * WIDTH:
        return buffer

    def unwritten() -> Any:
        # On a cache line: vectors that lie across two of them cost twice as much.
        memory: Any = np.empty(size + WIDTH)
        start = -ctypes.addressof(larger.from_buffer(memory)) % (_BYTES * WIDTH)
        return buffer.from_buffer(memory, start)

    return unwritten


@attrs.frozen(eq=False, kw_only=True)
class _Bound:
    """A step for one estimator, one sensor and arguments of certain shapes; it never changes.

    A result holds ``rows`` over lanes: mean, covariance, residual, S, NIS, log-likelihood, count.
    """

    entry: _Entry
    fixed: bytes
    allocated: Callable[[], Any]
    batch: tuple[int, ...]
    views: Mapping[str, _View]
    scalar: Mapping[str, bool]
    pose_filling: bytes
    z_filling: bytes

    def given(self, z: Array, dt: Any, t: Any, pose: Any, u: Any) -> bytes:
        """The inputs of one step in the order of `_places`: scalars, then rows, z last."""
        scalars: list[bytes] = []
        rows: list[bytes] = []
        if self.scalar["dt"]:
            scalars.append(_two(dt, t))
        else:
            rows += [np.broadcast_to(v, self.batch).tobytes() for v in (dt, t)]
        if u is not None:
            (scalars if self.scalar["u"] else rows).append(u.tobytes())
        where = scalars if self.scalar["pose"] else rows
        where += [b"" if pose is None else pose.tobytes(), self.pose_filling]
        return b"".join((*scalars, *rows, z.tobytes(), self.z_filling))

    def read(self, buffer: Any, name: str) -> Any:
        """One field of a result, of the type that arrays would give it."""
        view = self.views[name]
        if view.shape:
            made = view.of(buffer)
            return np.isfinite(made) if name == "ok" else made
        number = buffer[view.row]
        return math.isfinite(number) if name == "ok" else number


_two = struct.Struct("=2d").pack


def _bind(
    estimator: Any,
    sensor: int,
    z: tuple[int, ...],
    time: tuple[int, ...],
    pose: tuple[int, ...] | None,
    u: tuple[int, ...] | None,
    timeless: bool,
) -> _Bound | None:
    """The compiled step for arguments of these shapes; None if arrays have to do it."""
    if run.reason(estimator) or not 0 <= sensor < len(estimator.sensors):
        return None
    if run.begins_otherwise(estimator):
        return None
    sensors, model, batch = estimator.sensors, estimator.sensors[sensor], z[1:]
    lanes, size = math.prod(batch), model.pose_space.size
    scalar = {"dt": not time, "pose": pose is None or len(pose) == 1, "u": u is None or len(u) == 1}
    fits = (
        lanes > 0
        and z[:1] == (model.space.size,)
        and time in {(), batch}
        and (pose in {(size,), (size, *batch)} if size else pose is None)
        and (u is None or (len(u) > 0 and u[1:] in {(), batch}))
        and (u is None or _inputs(estimator.motion) in {None, u[0]})
    )
    if not fits:
        return None
    rates = {name: Rate.BOTH for name in ("dt", "u") if not scalar[name]}
    if not scalar["pose"]:
        rates |= {f"pose{i}": Rate.BOTH for i in range(len(sensors))}
    try:
        layout = run._layout(estimator, rates, 0 if u is None else u[0], _KEEP)  # noqa: SLF001
        entry = _entry(layout)
        fixed = _fixed(estimator, entry.program, sensor, batch)
    except (TraceError, TypeError, AttributeError, ValueError, IndexError):
        return None
    if entry.foreign or (entry.timed and timeless):
        return None
    pitch = _pitch(lanes)
    n, most = estimator.motion.space.size, max(s.space.size for s in sensors)
    widest = max(s.pose_space.size for s in sensors)
    return _Bound(
        entry=entry,
        fixed=fixed,
        allocated=_allocation(pitch * (n * (n + 1) + most * (most + 1) + 3)),
        batch=batch,
        views=_views(n, model.space.size, most, batch, pitch),
        scalar=scalar,
        pose_filling=bytes(_BYTES * (1 if scalar["pose"] else lanes) * (widest - size)),
        z_filling=bytes(_BYTES * lanes * (most - model.space.size)),
    )


def _inputs(motion: Any) -> int | None:
    """How many inputs a motion takes, where it tells."""
    space = getattr(motion, "input_space", None)
    return None if space is None else int(space.size)


def _fixed(estimator: Any, program: Program, sensor: int, batch: tuple[int, ...]) -> bytes:
    """The number of lanes and the pitch, then what does not change from step to step."""
    owners = run.owners(estimator)
    lanes = math.prod(batch)
    scalars, rows = [struct.pack("=2q", lanes, _pitch(lanes))], []
    for name, (_, rate) in program.inputs.items():
        if _given(name):
            continue
        owner, _, parameter = name.partition(".")
        value = sensor if name == "variant" else numbers_of(owners[owner])[parameter]
        if rate & Rate.LANE:
            rows.append(np.broadcast_to(np.asarray(value, _DOUBLE), batch).tobytes())
        else:
            scalars.append(struct.pack("=d", value))
    return b"".join((*scalars, *rows))


# ------------------------------------------------------------------------------------ stepping
def _real(values: Any) -> Array:
    array = np.asarray(values)
    if array.dtype.kind not in "fiu" or isinstance(values, np.ma.MaskedArray):
        raise TypeError
    return array.astype(_DOUBLE, copy=False)


def _forwards(dt: Any) -> bool:
    return bool(((dt >= 0) & (dt < math.inf)).all())


class Steps:
    """The bound steps of one estimator: remembered, safe between threads, never copied along."""

    __slots__ = ("_known", "_lock")

    def __init__(self) -> None:
        self._known: dict[Any, _Bound | None] = {}
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[Any, ...]:
        return Steps, ()

    def __repr__(self) -> str:
        return "Steps()"

    def step(
        self, estimator: Any, state: Any, z: Any, dt: Any, pose: Any, u: Any, t: Any, sensor: Any
    ) -> tuple[Gaussian, Innovation] | None:
        """One compiled step, or None where the arrays have to do it or to say what is wrong.

        Raises:
            ConfigError, CapabilityError: as `tracker.compile.run.reason`.
        """
        wanted = _ENVIRONMENT.get(_NAME)
        if wanted is not None and wanted != _ON and run.mode() == "off":
            return None
        time: tuple[int, ...] = ()
        try:
            if type(z) is not np.ndarray or z.dtype is not _DOUBLE:
                z = _real(z)
            if type(dt) is not float:
                dt = _real(dt)
                time = dt.shape
            usual = pose is None and u is None and t is None
            if not usual:
                pose = None if pose is None else _real(pose)
                u = None if u is None else _real(u)
                if t is not None and type(t) is not float:
                    t = _real(t)
                    time = time or t.shape
            shapes = (
                (z.shape, time)
                if usual
                else (
                    z.shape,
                    time,
                    *(None if v is None else v.shape for v in (pose, u)),
                    t is None,
                )
            )
            bound = self._known[sensor, shapes]
        except KeyError:
            bound = self._bound(estimator, sensor, shapes)
        except (TypeError, ValueError):
            return None
        if bound is None:
            if wanted is not None:
                run.reason(estimator)  # refuses where compiling is required
            return None
        # Whatever is wrong with the numbers, the arrays say it in words.
        if bound.batch:
            if np.isinf(z).any():
                return None
        else:
            few = z.tolist()
            if math.inf in few or -math.inf in few:
                return None
        if not (0.0 <= dt < math.inf if not time else _forwards(dt)):
            return None
        if not usual and not all(v is None or np.isfinite(v).all() for v in (pose, u, t)):
            return None
        before = _before(state, bound)
        if before is None:
            return None
        now = 0.0 if t is None else t
        given = bound.given(z, dt, now, pose, u)
        after = bound.allocated()
        bound.entry.call(bound.fixed, given, before, after)
        source = (after, bound)
        estimate, surprise = _new(_Estimate), _new(_Surprise)
        _fill_estimate(estimate, source)
        _fill_surprise(surprise, source)
        return estimate, surprise

    def _bound(self, estimator: Any, sensor: int, shapes: tuple[Any, ...]) -> _Bound | None:
        with self._lock:
            if len(self._known) >= _SHAPES:
                self._known = {}
            full = shapes if len(shapes) > 2 else (*shapes, None, None, True)
            made = _bind(estimator, sensor, *full)
            self._known[sensor, shapes] = made
        return made


def _before(state: Any, bound: _Bound) -> Any:
    """Rows of mean and covariance, or None for a state of another kind or shape."""
    kind = type(state)
    if kind is _Estimate:
        buffer, made = state._source  # noqa: SLF001 - a class of this module
        if made is bound or made.views["mean"].shape == bound.views["mean"].shape:
            return buffer
        return None
    if kind is not Gaussian:
        return None
    buffer = bound.allocated()
    for name in ("mean", "cov"):
        values, view = getattr(state, name), bound.views[name]
        if values.shape != view.shape or values.dtype != _DOUBLE:
            return None
        view.of(buffer)[...] = values
    return buffer
