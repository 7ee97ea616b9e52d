"""How likely a measurement is at each particle, and how surprising to all of them together."""

from __future__ import annotations

import functools
import math
from typing import Any

import attrs
import numpy as np

from tracker.protocols import SensorModel
from tracker.types import Array, Innovation, Projection
from tracker_particle import kernels
from tracker_particle.belief import Flags, Particles, centred, mean_of, outer
from tracker_particle.propagation import log_sum, wide

LOG_TAU = math.log(2.0 * math.pi)


@attrs.frozen(eq=False)
class Seen:
    """A measurement beside what each particle would have measured.

    Shapes:
        residual ``(m, N, *batch)``, about any place where a component was not measured; R
        ``(m, m, 1 or N, *batch)``; missing ``(m, *batch)``; log_likelihood ``(N, *batch)``: 0 in a
        lane without measurement, -inf where a particle cannot be.
    """

    residual: Array
    R: Array
    missing: Any
    log_likelihood: Array


def seen(points: Array, sensor: SensorModel, z: Any, pose: Any) -> Seen:
    """The likelihood of a measurement with Gaussian noise at each particle."""
    where = wide(pose)
    h = sensor.h(points, where)
    R = sensor.R(points, where)
    missing = np.isnan(z)
    column = np.where(missing[:, None], h[:, :1], z[:, None]) if missing.any() else z[:, None]
    v = sensor.residual(column, h)
    return Seen(v, R, missing, log_density(v, R, missing))


def log_density(v: Array, R: Array, missing: Any) -> Array:
    """Logarithm of the Gaussian density of the measured components.

    Shapes:
        v ``(m, N, *batch)``; R ``(m, m, 1 or N, *batch)``, axes of length 1 shared; missing
        ``(m, *batch)``; result ``(N, *batch)``.
    """
    if v.ndim == 2 and R.size == len(R) ** 2:  # one run, one R
        there = ~missing
        if not there.any():
            return np.zeros(v.shape[1:])
        whiten, constant = _whitening(R.tobytes(), len(R), there.tobytes())
        if there.all():
            y = v * whiten if whiten.shape[1] == 1 else whiten.dot(v)
        else:
            y = whiten.dot(v[there])
        density = np.einsum("is,is->s", y, y)
        density *= -0.5
        density += constant
    else:
        squares, logarithm = _eliminated(v, R, missing[:, None])
        count = np.add.reduce(~missing, axis=0)
        density = -0.5 * (squares + logarithm + LOG_TAU * count)
    lost = np.isnan(density)
    if np.count_nonzero(lost):  # the sensor has no answer at such a particle
        density[lost] = -math.inf
    return np.asarray(density)


@functools.lru_cache(maxsize=256)
def _whitening(content: bytes, m: int, there: bytes) -> tuple[Array, float]:
    """The inverse of the factor of R, a column of it where it is diagonal, and the constant."""
    measured = np.frombuffer(there, dtype=np.bool_)
    R: Array = np.frombuffer(content).reshape(m, m)[np.ix_(measured, measured)]
    if not (np.diagonal(R) > 0.0).all() or np.linalg.eigvalsh(R)[0] <= 0.0:
        return np.full(R.shape, math.nan), math.nan
    L: Any = np.linalg.cholesky(R)
    inverse: Any = np.linalg.solve(L, np.eye(len(L)))
    constant = -float(np.log(np.diagonal(L)).sum()) - 0.5 * LOG_TAU * len(L)
    diagonal = np.diagonal(inverse)
    whole = measured.all() and (inverse == np.diag(diagonal)).all()
    chosen: Array = diagonal[:, None].copy() if whole else inverse
    return chosen, constant


def _eliminated(v: Array, R: Array, missing: Any) -> tuple[Any, Any]:
    """``v' R^-1 v`` and ``log det R`` of the measured components; NaN where R is not positive.

    Shapes:
        v ``(m, *axes)``; R ``(m, m, *axes)``, missing ``(m, *axes)``, axes of length 1 shared.
    """
    m = len(v)
    rows: list[list[Any]] = [[None] * m for _ in range(m)]
    y: list[Any] = []
    squares, logarithm = np.zeros(v.shape[1:]), np.zeros(v.shape[1:])
    for a in range(m):
        u, pivot = np.where(missing[a], 0.0, v[a]), np.where(missing[a], 1.0, R[a, a])
        for b in range(a):
            entry = np.where(missing[a] | missing[b], 0.0, R[a, b])
            for c in range(b):
                entry = entry - rows[a][c] * rows[b][c]
            rows[a][b] = entry = entry / rows[b][b]
            pivot = pivot - entry * entry
            u = u - entry * y[b]
        pivot = np.where(pivot > 0.0, pivot, math.nan)
        rows[a][a] = deviation = np.sqrt(pivot)
        y.append(u / deviation)
        squares = squares + y[a] * y[a]
        logarithm = logarithm + np.log(pivot)
    return squares, logarithm


def weighed(
    state: Particles, sensor: SensorModel, z: Any, pose: Any, projection: Projection | None
) -> tuple[Particles, Innovation]:
    """Bayes' rule: weights times likelihood, and what the measurement said.

    Reference:
        Gordon, Salmond and Smith 1993; Doucet, Godsill and Andrieu 2000, eq. 10.
    """
    if z.ndim == 1:
        made = kernels.weigh(state, sensor, z.tolist(), pose)
        if made is not None:
            return made if projection is None else _beside(made, projection, sensor, z)
    what = seen(state.points, sensor, z, pose)
    after, loglik = log_sum(state.log_weights + what.log_likelihood)
    unseen = what.missing.all(axis=0)
    if np.any(unseen):  # not even rounding changes weights without evidence
        dead = 0.0 * state.points.sum(axis=(0, 1))  # NaN in a lane that has diverged
        after = np.where(unseen, state.log_weights, after)
        loglik = np.where(unseen, dead, loglik)
    innovation = surprise(state.weights, what, projection, sensor, z, loglik)
    flags = tuple(sensor.state.circular) if hasattr(sensor, "state") else state.circular
    return attrs.evolve(state, log_weights=after, circular=flags), innovation


def _beside(
    made: tuple[Particles, Innovation], projection: Projection, sensor: SensorModel, z: Any
) -> tuple[Particles, Innovation]:
    """The same, with the innovation of a projection that was computed before."""
    v = np.asarray(sensor.residual(z, projection.z))
    nis: Any = _distance_of_one(v.tolist(), projection.S.tolist())
    ok: Any = math.isfinite(nis)
    return made[0], attrs.evolve(made[1], residual=v, S=projection.S, nis=nis, ok=ok)


def surprise(
    weights: Array,
    what: Seen,
    projection: Projection | None,
    sensor: SensorModel,
    z: Any,
    loglik: Any,
) -> Innovation:
    """The innovation of weighted particles: their mean residual and its covariance with R.

    ``nis`` is that of a Gaussian with these moments; ``loglik`` is the particles' own estimate.
    """
    if projection is None:
        v = mean_of(what.residual, weights)
        S = outer(what.residual - v[:, None], weights) + noise_of(what.R, weights)
    else:
        v, S = sensor.residual(z, projection.z), projection.S
    v = np.where(what.missing, math.nan, v)
    nis = distance(v, S, what.missing)
    nis = nis + 0.0 * loglik  # NaN where no particle is possible
    count = np.add.reduce(~what.missing, axis=0, dtype=np.float64)
    return Innovation(v, S, nis, loglik, count, np.isfinite(nis))


def noise_of(R: Array, weights: Array) -> Array:
    """The mean of R over the particles, ``(m, m, *batch)``; batch axes of length 1 where shared."""
    if R.shape[2] == 1:
        return R[:, :, 0]
    return np.asarray(np.einsum("abs...,s...->ab...", R, weights))


def distance(v: Array, S: Array, missing: Any) -> Any:
    """``v' S^-1 v`` over the measured components, ``(*batch)``."""
    if v.ndim == 1:  # Python floats beat NumPy's scalars several times
        return _distance_of_one(v.tolist(), S.tolist())
    return _eliminated(v, S, missing)[0]


def _distance_of_one(v: list[float], S: list[list[float]]) -> float:
    kept = [a for a, value in enumerate(v) if value == value]  # noqa: PLR0124 - not NaN
    rows: list[list[float]] = []
    y: list[float] = []
    for i, a in enumerate(kept):
        row: list[float] = []
        pivot, u = S[a][a], v[a]
        for j, b in enumerate(kept[:i]):
            entry = S[a][b]
            for c in range(j):
                entry -= row[c] * rows[j][c]
            entry /= rows[j][j]
            row.append(entry)
            pivot -= entry * entry
            u -= entry * y[j]
        if not pivot > 0.0:
            return math.nan
        row.append(math.sqrt(pivot))
        rows.append(row)
        y.append(u / row[i])
    return sum(u * u for u in y)


def projected(
    points: Array, weights: Array, circular: Flags, sensor: SensorModel, pose: Any
) -> Projection:
    """What particles say of a measurement to come: mean, covariance and cross-covariance.

    Differences are taken from the measurement of the heaviest particle, through the sensor's own
    residual, so that a cloud across the cut has its mean inside the cloud.
    """
    where = wide(pose)
    h = sensor.h(points, where)
    heaviest = weights.argmax(axis=0)
    index = np.reshape(heaviest, (1, 1, *np.shape(heaviest)))
    near = np.take_along_axis(h, index, axis=1)
    d = sensor.residual(h, near)
    shift = mean_of(d, weights)
    d = d - shift[:, None]
    R = noise_of(sensor.R(points, where), weights)
    # Residual to zero: the mean in the interval that the sensor itself reports in.
    z = sensor.residual(near[:, 0] + shift, np.zeros_like(shift))
    _, dx = centred(points, weights, circular)
    return Projection(z, outer(d, weights) + R, outer(dx, weights, d))
