"""Prediction and weighing of one cloud as machine code, its particles in the place of time steps.

A step program (`tracker.compile.program`) walks through rows of 8 numbers at a time and adds up as it
goes: what it does for one lane over time, it does here for one belief over its particles, models,
draws, weights and moments in one pass. The arrays in `propagation` and `likelihood` say what is
computed, and compute it wherever this module answers None: without llvmlite, for models that cannot
be traced, for batches, for numbers of particles that do not fill rows of 8.
"""

from __future__ import annotations

import ctypes
import functools
import math
import os
import threading
import weakref
from collections.abc import Callable, Mapping, MutableMapping
from typing import Any

import attrs
import numpy as np

from tracker.algebra import condition
from tracker.compile import objects
from tracker.compile.fuse import structure, vector
from tracker.compile.llvm import emit
from tracker.compile.program import WIDTH, Program, Rate
from tracker.errors import TraceError
from tracker.models.functions import cos, exp, isnan, less, log, sin, sqrt, where
from tracker.models.graph import Node, needed
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Array, Gaussian, Innovation
from tracker_particle import draws
from tracker_particle.belief import Particles

_TINY = 1e-250
"""Below this sum of likelihoods, relative to the largest there could be, digits are lost."""

_SHARP = 1e-6
"""A variance below this share of the mean square about the centre is computed again, in two passes."""


@attrs.frozen(eq=False)
class Pass:
    """A compiled pass over the particles of a belief, and memory for the numbers that it leaves."""

    call: Callable[..., None]
    machine: objects.Machine
    left: Any


@attrs.frozen
class _Ahead:
    """What a prediction bakes in: the motion's structure and how many numbers it is given."""

    structure: tuple[Any, ...]
    columns: int
    inputs: int
    motion: Any = attrs.field(eq=False)


@attrs.frozen
class _Weigh:
    """What weighing bakes in."""

    structure: tuple[Any, ...]
    n: int
    sensor: Any = attrs.field(eq=False)


# ----------------------------------------------------------------------------------- programs
class _Rows:
    """A program over rows: particles are its time steps, numbers that all share its constants."""

    def __init__(self) -> None:
        self.program = Program()

    def row(self, name: str) -> Any:
        return self.program.input(name, 1, Rate.BOTH)[0]

    def rows(self, name: str, count: int) -> list[Any]:
        return [self.row(f"{name}{i}") for i in range(count)]

    def out(self, name: str, entries: Any) -> None:
        for i, entry in enumerate(entries):
            self.program.history(f"{name}{i}", [entry])

    def differs(self, entry: Any) -> bool:
        """Whether a value differs from particle to particle."""
        if not isinstance(entry, Node):
            return False
        return bool(self.program.rates(needed([entry]))[entry.index] & Rate.LANE)

    def finished(
        self, constants: list[Any], sums: list[Any], conclude: Callable[..., list[Any]]
    ) -> Pass:
        """The pass whose sums, and constants of all particles, lead to what ``conclude`` says."""
        self.program.state("constants", len(constants))
        self.program.set("constants", constants)
        self.program.total("sums", sums)
        last = Program()
        c = last.input("constants", len(constants), Rate.CALL)
        s = last.input("sums", len(sums), Rate.CALL)
        given = last.input("given", self.program.inputs["given"][0], Rate.CALL)
        found = conclude(c, s, given)
        last.state("found", len(found))
        last.set("found", found)
        texts = [
            emit(program).replace("define void @run(", f"define internal void @{name}(", 1)
            for name, program in (("step", self.program), ("last", last))
        ]
        lines = [line for text in texts for line in text.splitlines()]
        declared = dict.fromkeys(line for line in lines if line.startswith("declare "))
        defined = [line for line in lines if not line.startswith("declare ")]
        entry = _entry(self.program, len(constants), len(sums), len(found))
        machine = objects.compiled("\n".join([*declared, *defined, *entry]) + "\n")
        call = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 4, *[ctypes.c_void_p] * 6)(
            machine.address
        )
        return Pass(call, machine, ctypes.c_double * len(found))


_PLACES = {"x": "points", "weight": "weights", "a": "drawn", "b": "drawn", "given": "given"}


_MATRICES = ("points", "weights", "drawn", "given", "out", "left")


def _entry(program: Program, constants: int, sums: int, found: int) -> list[str]:
    """LLVM text of ``void run(N, key, key, word, points, weights, drawn, given, out, left)``.

    It draws the uniforms, says where the rows of the step lie in matrices, adds up the eight parts of its sums, and hands
    them to the conclusion.
    """
    wide_ = f"<{WIDTH} x double>"
    pointers = ", ".join(f"ptr %{name}" for name in _MATRICES)
    lines = [
        f"declare double @llvm.vector.reduce.fadd.v{WIDTH}f64(double, {wide_})",
        f"define void @run(i64 %N, i64 %k1, i64 %k2, i64 %word, {pointers}) {{",
        "entry:",
        f"  %groups = sdiv i64 %N, {WIDTH}",
    ]
    half = sum(name.startswith("a") for name in program.inputs)
    for name, size in (
        ("constants", constants * WIDTH), ("sums", sums * WIDTH), ("found", found * WIDTH),
        ("constants.one", constants), ("sums.one", sums),
    ):  # fmt: skip
        lines.append(f"  %a.{name} = alloca [{size} x double], align 64")
    lines.append(f"  store [{sums * WIDTH} x double] zeroinitializer, ptr %a.sums, align 64")
    if half:
        lines += _uniforms(2 * half)
    arguments = []
    for name in program.shapes(1, 1):
        pointer = f"%a.{name}"
        if name not in program.states:
            kind = name.rstrip("0123456789")
            row = int(name[len(kind) :] or 0) + (half if kind == "b" else 0)
            lines.append(f"  %o.{name} = mul i64 %N, {row}")
            base = f"%{_PLACES.get(kind, 'out')}"
            lines.append(f"  {pointer} = getelementptr inbounds double, ptr {base}, i64 %o.{name}")
        arguments.append(f"ptr {pointer}")
    lines.append(f"  call void @step(i64 0, i64 1, i64 %groups, {', '.join(arguments)})")

    def moved(kind: str, count: int, target: str, *, added: bool) -> None:
        for i in range(count):
            at = f"{kind}.{i}"
            lines.append(
                f"  %f.{at} = getelementptr inbounds double, ptr %a.{kind}, i64 {i * WIDTH}"
            )
            if added:
                lines.append(f"  %w.{at} = load {wide_}, ptr %f.{at}, align 8")
                add = f"call double @llvm.vector.reduce.fadd.v{WIDTH}f64(double -0.0, {wide_} %w.{at})"
                lines.append(f"  %v.{at} = {add}")
            else:
                lines.append(f"  %v.{at} = load double, ptr %f.{at}, align 8")
            lines.append(f"  %t.{at} = getelementptr inbounds double, ptr {target}, i64 {i}")
            lines.append(f"  store double %v.{at}, ptr %t.{at}, align 8")

    moved("constants", constants, "%a.constants.one", added=False)
    moved("sums", sums, "%a.sums.one", added=True)
    lines.append(
        "  call void @last(i64 0, i64 1, i64 1, ptr %a.constants.one, ptr %a.sums.one, ptr %given, "
        "ptr %a.found)"
    )
    moved("found", found, "%left", added=False)
    return [*lines, "  ret void", "}"]


def _uniforms(rows: int) -> list[str]:
    """LLVM text that fills ``rows`` of N uniforms: `draws.normals` before it makes normals of them.

    Reference:
        Doty-Humphrey, PractRand, sfc.h (SFC64), eight of it side by side.
    """
    v = f"<{draws.STREAMS} x i64>"
    places = ", ".join(f"i64 {i}" for i in range(draws.STREAMS))

    def splat(name: str, value: str) -> list[str]:
        everywhere = f"<{draws.STREAMS} x i32> zeroinitializer"
        return [
            f"  %{name}.one = insertelement {v} poison, i64 {value}, i32 0",
            f"  %{name} = shufflevector {v} %{name}.one, {v} poison, {everywhere}",
        ]

    def all_(number: int) -> str:
        return f"<{', '.join([f'i64 {number}'] * draws.STREAMS)}>"

    unit = f"<{', '.join(['double 0x3CA0000000000000'] * WIDTH)}>"  # 2**-53
    return [
        *splat("seed.a", "%k1"),
        *splat("seed.b", "%k2"),
        *splat("seed.word", "%word"),
        f"  %seed.c = add {v} %seed.word, <{places}>",
        f"  %numbers = mul i64 %groups, {rows}",
        "  br label %draw",
        "draw:",
        f"  %i = phi i64 [-{draws.MIXING}, %entry], [%i.next, %drawn.one]",
        f"  %a = phi {v} [%seed.a, %entry], [%a.next, %drawn.one]",
        f"  %b = phi {v} [%seed.b, %entry], [%b.next, %drawn.one]",
        f"  %c = phi {v} [%seed.c, %entry], [%c.next, %drawn.one]",
        f"  %w = phi {v} [{all_(1)}, %entry], [%w.next, %drawn.one]",
        "  %row = phi i64 [0, %entry], [%row.next, %drawn.one]",
        "  %column = phi i64 [0, %entry], [%column.next, %drawn.one]",
        f"  %ab = add {v} %a, %b",
        f"  %new = add {v} %ab, %w",
        f"  %w.next = add {v} %w, {all_(1)}",
        f"  %b.low = lshr {v} %b, {all_(11)}",
        f"  %a.next = xor {v} %b, %b.low",
        f"  %c.high = shl {v} %c, {all_(3)}",
        f"  %b.next = add {v} %c, %c.high",
        f"  %c.up = shl {v} %c, {all_(24)}",
        f"  %c.down = lshr {v} %c, {all_(40)}",
        f"  %c.turned = or {v} %c.up, %c.down",
        f"  %c.next = add {v} %c.turned, %new",
        "  %mixed = icmp sge i64 %i, 0",
        "  br i1 %mixed, label %keep, label %drawn.one",
        "keep:",
        "  %row.start = mul i64 %row, %N",
        "  %place = add i64 %row.start, %column",
        "  %to = getelementptr inbounds double, ptr %drawn, i64 %place",
        f"  %bits = lshr {v} %new, {all_(11)}",
        f"  %whole = uitofp {v} %bits to <{WIDTH} x double>",
        f"  %unit = fmul <{WIDTH} x double> %whole, {unit}",
        f"  store <{WIDTH} x double> %unit, ptr %to, align 8",
        "  %row.after = add i64 %row, 1",
        f"  %whole.group = icmp eq i64 %row.after, {rows}",
        "  %row.new = select i1 %whole.group, i64 0, i64 %row.after",
        f"  %column.after = add i64 %column, {WIDTH}",
        "  %column.new = select i1 %whole.group, i64 %column.after, i64 %column",
        "  br label %drawn.one",
        "drawn.one:",
        "  %row.next = phi i64 [0, %draw], [%row.new, %keep]",
        "  %column.next = phi i64 [0, %draw], [%column.new, %keep]",
        "  %i.next = add i64 %i, 1",
        "  %done = icmp sge i64 %i.next, %numbers",
        "  br i1 %done, label %pass, label %draw",
        "pass:",
    ]


def _second_moments(weight: Any, d: list[Any]) -> list[Any]:
    scaled = [weight * e for e in d]
    return [*scaled, *(scaled[i] * d[j] for i, j in _upper(len(d)))]


def _upper(m: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(m) for j in range(i, m)]


def _with(model: Any, nodes: list[Any]) -> Any:
    if not nodes:
        return model
    return model.with_parameters(**dict(zip(model.parameters, nodes, strict=True)))


@functools.lru_cache(maxsize=64)
def _ahead(key: _Ahead) -> Pass:
    """Rows in: x, uniforms in pairs, log weights. Rows out: x. Given: dt, t, u, parameters, root,
    centre. Constants out: where the centre goes.
    """
    n, k, q = key.motion.space.size, key.columns, key.inputs
    rows = _Rows()
    x = vector(rows.rows("x", n))
    pairs = [(rows.row(f"a{i}"), rows.row(f"b{i}")) for i in range(-(-k // 2))]
    weight = exp(rows.row("weight"))
    parameters = len(key.motion.parameters)
    given = rows.program.input("given", 2 + q + parameters + n * k + n, Rate.CALL)
    dt, t, u = given[0], given[1], given[2 : 2 + q]
    motion = _with(key.motion, given[2 + q : 2 + q + parameters])
    rest = given[2 + q + parameters :]
    noise: list[Any] = [None] * (2 * len(pairs))
    for i, (a, b) in enumerate(pairs):  # as `draws.normals`
        radius, angle = sqrt(-2.0 * log(1.0 - a)), (2.0 * math.pi) * (b - 0.5)
        noise[i], noise[len(pairs) + i] = radius * cos(angle), radius * sin(angle)
    inputs = vector(u) if q else None
    ahead = list(motion.f(x, dt, inputs, t))
    for i in range(n):
        for j in range(k):
            ahead[i] = ahead[i] + rest[i * k + j] * noise[j]
    centre = list(motion.f(vector(rest[n * k :]), dt, inputs, t))
    rows.out("ahead", ahead)
    d = [a - c for a, c in zip(ahead, centre, strict=True)]

    def conclude(centre: list[Any], sums: list[Any], _given: list[Any]) -> list[Any]:
        return _gaussian(centre, sums, 1.0)

    return rows.finished(centre, _second_moments(weight, d), conclude)


@functools.lru_cache(maxsize=64)
def _weigh(key: _Weigh) -> Pass:
    """Rows in: x, log weights. Rows out: log weights, not yet of sum one. Given: z, pose,
    parameters, centre. Constants out: the largest log-likelihood there can be, R.
    """
    sensor, n, m = key.sensor, key.n, key.sensor.space.size
    rows = _Rows()
    x = vector(rows.rows("x", n))
    before = rows.row("weight")
    p, parameters = sensor.pose_space.size, len(sensor.parameters)
    given = rows.program.input("given", m + p + parameters + n, Rate.CALL)
    z, pose = vector(given[:m]), vector(given[m : m + p]) if p else None
    sensor = _with(sensor, given[m + p : m + p + parameters])
    about = vector(given[m + p + parameters :])
    R = sensor.R(x, pose)
    if any(rows.differs(e) for e in R.ravel()):
        raise TraceError("the noise of the measurement differs from particle to particle")
    h = sensor.h(x, pose)
    none = vector([where(isnan(a), a, 0.0) for a in z])
    peak = _log_density(none, R, about)
    density = _log_density(sensor.residual(z, h), R, x)
    for a in range(m):  # no answer is no measurement only where nothing was measured
        density = density + where(isnan(z[a]), 0.0, where(isnan(h[a]), math.nan, 0.0))
    after = before + where(isnan(density), -math.inf, density)
    rows.out("after", [after])
    # Where nothing was measured, residuals are about what would be measured of the centre.
    usual = sensor.h(about, pose)
    reference = vector([where(isnan(a), b, a) for a, b in zip(z, usual, strict=True)])
    v = list(sensor.residual(reference, h))
    chance = exp(after - peak)
    d = [a - c for a, c in zip(x, about, strict=True)]

    def conclude(constants: list[Any], sums: list[Any], given: list[Any]) -> list[Any]:
        peak, noise, z = constants[0], constants[1:], given[:m]
        prior, (total, squares), rest = (
            sums[: m + len(noise)],
            sums[m + len(noise) :][:2],
            sums[m + len(noise) + 2 :],
        )
        mean, cov = _mean_and_covariance([0.0] * m, prior, 1.0)
        S = np.empty((m, m), dtype=object)
        for (i, j), r in zip(_upper(m), noise, strict=True):
            S[i, j] = S[j, i] = cov[i][j] + r
        v = [where(isnan(a), math.nan, b) for a, b in zip(z, mean, strict=True)]
        loglik = peak + log(total)
        centre = given[len(given) - n :]
        nis = _conditioned(vector(v), S, vector(centre))[2]
        found = [*v, *S.ravel(), nis, loglik, total, total * total / squares]
        return [*_gaussian(centre, rest, total), *found]

    return rows.finished(
        [peak, *(R[i, j] for i, j in _upper(m))],
        [*_second_moments(exp(before), v), chance, chance * chance, *_second_moments(chance, d)],
        conclude,
    )


def _conditioned(v: Any, S: Any, x: Any) -> tuple[Any, ...]:
    """What a Gaussian without spread would be told by a residual: nis and loglik are of v alone."""
    n, m = len(x), len(v)
    still, unrelated = np.zeros((n, n), dtype=object), np.zeros((n, m), dtype=object)
    return condition(x, still, v, S, unrelated)


def _log_density(v: Any, R: Any, x: Any) -> Any:
    """That of the measured components."""
    return _conditioned(v, R, x)[3]


def _mean_and_covariance(
    centre: list[Any], sums: list[Any], total: Any
) -> tuple[list[Any], list[list[Any]]]:
    """From sums about a centre."""
    n = len(centre)
    shift = [s / total for s in sums[:n]]
    squares = iter(sums[n:])
    cov: list[list[Any]] = [[None] * n for _ in range(n)]
    for i in range(n):
        for j in range(i, n):
            cov[i][j] = cov[j][i] = next(squares) / total - shift[i] * shift[j]
    return [c + s for c, s in zip(centre, shift, strict=True)], cov


def _gaussian(centre: list[Any], sums: list[Any], total: Any) -> list[Any]:
    """Mean, covariance, and 1 if the sums had enough digits for it."""
    mean, cov = _mean_and_covariance(centre, sums, total)
    n, good, at = len(mean), 1.0, len(mean)
    for i in range(n):
        good = where(less(_SHARP * sums[at] / total, cov[i][i]), good, 0.0)
        at += n - i
    return [*mean, *(e for row in cov for e in row), good]


# ------------------------------------------------------------------------------------ running
def ahead(
    state: Particles, motion: MotionModel, dt: Any, u: Any, t: Any, root: Array
) -> Particles | None:
    """The belief after the motion, as `propagation.propagated` has it; root ``(n, k, 1)``."""
    if not _runs(state) or type(dt) is not float or root.ndim != 3 or root.shape[2] != 1:
        return None
    flags = motion.space.circular
    inputs = [] if u is None else np.asarray(u).tolist()
    n, count = state.points.shape
    k = root.shape[1]
    usual = len(flags) == n and not any(flags)
    found = _found(_made_ahead, motion, (k, len(inputs))) if usual else None
    if found is None:
        return None
    done, parameters = found
    time = 0.0 if t is None else t
    given = (dt, time, *inputs, *parameters, *root.ravel().tolist(), *_centre(state))
    out, left = _numbers(n * count)(), done.left()
    points, weights = _memory(state)
    drawn = _scratch.of(2 * -(-k // 2) * count)
    third = draws.word(state.step, draws.NOISE)
    numbers = _numbers(len(given))(*given)
    done.call(count, *state.key.tolist(), third, points, weights, drawn, numbers, out, left)
    return Particles.known_as(
        np.ndarray((n, count), _DOUBLE, out),
        state.log_weights,
        state.key,
        state.step + 1,
        flags,
        _read(left, n),
        None,
        (out, weights),
    )


def weigh(
    state: Particles, sensor: SensorModel, z: list[float], pose: Any
) -> tuple[Particles, Innovation] | None:
    """The belief after a measurement, as `likelihood.weighed` has it."""
    if not _runs(state):
        return None
    n, count = state.points.shape
    place = [] if pose is None else np.asarray(pose).tolist()
    flags = sensor.state.circular
    sizes = (len(flags), len(z), len(place)) == (n, sensor.space.size, sensor.pose_space.size)
    usual = sizes and not any(flags)
    found = _found(_made_weigh, sensor, n) if usual else None
    if found is None:
        return None
    done, parameters = found
    given = (*z, *place, *parameters, *_centre(state))
    out, left = _numbers(count)(), done.left()
    points, weights = _memory(state)
    numbers = _numbers(len(given))(*given)
    done.call(count, 0, 0, 0, points, weights, None, numbers, out, left)
    m, at = len(z), n + n * n + 1
    nis, loglik, total, size = left[at + m + m * m :]
    if not total > _TINY:
        return None
    log_weights = np.ndarray((count,), _DOUBLE, out)
    log_weights -= loglik
    belief = Particles.known_as(
        state.points,
        log_weights,
        state.key,
        state.step,
        flags,
        _read(left, n),
        size,
        (points, out),
    )
    v = np.ndarray((m,), _DOUBLE, left, _BYTES * at)
    S = np.ndarray((m, m), _DOUBLE, left, _BYTES * (at + m))
    measured: Any = float(sum(a == a for a in z))  # noqa: PLR0124 - not NaN
    ok: Any = math.isfinite(nis)
    return belief, Innovation(v, S, nis, loglik, measured, ok)


# ------------------------------------------------------------------------------------- inside
_DOUBLE = np.dtype(np.float64)
_BYTES = 8

_available = functools.cache(objects.available)

_FOUND: MutableMapping[Any, dict[Any, Any]] = weakref.WeakKeyDictionary()
"""The passes of models, by what else they depend on; None where there is none."""


@functools.lru_cache(maxsize=256)
def _numbers(count: int) -> Any:
    """Memory of our own for so many numbers: a pass is told its place without asking NumPy."""
    return ctypes.c_double * count


class _Scratch(threading.local):
    """Memory of this thread for the uniforms of one pass."""

    def __init__(self) -> None:
        self.memory: Any = _numbers(0)()

    def of(self, count: int) -> Any:
        if len(self.memory) < count:
            self.memory = _numbers(count)()
        return self.memory


_scratch = _Scratch()


def _memory(state: Particles) -> Any:
    """Where points and log weights lie, for a pass to read."""
    if state.memory is not None:
        return state.memory
    return state.points.ctypes.data, state.log_weights.ctypes.data


# The mapping inside os.environ: asking os.environ itself takes as long as a tenth of a step.
_ENVIRONMENT: Mapping[Any, Any] = getattr(os.environ, "_data", os.environ)
_NAME = getattr(os.environ, "encodekey", str)("TRACKER_COMPILE")
_OFF = getattr(os.environ, "encodevalue", str)("off")


def _runs(state: Particles) -> bool:
    points = state.points
    return (
        points.ndim == 2
        and points.shape[1] % WIDTH == 0
        and _ENVIRONMENT.get(_NAME) != _OFF
        and _available()
        and (
            state.memory is not None
            or all(a.flags.c_contiguous and a.dtype == _DOUBLE for a in (points, state.log_weights))
        )
    )


def _found(make: Callable[[Any, Any], Pass], model: Any, size: Any) -> Any:
    """The pass of a model and its parameters, or None if it cannot be traced or differs by lane."""
    try:
        known = _FOUND.setdefault(model, {})
    except TypeError:
        return None
    if size not in known:
        try:
            parameters = [float(value) for value in model.parameters.values()]
            known[size] = (make(model, size), parameters)
        except (TraceError, TypeError, AttributeError, ValueError):
            known[size] = None
    return known[size]


def _made_ahead(motion: Any, size: tuple[int, int]) -> Pass:
    return _ahead(_Ahead(structure(motion), *size, motion))


def _made_weigh(sensor: Any, n: int) -> Pass:
    return _weigh(_Weigh(structure(sensor), n, sensor))


def _centre(state: Particles) -> list[float]:
    """A place inside the cloud: squares about it lose few digits."""
    known = state.known
    centre: list[float] = (state.points[:, 0] if known is None else known.mean).tolist()
    return centre


def _read(left: Any, n: int) -> Gaussian | None:
    """The moments that a pass has found, if with enough digits; they look into its memory."""
    if not left[n + n * n]:
        return None
    return Gaussian.trusted(
        np.ndarray((n,), _DOUBLE, left), np.ndarray((n, n), _DOUBLE, left, _BYTES * n)
    )
