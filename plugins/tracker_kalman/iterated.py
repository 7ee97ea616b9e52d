"""The iterated extended Kalman filter (Bell and Cathey 1993)."""

from __future__ import annotations

import math
from typing import Any

import attrs

from tracker.algebra import apply, condition, finite, product, symmetric_product, transpose
from tracker.algebra.gaussian import predicted, projected
from tracker.models import isnan, less, where
from tracker.models.linearise import linearise
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Gaussian, Innovation, Projection
from tracker_kalman.inner import at_least


@attrs.frozen
class IteratedExtendedKalmanFilter:
    """The first-order filter whose update is linearised again about its own result.

    Each iteration conditions the predicted state, not the last iterate, on the measurement seen
    through the sensor linearised at the last iterate: ``x = x- + K_i (z - h(x_i) - H_i (x- - x_i))``.
    These are the Gauss-Newton steps to the maximum of the posterior density; the measurement
    counts once. The number of iterations is fixed, so that the update can be compiled. It helps
    where measurements are good and the prediction is poor; steps are not damped, so a target close
    to the sensor may need none of it. Innovation, NIS and likelihood are those of the predicted
    state.

    Reference: Bell and Cathey, The iterated Kalman filter update as a Gauss-Newton method, IEEE
        Transactions on Automatic Control 38 (1993); Bar-Shalom, Li and Kirubarajan (2001),
        section 10.5.2.
    Laws: those of kind "filter"; one iteration is "ekf1"; iterating a linear update changes nothing.
    """

    iterations: int = attrs.field(default=3, validator=at_least(1, "filter 'iekf'"))

    needs = ("jacobian",)
    own_update = True

    def predict(
        self, state: Gaussian, motion: MotionModel, dt: Any, u: Any = None, t: Any = None
    ) -> Gaussian:
        """``f(x)`` and ``F P F' + Q``."""
        return predicted(state, motion, dt, u, t)

    def project(self, state: Gaussian, sensor: SensorModel, pose: Any = None) -> Projection:
        """``h(x)`` and ``H P H' + R`` at the predicted mean."""
        return projected(state, sensor, pose)

    def update(
        self,
        state: Gaussian,
        sensor: SensorModel,
        z: Any,
        pose: Any = None,
        projection: Projection | None = None,
    ) -> tuple[Gaussian, Innovation]:
        """Condition on ``z``, again and again; components that are NaN were not measured."""
        seen = self.project(state, sensor, pose) if projection is None else projection
        v = sensor.residual(z, seen.z)
        mean, cov, nis, loglik, count = condition(state.mean, state.cov, v, seen.S, seen.cross)
        innovation = Innovation(v, seen.S, nis, loglik, count, finite(nis))
        if getattr(sensor, "linear", False):  # the first step is the last
            return Gaussian.trusted(mean, cov), innovation
        for _ in range(self.iterations - 1):
            zhat, H = linearise(sensor, mean, pose)
            HP = product(H, state.cov)
            S = symmetric_product(HP, H) + sensor.R(mean, pose)
            moved = mean - state.mean
            v = sensor.residual(z, zhat) + apply(H, moved)
            # mean - moved is the predicted mean, and NaN in a lane that has diverged
            mean, cov, told, _, seen_again = condition(mean - moved, state.cov, v, S, transpose(HP))
            # A sensor without an answer there must not pass for a measurement that is missing.
            blind = where(less(seen_again, count), math.nan, 0.0)
            lost = where(isnan(told), math.nan, blind)
            mean, cov, nis, loglik = mean + blind, cov + blind, nis + lost, loglik + lost
        innovation = attrs.evolve(innovation, nis=nis, loglik=loglik, ok=finite(nis))
        return Gaussian.trusted(mean, cov), innovation
