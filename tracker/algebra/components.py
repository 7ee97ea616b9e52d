"""The algebra over components: object arrays of graph nodes or floats, where zeros vanish.

This is what a compiler reads. Equal expressions become one node, so sparsity and symmetry need no
patterns: both triangles of a covariance hold the same object.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from tracker.algebra.lanes import LEAST, LOG_TAU, PIVOTS
from tracker.models.functions import absolute, isnan, less, log, sqrt, where, wrap
from tracker.models.graph import is_zero, plain

_NORMAL = 2.0**-1022


def dot(a: Iterable[Any], b: Iterable[Any]) -> Any:
    """The sum of products, without those that are zero."""
    out: Any = 0.0
    for u, v in zip(a, b, strict=True):
        if not (is_zero(u) or is_zero(v)):
            out = u * v if is_zero(out) else out + u * v
    return plain(out)


def _total(entries: Iterable[Any]) -> Any:
    out: Any = 0.0
    for e in entries:
        out = out + e
    return plain(out)


def _matrix(rows: int, columns: int, entry: Callable[[int, int], Any]) -> Any:
    out = np.empty((rows, columns), dtype=object)
    for i in range(rows):
        for j in range(columns):
            out[i, j] = plain(entry(i, j))
    return out


def _symmetric(n: int, entry: Callable[[int, int], Any]) -> Any:
    out = np.empty((n, n), dtype=object)
    for i in range(n):
        for j in range(i, n):
            out[i, j] = out[j, i] = plain(entry(i, j))
    return out


def _vector(entries: Iterable[Any]) -> Any:
    values = [plain(e) for e in entries]
    out = np.empty(len(values), dtype=object)
    out[:] = values
    return out


def congruence(F: Any, P: Any) -> Any:
    half = product(F, P)
    return _symmetric(len(F), lambda i, j: dot(half[i], F[j]))


def product(H: Any, P: Any) -> Any:
    return _matrix(len(H), P.shape[1], lambda i, j: dot(H[i], P[:, j]))


def symmetric_product(A: Any, H: Any) -> Any:
    return _symmetric(len(H), lambda i, j: dot(A[i], H[j]))


def residual(difference: Any, circular: bool | tuple[bool, ...]) -> Any:
    flags = (circular,) * len(difference) if isinstance(circular, bool) else circular
    out = difference.copy()
    for i, flag in enumerate(flags):
        if flag:
            out[i] = (
                plain(wrap(difference[i]))
                if difference.ndim == 1
                else [plain(wrap(e)) for e in difference[i]]
            )
    return out


def curvature(A: Any, P: Any) -> tuple[Any, Any]:
    AP = [product(matrix, P) for matrix in A]
    transposed = [half.T.ravel() for half in AP]
    bias = _vector(0.5 * _total(half.diagonal()) for half in AP)
    return bias, _symmetric(len(A), lambda a, c: 0.5 * dot(AP[a].ravel(), transposed[c]))


def spread(L: Any, points: Any) -> Any:
    return product(L, points)


def weighted_mean(d: Any, weights: Any) -> Any:
    return product(d, weights)


def weighted(d: Any, weights: Any) -> Any:
    scaled = [[w * e for w, e in zip(weights.tolist(), row, strict=True)] for row in d]
    return _symmetric(len(d), lambda i, j: dot(scaled[i], d[j]))


def _factors(S: Any) -> tuple[list[list[Any]], list[Any]]:
    """``S = L D L'``: rows of L below its diagonal of ones, and the reciprocals of D.

    No square roots, which take longer than all else in a step that waits for them. A pivot that is
    not positive has the reciprocal zero: that direction carries no information.
    """
    m = len(S)
    rows: list[list[Any]] = []
    inverse: list[Any] = []
    for a in range(m):
        row, pivot = _eliminated(S, a, rows, inverse)
        rows.append(row)
        inverse.append(
            0.0 if is_zero(pivot) else where(less(pivot, _NORMAL), 0.0, 1.0 / pivot)
        )  # NaN stays
    return rows, inverse


def _eliminated(S: Any, a: int, rows: list[list[Any]], inverse: list[Any]) -> tuple[list[Any], Any]:
    """Row a of L, and the pivot that is left, given the rows and reciprocals before it."""
    scaled: list[Any] = []  # of L D
    row: list[Any] = []
    for b in range(a):
        scaled.append(S[a, b] - dot(scaled, rows[b]))
        row.append(plain(scaled[b] * inverse[b]))
    return row, S[a, a] - dot(scaled, row)


def factor(P: Any) -> Any:
    n = len(P)
    out = np.zeros((n, n), dtype=object)
    inverse: list[Any] = []
    for a in range(n):
        for b in range(a):
            out[a, b] = plain((P[a, b] - dot(out[a, :b], out[b, :b])) * inverse[b])
        pivot = P[a, a] - dot(out[a, :a], out[a, :a])
        if is_zero(pivot):
            inverse.append(0.0)
            continue
        good = pivot > 0.0
        bad = where(isnan(pivot), pivot, 0.0)
        root = sqrt(where(good, pivot, 1.0))
        inverse.append(where(good, 1.0 / root, bad))
        out[a, a] = plain(where(good, root, bad))
    return out


def _forward(rows: list[list[Any]], columns: list[Any]) -> list[Any]:
    """Rows of L^-1 B, given the rows of B."""
    out: list[Any] = []
    for a, column in enumerate(columns):
        out.append([plain(e - dot(rows[a], [w[i] for w in out])) for i, e in enumerate(column)])
    return out


def gain(cross: Any, S: Any) -> Any:
    n, m = cross.shape
    rows, inverse = _factors(S)
    ahead = _forward(rows, [list(cross[:, a]) for a in range(m)])
    out = np.zeros((n, m), dtype=object)
    for a in reversed(range(m)):
        later = range(a + 1, m)
        for i in range(n):
            known = dot([rows[b][a] for b in later], [out[i, b] for b in later])
            out[i, a] = plain(ahead[a][i] * inverse[a] - known)
    return out


def mahalanobis(v: Any, S: Any) -> Any:
    rows, inverse = _factors(S)
    y = [row[0] for row in _forward(rows, [[e] for e in v])]
    return dot(y, [u * r for u, r in zip(y, inverse, strict=True)])


def without_missing(S: Any, cross: Any, v: Any) -> tuple[Any, Any]:
    n, m = cross.shape
    seen = [where(isnan(e), 0.0, 1.0) for e in v]

    def entry(a: int, b: int) -> Any:
        return where(isnan(v[a]), 1.0, S[a, a]) if a == b else seen[a] * seen[b] * S[a, b]

    return _symmetric(m, entry), _matrix(n, m, lambda i, a: seen[a] * cross[i, a])


def condition(mean: Any, cov: Any, v: Any, S: Any, cross: Any) -> tuple[Any, ...]:
    # By S = L D L', as in _factors; but a negative pivot is an error here, and must be seen.
    n, m = cross.shape
    rows: list[list[Any]] = []
    inverse: list[Any] = []
    logarithm: Any = 0.0
    determinant: Any = 1.0
    count: Any = 0.0
    residuals = []
    for k in range(m):
        missing = isnan(v[k])
        row, pivot = _eliminated(S, k, rows, inverse)
        rows.append(row)
        reciprocal = where(less(pivot, 0.0), math.nan, 1.0 / pivot)
        inverse.append(where(missing, 0.0, reciprocal))
        determinant = where(missing, determinant, determinant * pivot)
        if k % PIVOTS == PIVOTS - 1:
            logarithm, determinant = logarithm + log(determinant), 1.0
        count = count + where(missing, 0.0, 1.0)
        residuals.append([where(missing, 0.0, v[k])])
    y = [row[0] for row in _forward(rows, residuals)]
    scaled = [plain(u * r) for u, r in zip(y, inverse, strict=True)]
    ahead = _forward(rows, [list(cross[:, k]) for k in range(m)])
    column = [[w[i] for w in ahead] for i in range(n)]
    over = [[plain(w * r) for w, r in zip(column[i], inverse, strict=True)] for i in range(n)]
    new = [mean[i] + dot(column[i], scaled) for i in range(n)]
    updated = None
    if cov is not None:
        updated = _symmetric(n, lambda i, j: cov[i, j] - dot(over[i], column[j]))
        # A variance of which little but rounding is left; a negative one was lost before.
        pairs = zip(cov.diagonal(), updated.diagonal(), strict=True)
        margins = [
            where(less(before, 0.0), 0.0, after - LEAST * before)
            for before, after in pairs
            if after is not before
        ]
        if margins:
            lost = less(_least(margins), 0.0)
            new = [where(lost, math.nan, e) for e in new]
    total: Any = 0.0
    for e in new:
        total = total + e
    # NaN in a lane whose mean is not finite (0 * total would vanish from the graph)
    nis = where(less(absolute(total), math.inf), dot(y, scaled), math.nan)
    loglik = -0.5 * (nis + (logarithm + log(determinant)) + LOG_TAU * count)
    return _vector(new), updated, nis, loglik, count


def _least(values: list[Any]) -> Any:
    """The smallest of some values. NaN may be overlooked: the mean tells of it."""
    out = values[0]
    for value in values[1:]:
        out = where(less(value, out), value, out)
    return out
