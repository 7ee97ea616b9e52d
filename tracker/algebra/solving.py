"""Verbs that solve linear equations, written once for lanes, one run and graph nodes.

Those that a filter needs at every step and in every interpretation's own best form (`gain`,
`condition`) live with the interpretations; these serve the forms that are seldom used.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tracker.algebra import components
from tracker.models.functions import isnan, less, sqrt, where
from tracker.models.graph import is_zero, plain
from tracker.types import Columns

_NORMAL = 2.0**-1022


def _reciprocal(pivot: Any) -> Any:
    """``1 / pivot``, zero where the pivot is not positive; NaN stays."""
    if is_zero(pivot):
        return 0.0
    good = less(_NORMAL, pivot)
    bad = where(isnan(pivot), math.nan, 0.0)
    return plain(where(good, 1.0 / where(good, pivot, 1.0), bad))


def dot(a: Any, b: Any) -> Any:
    """Products of leading components, summed: vectors with vectors, or with each column."""
    if not a.dtype.hasobject:
        return np.einsum("k...,k...->..." if a.ndim == b.ndim else "k...,kl...->l...", a, b)
    if b.ndim > 1:
        out = np.empty(b.shape[1], dtype=object)
        out[:] = [components.dot(a, b[:, c]) for c in range(b.shape[1])]
        return out
    return components.dot(a, b)


def whiten(L: Any, B: Any) -> Any:
    """``L^-1 B`` for a lower triangular L; a zero on its diagonal gives a row of zeros.

    Shapes:
        L ``(m, m, *batch)``; B ``(m, *batch)`` or ``(m, k, *batch)``; result as B.
    """
    rows: list[Any] = []
    for a in range(len(B)):
        row = B[a]
        for b in range(a):
            if not is_zero(L[a, b]):
                row = row - L[a, b] * rows[b]
        rows.append(row * _reciprocal(L[a, a]))
    return _stacked(rows, B.dtype if B.dtype.hasobject else L.dtype)


def _stacked(rows: list[Any], dtype: Any) -> Any:
    out = np.empty((len(rows), *np.broadcast_shapes(*(np.shape(row) for row in rows))), dtype=dtype)
    for a, row in enumerate(rows):
        out[a] = plain(row)
    return out


def inverse(P: Any) -> Any:
    """``P^-1``, exactly symmetric; NaN where P is not positive definite.

    Shapes:
        P ``(n, n, *batch)``, symmetric; result alike.
    """
    from tracker.algebra import factor, symmetric_product, transpose

    n = len(P)
    L = factor(P)
    unit = np.eye(n).astype(P.dtype).reshape(n, n, *(1,) * (P.ndim - 2))
    half = transpose(whiten(L, unit))
    out = symmetric_product(half, half)
    flaw: Any = 0.0
    for i in range(n):
        flaw = where(less(0.0, L[i, i]), flaw, math.nan)
    if not out.dtype.hasobject:
        return out + flaw
    for place, entry in np.ndenumerate(out):
        if not is_zero(entry):
            out[place] = plain(entry + flaw)
    return out


def solve(A: Any, B: Any) -> Any:
    """``A^-1 B`` for any square A, by orthogonalisation; not finite where A is singular.

    Shapes:
        A ``(n, n, *batch)`` or `Columns`; B ``(n, k, *batch)``; result alike. Axes of length 1 are
        shared.
    Reference:
        Björck (1967), Solving linear least squares problems by Gram-Schmidt orthogonalization, BIT 7.
    """
    A = A.dense() if isinstance(A, Columns) else A
    n = len(A)
    columns, left = [A[:, j] for j in range(n)], B
    upper: list[list[Any]] = []
    seen: list[Any] = []
    for j in range(n):
        size = plain(sqrt(dot(columns[j], columns[j])))
        direction = columns[j] * _reciprocal(size)
        upper.append([*[0.0] * j, size])
        for i in range(j + 1, n):
            upper[j].append(dot(direction, columns[i]))
            columns[i] = columns[i] - upper[j][i] * direction
        seen.append(dot(direction, left))
        left = left - direction[:, None] * seen[j]
    rows: list[Any] = [None] * n
    for j in reversed(range(n)):
        row = seen[j]
        for i in range(j + 1, n):
            if not is_zero(upper[j][i]):
                row = row - upper[j][i] * rows[i]
        singular = is_zero(upper[j][j])
        rows[j] = row * math.nan if singular else row / upper[j][j]
    return _stacked(rows, B.dtype if B.dtype.hasobject else A.dtype)
