"""The Kalman filter for linear models (Kalman 1960; thesis eq. 2-5 to 2-15)."""

from __future__ import annotations

from typing import Any

import attrs

from tracker.algebra.gaussian import conditioned, predicted, projected
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Gaussian, Innovation, Projection


@attrs.frozen
class KalmanFilter:
    """The optimal filter for linear models with Gaussian noise, in whitened form.

    With ``S = H P H' + R = L L'`` and ``W = L^-1 H P`` the update is ``x + W' L^-1 v`` and
    ``P - W' W``: symmetric by construction, and the cheapest form there is.

    Reference: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and
        Navigation, section 5.2; paper 4, eq. 2-5 to 2-15.
    Laws: those of kind "filter"; on linear problems it equals the batch least-squares solution.
    """

    needs = ("linear",)

    def predict(
        self, state: Gaussian, motion: MotionModel, dt: Any, u: Any = None, t: Any = None
    ) -> Gaussian:
        """``F x + B u`` and ``F P F' + Q``."""
        return predicted(state, motion, dt, u, t)

    def project(self, state: Gaussian, sensor: SensorModel, pose: Any = None) -> Projection:
        """``H x`` and ``H P H' + R``."""
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
