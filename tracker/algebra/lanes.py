"""The algebra over arrays of lanes: NumPy, components first, any batch axes last.

No lane ever touches another one, and nothing is reordered, so a lane's bits do not depend on its
neighbours. Written for speed at about 1,000 lanes: a verb is a dozen array operations.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from tracker.models.functions import wrap
from tracker.types import Columns

LOG_TAU = math.log(2.0 * math.pi)
PIVOTS = 4
"""Pivots multiplied before their logarithm is taken: a product of many small ones would underflow."""

LEAST = 2.0**-48
"""An update that leaves less than this of a variance has left little but rounding of it."""

BUFFER = 128
"""Entries in NumPy's working buffer (8,192 by default): whatever broadcasts is copied through it, and
through a small one twice as fast."""


@contextlib.contextmanager
def at_once() -> Iterator[None]:
    """NumPy set up for recursions over lanes; a lane that diverges is no reason for a warning."""
    with np.errstate(all="ignore"):  # restores the buffer too
        np.setbufsize(BUFFER)
        yield


NEARLY_PI = math.pi - 2e-15
"""Angles of smaller size are their own `wrap`; between here and pi its rounding decides."""


def wrap_in_place(angles: Any) -> None:
    """`tracker.models.wrap` of the few angles that need it."""
    outside = np.abs(angles) >= NEARLY_PI
    if outside.any():
        angles[outside] = wrap(angles[outside])


def _shared(F: Any) -> bool:
    return all(length == 1 for length in F.shape[2:])


def mirror(A: Any) -> None:
    """Copy the upper triangle over the lower one."""
    for j in range(len(A) - 1):
        A[j + 1 :, j] = A[j, j + 1 :]


def congruence(F: Any, P: Any) -> Any:
    if isinstance(F, Columns):
        F = F.dense()
    k, n = F.shape[:2]
    if _shared(F):  # matrix products over all lanes at once
        matrix = F.reshape(k, n)
        half = (matrix @ P.reshape(n, -1)).reshape(k, n, -1)
        out = np.matmul(matrix, half).reshape(k, k, *P.shape[2:])
    else:
        half = np.einsum("ik...,kj...->ij...", F, P)
        out = np.einsum("ik...,jk...->ij...", half, F)
    mirror(out)
    return out


def product(H: Any, P: Any) -> Any:
    if isinstance(H, Columns):
        entries, columns = H.entries, H.columns
        if not columns:
            return np.zeros((entries.shape[0], *P.shape[1:]))
        out = entries[:, 0, None] * P[columns[0]]
        for j in range(1, len(columns)):
            out += entries[:, j, None] * P[columns[j]]
        return out
    return np.einsum("ai...,ij...->aj...", H, P)


def symmetric_product(A: Any, H: Any) -> Any:
    if isinstance(H, Columns):
        columns = H.columns
        first, last = (columns[0], columns[-1] + 1) if columns else (0, 0)
        whole = columns == tuple(range(first, last))
        used = A[:, first:last] if whole else A[:, list(columns)]
        out = np.einsum("aj...,cj...->ac...", used, H.entries)
    else:
        out = np.einsum("aj...,cj...->ac...", A, H)
    mirror(out)
    return out


def curvature(A: Any, P: Any) -> tuple[Any, Any]:
    AP = np.einsum("aij...,jk...->aik...", A, P)
    covariance = 0.5 * np.einsum("aij...,cji...->ac...", AP, AP)
    mirror(covariance)
    return 0.5 * np.einsum("aii...->a...", AP), covariance


def spread(L: Any, points: Any) -> Any:
    return np.einsum("ij...,js->is...", L, points)


def weighted_mean(d: Any, weights: Any) -> Any:
    return np.einsum("as...,sk->ak...", d, weights)


def weighted(d: Any, weights: Any) -> Any:
    scaled = d * weights.reshape(-1, *(1,) * (d.ndim - 2))
    out = np.einsum("as...,cs...->ac...", scaled, d)
    mirror(out)
    return out


def factor(P: Any) -> Any:
    n = len(P)
    A, L = P.copy(), np.zeros(P.shape)
    for j in range(n):
        pivot = np.sqrt(np.maximum(A[j, j], 0.0))
        column = L[j:, j]
        np.divide(A[j:, j], pivot, out=column, where=~(pivot <= 0))
        if j + 1 < n:
            A[j + 1 :, j + 1 :] -= column[1:, None] * column[1:]
    return L


def _inverse_factor(S: Any) -> tuple[list[list[Any]], list[Any]]:
    """Rows of the Cholesky factor of S below the diagonal, and the reciprocals of its diagonal."""
    m = len(S)
    rows: list[list[Any]] = [[None] * m for _ in range(m)]
    inverse: list[Any] = [None] * m
    for a in range(m):
        pivot = S[a, a]
        for b in range(a):
            entry = S[a, b]
            for c in range(b):
                entry = entry - rows[a][c] * rows[b][c]
            rows[a][b] = entry = entry * inverse[b]
            pivot = pivot - entry * entry
        root = np.sqrt(np.maximum(pivot, 0.0))
        inverse[a] = np.divide(1.0, root, out=np.zeros(root.shape), where=~(root <= 0))
    return rows, inverse


def gain(cross: Any, S: Any) -> Any:
    m = len(S)
    rows, inverse = _inverse_factor(S)
    whitened: list[Any] = []
    for a in range(m):
        w = cross[:, a]
        for b in range(a):
            w = w - rows[a][b] * whitened[b]
        whitened.append(w * inverse[a])
    out = np.empty(np.broadcast_shapes(cross.shape, (1, m, *S.shape[2:])))
    for a in reversed(range(m)):
        w = whitened[a]
        for b in range(a + 1, m):
            w = w - rows[b][a] * out[:, b]
        np.multiply(w, inverse[a], out[:, a])
    return out


def mahalanobis(v: Any, S: Any) -> Any:
    rows, inverse = _inverse_factor(S)
    y: list[Any] = []
    total: Any = 0.0
    for a in range(len(S)):
        u = v[a]
        for b in range(a):
            u = u - rows[a][b] * y[b]
        y.append(u * inverse[a])
        total = total + y[a] * y[a]
    return total


def without_missing(S: Any, cross: Any, v: Any) -> tuple[Any, Any]:
    missing = np.isnan(v)
    if not missing.any():
        return S, cross
    unit = np.eye(len(v)).reshape(len(v), len(v), *(1,) * (v.ndim - 1))
    return np.where(missing[:, None] | missing, unit, S), np.where(missing, 0.0, cross)


def condition(mean: Any, cov: Any, v: Any, S: Any, cross: Any) -> tuple[Any, ...]:
    m = len(v)
    missing = np.isnan(v)
    masked = np.count_nonzero(missing) > 0
    if masked:
        v = np.where(missing, 0.0, v)
        unseen = missing.astype(np.float64)
        seen = 1.0 - unseen
    rows: list[list[Any]] = [[None] * m for _ in range(m)]
    W: list[Any] = []
    y: list[Any] = []
    logarithm: Any = 0.0
    determinant: Any = 1.0
    for k in range(m):
        s, w, u = S[k, k], cross[:, k], v[k]
        for j in range(k):
            entry = S[k, j]
            for i in range(j):
                entry = entry - rows[k][i] * rows[j][i]
            rows[k][j] = entry = entry * rows[j][j]
            s = s - entry * entry
            w = w - entry * W[j]
            u = u - entry * y[j]
        if masked:  # unit pivot, and the reciprocal of an infinite variance: w and u become zero
            s = s * seen[k]
            s += unseen[k]
            inverse = seen[k] / np.sqrt(s)
        else:
            inverse = 1.0 / np.sqrt(s)
        determinant = determinant * s
        if k % PIVOTS == PIVOTS - 1:
            logarithm, determinant = logarithm + np.log(determinant), 1.0
        rows[k][k] = inverse
        W.append(w * inverse)
        y.append(u * inverse)
    nis: Any = 0.0
    before = cov
    outer = np.empty((*W[0].shape[:1], *W[0].shape))
    smaller = np.empty_like(outer)
    for w, u in zip(W, y, strict=True):
        mean = mean + w * u
        nis = nis + u * u
        if cov is not None:
            cov = np.subtract(cov, np.multiply(w[:, None], w, outer), smaller)
    if cov is not None:
        lost = cov.diagonal() < LEAST * before.diagonal()
        if np.count_nonzero(lost):
            lost &= before.diagonal() >= 0.0  # a negative one was lost before
            mean = np.where(lost.any(axis=-1), math.nan, mean)
    nis += 0.0 * np.add.reduce(mean, axis=0)  # NaN in a lane whose mean is not finite
    count = np.add.reduce(seen, axis=0) if masked else np.full(nis.shape, float(m))
    loglik = -0.5 * (nis + (logarithm + np.log(determinant)) + LOG_TAU * count)
    return mean, cov, nis, loglik, count
