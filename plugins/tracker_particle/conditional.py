"""Passes of the marginalised particle filter, where all particles share the covariance of what is linear.

They are told in `kernels.Rows` as those of other filters are; the arrays of `marginalised` say what
they compute. A cloud is rows of whole states, and the triangle of the shared covariance beside them.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import attrs
import numpy as np

from tracker.algebra import (
    condition,
    dense,
    gain,
    mahalanobis,
    product,
    symmetric_product,
    transpose,
    without_missing,
)
from tracker.compile.fuse import structure, vector
from tracker.compile.program import Rate
from tracker.errors import TraceError
from tracker.models.functions import exp, isnan, less, log, where
from tracker.models.linearise import linearise
from tracker_particle.kernels import (
    SHARP,
    Pass,
    Rows,
    conditioned,
    factored,
    made_for,
    mean_and_covariance,
    normals,
    second_moments,
    upper,
    with_numbers,
)

DIFFERS = "its Jacobian by the linear components, or its noise, differs from particle to particle"


def moving(motion: Any, linear: tuple[int, ...], inputs: int) -> Any:
    """The pass of a motion and its parameters, or in words why there is none."""
    return made_for(_made_ahead, motion, (linear, inputs))


def weighing(sensor: Any, n: int, linear: tuple[int, ...]) -> Any:
    """The pass of a sensor and its parameters, or in words why there is none."""
    return made_for(_made_weigh, sensor, (linear, n))


@attrs.frozen
class _Ahead:
    """What a prediction bakes in."""

    structure: tuple[Any, ...]
    linear: tuple[int, ...]
    inputs: int
    motion: Any = attrs.field(eq=False)


@attrs.frozen
class _Weigh:
    """What weighing bakes in."""

    structure: tuple[Any, ...]
    linear: tuple[int, ...]
    n: int
    sensor: Any = attrs.field(eq=False)


def _made_ahead(motion: Any, size: tuple[tuple[int, ...], int]) -> Pass:
    return _ahead(_Ahead(structure(motion), *size, motion))


def _made_weigh(sensor: Any, size: tuple[tuple[int, ...], int]) -> Pass:
    return _weigh(_Weigh(structure(sensor), *size, sensor))


@functools.lru_cache(maxsize=64)
def _ahead(key: _Ahead) -> Pass:
    """Given: dt, t, u, parameters, Q, centre, triangle. As `marginalised._drawn` after a prediction."""
    n, own, q = key.motion.space.size, list(key.linear), key.inputs
    others = [i for i in range(n) if i not in own]
    k, parameters = len(others), len(key.motion.parameters)
    rows = Rows()
    x = vector(rows.rows("x", n))
    noise = normals(rows.pairs(k))
    weight = exp(rows.row("weight"))
    triangle = len(upper(len(own)))
    given = rows.program.input("given", 2 + q + parameters + n * n + n + triangle, Rate.CALL)
    dt, t, u = given[0], given[1], vector(given[2 : 2 + q]) if q else None
    motion = with_numbers(key.motion, given[2 + q : 2 + q + parameters])
    rest = given[2 + q + parameters :]
    Q, about, P = (
        vector(rest[: n * n]).reshape(n, n),
        rest[n * n :][:n],
        _symmetric(rest[-triangle:]),
    )
    f, F = linearise(motion, x, dt, u, t)
    A = dense(F)[:, own]
    if any(rows.differs(e) for e in A.ravel()):
        raise TraceError(DIFFERS)
    cov = symmetric_product(product(A, P), A) + Q
    inner, cross = cov[np.ix_(others, others)], cov[np.ix_(own, others)]
    G, gone = factored(inner)
    # The arrays drop columns that are gone, and draw for the others alone.
    whole = where(less(gone, 0.5), 1.0, where(less(k - 0.5, gone), 1.0, 0.0))
    K = gain(cross, inner)
    moved = [sum((G[i][j] * noise[j] for j in range(i + 1)), 0.0) for i in range(k)]
    ahead = list(f)
    for i, place in enumerate(others):
        ahead[place] = ahead[place] + moved[i]
    for i, place in enumerate(own):
        for j in range(k):
            ahead[place] = ahead[place] + K[i, j] * moved[j]
    rows.out("ahead", ahead)
    after = cov[np.ix_(own, own)] - product(K, transpose(cross))
    centre = list(motion.f(vector(about), dt, u, t))
    d = [a - c for a, c in zip(ahead, centre, strict=True)]

    def conclude(constants: list[Any], sums: list[Any], _given: list[Any]) -> list[Any]:
        return _gaussian(constants[:n], constants[n:-1], sums, 1.0, own, constants[-1])

    constants = [*centre, *(after[i, j] for i, j in upper(len(own))), whole]
    return rows.finished(constants, second_moments(weight, d), conclude)


@functools.lru_cache(maxsize=64)
def _weigh(key: _Weigh) -> Pass:
    """Given: z, pose, parameters, centre, triangle. As `MarginalisedFilter.update`; means are updated
    where they lie.
    """
    sensor, n, own, m = key.sensor, key.n, list(key.linear), key.sensor.space.size
    rows = Rows()
    x = vector(rows.rows("x", n))
    before = rows.row("weight")
    p, parameters = sensor.pose_space.size, len(sensor.parameters)
    triangle = len(upper(len(own)))
    given = rows.program.input("given", m + p + parameters + n + triangle, Rate.CALL)
    z, pose = vector(given[:m]), vector(given[m : m + p]) if p else None
    sensor = with_numbers(sensor, given[m + p : m + p + parameters])
    about, P = vector(given[m + p + parameters :][:n]), _symmetric(given[-triangle:])
    h, H = linearise(sensor, x, pose)
    C, R = dense(H)[:, own], sensor.R(x, pose)
    if any(rows.differs(e) for e in (*C.ravel(), *R.ravel())):
        raise TraceError(DIFFERS)
    CP = product(C, P)
    S = symmetric_product(CP, C) + R
    inert, cross = without_missing(S, transpose(CP), z)
    # That of nothing but what was measured, so that no covariance is one of a particle's own.
    still = vector([where(isnan(a), math.nan, 0.0) for a in z])
    _, after, _, peak, _ = condition(about[own], P, still, S, transpose(CP))
    far = sensor.residual(z, h)

    def answered(a: Any, value: Any) -> Any:
        """The value at a particle, zero where the sensor has no answer there."""
        for e in h:
            value = where(isnan(e), 0.0, value)
        return where(isnan(a), 0.0, value)

    v = vector([answered(a, e) for a, e in zip(z, far, strict=True)])
    density = peak - 0.5 * mahalanobis(v, inert)
    for e in h:
        density = where(isnan(e), -math.inf, density)
    weight = before + where(isnan(density), -math.inf, density)
    rows.out("after", [weight])
    K = gain(cross, inert)
    updated = list(x)
    for i, place in enumerate(own):
        for a in range(m):
            updated[place] = updated[place] + K[i, a] * v[a]
        rows.program.history(f"moved{place}", [updated[place]])
    usual = sensor.h(about, pose)
    reference = vector([where(isnan(a), b, a) for a, b in zip(z, usual, strict=True)])
    told = list(sensor.residual(reference, h))
    chance = exp(weight - peak)
    d = [a - b for a, b in zip(updated, about, strict=True)]
    pairs = upper(m)

    def conclude(constants: list[Any], sums: list[Any], given: list[Any]) -> list[Any]:
        peak, noise, more = constants[0], constants[1 : 1 + len(pairs)], constants[1 + len(pairs) :]
        first, (total, squares), rest = (
            sums[: m + len(pairs)], sums[m + len(pairs) :][:2], sums[m + len(pairs) + 2 :]
        )  # fmt: skip
        mean, cov = mean_and_covariance([0.0] * m, first, 1.0)
        spread = np.empty((m, m), dtype=object)
        for (i, j), r in zip(pairs, noise, strict=True):
            spread[i, j] = spread[j, i] = cov[i][j] + r
        v = [where(isnan(a), math.nan, b) for a, b in zip(given[:m], mean, strict=True)]
        loglik = peak + log(total)
        centre = given[m + p + parameters :][:n]
        nis = conditioned(vector(v), spread, vector(centre))[2]
        found = [*v, *spread.ravel(), nis, loglik, total, total * total / squares]
        return [*_gaussian(centre, more, rest, total, own, 1.0), *found]

    return rows.finished(
        [peak, *(S[i, j] for i, j in pairs), *(after[i, j] for i, j in upper(len(own)))],
        [*second_moments(exp(before), told), chance, chance * chance, *second_moments(chance, d)],
        conclude,
        in_place=True,
    )


# ------------------------------------------------------------------------------------- inside
def _symmetric(triangle: list[Any]) -> Any:
    size = int((math.isqrt(8 * len(triangle) + 1) - 1) // 2)
    out = np.empty((size, size), dtype=object)
    for (i, j), entry in zip(upper(size), triangle, strict=True):
        out[i, j] = out[j, i] = entry
    return out


def _gaussian(
    centre: list[Any], more: list[Any], sums: list[Any], total: Any, own: list[int], whole: Any
) -> list[Any]:
    """Mean, triangle, covariance, and 1 if the sums had enough digits for it."""
    mean, cov = mean_and_covariance(centre, sums, total)
    n, good, at = len(mean), whole, len(mean)
    P = _symmetric(more)
    for a, i in enumerate(own):
        for b, j in enumerate(own):
            cov[i][j] = cov[i][j] + P[a, b]
    for i in range(n):
        good = where(less(SHARP * sums[at] / total, cov[i][i]), good, 0.0)
        at += n - i
    return [*mean, *more, *(e for row in cov for e in row), good]
