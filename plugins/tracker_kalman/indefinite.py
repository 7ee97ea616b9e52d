"""What to do with a covariance that a negative weight has made indefinite: refuse it, or raise it.

Written over entries, so that it is one definition for lanes, one run and graph nodes. Which filters
need it is theirs to say.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tracker.models import absolute, isnan, less, maximum, minimum, sqrt, where
from tracker.models.graph import plain

ROUNDING = 1e-12
"""A pivot that is below zero by so much of the entry it came from may owe that to rounding alone."""

_TINY = 2.0**-1022


def semidefinite(P: Any, rounding: float = 1.0) -> Any:
    """P where it is positive semi-definite, NaN elsewhere.

    ``rounding`` says how many times larger than P the terms were that P is the sum of.

    Shapes:
        P ``(n, n, *batch)``, symmetric; result alike.
    Reference:
        Higham (2002), Accuracy and Stability of Numerical Algorithms, sections 10.1.1 and 10.3.
    """
    n, tolerance = len(P), ROUNDING * rounding
    A = [[P[i, j] for j in range(n)] for i in range(n)]
    lowest: Any = 1.0
    with np.errstate(all="ignore"):
        for j in range(n):
            near = absolute(P[j, j]) * tolerance
            lowest = minimum(A[j][j] + near, lowest)  # NaN if the pivot is
            # Below a pivot of zero stand zeros; anything else, so divided, sends a later one far down.
            _eliminate(A, j, maximum(maximum(A[j][j], near), _TINY))
    good = less(-_TINY, lowest)
    return _of_entries(P, lambda i, j: where(good, P[i, j], math.nan))


def raised(P: Any, floor: float) -> Any:
    """P plus a diagonal that makes it positive definite; P itself where it is.

    Works on P scaled to a unit diagonal, so that ``floor``, the smallest pivot allowed, has no unit. A
    negative pivot is raised to its own size, since a variance that came out as -4 is no reason to be
    certain, and further where the entries below it would otherwise grow.

    Shapes:
        P ``(n, n, *batch)``, symmetric; result alike.
    Reference:
        Gill, Murray and Wright (1981), Practical Optimization, section 4.4.2.2.
    """
    n = len(P)
    variance = [absolute(P[i, i]) for i in range(n)]
    scale = [1.0 / sqrt(where(less(0.0, v), v, 1.0)) for v in variance]
    C = [[P[i, j] * (scale[i] * scale[j]) for j in range(n)] for i in range(n)]
    largest: Any = 0.0
    for i in range(n):
        for j in range(i):
            largest = maximum(largest, absolute(C[i][j]))
    bound = maximum(1.0, largest * (1.0 / math.sqrt(max(n * n - 1.0, 1.0))))
    added = []
    for j in range(n):
        pivot, most = C[j][j], 0.0
        for i in range(j + 1, n):
            most = maximum(most, absolute(C[i][j]))
        needed = maximum(maximum(absolute(pivot), most * most / bound), floor)
        added.append(where(isnan(pivot), pivot, (needed - pivot) * variance[j]))
        _eliminate(C, j, needed)
    return _of_entries(P, lambda i, j: P[i, j] + added[i] if i == j else P[i, j])


def _eliminate(C: list[list[Any]], j: int, pivot: Any) -> None:
    """One step of the Cholesky recursion, on the lower triangle."""
    inverse = 1.0 / pivot
    for i in range(j + 1, len(C)):
        ratio = C[i][j] * inverse
        for k in range(j + 1, i + 1):
            C[i][k] = C[i][k] - ratio * C[k][j]


def _of_entries(P: Any, entry: Any) -> Any:
    out = np.empty_like(P)
    for i in range(len(P)):
        for j in range(i, len(P)):
            out[i, j] = out[j, i] = plain(entry(i, j))
    return out


def unless_refused(cov: Any, *values: Any) -> tuple[Any, ...]:
    """Values ``(*batch)`` or ``(n, *batch)`` with NaN in the lanes that `semidefinite` refused."""
    refused = isnan(cov[0, 0])

    def kept(value: Any) -> Any:
        if not (isinstance(value, np.ndarray) and value.ndim == cov.ndim - 1):
            return where(refused, math.nan, value)
        out = np.empty_like(value)
        for i in range(len(value)):
            out[i] = where(refused, math.nan, value[i])
        return out

    return tuple(kept(value) for value in values)
