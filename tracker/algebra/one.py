"""The algebra over one run: matrices without batch axes, through BLAS and LAPACK."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from tracker.algebra import lanes
from tracker.types import Columns

LEAST, LOG_TAU = lanes.LEAST, lanes.LOG_TAU


def _dense(H: Any) -> Any:
    return H.dense() if isinstance(H, Columns) else H


@functools.cache
def _triangles(n: int) -> tuple[Any, Any]:
    row, column = np.tril_indices(n, -1)
    return row * n + column, column * n + row


def _mirror(A: Any) -> None:
    """Copy the upper triangle over the lower one; for few entries much faster than averaging both."""
    n = len(A)
    if n == 2:  # the most common innovation covariance
        A[1, 0] = A[0, 1]
        return
    lower, upper = _triangles(n)
    A.put(lower, A.take(upper))


def congruence(F: Any, P: Any) -> Any:
    F = _dense(F)
    out = F.dot(P).dot(F.T)
    _mirror(out)
    return out


def product(H: Any, P: Any) -> Any:
    return _dense(H).dot(P)


def symmetric_product(A: Any, H: Any) -> Any:
    out = A.dot(_dense(H).T)
    _mirror(out)
    return out


def curvature(A: Any, P: Any) -> tuple[Any, Any]:
    m = len(A)
    AP = A @ P
    covariance = 0.5 * AP.reshape(m, -1).dot(AP.swapaxes(1, 2).reshape(m, -1).T)
    _mirror(covariance)
    return 0.5 * AP.trace(axis1=1, axis2=2), covariance


def spread(L: Any, points: Any) -> Any:
    return L.dot(points)


def weighted_mean(d: Any, weights: Any) -> Any:
    return d.dot(weights)


def weighted(d: Any, weights: Any) -> Any:
    out = (d * weights).dot(d.T)
    _mirror(out)
    return out


def factor(P: Any) -> Any:
    L, info = dpotrf(P, 1, 1)
    # Singular (or not finite): the rule of the lanes, on one lane.
    return L if info == 0 else lanes.factor(P[..., None])[..., 0]


def gain(cross: Any, S: Any) -> Any:
    L, info = dpotrf(S, 1, 0)
    if info:
        return lanes.gain(cross[..., None], S[..., None])[..., 0]
    whitened = dtrtrs(L, cross.T, 1)[0]
    return dtrtrs(L, whitened, 1, 1)[0].T


def mahalanobis(v: Any, S: Any) -> Any:
    if v.ndim > 1:
        return lanes.mahalanobis(v, S.reshape(S.shape + (1,) * (v.ndim - 1)))
    return lanes.mahalanobis(v[:, None], S[..., None])[0]


def condition(mean: Any, cov: Any, v: Any, S: Any, cross: Any) -> tuple[Any, ...]:
    HP = cross.T
    if math.isnan(sum(v.tolist())):
        seen = np.flatnonzero(~np.isnan(v))
        if not len(seen):
            zero = 0.0 * mean.sum()
            return mean, cov, zero, zero, 0.0
        v, HP, S = v[seen], HP[seen], S[np.ix_(seen, seen)]
    L, info = dpotrf(S, 1, 0)
    if info:  # not positive definite: NaN, as in a lane
        nan = np.full_like(mean, math.nan)
        lost = None if cov is None else np.full_like(cov, math.nan)
        return nan, lost, math.nan, math.nan, float(len(v))
    y = dtrtrs(L, v, 1)[0]
    W = dtrtrs(L, HP, 1)[0]
    mean = mean + y.dot(W)
    nis = float(y.dot(y)) + 0.0 * sum(mean.tolist())  # NaN where the mean is not finite
    # A product of many small pivots would underflow to zero.
    loglik = -0.5 * (nis + 2.0 * sum(map(math.log, L.diagonal().tolist())) + LOG_TAU * len(v))
    if cov is None:
        return mean, None, nis, loglik, float(len(v))
    updated = cov - W.T.dot(W)
    # Lists: for few entries they are searched faster than arrays; mostly the extremes tell enough.
    after, before = updated.diagonal().tolist(), cov.diagonal().tolist()
    if min(after) < LEAST * max(before) and _lost(after, before):
        mean, nis, loglik = np.full_like(mean, math.nan), math.nan, math.nan
    return mean, updated, nis, loglik, float(len(v))


def _lost(after: list[float], before: list[float]) -> bool:
    """Whether little but rounding is left of a variance; a negative one was lost before."""
    return any(a < LEAST * b for a, b in zip(after, before, strict=True) if b >= 0.0)
