"""Passes of the auxiliary particle filter: a motion without and with noise, and weighing in two stages.

They are told in `kernels.Rows` as those of other filters are; the arrays of `auxiliary` say what they
compute. What lies in which row of a cloud is told in `machine.twofold`.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import attrs
import numpy as np

from tracker.compile.fuse import structure, vector
from tracker.compile.program import Rate
from tracker.errors import TraceError
from tracker.models.functions import exp, isnan, less, log, where
from tracker_particle import machine
from tracker_particle.kernels import (
    TINY,
    Pass,
    Rows,
    compiled,
    conditioned,
    gaussian,
    log_density,
    made_for,
    mean_and_covariance,
    normals,
    second_moments,
    upper,
    with_numbers,
)


def moving(motion: Any, columns: int, inputs: int) -> Any:
    """The pass of a motion and its parameters, or in words why there is none."""
    return made_for(_made_ahead, motion, ("auxiliary", columns, inputs))


def weighing(sensor: Any, n: int) -> Any:
    """The pass of a sensor and its parameters, or in words why there is none."""
    return made_for(_made_weigh, sensor, ("auxiliary", n))


@attrs.frozen
class _Ahead:
    """What a prediction bakes in."""

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


def _made_ahead(motion: Any, size: tuple[str, int, int]) -> Pass:
    return _ahead(_Ahead(structure(motion), *size[1:], motion))


def _made_weigh(sensor: Any, size: tuple[str, int]) -> Pass:
    return _weigh(_Weigh(structure(sensor), size[1], sensor))


@functools.lru_cache(maxsize=64)
def _ahead(key: _Ahead) -> Pass:
    """Given: dt, t, u, parameters, root, centre. As `AuxiliaryFilter.predict`."""
    n, k, q = key.motion.space.size, key.columns, key.inputs
    rows = Rows()
    x = vector(rows.rows("x", n))
    noise = normals(rows.pairs(k))
    weight = exp(rows.row("weight"))
    parameters = len(key.motion.parameters)
    given = rows.program.input("given", 2 + q + parameters + n * k + n, Rate.CALL)
    dt, t, u = given[0], given[1], vector(given[2 : 2 + q]) if q else None
    motion = with_numbers(key.motion, given[2 + q : 2 + q + parameters])
    rest = given[2 + q + parameters :]
    centres = list(motion.f(x, dt, u, t))
    rows.out("ahead", centres)
    d = []
    about = list(motion.f(vector(rest[n * k :]), dt, u, t))
    for i in range(n):
        moved: Any = 0.0
        for j in range(k):
            moved = moved + rest[i * k + j] * noise[j]
        rows.program.history(f"ahead{n + 1 + i}", [moved])
        d.append(centres[i] + moved - about[i])

    def conclude(centre: list[Any], sums: list[Any], _given: list[Any]) -> list[Any]:
        return gaussian(centre, sums, 1.0)

    return rows.finished(about, second_moments(weight, d), conclude)


@functools.lru_cache(maxsize=64)
def _weigh(key: _Weigh) -> Pass:
    """Given: z, pose, parameters, number of particles, evidence of the first stage, centre. As
    `AuxiliaryFilter.update`.
    """
    n, m = key.n, key.sensor.space.size
    first, _ = _first(key)
    second, _ = _second(key)
    count = m + key.sensor.pose_space.size + len(key.sensor.parameters)
    text = machine.twofold(first, second, n, m, count)
    return compiled(text, n + n * n + 1 + m + m * m + 1 + 3)


# ------------------------------------------------------------------------------------- inside
def _given(rows: Rows, key: _Weigh) -> tuple[Any, ...]:
    """Sensor, z, pose, number of particles, evidence and centre."""
    sensor, n, m = key.sensor, key.n, key.sensor.space.size
    p, parameters = sensor.pose_space.size, len(sensor.parameters)
    given = rows.program.input("given", m + p + parameters + 2 + n, Rate.CALL)
    z, pose = vector(given[:m]), vector(given[m : m + p]) if p else None
    made = with_numbers(sensor, given[m + p : m + p + parameters])
    rest = given[m + p + parameters :]
    return made, z, pose, rest[0], rest[1], vector(rest[2:])


def _noise(rows: Rows, sensor: Any, x: Any, pose: Any) -> Any:
    R = sensor.R(x, pose)
    if any(rows.differs(e) for e in R.ravel()):
        raise TraceError("the noise of the measurement differs from particle to particle")
    return R


def _density(sensor: Any, z: Any, h: Any, R: Any, x: Any) -> Any:
    """As `kernels` has it: no answer is no measurement only where nothing was measured."""
    density = log_density(sensor.residual(z, h), R, x)
    for a, e in zip(z, h, strict=True):
        density = density + where(isnan(a), 0.0, where(isnan(e), math.nan, 0.0))
    return where(isnan(density), -math.inf, density)


def _first(key: _Weigh) -> tuple[str, int]:
    """The likelihood at centres, for a choice of parents, and what z says to their children."""
    n, m = key.n, key.sensor.space.size
    rows = Rows()
    x = vector(rows.rows("x", n))
    moved = [rows.row(f"x{n + 1 + i}") for i in range(n)]
    before = rows.row("weight")
    sensor, z, pose, _, _, about = _given(rows, key)
    R = _noise(rows, sensor, x, pose)
    none = vector([where(isnan(a), a, 0.0) for a in z])
    peak = log_density(none, R, about)
    likely = _density(sensor, z, sensor.h(x, pose), R, x)
    rows.program.history(f"moved{n}", [likely])
    stage = before + likely
    rows.out("after", [stage])
    children = vector([a + b for a, b in zip(x, moved, strict=True)])
    usual = sensor.h(about, pose)
    reference = vector([where(isnan(a), b, a) for a, b in zip(z, usual, strict=True)])
    v = list(sensor.residual(reference, sensor.h(children, pose)))
    pairs = upper(m)

    def conclude(constants: list[Any], sums: list[Any], given: list[Any]) -> list[Any]:
        z, total = given[:m], sums[-1]
        mean, cov = mean_and_covariance([0.0] * m, sums[:-1], 1.0)
        S = np.empty((m, m), dtype=object)
        for (i, j), r in zip(pairs, constants[1:], strict=True):
            S[i, j] = S[j, i] = cov[i][j] + r
        told = [where(isnan(a), math.nan, b) for a, b in zip(z, mean, strict=True)]
        nis = conditioned(vector(told), S, vector(given[len(given) - n :]))[2]
        measured: Any = 0.0
        for a in z:
            measured = measured + where(isnan(a), 0.0, 1.0)
        return [*told, *S.ravel(), nis, constants[0] + log(total), total, measured]

    return rows.text(
        [peak, *(R[i, j] for i, j in pairs)],
        [*second_moments(exp(before), v), exp(stage - peak)],
        conclude,
        in_place=True,
    )


def _second(key: _Weigh) -> tuple[str, int]:
    """What the likelihood of the parent got wrong at its child."""
    n = key.n
    rows = Rows()
    centres = rows.rows("x", n)
    first = rows.row(f"x{n}")
    moved = rows.rows("weight", n)
    real = rows.row("real")
    sensor, z, pose, count, evidence, about = _given(rows, key)
    x = vector([a + b for a, b in zip(centres, moved, strict=True)])
    rows.out("ahead", x)
    R = _noise(rows, sensor, x, pose)
    gained = _density(sensor, z, sensor.h(x, pose), R, x) - first - log(count) + real
    rows.program.history("log", [gained + evidence])
    chance = exp(gained)
    d = [a - b for a, b in zip(x, about, strict=True)]

    def conclude(_constants: list[Any], sums: list[Any], given: list[Any]) -> list[Any]:
        total = where(less(sums[0], 1.0 / TINY), sums[0], 0.0)  # too likely to be added up
        centre = given[len(given) - n :]
        return [*gaussian(centre, sums[1:], sums[0]), log(total), total]

    return rows.text([count], [chance, *second_moments(chance, d)], conclude, in_place=True)
