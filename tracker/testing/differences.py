"""Derivatives by differences, for holding exact ones against; nothing here knows the graph.

Central differences over halving steps, extrapolated by Richardson's rule; each entry takes the step
and order whose error estimate is smallest (Ridders 1982), so that neither the scale of the geometry
nor rounding has to be known beforehand. Complex steps are no alternative: atan2 takes none.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from tracker.types import Array

LEVELS = 14
LARGEST = 0.1
ROUNDING = 4.0 * float(np.finfo(float).eps)

Function = Callable[[Array], Array]
Difference = Callable[[Array, Array], Any]


def _extrapolated(raw: Array, rounding: Array) -> tuple[Array, Array]:
    """Best value and its error estimate from ``(LEVELS, ...)`` quotients at halving steps.

    ``rounding`` is what rounding alone may do to each quotient: two that agree better do so by luck.
    """
    best, error = raw[0].copy(), np.full(raw[0].shape, np.inf)
    before = [raw[0]]
    for level in range(1, len(raw)):
        row = [raw[level]]
        for order in range(1, level + 1):
            factor = 4.0**order
            row.append((factor * row[-1] - before[order - 1]) / (factor - 1.0))
            doubt = np.maximum(np.abs(row[-1] - row[-2]), np.abs(row[-1] - before[order - 1]))
            doubt = np.maximum(doubt, rounding[level])
            better = doubt < error
            best, error = np.where(better, row[-1], best), np.where(better, doubt, error)
        before = row
    return best, error


def _steps(scale: Array) -> Array:
    shape = (LEVELS,) + (1,) * scale.ndim
    return scale * (LARGEST * 0.5 ** np.arange(LEVELS)).reshape(shape)


def _along(function: Function, x: Array, offsets: Array) -> Array:
    """``function`` at ``x + offsets``, offsets ``(n, ..., B)``: one call, lanes fastest."""
    points = x.reshape(len(x), *(1,) * (offsets.ndim - 2), x.shape[1]) + offsets
    value = np.asarray(function(points.reshape(len(x), -1)))
    return value.reshape(len(value), *offsets.shape[1:])


def first(
    function: Function, x: Array, scale: Array, difference: Difference
) -> tuple[Array, Array]:
    """First derivatives of a function of lanes, with error estimates.

    Shapes:
        x and scale ``(n, B)``; function from ``(n, K)`` to ``(m, K)``, where K is a multiple of B,
        the lanes repeated; result ``(m, n, B)``, twice.
    """
    n, lanes = x.shape
    h = _steps(scale)  # (LEVELS, n, B)
    offsets = np.zeros((n, 2, LEVELS, n, lanes))
    for i in range(n):
        offsets[i, 0, :, i], offsets[i, 1, :, i] = h[:, i], -h[:, i]
    value = _along(function, x, offsets)
    raw = difference(value[:, 0], value[:, 1]) / (2.0 * h)
    rounding = ROUNDING * np.abs(value).max(axis=1) / h
    return _extrapolated(np.moveaxis(raw, 1, 0), np.moveaxis(rounding, 1, 0))


def second(
    function: Function, x: Array, scale: Array, difference: Difference
) -> tuple[Array, Array]:
    """Second derivatives along the axes and their diagonals, with error estimates.

    Shapes:
        as `first`; result ``(m, n, n, B)``, twice.
    """
    n, lanes = x.shape
    pairs = [(i, j) for i in range(n) for j in range(i, n)]
    h = _steps(scale)
    offsets = np.zeros((n, 2, LEVELS, len(pairs), lanes))
    for k, (i, j) in enumerate(pairs):
        for a in {i, j}:
            offsets[a, 0, :, k], offsets[a, 1, :, k] = h[:, a], -h[:, a]
    value = _along(function, x, offsets)
    centre = np.broadcast_to(
        np.asarray(function(x))[:, None, None], (len(value), LEVELS, len(pairs), lanes)
    )
    bend = difference(value[:, 0], centre) + difference(value[:, 1], centre)
    # In units of scale: the curvature along e_i + e_j is that of i, plus that of j, plus 2 ij.
    unit = (LARGEST * 0.5 ** np.arange(LEVELS)).reshape(LEVELS, 1, 1) ** 2
    rounding = np.abs(value).max(axis=1) * (ROUNDING / unit)
    curvature, doubt = _extrapolated(  # (m, pairs, B)
        np.moveaxis(bend / unit, 1, 0), np.moveaxis(rounding, 1, 0)
    )
    out, error = np.empty((2, len(value), n, n, lanes))
    own = [pairs.index((i, i)) for i in range(n)]
    for k, (i, j) in enumerate(pairs):
        if i == j:
            entry, unsure = curvature[:, k], doubt[:, k]
        else:
            entry = 0.5 * (curvature[:, k] - curvature[:, own[i]] - curvature[:, own[j]])
            unsure = doubt[:, k] + doubt[:, own[i]] + doubt[:, own[j]]
        both = scale[i] * scale[j]
        out[:, i, j] = out[:, j, i] = entry / both
        error[:, i, j] = error[:, j, i] = unsure / both
    return out, error
