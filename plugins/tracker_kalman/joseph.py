"""The extended Kalman filter with the Joseph form of the covariance update."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.algebra import (
    condition,
    congruence,
    dense,
    finite,
    gain,
    product,
    without_missing,
)
from tracker.algebra.gaussian import predicted, projected
from tracker.models.linearise import linearise
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Gaussian, Innovation, Projection


@attrs.frozen
class JosephFilter:
    """The first-order filter whose update cannot lose positive semi-definiteness by subtraction.

    ``P = (I - K H) P (I - K H)' + K R K'`` is a sum of congruences, whatever the gain. It costs
    about twice the whitened form and differs from it only by rounding: choose it when R is many
    orders below ``H P H'``.

    Reference: Bucy and Joseph 1968; Bar-Shalom, Li and Kirubarajan (2001), eq. 5.2.3-18.
    Laws: those of kind "filter".
    """

    needs = ("jacobian",)
    own_update = True

    def predict(
        self, state: Gaussian, motion: MotionModel, dt: Any, u: Any = None, t: Any = None
    ) -> Gaussian:
        """``f(x)`` and ``F P F' + Q``."""
        return predicted(state, motion, dt, u, t)

    def project(self, state: Gaussian, sensor: SensorModel, pose: Any = None) -> Projection:
        """``h(x)`` and ``H P H' + R``."""
        return projected(state, sensor, pose)

    def update(
        self,
        state: Gaussian,
        sensor: SensorModel,
        z: Any,
        pose: Any = None,
        projection: Projection | None = None,
    ) -> tuple[Gaussian, Innovation]:
        """Condition on ``z``; components that are NaN were not measured."""
        seen = self.project(state, sensor, pose) if projection is None else projection
        v = sensor.residual(z, seen.z)
        mean, _, nis, loglik, count = condition(state.mean, None, v, seen.S, seen.cross)
        S, cross = without_missing(seen.S, seen.cross, v)
        K = gain(cross, S)
        H = dense(linearise(sensor, state.mean, pose)[1])
        keep = _identity_like(state.cov) - product(K, H)
        R = sensor.R(state.mean, pose)
        cov = congruence(keep, state.cov) + congruence(K, R)
        innovation = Innovation(v, seen.S, nis, loglik, count, finite(nis))
        return Gaussian.trusted(mean, cov), innovation


def _identity_like(cov: Any) -> Any:
    n = len(cov)
    return np.eye(n, dtype=cov.dtype).reshape(n, n, *(1,) * (cov.ndim - 2))
