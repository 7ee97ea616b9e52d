"""The algebra over square roots: lower triangular L in the place of ``P = L L'``.

Each verb is written once, over rows or entries, for lanes, one run and graph nodes alike; filters
that carry roots live elsewhere. What a root loses when a sum of squares is formed - half the digits -
is why these exist.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tracker.algebra.lanes import LOG_TAU
from tracker.algebra.solving import dot
from tracker.models.functions import absolute, isnan, less, log, sqrt, where
from tracker.models.graph import is_zero, plain


def beside(*blocks: Any) -> Any:
    """Matrices next to each other, as one; batch axes that lanes share are repeated.

    Shapes:
        blocks ``(n, k_i, *batch)``; result ``(n, sum k_i, *batch)``.
    """
    batch = np.broadcast_shapes(*(block.shape[2:] for block in blocks))
    return np.concatenate(
        [np.broadcast_to(block, block.shape[:2] + batch) for block in blocks], axis=1
    )


def triangularise(A: Any) -> Any:
    """Lower triangular L with ``L L' = A A'`` and a diagonal that is not negative.

    A row that depends on those above it has a zero on the diagonal and zeros below. By modified
    Gram-Schmidt, whose triangular factor is as accurate as that of Householder's reflections.

    Shapes:
        A ``(n, k, *batch)``, any k; result ``(n, n, *batch)``.
    Reference:
        Björck (1967), Solving linear least squares problems by Gram-Schmidt orthogonalization, BIT 7.
    """
    n = len(A)
    rows = [A[i] for i in range(n)]
    L = np.zeros((n, n, *A.shape[2:]), dtype=A.dtype)
    for i in range(n):
        square = dot(rows[i], rows[i])
        if is_zero(square):
            continue
        size = sqrt(square)
        L[i, i] = plain(size)
        # NaN stays; where the row is zero its direction is too
        inverse = 1.0 / where(less(0.0, size), size, where(isnan(size), size, math.inf))
        direction = rows[i] * inverse
        for j in range(i + 1, n):
            along = dot(rows[j], direction)
            L[j, i] = plain(along)
            rows[j] = rows[j] - along * direction
    return L


def downdate(L: Any, v: Any) -> Any:
    """Lower triangular with ``L L' - v v'``; NaN where that is not positive semi-definite.

    Shapes:
        L ``(n, n, *batch)``; v ``(n, *batch)``; result as L.
    Reference:
        Gill, Golub, Murray and Saunders (1974), Methods for modifying matrix factorizations,
        Mathematics of Computation 28, method C1.
    """
    n = len(L)
    out, left = np.zeros_like(L), [v[i] for i in range(n)]
    for j in range(n):
        square = (L[j, j] - left[j]) * (L[j, j] + left[j])
        diagonal = sqrt(square)  # NaN if negative
        out[j, j] = plain(diagonal)
        known = less(0.0, L[j, j])
        inverse = where(known, 1.0 / where(known, L[j, j], 1.0), 0.0)
        sine, cosine = left[j] * inverse, where(known, diagonal * inverse, 1.0)
        steep = less(0.0, cosine)
        secant = where(steep, 1.0 / where(steep, cosine, 1.0), 0.0)
        for i in range(j + 1, n):
            out[i, j] = plain((L[i, j] - sine * left[i]) * secant)
            left[i] = cosine * left[i] - sine * out[i, j]
    return out


def condition_root(mean: Any, joint: Any, v: Any) -> tuple[Any, ...]:
    """Condition a Gaussian on a measurement, given the root of their joint covariance.

    ``joint`` is lower triangular over measurement and state: ``[[S_root, 0], [K_root, L]]``; then L
    is the root of the updated covariance and ``mean + K_root S_root^-1 v`` the updated mean. The rows
    of components that were not measured (NaN in v) hold a one on the diagonal and nothing else.

    Shapes:
        mean ``(n, *batch)``; joint ``(m + n, m + n, *batch)``; v ``(m, *batch)``.

    Returns:
        mean, root, nis, loglik, count (of measured components): the last three ``(*batch)``.
    """
    m, n = len(v), len(mean)
    y: list[Any] = []
    nis: Any = 0.0
    logarithm: Any = 0.0
    count: Any = 0.0
    for a in range(m):
        missing = isnan(v[a])
        left = where(missing, 0.0, v[a])
        for b in range(a):
            left = left - joint[a, b] * y[b]
        y.append(left / joint[a, a])
        nis = nis + y[a] * y[a]
        logarithm = logarithm + where(missing, 0.0, log(joint[a, a]))
        count = count + where(missing, 0.0, 1.0)
    new = np.empty_like(mean)
    total: Any = 0.0
    for i in range(n):
        entry = mean[i]
        for a in range(m):
            entry = entry + joint[m + i, a] * y[a]
        new[i] = plain(entry)
        total = total + entry
    nis = where(less(absolute(total), math.inf), nis, math.nan)
    root = joint[m:, m:]
    for i in range(n):  # a root that a downdate has lost
        nis = where(isnan(root[i, i]), math.nan, nis)
    loglik = -0.5 * (nis + 2.0 * logarithm + LOG_TAU * count)
    return new, root, nis, loglik, count
