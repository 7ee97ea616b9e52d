"""The iterated posterior linearisation filter: sigma points drawn where the answer turns out to lie."""

from __future__ import annotations

from typing import Any

import attrs

from tracker.algebra import (
    apply,
    congruence,
    factor,
    finite,
    gain,
    product,
    residual,
    symmetric_product,
    transpose,
)
from tracker.models import isnan, where
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Gaussian, Innovation, Projection
from tracker_kalman.indefinite import raised
from tracker_kalman.inner import at_least
from tracker_kalman.sigma_point import SigmaPointFilter, check_floor, through_sensor, updated
from tracker_kalman.sigma_points import PointSet, Scaled, point_set


@attrs.frozen
class PosteriorLinearisationFilter:
    """The sigma-point filter whose update regresses h on the state about its own result.

    Each iteration spreads points over the last posterior, fits ``h(x) = A x + b`` with the residual
    covariance Omega to them, and conditions the *predicted* state on the measurement seen through that
    fit: a measurement counts once. The first iteration is `sigma_point.SigmaPointFilter`. The number of
    iterations is fixed, so that the update can be compiled. Innovation, NIS and likelihood are those
    of the first: of the predicted state. Linear sensors need no iteration. Iterations are not damped:
    where a target passes close to a sensor they may settle at a wrong answer and be certain of it (of
    1,000 runs of scenario "two_stations" 12, as of the iterated extended filter 13; of the plain
    sigma-point filter none).

    Raises:
        DomainError: if iterations is not at least 1.
    Reference:
        García-Fernández, Svensson, Morelande and Särkkä (2015), Posterior linearization filter:
        principles and implementation using sigma points, IEEE Transactions on Signal Processing 63
        (20), algorithm 1.
    Laws:
        those of kind "filter"; iterating a linear update changes nothing.
    """

    iterations: int = attrs.field(default=3, validator=at_least(1, "filter 'iplf'"))
    points: PointSet = attrs.field(factory=Scaled, converter=point_set)
    floor: float | None = attrs.field(default=None)

    needs = ()
    own_update = True

    @floor.validator
    def _small(self, _attribute: object, floor: float | None) -> None:
        check_floor(floor)

    @property
    def _first(self) -> SigmaPointFilter:
        return SigmaPointFilter(self.points, floor=self.floor)

    def predict(
        self, state: Gaussian, motion: MotionModel, dt: Any, u: Any = None, t: Any = None
    ) -> Any:
        """Mean and covariance of f over the points, and Q."""
        return self._first.predict(state, motion, dt, u, t)

    def project(self, state: Gaussian, sensor: SensorModel, pose: Any = None) -> Projection:
        """Mean and covariance of h over the points of the predicted state, and R."""
        return self._first.project(state, sensor, pose)

    def update(
        self,
        state: Gaussian,
        sensor: SensorModel,
        z: Any,
        pose: Any = None,
        projection: Projection | None = None,
    ) -> tuple[Gaussian, Innovation]:
        """Condition on ``z``; components that are NaN were not measured."""
        after, innovation = self._first.update(state, sensor, z, pose, projection)
        if getattr(sensor, "linear", False):
            return after, innovation
        last = innovation
        for _ in range(self.iterations - 1):
            root = factor(after.cov)
            seen = through_sensor(self.points, after.mean, root, sensor, pose)
            A = gain(transpose(seen.cross), after.cov)
            noise = seen.cov - congruence(A, after.cov)  # Omega + R
            if self.floor is not None and seen.rule.negative:
                noise = raised(noise, self.floor)
            back = residual(state.mean, after.mean, sensor.state.circular)
            AP = product(A, state.cov)
            fitted = Projection(
                seen.mean + apply(A, back), symmetric_product(AP, A) + noise, transpose(AP)
            )
            after, last = updated(state, sensor, z, fitted, seen.rule, self.floor)
        lost = isnan(last.nis)
        nis, loglik = (
            where(lost, last.nis, innovation.nis),
            where(lost, last.nis, innovation.loglik),
        )
        return after, attrs.evolve(innovation, nis=nis, loglik=loglik, ok=finite(nis))
