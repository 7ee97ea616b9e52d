"""Particles through a motion model: noise with any covariance, and resampling where it is due."""

from __future__ import annotations

import functools
import math
from typing import Any

import attrs
import numpy as np

from tracker.protocols import MotionModel
from tracker.types import Array
from tracker_particle import draws, kernels
from tracker_particle.belief import Particles, effective_sample_size, even, spread
from tracker_particle.resampling import SYSTEMATIC, Ancestors, Scheme

_GRAIN = 1e-9


def wide(value: Any) -> Any:
    """An argument ``(k, *batch)`` of a model, for particles ``(k, 1, *batch)``; what is shared stays."""
    if value is None:
        return None
    array = np.asarray(value)
    return array if array.ndim < 2 else array[:, None]


def root(Q: Array) -> Array:
    """G with ``G G' = Q``: a column for every source of noise that there is.

    Shapes:
        Q ``(n, n, *axes)``; G ``(n, k, *axes)``, k at most n: n minus the columns that are zero
        everywhere.
    """
    if Q.size == Q.shape[0] ** 2:
        few = _root_of(Q.tobytes(), len(Q))
        return few.reshape(*few.shape, *(1,) * (Q.ndim - 2))
    return factored(Q)


@functools.lru_cache(maxsize=256)
def _root_of(content: bytes, n: int) -> Array:
    full = factored(np.frombuffer(content).reshape(n, n))
    kept = full[:, ~(full == 0.0).all(axis=0)]
    kept.setflags(write=False)
    return kept


def factored(P: Array) -> Array:
    """Lower triangular factor; columns of pivots that are only rounding are zero."""
    n = len(P)
    A, L = np.array(P), np.zeros(P.shape)
    for j in range(n):
        pivot = A[j, j]
        gone = pivot <= kernels.ROUNDING * P[j, j]  # NaN is not gone
        np.divide(A[j:, j], np.sqrt(pivot), out=L[j:, j], where=~gone)
        column = L[j + 1 :, j]
        A[j + 1 :, j + 1 :] -= column[:, None] * column
    return L


def noise(state: Any, count: int, columns: int) -> Array:
    """Standard normals of a prediction, ``(columns, N, *batch)``."""
    return draws.normals(state.key, state.step, draws.NOISE, columns, count)


def propagated(state: Particles, motion: MotionModel, dt: Any, u: Any, t: Any) -> Particles:
    """Each particle through the motion, with noise of its own."""
    points = state.points
    Q = motion.Q(points, dt)
    own = 1 < len(state.log_weights) == Q.shape[2]  # every particle has noise of its own
    G = None if own else root(Q)
    made = kernels.ahead(state, motion, dt, u, t, G)
    if made is not None:
        return made
    G = root(Q) if G is None else G
    ahead = motion.f(points, dt, wide(u), t)
    if G.shape[1]:
        ahead = ahead + spread(G, noise(state, points.shape[1], G.shape[1]))
    return attrs.evolve(
        state, points=ahead, step=state.step + 1, circular=tuple(motion.space.circular)
    )


def due(weights: Array, threshold: float) -> Any:
    """Which lanes have an effective sample size below the threshold, a share of N."""
    return effective_sample_size(weights) < least_size(threshold, len(weights))


def lacking(state: Particles, threshold: float) -> Any:
    """The same of a belief, which may know its effective sample size."""
    return state.effective_sample_size < least_size(threshold, len(state.log_weights))


def least_size(threshold: float, count: int) -> float:
    """The smallest effective sample size that is enough; even weights are, whatever rounding did."""
    return (1.0 - _GRAIN) * threshold * count


def chosen(
    state: Any, weights: Array, scheme: Scheme, purpose: int, only: Any = True
) -> tuple[Ancestors, Array]:
    """Ancestors by weight, ``(N, *batch)``, and the log weights after: even.

    Where ``only`` is False a lane keeps its particles and its weights.
    """
    count, batch = len(weights), weights.shape[1:]
    uniform = draws.uniforms(state.key, state.step, purpose, scheme.numbers(count))
    ancestors = scheme(weights, uniform)
    after = even(count, batch)
    if only is not True and not np.all(only):
        own = np.arange(count).reshape(-1, *(1,) * len(batch))
        ancestors = np.where(only, ancestors, own)
        after = np.where(only, after, state.log_weights)
    return ancestors, after


def picked(points: Array, ancestors: Ancestors) -> Array:
    """The ancestors' points; axes ``(..., N, *batch)`` as those of ancestors, or 1 where shared."""
    if ancestors.ndim == 1 and points.ndim == 2:
        return points.take(ancestors, axis=1)
    axis = points.ndim - ancestors.ndim
    if points.shape[axis] == 1:
        return points
    index = ancestors.reshape((1,) * axis + ancestors.shape)
    return np.take_along_axis(points, index, axis=axis)


def resampled(state: Particles, scheme: Scheme, threshold: float) -> Particles:
    """The same belief in particles of even weight, in the lanes where it is due."""
    needed = lacking(state, threshold)
    if needed is False or not np.any(needed):  # of one run it is a Python number's
        return state
    made = kernels.choose(state) if scheme == SYSTEMATIC else None
    if made is not None:
        return made
    ancestors, after = chosen(state, state.weights, scheme, draws.RESAMPLING, needed)
    points = picked(state.points, ancestors)
    return Particles(points, after, state.key, state.step, state.circular)


def log_sum(log_weights: Array) -> tuple[Array, Any]:
    """Weights that sum to one, and the logarithm of what they summed to.

    NaN throughout in a lane where no particle is possible.
    """
    largest = log_weights.max(axis=0)
    shifted = log_weights - largest
    total = np.log(np.add.reduce(np.exp(shifted), axis=0))
    if shifted.ndim == 1:
        total = float(total)
        largest = float(largest)
        if math.isnan(total):
            return np.full_like(shifted, math.nan), math.nan
    shifted -= total
    return shifted, largest + total
