"""Any linear motion given by its matrices; motions with a name of their own have their own module."""

from __future__ import annotations

from typing import Any, cast

import attrs
import numpy as np

from tracker.errors import CapabilityError, DomainError, ShapeError, wording
from tracker.models.parameters import shaped
from tracker.types import Array, ArrayLike, Space, as_array
from tracker_motion.discretisation import integral, is_nilpotent, matrix_fraction, transition


@attrs.frozen(eq=False)
class LinearMotion:
    """A linear motion as plain matrices; `linear` makes it and describes it.

    Either ``F``, ``L`` and ``Qc`` of a model in continuous time, or, with L and Qc missing, ``F`` and
    ``Qd`` of one step of a model in discrete time.
    """

    space: Space
    F: Array
    L: Array | None = None
    Qc: Array | None = None
    Qd: Array | None = None
    name: str = "linear"
    linear: bool = attrs.field(default=True, init=False)

    @property
    def why_opaque(self) -> str:
        """Why this motion cannot be traced, or ''."""
        if self.Qd is not None or is_nilpotent(self.F):
            return ""
        return "motion 'linear': the exponential of F is not a polynomial in dt"

    def f(self, x: ArrayLike, dt: Any, u: ArrayLike | None = None, t: Any = None) -> Any:
        """The state after a step, ``(n, *batch)``."""
        return self.linearise(x, dt, u, t)[0]

    def jacobian(self, x: ArrayLike, dt: Any, u: ArrayLike | None = None, t: Any = None) -> Any:
        """The transition matrix, ``(n, n, *batch)``; trailing axes of 1 where all lanes share it."""
        return self.linearise(x, dt, u, t)[1]

    def hessian(self, x: ArrayLike, dt: Any, u: ArrayLike | None = None, t: Any = None) -> Any:
        """Zeros, ``(n, n, n, *batch)``, shared by all lanes."""
        A = self.jacobian(x, dt, u, t)
        return np.zeros((len(A), *A.shape), dtype=A.dtype)

    def linearise(
        self,
        x: ArrayLike,
        dt: Any,
        u: ArrayLike | None = None,
        t: Any = None,  # noqa: ARG002 - the protocol passes it
    ) -> tuple[Any, Any]:
        """`f` and `jacobian` together."""
        if u is not None:
            raise CapabilityError("motion 'linear' takes no input: call it without u.")
        state = shaped(x, self.space, "x", self.name)
        A = self.F if self.Qd is not None else transition(self.F, dt)
        A = _beside(A, state)
        return (A * state).sum(axis=1), A

    def Q(self, x: ArrayLike, dt: Any) -> Any:
        """Covariance of the noise of a step, ``(n, n, *batch)``, shared axes of length 1."""
        state = shaped(x, self.space, "x", self.name)
        if self.Qd is not None:
            return _beside(self.Qd, state)
        method = integral if is_nilpotent(self.F) else matrix_fraction
        return _beside(method(self.F, cast("Array", self.L), cast("Array", self.Qc), dt), state)

    def lanes(self, _index: Any) -> LinearMotion:
        """Itself: no parameter differs between lanes."""
        return self


def linear(
    space: Space,
    F: ArrayLike,
    *,
    L: ArrayLike | None = None,
    Qc: ArrayLike | None = None,
    Q: ArrayLike | None = None,
) -> LinearMotion:
    """Any linear motion: ``dx/dt = F x + L w`` given F, L, Qc, or ``x' = F x + w`` given F, Q.

    In continuous time ``w`` is white of spectral density Qc, and L is the identity where it is not
    given. In discrete time a call is one step and ``dt`` is ignored: F and Q belong to the step that
    they were made for.

    Shapes:
        F, Q ``(n, n)``, L ``(n, w)``, Qc ``(w, w)``; state ``(n, *batch)``.
    Units:
        those of ``space``; F per second in continuous time.

    Raises:
        ShapeError: if the matrices do not fit together or do not fit ``space``.
        DomainError: if not exactly one of Qc and Q is given, or it is not a covariance.
    Reference:
        paper 0, eq. (1)-(4); paper 4, eq. (2-1), (3-11).
    Laws:
        in continuous time two half steps equal one step, in f and Q.

    Example:
    >>> damped = linear(Space.of("x [m]", "vx [m/s]"), [[0, 1], [0, -0.5]], L=[[0], [1]], Qc=[[0.1]])
    >>> damped.f([0.0, 1.0], dt=2.0).round(4).tolist()
    [1.2642, 0.3679]
    """
    n = len(space)
    square = _sized(F, "F", (n, n), space)
    if (Qc is None) == (Q is None) or (Q is not None and L is not None):
        raise DomainError(
            wording(
                "parameters of motion 'linear'",
                got=f"Qc {'missing' if Qc is None else 'given'}, Q {'missing' if Q is None else 'given'}"
                f", L {'missing' if L is None else 'given'}",
                expected="either Qc, with or without L, or Q alone",
                do="give Qc for a model in continuous time, Q for one step of a discrete model",
            )
        )
    if Q is not None:
        return LinearMotion(space, square, Qd=_covariance(Q, "Q", n, space))
    gain = np.eye(n) if L is None else as_array(L, "L")
    width = gain.shape[-1] if gain.ndim else 0
    gain = _sized(gain, "L", (n, width), space)
    density = _covariance(cast("ArrayLike", Qc), "Qc", width, space)
    return LinearMotion(space, square, L=gain, Qc=density)


def _sized(matrix: ArrayLike, name: str, shape: tuple[int, int], space: Space) -> Array:
    array = np.array(as_array(matrix, name))
    if array.shape != shape or not np.isfinite(array).all():
        raise ShapeError(
            wording(
                f"parameter {name!r}",
                got=f"shape {array.shape}"
                + ("" if np.isfinite(array).all() else " with NaN or inf"),
                expected=f"finite numbers, {shape}, for the state ({space})",
                do="give one row per state component",
            )
        )
    return array


def _covariance(matrix: ArrayLike, name: str, size: int, space: Space) -> Array:
    array = _sized(matrix, name, (size, size), space)
    scale = float(np.abs(array).max(initial=0.0))
    if not np.allclose(array, array.T, rtol=0.0, atol=1e-9 * scale) or (
        size and np.linalg.eigvalsh(array)[0] < -1e-9 * scale
    ):
        raise DomainError(
            wording(
                f"parameter {name!r}",
                got="a matrix that is not a covariance",
                expected="a symmetric positive semi-definite matrix",
                do="check signs and symmetry",
            )
        )
    return (array + array.T) / 2.0


def _beside(matrix: Any, state: Any) -> Any:
    """``matrix`` with as many batch axes as ``state``."""
    missing = state.ndim + 1 - matrix.ndim
    return matrix.reshape(*matrix.shape, *(1,) * missing) if missing > 0 else matrix
