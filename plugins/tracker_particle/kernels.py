"""Prediction and weighing of one cloud as machine code, its particles in the place of time steps.

A step program (`tracker.compile.program`) walks through rows of 8 numbers at a time and adds up as it
goes: what it does for one lane over time, it does here for one belief over its particles, models,
draws, weights and moments in one pass. The arrays in `propagation` and `likelihood` say what is
computed, and compute it wherever this module answers None: without llvmlite, for models that cannot
be traced, for batches. Rows of 8 that particles do not fill are filled up with copies that weigh nothing.
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
from tracker_particle import draws, machine
from tracker_particle.belief import Particles

ROUNDING = 1e-13
"""A pivot below this share of its variance is what rounding left of a singular matrix."""

TINY = 1e-140
"""Below this sum of likelihoods, relative to the largest there could be, squares of them lose digits."""

SHARP = 1e-6
"""A variance below this share of the mean square about the centre is computed again, in two passes."""


@attrs.frozen(eq=False)
class Pass:
    """A compiled pass over the particles of a belief, and memory for the numbers that it leaves."""

    call: Callable[..., None]
    machine: objects.Machine
    size: int

    @property
    def left(self) -> Any:
        """What its memory is an instance of."""
        return numbers(self.size)


@attrs.frozen
class _Ahead:
    """What a prediction bakes in: the motion's structure and how many numbers it is given.

    ``columns`` of a root of the noise are given; None if every particle has noise of its own.
    """

    structure: tuple[Any, ...]
    columns: int | None
    inputs: int
    motion: Any = attrs.field(eq=False)


@attrs.frozen
class _Weigh:
    """What weighing bakes in."""

    structure: tuple[Any, ...]
    n: int
    sensor: Any = attrs.field(eq=False)


# ----------------------------------------------------------------------------------- programs
class Rows:
    """A program over rows: particles are its time steps, numbers that all share its constants."""

    def __init__(self) -> None:
        self.program = Program()

    def row(self, name: str) -> Any:
        """A number of each particle; `machine` says where it lies, by its name."""
        return self.program.input(name, 1, Rate.BOTH)[0]

    def rows(self, name: str, count: int) -> list[Any]:
        """Several, one after the other."""
        return [self.row(f"{name}{i}") for i in range(count)]

    def pairs(self, count: int) -> list[tuple[Any, Any]]:
        """Uniforms for so many normals."""
        return [(self.row(f"a{i}"), self.row(f"b{i}")) for i in range(-(-count // 2))]

    def out(self, name: str, entries: Any) -> None:
        """Numbers of each particle that the pass writes."""
        for i, entry in enumerate(entries):
            self.program.history(f"{name}{i}", [entry])

    def differs(self, entry: Any) -> bool:
        """Whether a value differs from particle to particle."""
        if not isinstance(entry, Node):
            return False
        return bool(self.program.rates(needed([entry]))[entry.index] & Rate.LANE)

    def finished(
        self,
        constants: list[Any],
        sums: list[Any],
        conclude: Callable[..., list[Any]],
        *,
        in_place: bool = False,
    ) -> Pass:
        """The pass whose sums, and constants of all particles, lead to what ``conclude`` says.

        ``in_place``: rows are written where others of the same place are read.
        """
        return compiled(*self.text(constants, sums, conclude, in_place=in_place))

    def text(
        self,
        constants: list[Any],
        sums: list[Any],
        conclude: Callable[..., list[Any]],
        *,
        in_place: bool = False,
    ) -> tuple[str, int]:
        """The same, not yet compiled, and how many numbers it leaves."""
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
        if in_place:
            texts[0] = texts[0].replace("ptr noalias", "ptr")
        lines = [line for text in texts for line in text.splitlines()]
        declared = dict.fromkeys(line for line in lines if line.startswith("declare "))
        defined = [line for line in lines if not line.startswith("declare ")]
        entry = machine.entry(self.program, len(constants), len(sums), len(found))
        return "\n".join([*declared, *defined, *entry]) + "\n", len(found)


def compiled(text: str, size: int) -> Pass:
    """The pass of an LLVM text that leaves so many numbers."""
    made = objects.compiled(text)
    call = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 4, *[ctypes.c_void_p] * 6)(made.address)
    return Pass(call, made, size)


def second_moments(weight: Any, d: list[Any]) -> list[Any]:
    """What the moments of some differences are sums of."""
    scaled = [weight * e for e in d]
    return [*scaled, *(scaled[i] * d[j] for i, j in upper(len(d)))]


def upper(m: int) -> list[tuple[int, int]]:
    """Places of the upper triangle of a matrix, row by row."""
    return [(i, j) for i in range(m) for j in range(i, m)]


def normals(pairs: list[tuple[Any, Any]]) -> list[Any]:
    """Normals of pairs of uniforms, as `draws.normals` has them."""
    out: list[Any] = [None] * (2 * len(pairs))
    for i, (a, b) in enumerate(pairs):
        radius, angle = sqrt(-2.0 * log(1.0 - a)), (2.0 * math.pi) * (b - 0.5)
        out[i], out[len(pairs) + i] = radius * cos(angle), radius * sin(angle)
    return out


def root_of(motion: Any, x: Any, dt: Any, numbers: list[Any]) -> list[list[Any]]:
    """The root of the noise: of these numbers, ``(n, k)``, or else each particle's own."""
    n = len(x)
    if not numbers:
        return factored(motion.Q(x, dt))[0]
    return [numbers[i * len(numbers) // n : (i + 1) * len(numbers) // n] for i in range(n)]


def factored(P: Any) -> tuple[list[list[Any]], Any]:
    """`propagation.factored`, and how many of its columns are zero."""
    n = len(P)
    A: list[list[Any]] = [list(row) for row in P]
    L: list[list[Any]] = [[0.0] * n for _ in range(n)]
    gone: Any = 0.0
    for j in range(n):
        pivot = A[j][j]
        there = less(ROUNDING * P[j][j], pivot)
        here = where(there, 0.0, where(isnan(pivot), 0.0, 1.0))
        gone = gone + here
        scale = sqrt(where(less(0.5, here), 1.0, pivot))
        for i in range(j, n):
            L[i][j] = where(less(0.5, here), 0.0, A[i][j] / scale)
        for i in range(j + 1, n):
            for b in range(j + 1, n):
                A[i][b] = A[i][b] - L[i][j] * L[b][j]
    return L, gone


def with_numbers(model: Any, nodes: list[Any]) -> Any:
    """A model with these parameters."""
    if not nodes:
        return model
    return model.with_parameters(**dict(zip(model.parameters, nodes, strict=True)))


@functools.lru_cache(maxsize=64)
def _ahead(key: _Ahead) -> Pass:
    """Rows in: x, uniforms in pairs, log weights. Rows out: x. Given: dt, t, u, parameters, root,
    centre. Constants out: where the centre goes.
    """
    n, q = key.motion.space.size, key.inputs
    k = n if key.columns is None else key.columns
    rows = Rows()
    x = vector(rows.rows("x", n))
    pairs = rows.pairs(k)
    weight = exp(rows.row("weight"))
    parameters, numbers = len(key.motion.parameters), n * (key.columns or 0)
    given = rows.program.input("given", 2 + q + parameters + numbers + n, Rate.CALL)
    dt, t, u = given[0], given[1], given[2 : 2 + q]
    motion = with_numbers(key.motion, given[2 + q : 2 + q + parameters])
    rest = given[2 + q + parameters :]
    noise = normals(pairs)
    inputs = vector(u) if q else None
    ahead = list(motion.f(x, dt, inputs, t))
    G = root_of(motion, x, dt, rest[:numbers])
    for i in range(n):
        for j in range(k):
            ahead[i] = ahead[i] + G[i][j] * noise[j]
    centre = list(motion.f(vector(rest[numbers:]), dt, inputs, t))
    rows.out("ahead", ahead)
    d = [a - c for a, c in zip(ahead, centre, strict=True)]

    def conclude(centre: list[Any], sums: list[Any], _given: list[Any]) -> list[Any]:
        return gaussian(centre, sums, 1.0)

    return rows.finished(centre, second_moments(weight, d), conclude)


@functools.lru_cache(maxsize=64)
def _weigh(key: _Weigh) -> Pass:
    """Rows in: x, log weights. Rows out: log weights, not yet of sum one. Given: z, pose,
    parameters, centre. Constants out: the largest log-likelihood there can be, R.
    """
    sensor, n, m = key.sensor, key.n, key.sensor.space.size
    rows = Rows()
    x = vector(rows.rows("x", n))
    before = rows.row("weight")
    p, parameters = sensor.pose_space.size, len(sensor.parameters)
    given = rows.program.input("given", m + p + parameters + n, Rate.CALL)
    z, pose = vector(given[:m]), vector(given[m : m + p]) if p else None
    sensor = with_numbers(sensor, given[m + p : m + p + parameters])
    about = vector(given[m + p + parameters :])
    R = sensor.R(x, pose)
    if any(rows.differs(e) for e in R.ravel()):
        raise TraceError("the noise of the measurement differs from particle to particle")
    h = sensor.h(x, pose)
    none = vector([where(isnan(a), a, 0.0) for a in z])
    peak = log_density(none, R, about)
    density = log_density(sensor.residual(z, h), R, x)
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
        mean, cov = mean_and_covariance([0.0] * m, prior, 1.0)
        S = np.empty((m, m), dtype=object)
        for (i, j), r in zip(upper(m), noise, strict=True):
            S[i, j] = S[j, i] = cov[i][j] + r
        v = [where(isnan(a), math.nan, b) for a, b in zip(z, mean, strict=True)]
        loglik = peak + log(total)
        centre = given[len(given) - n :]
        nis = conditioned(vector(v), S, vector(centre))[2]
        found = [*v, *S.ravel(), nis, loglik, total, total * total / squares]
        return [*gaussian(centre, rest, total), *found]

    return rows.finished(
        [peak, *(R[i, j] for i, j in upper(m))],
        [*second_moments(exp(before), v), chance, chance * chance, *second_moments(chance, d)],
        conclude,
    )


def conditioned(v: Any, S: Any, x: Any) -> tuple[Any, ...]:
    """What a Gaussian without spread would be told by a residual: nis and loglik are of v alone."""
    n, m = len(x), len(v)
    still, unrelated = np.zeros((n, n), dtype=object), np.zeros((n, m), dtype=object)
    return condition(x, still, v, S, unrelated)


def log_density(v: Any, R: Any, x: Any) -> Any:
    """That of the measured components."""
    return conditioned(v, R, x)[3]


def mean_and_covariance(
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


def gaussian(centre: list[Any], sums: list[Any], total: Any) -> list[Any]:
    """Mean, covariance, and 1 if the sums had enough digits for it."""
    mean, cov = mean_and_covariance(centre, sums, total)
    n, good, at = len(mean), 1.0, len(mean)
    for i in range(n):
        good = where(less(SHARP * sums[at] / total, cov[i][i]), good, 0.0)
        at += n - i
    return [*mean, *(e for row in cov for e in row), good]


# ------------------------------------------------------------------------------------ running
def ahead(
    state: Particles, motion: MotionModel, dt: Any, u: Any, t: Any, root: Array | None
) -> Particles | None:
    """The belief after the motion, as `propagation.propagated` has it; root ``(n, k, 1)``, or None where
    particles have noise of their own.
    """
    if not _runs(state) or type(dt) is not float or (root is not None and root.shape[2:] != (1,)):
        return None
    inputs = [] if u is None else np.asarray(u).tolist()
    n, count = state.points.shape
    k = None if root is None else root.shape[1]
    found = moving(motion, n, k, len(inputs))
    if type(found) is str:
        return None
    done, parameters, flags = found
    time = 0.0 if t is None else t
    flat = [] if root is None else root.ravel().tolist()
    given = (dt, time, *inputs, *parameters, *flat, *_centre(state))
    full = filled(count)
    out, left = numbers(n * full)(), done.left()
    points, weights = _memory(state)
    drawn = _scratch.of(drawing(n if k is None else k) * full)
    third = draws.word(state.step, draws.NOISE)
    done.call(
        full, *state.key.tolist(), third, points, weights, drawn, numbers(len(given))(*given), out, left
    )  # fmt: skip
    return Particles.known_as(
        np.ndarray((n, count), _DOUBLE, out, 0, (_BYTES * full, _BYTES)),
        state.log_weights,
        state.key,
        state.step + 1,
        flags,
        _read(left, n),
        state.known_size,
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
    found = weighing(sensor, n, len(z), len(place))
    if type(found) is str:
        return None
    done, parameters, flags = found
    given = (*z, *place, *parameters, *_centre(state))
    full = filled(count)
    out, left = numbers(full)(), done.left()
    points, weights = _memory(state)
    done.call(full, 0, 0, 0, points, weights, None, numbers(len(given))(*given), out, left)
    m, at = len(z), n + n * n + 1
    nis, loglik, total, size = left[at + m + m * m :]
    if not total > TINY:
        return None
    measured: Any = float(sum(a == a for a in z))  # noqa: PLR0124 - not NaN
    if measured:
        log_weights = np.ndarray((full,), _DOUBLE, out)
        log_weights -= loglik
        belief = Particles.known_as(
            state.points,
            log_weights[:count],
            state.key,
            state.step,
            flags,
            _read(left, n),
            size,
            (points, out),
        )
    else:  # not even rounding changes weights without evidence
        if state.known is None:
            return None
        loglik = 0.0
        belief = Particles.known_as(
            state.points,
            state.log_weights,
            state.key,
            state.step,
            flags,
            state.known,
            state.known_size,
            (points, weights),
        )
    v = np.ndarray((m,), _DOUBLE, left, _BYTES * at)
    S = np.ndarray((m, m), _DOUBLE, left, _BYTES * (at + m))
    ok: Any = math.isfinite(nis)
    return belief, Innovation(v, S, nis, loglik, measured, ok)


def choose(state: Particles) -> Particles | None:
    """The belief in particles of even weight, as `propagation.resampled` has it, systematically."""
    if not _runs(state):
        return None
    n, count = state.points.shape
    full = filled(count)
    out = numbers(n * full)()
    points, weights = _memory(state)
    third = draws.word(state.step, draws.RESAMPLING)
    scratch = _scratch.of(CHOOSING * full)
    choosing().call(count, full, n, *state.key.tolist(), third, weights, points, scratch, out)
    flat = even(count)
    return Particles.known_as(
        np.ndarray((n, count), _DOUBLE, out, 0, (_BYTES * full, _BYTES)),
        np.frombuffer(flat, _DOUBLE, count),
        state.key,
        state.step,
        state.circular,
        None,
        float(count),
        (out, flat),
    )


# ------------------------------------------------------------------------------------- inside
_DOUBLE = np.dtype(np.float64)
_BYTES = 8

CHOOSING = 4
"""Numbers of scratch that choosing needs for each place of a row."""

_available = functools.cache(objects.available)

_FOUND: MutableMapping[Any, dict[Any, Any]] = weakref.WeakKeyDictionary()
"""The passes of models, by what else they depend on; in words why there is none."""


def filled(count: int) -> int:
    """How long a row of so many particles is."""
    return -(-count // WIDTH) * WIDTH


def drawing(columns: int) -> int:
    """How many uniforms a particle takes for so many normals."""
    return 2 * -(-columns // 2)


@functools.lru_cache(maxsize=256)
def numbers(count: int) -> Any:
    """Memory of our own for so many numbers: a pass is told its place without asking NumPy."""
    return ctypes.c_double * count


@functools.lru_cache(maxsize=64)
def even(count: int) -> Any:
    """Log weights of particles that weigh the same, in memory that nobody writes to."""
    flat: Any = np.full(filled(count), -math.inf)
    flat[:count] = -math.log(count)
    return (ctypes.c_char * flat.nbytes).from_buffer(flat)


@functools.cache
def choosing() -> Pass:
    """The compiled choice of ancestors."""
    made = objects.compiled(machine.choosing())
    call = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 6, *[ctypes.c_void_p] * 4)(made.address)
    return Pass(call, made, 0)


class _Scratch(threading.local):
    """Memory of this thread for what one pass needs in between."""

    def __init__(self) -> None:
        self.memory: Any = numbers(0)()

    def of(self, count: int) -> Any:
        if len(self.memory) < count:
            self.memory = numbers(count)()
        return self.memory


_scratch = _Scratch()


def laid_out(rows: Array, log_weights: Array, points: Any, weights: Any) -> None:
    """Write a cloud into rows ``(n, full)`` and ``(full,)``: what fills up is a copy, and weighs nothing."""
    count = len(log_weights)
    n = len(rows)
    points[:n, :count], points[:n, count:] = rows, rows[:, -1:]
    weights[:count], weights[count:] = log_weights, -math.inf


def _memory(state: Particles) -> Any:
    """Where points and log weights lie, for a pass to read."""
    if state.memory is not None:
        return state.memory
    n, count = state.points.shape
    full = filled(count)
    if full == count and all(
        a.flags.c_contiguous and a.dtype == _DOUBLE for a in (state.points, state.log_weights)
    ):
        return state.points.ctypes.data, state.log_weights.ctypes.data
    points, weights = numbers(n * full)(), numbers(full)()
    whole = np.ndarray((n, full), _DOUBLE, points), np.ndarray((full,), _DOUBLE, weights)
    laid_out(state.points, state.log_weights, *whole)
    return points, weights


# The mapping inside os.environ: asking os.environ itself takes as long as a tenth of a step.
_ENVIRONMENT: Mapping[Any, Any] = getattr(os.environ, "_data", os.environ)
_NAME = getattr(os.environ, "encodekey", str)("TRACKER_COMPILE")
_OFF = getattr(os.environ, "encodevalue", str)("off")


def _runs(state: Particles) -> bool:
    return state.points.ndim == 2 and _ENVIRONMENT.get(_NAME) != _OFF and _available()


def moving(motion: Any, n: int, columns: int | None, inputs: int) -> Any:
    """The pass of a motion, its parameters and its circular components, or in words why there is none."""
    return made_for(_made_ahead, motion, (n, columns, inputs))


def weighing(sensor: Any, n: int, m: int, p: int) -> Any:
    """The pass of a sensor, its parameters and circular components, or in words why there is none."""
    return made_for(_made_weigh, sensor, (n, m, p))


def made_for(make: Callable[[Any, Any], Pass], model: Any, size: Any) -> Any:
    """The pass that is made for a model, its parameters, and which components of the state are circular.

    In words why there is none.
    """
    try:
        known = _FOUND.setdefault(model, {})
    except TypeError:
        return "it cannot be remembered"
    if size not in known:
        try:
            parameters = [float(value) for value in model.parameters.values()]
            known[size] = (make(model, size), parameters, _on_lines(model))
        except (TraceError, TypeError, AttributeError, ValueError) as error:
            known[size] = getattr(model, "why_opaque", "") or f"it cannot be traced: {error}"
    return known[size]


def _on_lines(model: Any) -> tuple[bool, ...]:
    """Which components of the state are circular: none is, or else.

    Raises:
        TraceError: if one is.
    """
    flags = tuple((model.state if hasattr(model, "h") else model.space).circular)
    if any(flags):
        raise TraceError("a component of its state lives on a circle")
    return flags


def _made_ahead(motion: Any, size: tuple[int, int | None, int]) -> Pass:
    if motion.space.size != size[0]:
        raise TraceError("it moves other states than these")
    return _ahead(_Ahead(structure(motion), *size[1:], motion))


def _made_weigh(sensor: Any, size: tuple[int, int, int]) -> Pass:
    if (sensor.state.size, sensor.space.size, sensor.pose_space.size) != size:
        raise TraceError("it is given what it does not take")
    return _weigh(_Weigh(structure(sensor), size[0], sensor))


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
