"""The second-order extended Kalman filter (paper 0 eq. 9-11; Athans, Wishner and Bertolini 1968)."""

from __future__ import annotations

from typing import Any

import attrs

from tracker.algebra import congruence, curvature, product, symmetric_product, transpose
from tracker.algebra.gaussian import conditioned, predicted, projected
from tracker.models.linearise import expand
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Gaussian, Innovation, Projection


@attrs.frozen
class SecondOrderExtendedKalmanFilter:
    """The extended Kalman filter on models expanded to second order about the latest estimate.

    The quadratic part of a model has mean ``tr(A_i P) / 2`` and covariance ``tr(A_i P A_j P) / 2``,
    exactly, for Gaussian errors of covariance P; both are added to the first-order moments of the
    prediction and of the measurement. Models that are linear are not asked for second derivatives.

    ``second_order_innovation=False`` leaves the covariance out of S, as paper 0 prints it in eq. 10
    (an erratum: the analogous eq. 9 has it): the filter then trusts measurements too much, and
    does worse than the first-order one.

    Reference: Bar-Shalom, Li and Kirubarajan (2001), section 10.3.2; Särkkä (2013), algorithm 5.6;
        paper 0, eq. 9-11 with the second derivatives of the sensor itself (eq. 33 misprints them).
    Laws: those of kind "filter"; equal to "ekf1" where the models are linear.
    """

    second_order_innovation: bool = True

    needs = ("jacobian", "hessian")

    def predict(
        self, state: Gaussian, motion: MotionModel, dt: Any, u: Any = None, t: Any = None
    ) -> Gaussian:
        """``f(x) + tr(F_i P) / 2`` and ``F P F' + Q + tr(F_i P F_j P) / 2``."""
        if getattr(motion, "linear", False):
            return predicted(state, motion, dt, u, t)
        mean, F, second = expand(motion, state.mean, dt, u, t)
        bias, more = curvature(second, state.cov)  # eq. (9)
        cov = congruence(F, state.cov) + motion.Q(state.mean, dt) + more
        return Gaussian.trusted(mean + bias, cov)

    def project(self, state: Gaussian, sensor: SensorModel, pose: Any = None) -> Projection:
        """``h(x) + tr(H_i P) / 2`` and ``H P H' + R + tr(H_i P H_j P) / 2``."""
        if getattr(sensor, "linear", False):
            return projected(state, sensor, pose)
        z, H, second = expand(sensor, state.mean, pose)
        HP = product(H, state.cov)
        bias, more = curvature(second, state.cov)
        S = symmetric_product(HP, H) + sensor.R(state.mean, pose)
        if self.second_order_innovation:  # missing in eq. (10)
            S = S + more
        return Projection(z + bias, S, transpose(HP))

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
