"""Sigma-point filters that carry a square root of the covariance instead of the covariance."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.algebra import (
    beside,
    downdate,
    factor,
    product,
    spread,
    transpose,
    triangularise,
)
from tracker.models.linearise import linearise
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Innovation, Projection
from tracker_kalman.rooted import SquareRootGaussian, conditioned_root, rooted, square
from tracker_kalman.sigma_point import through_motion, through_sensor
from tracker_kalman.sigma_points import PointSet, Scaled, SigmaPoints, point_set


@attrs.frozen
class SquareRootSigmaPointFilter:
    """The sigma-point filter on roots: no covariance is formed, squared or factored on the way.

    Roots of the predicted state and of the update are made triangular by orthogonal
    transformations, so that the covariance ``L L'`` is positive semi-definite whatever rounding does, and
    a filter in float64 keeps the digits of one twice as precise. Points are drawn again before the
    update; noise is additive. A point of negative weight is taken away by a downdate; where that leaves
    no covariance the lane becomes NaN with ``ok=False``. Linear models need no points, as in
    `sigma_point.SigmaPointFilter`.

    An update computes its projection anew: moments do not hold the roots.

    Reference:
        Van der Merwe and Wan (2001), The square-root unscented Kalman filter for state and parameter
        estimation, ICASSP; Arasaratnam and Haykin (2009), Cubature Kalman filters, section VI.
    Laws:
        those of kind "filter"; equal to `sigma_point.SigmaPointFilter` on well-conditioned problems.
    """

    points: PointSet = attrs.field(factory=Scaled, converter=point_set)

    needs = ()

    def begin(self, prior: Any) -> SquareRootGaussian:
        """A Gaussian as a mean and a root."""
        return rooted(prior)

    def predict(
        self, state: Any, motion: MotionModel, dt: Any, u: Any = None, t: Any = None
    ) -> SquareRootGaussian:
        """Mean of f over the points, and the root of their deviations beside that of Q."""
        state = rooted(state)
        if getattr(motion, "linear", False):
            mean, F = linearise(motion, state.mean, dt, u, t)
            Q = motion.Q(state.mean, dt)
            root = triangularise(beside(product(F, state.root), factor(Q)))
            return SquareRootGaussian(mean, root)
        ahead = through_motion(self.points, state.mean, state.root, motion, dt, u, t)
        some, lost = _parted(ahead.deviations, ahead.rule)
        root = triangularise(beside(some, factor(ahead.noise)))
        for k in range(lost.shape[1]):
            root = downdate(root, lost[:, k])
        return SquareRootGaussian(ahead.mean, root)

    def project(self, state: Any, sensor: SensorModel, pose: Any = None) -> Projection:
        """Mean and covariance of h over the points, and R; the covariance of state and measurement."""
        projection: Projection = self._seen(rooted(state), sensor, pose)[0]
        return projection

    def update(
        self,
        state: Any,
        sensor: SensorModel,
        z: Any,
        pose: Any = None,
        projection: Projection | None = None,  # noqa: ARG002 - moments do not hold the roots
    ) -> tuple[SquareRootGaussian, Innovation]:
        """Condition on ``z``; components that are NaN were not measured."""
        state = rooted(state)
        return conditioned_root(state, sensor, z, *self._seen(state, sensor, pose))

    def _seen(self, state: SquareRootGaussian, sensor: SensorModel, pose: Any) -> tuple[Any, ...]:
        """What `conditioned_root` takes: projection, deviations seen and known, R, those of negative weight."""
        if getattr(sensor, "linear", False):
            z, H = linearise(sensor, state.mean, pose)
            R, seen = sensor.R(state.mean, pose), product(H, state.root)
            cross = product(state.root, transpose(seen))
            return Projection(z, square(seen) + R, cross), seen, state.root, R
        seen = through_sensor(self.points, state.mean, state.root, sensor, pose)
        rule, nowhere = seen.rule, 0.0 * state.mean
        some, lost = _parted(seen.deviations, rule)
        known, gone = _parted(spread(nowhere, state.root, rule.places), rule)
        projection = Projection(seen.mean, seen.cov, seen.cross)
        if not rule.negative:
            return projection, some, known, seen.noise
        return projection, some, known, seen.noise, np.concatenate([lost, gone])


def _parted(d: Any, rule: SigmaPoints) -> tuple[Any, Any]:
    """Deviations times the roots of their weights: those of positive and those of negative weight."""
    scaled = d * np.sqrt(np.abs(rule.cov)).reshape(-1, *(1,) * (d.ndim - 2))
    return scaled[:, rule.cov > 0.0], scaled[:, rule.cov < 0.0]
