"""The square-root extended Kalman filter (Kaminski, Bryson and Schmidt 1971)."""

from __future__ import annotations

from typing import Any

import attrs

from tracker.algebra import beside, factor, product, transpose, triangularise
from tracker.models.linearise import linearise
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Gaussian, Innovation, Projection
from tracker_kalman.rooted import SquareRootGaussian, conditioned_root, rooted, square


@attrs.frozen
class SquareRootFilter:
    """The first-order filter that carries a root of the covariance instead of the covariance.

    Prediction and update make arrays of roots triangular: ``[F L, Q^1/2]``, and
    ``[[H L, R^1/2], [L, 0]]``, whose lower right block is the new root. The covariance is positive
    semi-definite whatever is rounded, and keeps variances of which one is 1e30 times another, where
    the covariance form keeps 1e15. Otherwise it equals "ekf1", and "kf" on linear models.

    Reference: Kaminski, Bryson and Schmidt, Discrete square root filtering, IEEE Transactions on
        Automatic Control 16 (1971); Anderson and Moore (1979), Optimal Filtering, section 6.5.
    Laws: those of kind "filter"; equal to the Kalman filter on linear problems.
    """

    needs = ("jacobian",)

    def begin(self, prior: Gaussian | SquareRootGaussian) -> SquareRootGaussian:
        """The prior by its root, which a singular covariance has too."""
        return rooted(prior)

    def predict(
        self, state: SquareRootGaussian, motion: MotionModel, dt: Any, u: Any = None, t: Any = None
    ) -> SquareRootGaussian:
        """``f(x)`` and the root of ``F P F' + Q``."""
        mean, F = linearise(motion, state.mean, dt, u, t)
        noise = factor(motion.Q(state.mean, dt))
        return SquareRootGaussian(mean, triangularise(beside(product(F, state.root), noise)))

    def project(
        self, state: SquareRootGaussian, sensor: SensorModel, pose: Any = None
    ) -> Projection:
        """``h(x)`` and ``H P H' + R``."""
        z, H = linearise(sensor, state.mean, pose)
        HL = product(H, state.root)
        S = square(HL) + sensor.R(state.mean, pose)
        return Projection(z, S, product(state.root, transpose(HL)))

    def update(
        self,
        state: SquareRootGaussian,
        sensor: SensorModel,
        z: Any,
        pose: Any = None,
        projection: Projection | None = None,
    ) -> tuple[SquareRootGaussian, Innovation]:
        """Condition on ``z``; components that are NaN were not measured."""
        seen = self.project(state, sensor, pose) if projection is None else projection
        # S is a square already: the update starts from the roots again.
        HL = product(linearise(sensor, state.mean, pose)[1], state.root)
        R = sensor.R(state.mean, pose)
        return conditioned_root(state, sensor, z, seen, HL, state.root, R)
