"""The strong tracking filter: a fading factor around any Gaussian filter (Zhou and Frank 1996)."""

from __future__ import annotations

import math
from typing import Any

import attrs
import numpy as np

from tracker.adaptation import with_process_noise
from tracker.models import isnan, less, maximum, minimum, where
from tracker.protocols import MotionModel, SensorModel
from tracker.types import PARAMETER, SYMMETRIC, Gaussian, Innovation, Projection
from tracker_adaptive.settings import between
from tracker_kalman.inner import gaussian_filter, needs_of_inner, tags_of_inner

OWNER = "filter 'strong_tracking'"


@attrs.frozen(eq=False)
class Faded:
    """A Gaussian state; its covariance without the last process noise; how surprising residuals were.

    ``unmeasured`` is the covariance that the prior and the motion alone would give by now.

    Shapes:
        carried, unmeasured ``(n, n, *batch)``; surprise, begun ``(1, *batch)``.
    """

    state: Gaussian
    carried: Any = attrs.field(metadata=SYMMETRIC)
    unmeasured: Any = attrs.field(metadata=SYMMETRIC)
    surprise: Any
    begun: Any

    def moments(self) -> Gaussian:
        """Mean and covariance of the state."""
        return self.state


@attrs.frozen(eq=False)
class StrongTracking:
    """Any Gaussian filter whose predicted covariance is inflated when residuals are too large for it.

    ``P- = fading F P F' + Q`` with ``fading = max(1, N / M)``, where N is what residuals show beyond
    what Q and ``softening`` times R explain, and M is what the carried covariance explains. Traces are
    taken of variances over those of the sensor, so that angles and ranges can be added; the average
    of squared residuals is ``V <- (remember V + v^2) / (1 + remember)``, as printed, which recalls a
    measurement or two. A filter that has lost a manoeuvring target finds it again; one that has not
    loses some accuracy, the less the larger ``softening``: at 2, noise alone inflates the covariance of
    a filter that has converged, again and again, and an extended Kalman filter may diverge of that. It
    takes outliers for manoeuvres.

    As printed the covariance has no bound. Noise larger than R looks like a manoeuvre that never ends,
    and what a measurement hardly shows, a range seen by angles, is inflated at each step and taken
    back at none: variances of 1e160 m2. Here no variance is inflated beyond ``beyond`` times what the
    prior and the motion alone would predict: who has measured knows no less than who has not.
    Manoeuvres are followed as before. With R too small the errors stay several times those of the
    inner filter, and NIS tells of it; a prior that is much too certain must be given a larger bound.

    ``inner``: any filter whose belief is a Gaussian, or its name; "ukf" gives the STF-UKF. Residual, S
    and NIS of the innovation are those of the inflated prediction. The process noise must be one that
    is added.

    Numbers:
        inner: the filter that it is written around.
        softening: at least 1; may differ per lane.
        remember: weight of the past squares, in (0, 1]; may differ per lane.
        most: the largest fading factor; may differ per lane.
        beyond: how many times the variance without any measurement it may inflate to, above 0; may
            differ per lane.

    Raises:
        DomainError: for numbers out of range.
    Source: Zhou and Frank, Strong tracking filtering of nonlinear time-varying stochastic systems with
        coloured noise, International Journal of Control 65 (1996); named in paper 4, chapter 1. The
        bounds ``most`` and ``beyond`` are not theirs.
    Laws: those of kind "filter" that take a prediction at its word; with a great ``softening`` it is
        the inner filter; no variance is inflated beyond its bound.
    """

    inner: Any = attrs.field(default="ekf1", converter=gaussian_filter)
    softening: Any = attrs.field(
        default=4.5, validator=between(1.0, 1e300, OWNER, closed=True), metadata=PARAMETER
    )
    remember: Any = attrs.field(
        default=0.95, validator=between(0.0, 1.0 + 1e-12, OWNER), metadata=PARAMETER
    )
    most: Any = attrs.field(
        default=10.0, validator=between(1.0, 1e12, OWNER, closed=True), metadata=PARAMETER
    )
    beyond: Any = attrs.field(
        default=4.0, validator=between(0.0, np.inf, OWNER), metadata=PARAMETER
    )

    needs, tags = needs_of_inner, tags_of_inner

    def begin(self, prior: Any) -> Faded:
        """The given state; no residual yet."""
        if isinstance(prior, Faded):
            return prior
        zero = np.zeros((1, *prior.mean.shape[1:]), dtype=prior.mean.dtype)
        return Faded(prior, prior.cov, prior.cov, zero, zero)

    def predict(
        self, state: Faded, motion: MotionModel, dt: Any, u: Any = None, t: Any = None
    ) -> Faded:
        """As its inner filter, which first predicts without process noise."""
        Q = motion.Q(state.state.mean, dt)
        carried = self.inner.predict(state.state, with_process_noise(motion, 0.0 * Q), dt, u, t)
        ahead = Gaussian.trusted(carried.mean, carried.cov + Q)
        blind = Gaussian.trusted(state.state.mean, state.unmeasured)
        unmeasured = self.inner.predict(blind, motion, dt, u, t).cov
        return Faded(ahead, carried.cov, unmeasured, state.surprise, state.begun)

    def project(self, state: Faded, sensor: SensorModel, pose: Any = None) -> Projection:
        """As its inner filter, before any inflation: the residual decides about that."""
        seen: Projection = self.inner.project(state.state, sensor, pose)
        return seen

    def update(
        self,
        state: Faded,
        sensor: SensorModel,
        z: Any,
        pose: Any = None,
        projection: Projection | None = None,
    ) -> tuple[Faded, Innovation]:
        """Inflate and condition on ``z``; components that are NaN were not measured."""
        seen = self.project(state, sensor, pose) if projection is None else projection
        without = Gaussian.trusted(state.state.mean, state.carried)
        bare = self.inner.project(without, sensor, pose).S
        R, v = sensor.R(state.state.mean, pose), sensor.residual(z, seen.z)
        count: Any = 0.0
        square: Any = 0.0
        added: Any = 0.0
        explained: Any = 0.0
        for i in range(len(v)):
            missing, worth = isnan(v[i]), 1.0 / R[i, i]
            count = count + where(missing, 0.0, 1.0)
            square = square + where(missing, 0.0, v[i] * v[i] * worth)
            added = added + where(missing, 0.0, (seen.S[i, i] - bare[i, i]) * worth)
            explained = explained + where(missing, 0.0, (bare[i, i] - R[i, i]) * worth)
        share = 1.0 / maximum(count, 1.0)
        nothing = less(count, 0.5)
        squares = minimum(square * share, 1e100)
        past = (self.remember * state.surprise[0] + squares) * (1.0 / (1.0 + self.remember))
        past = where(less(0.5, state.begun[0]), past, squares)
        unexplained = past - added * share - self.softening
        sound = less(1e-12, explained * share)
        factor = minimum(unexplained / where(sound, explained * share, 1.0), self.most)
        factor = minimum(factor, self._room(state))
        factor = where(nothing, 1.0, where(sound, maximum(factor, 1.0), 1.0))
        inflated = state.state.cov + state.carried * (factor - 1.0)
        after, told = self.inner.update(
            Gaussian.trusted(state.state.mean, inflated), sensor, z, pose
        )
        # A prediction that nothing was measured against stays as it was, and can be told apart yet.
        kept = where(nothing, state.carried, after.cov)
        surprise = where(nothing, state.surprise, _row(past, state.surprise))
        begun = where(nothing, state.begun, 1.0 + 0.0 * state.begun)
        return Faded(after, kept, state.unmeasured, surprise, begun), told

    def _room(self, state: Faded) -> Any:
        """The factor that makes some variance as large as it may be, ``(*batch)``."""
        least: Any = math.inf
        for i in range(len(state.carried)):
            carried = state.carried[i, i]
            left = self.beyond * state.unmeasured[i, i] - (state.state.cov[i, i] - carried)
            grows = less(0.0, carried)
            room = left / where(grows, carried, 1.0)
            # A bound that is not finite, as after ages of an unstable motion, is none.
            least = minimum(
                least, where(grows, where(less(room, math.inf), room, math.inf), math.inf)
            )
        return least


def _row(value: Any, like: Any) -> Any:
    """``value`` as the only row of an array like another."""
    out = np.empty_like(like)
    out[0] = value
    return out
