"""Sigma-point filters: one kernel for every set of points, and the names that the field gives them.

The sets are in `sigma_points`; square-root and iterated forms and the smoother have modules of
their own, over the same kernel.
"""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.algebra import (
    condition,
    factor,
    finite,
    product,
    residual,
    spread,
    transpose,
    weighted,
    weighted_mean,
)
from tracker.algebra.gaussian import conditioned, predicted, projected
from tracker.errors import DomainError, TraceError, wording
from tracker.protocols import MotionModel, SensorModel
from tracker.types import SYMMETRIC, Array, Gaussian, Innovation, Projection, brief
from tracker_kalman.indefinite import raised, semidefinite, unless_refused
from tracker_kalman.sigma_points import (
    CubatureDegree5,
    GaussHermite,
    MinimalSimplex,
    PointSet,
    Scaled,
    SigmaPoints,
    SphericalSimplex,
    Symmetric,
    general,
    point_set,
)

UNROLLED = 256
"""Most points that a compiled step holds, one after the other; with more, a filter runs on arrays."""


# --------------------------------------------------------------------------------- the kernel
@attrs.frozen(eq=False)
class Transformed:
    """Sigma points of a Gaussian state after a function: deviations from their weighted mean.

    Shapes:
        mean ``(k, *batch)``; deviations ``(k, s, *batch)``; root ``(n, n, *batch)``, the factor that
        the points were spread by; noise ``(k, k, *batch)``, what is added to the covariance, or None
        if the points know it.
    """

    mean: Array
    deviations: Array
    root: Array
    rule: SigmaPoints
    noise: Array | None

    @property
    def cov(self) -> Array:
        """Covariance ``(k, k, *batch)``."""
        out: Array = weighted(self.deviations, self.rule.cov)
        return out if self.noise is None else out + self.noise

    @property
    def cross(self) -> Array:
        """Covariance of the state with the value of the function, ``(n, k, *batch)``."""
        weights = self.rule.cross[:, : len(self.root)]
        out: Array = product(self.root, transpose(weighted_mean(self.deviations, weights)))
        return out


def rule_for(points: PointSet, n: int, mean: Any) -> SigmaPoints:
    """Points in n dimensions, if they are not too many for a state of graph nodes.

    Raises:
        TraceError: if they are.
    """
    rule = points.points(n)
    if len(rule) > UNROLLED and mean.dtype.hasobject:
        raise TraceError(
            f"{points} has {len(rule)} points in {n} dimensions, more than the {UNROLLED} that a "
            "compiled step holds"
        )
    return rule


def through_motion(
    points: PointSet,
    mean: Any,
    root: Any,
    motion: MotionModel,
    dt: Any,
    u: Any,
    t: Any,
    augmented: bool = False,
    more: int = 0,
) -> Transformed:
    """Points of a state ``dt`` seconds later; ``more`` dimensions of the set are left to others.

    Shapes:
        mean ``(n, *batch)``; root ``(n, n, *batch)``.
    """
    n, Q = len(mean), motion.Q(mean, dt)
    rule = rule_for(points, (2 * n if augmented else n) + more, mean)
    centre = motion.f(mean, dt, u, t)
    values = motion.f(spread(mean, root, rule.places[:n]), dt, u, t)
    if augmented:
        values = values + _noise(mean, Q, rule.places[n : 2 * n])
    d = residual(values, centre[:, None], motion.space.circular)
    ahead = weighted_mean(d, rule.mean)
    return Transformed(centre + ahead, d - ahead[:, None], root, rule, None if augmented else Q)


def through_sensor(
    points: PointSet,
    mean: Any,
    root: Any,
    sensor: SensorModel,
    pose: Any,
    augmented: bool = False,
) -> Transformed:
    """Points of a state as a sensor sees them, in wrapped differences: they may straddle a cut.

    Shapes:
        mean ``(n, *batch)``; root ``(n, n, *batch)``.
    """
    n, m, R = len(mean), sensor.space.size, sensor.R(mean, pose)
    rule = rule_for(points, n + m if augmented else n, mean)
    centre = sensor.h(mean, pose)
    values = sensor.h(spread(mean, root, rule.places[:n]), pose)
    if augmented:
        values = values + _noise(centre, R, rule.places[n:])
    return _seen(sensor, centre, values, root, rule, None if augmented else R)


def _seen(
    sensor: SensorModel, centre: Any, values: Any, root: Any, rule: SigmaPoints, R: Any
) -> Transformed:
    d = sensor.residual(values, centre[:, None])
    ahead = weighted_mean(d, rule.mean)
    return Transformed(centre + ahead, d - ahead[:, None], root, rule, R)


def _noise(like: Any, cov: Any, places: Any) -> Any:
    """Points of a noise of mean zero, for values like these."""
    return spread(0.0 * like, factor(cov), places)


# --------------------------------------------------------------------------------- the filter
@attrs.frozen(eq=False)
class Propagated:
    """A predicted Gaussian beside the sigma points that it was computed from.

    Shapes:
        mean ``(n, *batch)``; cov ``(n, n, *batch)``; deviations ``(n, s, *batch)``, of the points
        from the mean.
    """

    mean: Array = attrs.field(repr=brief)
    cov: Array = attrs.field(repr=brief, metadata=SYMMETRIC)
    deviations: Array = attrs.field(repr=brief)

    def moments(self) -> Gaussian:
        """Mean and covariance."""
        return Gaussian.trusted(self.mean, self.cov)


@attrs.frozen
class SigmaPointFilter:
    """Moments propagated through f and h by weighted points instead of derivatives.

    ``points`` is a set of `sigma_points` or the name of one. ``redraw``: before the update new points
    are drawn from the predicted moments, as paper 0 recommends; without, the propagated ones are used,
    which do not know the process noise. ``augmented``: points are spread over the noise too, which is
    then seen through the points' own moments: state and process noise, then state and measurement
    noise; without redraw all three at once, for which ``measured`` tells how many components are
    measured. ``floor``: with a negative weight a covariance may come out indefinite; that lane becomes
    NaN with ``ok=False``, or, with a floor such as 1e-6, the covariance is raised to it
    (`tracker_kalman.indefinite.raised`).

    Linear models need no points: every set is exact there, and ``F P F' + Q`` is computed instead,
    which differs by rounding alone. Angles, of measurement and state, are averaged and subtracted as
    wrapped differences from the value at the mean. Singular covariances are allowed. Augmented points
    depend on how many components a sensor has, so that a missing one equals a sensor without it only
    as well as the points are right.

    Raises:
        DomainError: for a set that does not exist, or options that do not fit together.
    Reference:
        paper 0, eq. 12-23, with P- in eq. 18 and the sign of eq. 23 corrected; paper 2, eq. 23-30; Särkkä
        (2013), Bayesian Filtering and Smoothing, sections 5.6 and 6.3.
    Laws:
        those of kind "filter"; equal to the Kalman filter on linear problems.

    Example:
    >>> SigmaPointFilter("gauss_hermite_3").points
    GaussHermite(order=3)
    """

    points: PointSet = attrs.field(factory=Scaled, converter=point_set)
    redraw: bool = True
    augmented: bool = False
    measured: int | None = None
    floor: float | None = attrs.field(default=None)

    needs = ()

    @floor.validator
    def _small(self, _attribute: object, floor: float | None) -> None:
        check_floor(floor)

    def __attrs_post_init__(self) -> None:
        if self.augmented and not self.redraw and self.measured is None:
            raise DomainError(
                wording(
                    "parameter 'measured'",
                    got="nothing, with augmented=True and redraw=False",
                    expected="how many components are measured",
                    do="give it, or leave redraw on",
                )
            )

    def predict(
        self, state: Any, motion: MotionModel, dt: Any, u: Any = None, t: Any = None
    ) -> Any:
        """Mean and covariance of f over the points, and Q."""
        state = state.moments()
        if self.redraw and getattr(motion, "linear", False):
            return predicted(state, motion, dt, u, t)
        more = 0 if self.redraw else self._measured
        root = factor(state.cov)
        ahead = through_motion(
            self.points, state.mean, root, motion, dt, u, t, self.augmented, more
        )
        mean, cov = ahead.mean, ahead.cov
        if ahead.rule.negative:
            cov = sound(cov, ahead.rule, self.floor)
            (mean,) = unless_refused(cov, mean)
        if self.redraw:
            return Gaussian.trusted(mean, cov)
        return Propagated(mean, cov, ahead.deviations)

    def project(self, state: Any, sensor: SensorModel, pose: Any = None) -> Projection:
        """Mean and covariance of h over the points, and R; the covariance of state and measurement."""
        if isinstance(state, Propagated):
            return self._of_propagated(state, sensor, pose)
        if getattr(sensor, "linear", False):
            return projected(state, sensor, pose)
        root = factor(state.cov)
        seen = through_sensor(self.points, state.mean, root, sensor, pose, self.augmented)
        return Projection(seen.mean, self._raised(seen.cov, seen.rule), seen.cross)

    def update(
        self,
        state: Any,
        sensor: SensorModel,
        z: Any,
        pose: Any = None,
        projection: Projection | None = None,
    ) -> tuple[Gaussian, Innovation]:
        """Condition on ``z``; components that are NaN were not measured."""
        seen = self.project(state, sensor, pose) if projection is None else projection
        return updated(state.moments(), sensor, z, seen, self._rule(state, sensor), self.floor)

    # ---------------------------------------------------------------------------- inside
    @property
    def _measured(self) -> int:
        """Dimensions of a set that is drawn once a step that belong to the measurement noise."""
        return self.measured or 0 if self.augmented else 0

    def _rule(self, state: Any, sensor: SensorModel) -> SigmaPoints | None:
        """The points that see a measurement; None if it is seen exactly."""
        n = len(state.mean)
        if isinstance(state, Propagated):
            return self.points.points((2 * n if self.augmented else n) + self._measured)
        if getattr(sensor, "linear", False):
            return None
        return self.points.points(n + sensor.space.size if self.augmented else n)

    def _of_propagated(self, state: Propagated, sensor: SensorModel, pose: Any) -> Projection:
        n, m = len(state.mean), sensor.space.size
        if self.augmented and m != self.measured:
            raise DomainError(
                wording(
                    "parameter 'measured'",
                    got=self.measured,
                    expected=f"{m}, as sensor {getattr(sensor, 'name', '?')!r} measures",
                    do="correct it, or leave redraw on",
                )
            )
        rule = self._rule(state, sensor)
        assert rule is not None  # noqa: S101 - propagated points always see
        centre, R = sensor.h(state.mean, pose), sensor.R(state.mean, pose)
        values = sensor.h(state.mean[:, None] + state.deviations, pose)
        if self.augmented:
            values = values + _noise(centre, R, rule.places[2 * n :])
        seen = _seen(sensor, centre, values, None, rule, None if self.augmented else R)
        both = weighted(np.concatenate([state.deviations, seen.deviations]), rule.cov)
        return Projection(seen.mean, self._raised(seen.cov, rule), both[:n, n:])

    def _raised(self, S: Any, rule: SigmaPoints) -> Any:
        """An indefinite S is refused by the update itself."""
        return S if self.floor is None or not rule.negative else raised(S, self.floor)


def sound(cov: Any, rule: SigmaPoints, floor: float | None) -> Any:
    """A covariance that negative weights may have made indefinite: raised, or NaN where it is."""
    return semidefinite(cov, rule.rounding) if floor is None else raised(cov, floor)


def updated(
    state: Gaussian,
    sensor: SensorModel,
    z: Any,
    seen: Projection,
    rule: SigmaPoints | None,
    floor: float | None,
) -> tuple[Gaussian, Innovation]:
    """`conditioned`, of moments from points: a covariance that comes out indefinite is raised or refused.

    ``rule`` is None if the measurement was seen exactly.
    """
    after, innovation = conditioned(state, sensor, z, seen)
    if rule is None or not rule.negative:
        return after, innovation
    cov = sound(after.cov, rule, floor)
    if floor is None:
        mean, nis, loglik = unless_refused(cov, after.mean, innovation.nis, innovation.loglik)
    else:  # a subtraction that left no variance is no reason to give up: it has been raised
        mean, _, nis, loglik, _ = condition(
            state.mean, None, innovation.residual, seen.S, seen.cross
        )
    told = attrs.evolve(innovation, nis=nis, loglik=loglik, ok=finite(nis))
    return Gaussian.trusted(mean, cov), told


def check_floor(floor: float | None) -> None:
    """Refuse what is no floor.

    Raises:
        DomainError: if it is not between 0 and 1.
    """
    if floor is not None and not 0.0 < floor < 1.0:
        raise DomainError(
            wording(
                "parameter 'floor'",
                got=floor,
                expected="a number between 0 and 1, or nothing",
                do="1e-6 is a usual one",
            )
        )


# ------------------------------------------------------------------------ what the field names
def unscented(
    alpha: float = 1.0,
    beta: float = 2.0,
    kappa: float | None = 0.0,
    *,
    redraw: bool = True,
    augmented: bool = False,
    measured: int | None = None,
    floor: float | None = None,
) -> SigmaPointFilter:
    """The unscented filter with scaled points: `Scaled` says what alpha, beta and kappa do.

    Reference:
        paper 2, eq. 23-30; Wan and van der Merwe (2001), The unscented Kalman filter.
    """
    return SigmaPointFilter(Scaled(alpha, beta, kappa), redraw, augmented, measured, floor)


def unscented_symmetric(
    *, redraw: bool = True, augmented: bool = False, measured: int | None = None
) -> SigmaPointFilter:
    """The unscented filter of paper 0: 2n equal points, no centre.

    Reference:
        paper 0, eq. 12-23.
    """
    return SigmaPointFilter(Symmetric(), redraw, augmented, measured)


def unscented_general(
    kappa: float | None = None,
    *,
    redraw: bool = True,
    augmented: bool = False,
    measured: int | None = None,
    floor: float | None = None,
) -> SigmaPointFilter:
    """The original unscented filter; kappa is by default ``3 - n``, and may be negative.

    Reference:
        Julier, Uhlmann and Durrant-Whyte (2000), IEEE Transactions on Automatic Control 45 (3).
    """
    return SigmaPointFilter(general(kappa), redraw, augmented, measured, floor)


def unscented_spherical_simplex(
    centre: float = 0.0,
    *,
    redraw: bool = True,
    augmented: bool = False,
    measured: int | None = None,
) -> SigmaPointFilter:
    """The unscented filter with the n + 1 points of `SphericalSimplex`.

    Reference:
        Julier (2003), The spherical simplex unscented transformation.
    """
    return SigmaPointFilter(SphericalSimplex(centre), redraw, augmented, measured)


def unscented_minimal_simplex(
    centre: float = 0.0,
    *,
    redraw: bool = True,
    augmented: bool = False,
    measured: int | None = None,
) -> SigmaPointFilter:
    """The unscented filter with the n + 1 points of `MinimalSimplex`.

    Reference:
        Julier and Uhlmann (2002), Reduced sigma point filters.
    """
    return SigmaPointFilter(MinimalSimplex(centre), redraw, augmented, measured)


def cubature(
    *, redraw: bool = True, augmented: bool = False, measured: int | None = None
) -> SigmaPointFilter:
    """The cubature filter of third degree; its points are those of `unscented_symmetric`.

    Reference:
        Arasaratnam and Haykin (2009), Cubature Kalman filters.
    """
    return SigmaPointFilter(Symmetric(), redraw, augmented, measured)


def cubature_degree_5(
    *,
    redraw: bool = True,
    augmented: bool = False,
    measured: int | None = None,
    floor: float | None = None,
) -> SigmaPointFilter:
    """The cubature filter of fifth degree; more than four dimensions have negative weights.

    Reference:
        Jia, Xin and Cheng (2013), High-degree cubature Kalman filter.
    """
    return SigmaPointFilter(CubatureDegree5(), redraw, augmented, measured, floor)


def gauss_hermite(
    order: int = 3, *, redraw: bool = True, augmented: bool = False, measured: int | None = None
) -> SigmaPointFilter:
    """The Gauss-Hermite filter with ``order`` points on each axis, ``order^n`` in all.

    Reference:
        Ito and Xiong (2000), Gaussian filters for nonlinear filtering problems.
    """
    return SigmaPointFilter(GaussHermite(order), redraw, augmented, measured)
