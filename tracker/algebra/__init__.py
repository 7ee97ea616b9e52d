"""The small matrix algebra that filters and smoothers are written over, once.

A definition uses ``+``, ``-`` and the verbs below, and runs under three interpretations, chosen by
the arguments alone:

* *lanes*: float arrays with batch axes last, ``(n, *batch)`` and ``(n, n, *batch)``; a value that
  all lanes share has trailing axes of length 1. NumPy, every lane at once.
* *one run*: ``(n,)`` and ``(n, n)``; BLAS and LAPACK.
* *components*: object arrays ``(n,)`` and ``(n, n)`` of graph nodes (or floats); what a compiler
  reads.

The verbs are coarse on purpose: each costs a microsecond or two of Python however small the
matrices are. Covariances stay exactly symmetric: the upper triangle is computed or mirrored.
Filters themselves do not belong here.
"""

from __future__ import annotations

import functools
import math
from types import ModuleType
from typing import Any

import numpy as np

from tracker.algebra import components, lanes
from tracker.algebra.lanes import at_once
from tracker.algebra.mixtures import mix
from tracker.algebra.roots import beside, condition_root, downdate, triangularise
from tracker.algebra.solving import inverse, solve, whiten
from tracker.models.functions import wrap
from tracker.types import Block, Columns

__all__ = [
    "apply",
    "at_once",
    "beside",
    "condition",
    "condition_root",
    "congruence",
    "curvature",
    "dense",
    "downdate",
    "factor",
    "finite",
    "gain",
    "inverse",
    "mahalanobis",
    "mix",
    "product",
    "residual",
    "solve",
    "spread",
    "symmetric_product",
    "transpose",
    "triangularise",
    "weighted",
    "weighted_mean",
    "whiten",
    "without_missing",
    "wrap",
]


def _of(matrix: Any) -> Any:
    """The interpretation that a covariance-like value asks for."""
    if matrix.dtype.hasobject:
        return components
    if matrix.ndim > 2:
        return lanes
    return _one_run()


@functools.cache
def _one_run() -> ModuleType:
    from tracker.algebra import one  # SciPy is imported on the first such step

    return one


def congruence(F: Any, P: Any) -> Any:
    """``F P F'``, exactly symmetric: a covariance seen through a linear map.

    Shapes:
        F ``(k, n, *batch)`` or `Columns`; P ``(n, n, *batch)``; result ``(k, k, *batch)``.
    """
    return _of(P).congruence(F, P)


def product(H: Any, P: Any) -> Any:
    """``H P``.

    Shapes:
        H ``(m, n, *batch)`` or `Columns`; P ``(n, k, *batch)``; result ``(m, k, *batch)``.
    """
    return _of(P).product(H, P)


def symmetric_product(A: Any, H: Any) -> Any:
    """``A H'`` where the result is known to be symmetric, as ``(H P) H'`` is.

    Shapes:
        A ``(m, n, *batch)``; H ``(m, n, *batch)`` or `Columns`; result ``(m, m, *batch)``.
    """
    return _of(A).symmetric_product(A, H)


def apply(A: Any, v: Any) -> Any:
    """``A v``.

    Shapes:
        A ``(k, n, *batch)`` or `Columns`; v ``(n, *batch)``; result ``(k, *batch)``.
    """
    column = v[:, None]
    return _of(column).product(A, column)[:, 0]


def transpose(A: Any) -> Any:
    """The two matrix axes exchanged, as a view."""
    return A.swapaxes(0, 1)


def residual(z: Any, zhat: Any, circular: bool | tuple[bool, ...]) -> Any:
    """``z - zhat``, in (-pi, pi] where a component lives on a circle.

    Shapes:
        z, zhat ``(m, ...)``; circular: one flag for all components, or one each (`Space.circular`).
    """
    difference = z - zhat
    if circular is False or (circular is not True and True not in circular):
        return difference
    if difference.dtype.hasobject:
        return components.residual(difference, circular)
    if difference.ndim == 1:
        flags = (circular,) * len(difference) if circular is True else circular
        for i, value in enumerate(difference.tolist()):
            if flags[i] and abs(value) >= lanes.NEARLY_PI:
                difference[i] = wrap(value)
        return difference
    if circular is True:
        lanes.wrap_in_place(difference)
        return difference
    for i, flag in enumerate(circular):
        if flag:
            lanes.wrap_in_place(difference[i])
    return difference


def curvature(A: Any, P: Any) -> tuple[Any, Any]:
    """What second derivatives A add to a mean and a covariance: ``tr(A_i P) / 2`` and
    ``tr(A_i P A_j P) / 2``, the moments of ``e' A_i e / 2`` for e of covariance P.

    Shapes:
        A ``(m, n, n, *batch)`` or `Block`, symmetric; P ``(n, n, *batch)``; result ``(m, *batch)``
        and ``(m, m, *batch)``.
    """
    if isinstance(A, Block):
        P, A = _part(P, A.columns), A.entries
    return _of(P).curvature(A, P)  # type: ignore[no-any-return]


def _part(P: Any, places: tuple[int, ...]) -> Any:
    """Some rows and columns of P; a view where they lie side by side."""
    if not places:
        return P[:0, :0]
    first, last = places[0], places[-1] + 1
    if places == tuple(range(first, last)):
        return P[first:last, first:last]
    return P[np.ix_(places, places)]


def factor(P: Any) -> Any:
    """Lower triangular L with ``L L' = P``; a zero pivot gives a zero column, so singular P works.

    Shapes:
        P ``(n, n, *batch)``; result alike.
    """
    return _of(P).factor(P)


def spread(mean: Any, L: Any, points: Any) -> Any:
    """``mean + L xi`` for each column xi of ``points``: places spread about a mean.

    Shapes:
        mean ``(n, *batch)``; L ``(n, n, *batch)``; points ``(n, s)``, numbers;
        result ``(n, s, *batch)``.
    """
    return mean[:, None] + _of(L).spread(L, points)


def weighted_mean(d: Any, weights: Any) -> Any:
    """``sum_s w_s d_s``. Of angles, give differences about one of them: differences can be added.

    With several columns of weights, as many means: those with weights ``w_s xi_s``, times the L
    of `spread`, are the covariance between what was spread and d.

    Shapes:
        d ``(m, s, *batch)``; weights ``(s,)`` or ``(s, k)``, numbers; result ``(m, *batch)`` or
        ``(m, k, *batch)``.
    """
    if weights.ndim == 1:
        return _of(d).weighted_mean(d, weights[:, None])[:, 0]
    return _of(d).weighted_mean(d, weights)


def weighted(d: Any, weights: Any) -> Any:
    """``sum_s w_s d_s d_s'``, exactly symmetric.

    Shapes:
        d ``(m, s, *batch)``; weights ``(s,)``, numbers; result ``(m, m, *batch)``.
    """
    return _of(d).weighted(d, weights)


def gain(cross: Any, S: Any) -> Any:
    """``cross S^-1``, the regression of a state on what correlates with it by ``cross``.

    A direction in which S is exactly zero carries no information: its column of the gain is zero.

    Shapes:
        cross ``(n, m, *batch)``; S ``(m, m, *batch)``; result ``(n, m, *batch)``.
    """
    return _of(S).gain(cross, S)


def without_missing(S: Any, cross: Any, v: Any) -> tuple[Any, Any]:
    """S and cross with the components whose residual is NaN made inert: unit variance, uncorrelated.

    Shapes:
        S ``(m, m, *batch)``; cross ``(n, m, *batch)``; v ``(m, *batch)``.
    """
    chosen: Any = components if S.dtype.hasobject else lanes
    return chosen.without_missing(S, cross, v)  # type: ignore[no-any-return]


def mahalanobis(v: Any, S: Any) -> Any:
    """``v' S^-1 v``.

    Shapes:
        v ``(m, *batch)``; S ``(m, m, *batch)``, broadcast against it; result ``(*batch)``.
    """
    return _of(S).mahalanobis(v, S)


def condition(mean: Any, cov: Any, v: Any, S: Any, cross: Any) -> tuple[Any, ...]:
    """Condition a Gaussian on a measurement; components whose residual is NaN were not measured.

    The whitened update: with ``S = L L'``, ``W = L^-1 cross'``, ``y = L^-1 v``, the result is
    ``mean + W' y`` and ``cov - W' W``, symmetric by construction. The subtraction cancels all digits
    when a measurement is some 1e15 times better than the prior (``H P H' / R``), or has no noise at
    all: where less than `tracker.algebra.lanes.LEAST` of a variance is left, what is left is
    rounding, and mean, nis and loglik are NaN: ``ok`` is False, then and ever after. Use the filter
    "ekf1_joseph" or "square_root" for such problems. One that finds its covariance by itself gives
    None for cov.

    Shapes:
        mean ``(n, *batch)``; cov ``(n, n, *batch)`` or None; v ``(m, *batch)``; S ``(m, m, *batch)``;
        cross ``(n, m, *batch)``.

    Returns:
        mean, cov (or None), nis, loglik, count (of measured components): the last three ``(*batch)``.
    """
    return _of(S if cov is None else cov).condition(mean, cov, v, S, cross)  # type: ignore[no-any-return]


def dense(H: Any) -> Any:
    """A Jacobian as a full matrix."""
    return H.dense() if isinstance(H, Columns) else H


def finite(value: Any) -> Any:
    """Whether each lane is finite; a graph node answers True: its kernel flags lanes itself."""
    if type(value) is float:
        return math.isfinite(value)
    return np.isfinite(value) if isinstance(value, (float, np.ndarray)) else True
