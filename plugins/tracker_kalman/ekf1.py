"""The first-order extended Kalman filter (paper 0 eq. 6-8; paper 2 eq. 13-22; thesis eq. 2-23 to 2-26)."""

from __future__ import annotations

from typing import Any

import attrs

from tracker.algebra.gaussian import conditioned, predicted, projected
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Gaussian, Innovation, Projection


@attrs.frozen
class ExtendedKalmanFilter:
    """The Kalman filter on models linearised about the latest estimate.

    Predict ``f(x)`` and ``F P F' + Q`` with F at the filtered mean; update with H at the predicted
    mean and the residual ``z - h(x)``, wrapped. The update is whitened (see `tracker.algebra`).

    Reference: Bar-Shalom, Li and Kirubarajan (2001), section 10.3; Särkkä (2013), section 5.2; paper 0, eq. 6-8,
        with the Jacobian of eq. 31 (eq. 32 prints its columns swapped).
    Laws: those of kind "filter"; equal to the Kalman filter on linear problems.
    """

    needs = ("jacobian",)

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
        return conditioned(state, sensor, z, seen)
