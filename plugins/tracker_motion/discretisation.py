"""Transition and noise of a linear stochastic model over a step, by the integral and by the matrix
fraction of paper 0; no particular model lives here.

The model is ``dx/dt = F x + L w``, with ``w`` white of spectral density ``Qc``. If ``F`` is nilpotent
(all kinematic chains are) its exponential is a polynomial, and every function here is exact and
runs on graph nodes too; otherwise SciPy's matrix exponential is used, on numbers only.

Shapes: F ``(n, n)``, L ``(n, w)``, Qc ``(w, w)``; dt scalar or ``(*batch)``; results
``(n, n, *batch)``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from tracker.errors import DomainError, ShapeError, wording
from tracker.types import Array, ArrayLike, as_array

_POINTS = 12
_MOST_PANELS = 10_000


def is_nilpotent(F: ArrayLike) -> bool:
    """Whether a power of ``F`` is exactly zero, so that its exponential is a polynomial.

    Example:
    >>> is_nilpotent([[0.0, 1.0], [0.0, 0.0]]), is_nilpotent([[0.0, 1.0], [-1.0, 0.0]])
    (True, False)
    """
    return _index(_square(F, "F")) > 0


def transition(F: ArrayLike, dt: Any) -> Any:
    """State transition over a step, ``expm(F dt)``.

    Shapes: as in the module's description.
    Reference: paper 0, eq. (3).

    Example:
    >>> transition([[0.0, 1.0], [0.0, 0.0]], [0.5, 2.0])[0, 1].tolist()
    [0.5, 2.0]
    """
    return _transition(_square(F, "F"), _times(dt))


def integral(F: ArrayLike, L: ArrayLike, Qc: ArrayLike, dt: Any) -> Any:
    """Covariance of the noise of a step by quadrature of its defining integral.

    ``Q = ∫ expm(F s) L Qc L' expm(F s)' ds`` over ``0 <= s <= dt``, by Gauss-Legendre rules: for nilpotent
    F one whose number of points makes it exact, else one of 12 points for each unit of
    ``norm(F) dt``. All weights are positive, so Q is positive semi-definite for ``dt >= 0``.

    Shapes: as in the module's description.

    Raises:
        ShapeError: if the matrices do not fit together.
        DomainError: if ``norm(F) dt`` is so large (above 10,000) that the sum would take for ever.
    Reference: paper 0, eq. (3).
    Laws: equals `matrix_fraction` and the closed forms to 1e-12.

    Example:
    >>> integral([[0, 1], [0, 0]], [[0], [1]], [[1]], 3.0).round(9).tolist()
    [[9.0, 4.5], [4.5, 3.0]]
    """
    square, spread = _checked(F, L, Qc)
    t = _times(dt)
    index = _index(square)  # the integrand is a polynomial of degree 2 (index - 1)
    panels = 1 if index else _panels(square, t)
    points, weights = np.polynomial.legendre.leggauss(index or _POINTS)
    total: Any = 0.0
    for panel in range(panels):
        for point, weight in zip(points, weights, strict=True):
            share = (panel + (1.0 + point) / 2.0) / panels
            A = _transition(square, t * share)
            total = total + (weight / (2.0 * panels)) * _congruence(A, spread)
    return _mirrored(total * t)


def matrix_fraction(F: ArrayLike, L: ArrayLike, Qc: ArrayLike, dt: Any) -> Any:
    """Covariance of the noise of a step by matrix fraction decomposition.

    ``[C; D] = expm([[F, L Qc L'], [0, -F']] dt) [0; I]``, ``Q = C D^-1``. As ``D = expm(-F' dt)``, its
    inverse is ``expm(F dt)'``: no linear system is solved.

    Shapes: as in the module's description.

    Raises:
        ShapeError: if the matrices do not fit together.
    Reference: paper 0, eq. (4).
    Laws: equals `integral` and the closed forms to 1e-12.

    Example:
    >>> matrix_fraction([[0, 1], [0, 0]], [[0], [1]], [[1]], 3.0).round(9).tolist()
    [[9.0, 4.5], [4.5, 3.0]]
    """
    square, spread = _checked(F, L, Qc)
    n = len(square)
    block = np.block([[square, spread], [np.zeros((n, n)), -square.T]])
    C = _transition(block, _times(dt))[:n, n:]
    return _mirrored(_product(C, _transposed(_transition(square, _times(dt)))))


METHODS: Final[dict[str, Callable[..., Any]]] = {
    "integral": integral,
    "matrix fraction": matrix_fraction,
}
"""The two by the names that models take as ``discretisation``."""


# ------------------------------------------------------------------------------------- inside
def _times(dt: Any) -> Any:
    """``dt`` with two axes in front, to multiply matrices; a graph node in an object array."""
    t = np.asarray(dt)
    return (t if t.dtype == object else as_array(t, "dt"))[None, None]


def _index(F: Array) -> int:
    """The lowest power of F that is exactly zero; 0 if there is none."""
    power = np.eye(len(F))
    for k in range(1, len(F) + 1):
        power = power @ F
        if not power.any():
            return k
    return 0


def _transition(F: Array, t: Any) -> Any:
    return _polynomial(F, t) if _index(F) else _exponential(F, t)


def _polynomial(F: Array, t: Any) -> Any:
    """``sum F^k t^k / k!``, which ends because F is nilpotent."""
    lanes = (1,) * (t.ndim - 2)
    power, step = np.eye(len(F)), t**0
    out = power.reshape(*F.shape, *lanes) * step
    for k in range(1, len(F)):
        power, step = power @ F / k, step * t
        out = out + power.reshape(*F.shape, *lanes) * step
    return out


def _exponential(F: Array, t: Any) -> Array:
    from scipy.linalg import expm  # heavy: only models that need it pay

    if t.dtype == object:
        float(t.item())  # a node raises the error that says what can be traced
    stacked = expm(F * as_array(t[0, 0], "dt")[..., None, None])
    return np.ascontiguousarray(np.moveaxis(stacked, (-2, -1), (0, 1)))


def _panels(F: Array, t: Any) -> int:
    longest = float(np.max(np.abs(as_array(t, "dt")), initial=0.0))
    reach = longest * float(np.linalg.norm(F, 2))
    if not reach <= _MOST_PANELS:
        raise DomainError(
            wording(
                "norm(F) times dt",
                got=f"{reach:.3g}",
                expected=f"at most {_MOST_PANELS}",
                do="use matrix_fraction, or check units and time step",
            )
        )
    return max(1, int(np.ceil(reach)))


def _product(A: Any, B: Any) -> Any:
    return (A[:, :, None] * B[None, :, :]).sum(axis=1)


def _transposed(A: Any) -> Any:
    return A.swapaxes(0, 1)


def _congruence(A: Any, S: Array) -> Any:
    return _product(_product(A, S.reshape(*S.shape, *(1,) * (A.ndim - 2))), _transposed(A))


def _mirrored(Q: Any) -> Any:
    return 0.5 * (Q + _transposed(Q))


def _square(F: ArrayLike, name: str) -> Array:
    matrix = as_array(F, name)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise ShapeError(
            wording(
                f"argument {name!r}",
                got=f"shape {matrix.shape}",
                expected="a square matrix (n, n)",
                do="give one row and one column per state component",
            )
        )
    return matrix


def _checked(F: ArrayLike, L: ArrayLike, Qc: ArrayLike) -> tuple[Array, Array]:
    """F and ``L Qc L'``."""
    square, gain, density = _square(F, "F"), as_array(L, "L"), _square(Qc, "Qc")
    if gain.shape != (len(square), len(density)):
        raise ShapeError(
            wording(
                "argument 'L'",
                got=f"shape {gain.shape}",
                expected=f"({len(square)}, {len(density)}), to stand between F and Qc",
                do="give one row per state component and one column per noise",
            )
        )
    return square, gain @ density @ gain.T
