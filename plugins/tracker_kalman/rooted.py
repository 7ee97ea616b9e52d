"""Gaussian beliefs carried as a mean and a square root, and their update; filters have own modules."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.algebra import (
    beside,
    condition_root,
    downdate,
    factor,
    finite,
    transpose,
    triangularise,
    weighted,
    without_missing,
)
from tracker.protocols import SensorModel
from tracker.types import LOWER, Array, Gaussian, Innovation, Projection, brief


@attrs.frozen(eq=False)
class SquareRootGaussian:
    """A normal distribution, or a batch of them, whose covariance is ``L L'``.

    Shapes:
        mean ``(n, *batch)``; root L ``(n, n, *batch)``, lower triangular.
    """

    mean: Array = attrs.field(repr=brief)
    root: Array = attrs.field(repr=brief, metadata=LOWER)

    def moments(self) -> Gaussian:
        """Mean and covariance."""
        return Gaussian.trusted(self.mean, square(self.root))


def square(A: Any) -> Any:
    """``A A'``, exactly symmetric.

    Shapes:
        A ``(n, k, *batch)``; result ``(n, n, *batch)``.
    """
    return weighted(A, np.ones(A.shape[1]))


def rooted(belief: Any) -> SquareRootGaussian:
    """A Gaussian as a mean and a root; a belief that is one already as it is."""
    if isinstance(belief, SquareRootGaussian):
        return belief
    return SquareRootGaussian(belief.mean, factor(belief.cov))


def conditioned_root(
    state: SquareRootGaussian,
    sensor: SensorModel,
    z: Any,
    projection: Projection,
    seen: Any,
    known: Any,
    R: Any,
    lost: Any = None,
) -> tuple[SquareRootGaussian, Innovation]:
    """Bayes' rule without forming a covariance: the joint root of measurement and state, made triangular.

    The joint covariance is ``[[seen], [known]] [[seen], [known]]'``, and R where both are measurements;
    less the same of ``lost``, of negative weight.

    Shapes:
        seen ``(m, s, *batch)``; known ``(n, s, *batch)``; R ``(m, m, *batch)``; lost ``(m + n, k,
        *batch)`` or None; z ``(m, *batch)``, NaN where a component was not measured.
    Reference:
        Arasaratnam and Haykin (2009), Cubature Kalman filters, section VI; Kailath, Sayed and
        Hassibi (2000), Linear Estimation, section 12.3.
    """
    v = sensor.residual(z, projection.z)
    m, n = len(v), len(state.mean)
    columns = 0 if lost is None else lost.shape[1]
    every = transpose(seen if lost is None else beside(seen, lost[:m]))
    R, every = without_missing(R, every, v)
    every = transpose(every)
    none = np.zeros((n, m, *(1,) * (known.ndim - 2)), dtype=known.dtype)
    above = beside(every[:, : every.shape[1] - columns], factor(R))
    joint = triangularise(np.concatenate([above, beside(known, none)]))
    for k in range(columns):
        gone = np.concatenate([every[:, k - columns], lost[m:, k]])
        joint = downdate(joint, gone)
    mean, root, nis, loglik, count = condition_root(state.mean, joint, v)
    innovation = Innovation(v, projection.S, nis, loglik, count, finite(nis))
    return SquareRootGaussian(mean, root), innovation
