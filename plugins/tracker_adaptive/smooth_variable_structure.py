"""The smooth variable structure filter (Habibi 2007) with a covariance (Gadsden and Habibi 2010)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from tracker.algebra import (
    apply,
    condition,
    factor,
    finite,
    gain,
    product,
    symmetric_product,
    transpose,
    whiten,
    without_missing,
)
from tracker.algebra.lanes import LEAST
from tracker.models import absolute, isnan, less, maximum, sqrt, where
from tracker.protocols import MotionModel, SensorModel
from tracker.types import PARAMETER, Gaussian, Innovation, Projection
from tracker_adaptive.mismatch import diagonal_of
from tracker_adaptive.noisy_belief import room_for, within
from tracker_adaptive.settings import between
from tracker_kalman.inner import conditioning_filter, needs_of_inner, tags_of_inner

OWNER = "filter 'smooth_variable_structure'"


@attrs.frozen(eq=False)
class WithResidual:
    """A Gaussian state, and what the last update left of each measured component's residual.

    Shapes:
        left ``(k, *batch)``, absolute values.
    """

    state: Gaussian
    left: Any

    def moments(self) -> Gaussian:
        """Mean and covariance of the state."""
        return self.state


@attrs.frozen(eq=False)
class SmoothVariableStructure:
    """A filter whose gain is not optimal but bounds the error, whatever the noise really is.

    A residual is corrected whole, and a little more, ``(|e| + convergence |e_before|) sign(e)`` with
    e_before what the last update left; within ``boundary`` standard deviations of the sensor
    ``sign(e)`` becomes ``e / boundary``, lest it chatter. The residual is brought into the state by
    ``H+ = P H' (H P H' + share R)^-1``, for a share of zero an inverse of H that reaches states which
    are not measured by their correlations: the published one needs as many measurements as states, or
    a canonical form. The covariance is Joseph's for the gain that results, as a sum of squares of
    roots: positive semi-definite whatever the gain is.

    Where it fails: in a direction that measurements hardly show, a range by bearings, ``H+`` makes
    noise into large corrections. There a residual of so many deviations has that many over ``boundary
    share`` times the Kalman gain: keep ``boundary share`` above the deviations that the noise *really*
    has, in those that the sensor claims. The defaults make it 1.5. Nearer to the published inverse
    (a share of 0.01) it loses a sixth of its runs by two bearings, and nearly all by the angles of two
    sensors beside each other (scenario "underwater_angles") even told the right noise; so do the
    defaults there where the noise is 3.4 times as large as told. NIS tells of it.

    ``inner``: any filter whose belief is a Gaussian, or its name; it predicts and projects. In an
    estimator of several sensors, what is left belongs to components by their place.

    Numbers:
        inner: the filter that it is written around.
        boundary: width of the smoothing boundary layer in standard deviations of the sensor.
        convergence: gamma in (0, 1), the share of an error that remains.
        share: that of R beside ``H P H'``, above 0 and not above 1. All but the first may differ per
            lane.

    Raises:
        DomainError: for numbers out of range.
    Source: Habibi, The smooth variable structure filter, Proceedings of the IEEE 95 (2007), eq. 38-40;
        covariance after Gadsden and Habibi, A new form of the smooth variable structure filter with a
        covariance derivation, CDC 2010, eq. 2.10.
    Laws: those of kind "filter" that do not want the gain to be Kalman's; an update that leaves
        nothing but rounding of the noise beside ``H P H'`` is not ok.
    """

    inner: Any = attrs.field(default="ekf1", converter=conditioning_filter)
    boundary: Any = attrs.field(
        default=5.0, validator=between(0.0, 1e12, OWNER), metadata=PARAMETER
    )
    convergence: Any = attrs.field(
        default=0.1, validator=between(0.0, 1.0, OWNER), metadata=PARAMETER
    )
    share: Any = attrs.field(
        default=0.3, validator=between(0.0, 1.0 + 1e-12, OWNER), metadata=PARAMETER
    )

    needs, tags = needs_of_inner, tags_of_inner

    def begin(self, prior: Any, *, sensors: Sequence[Any] | None = None) -> WithResidual:
        """The given state; no residual yet."""
        if isinstance(prior, WithResidual):
            return prior
        shape = (room_for(sensors), *prior.mean.shape[1:])
        return WithResidual(prior, np.zeros(shape, dtype=prior.mean.dtype))

    def predict(
        self, state: WithResidual, motion: MotionModel, dt: Any, u: Any = None, t: Any = None
    ) -> WithResidual:
        """As its inner filter."""
        return WithResidual(self.inner.predict(state.state, motion, dt, u, t), state.left)

    def project(self, state: WithResidual, sensor: SensorModel, pose: Any = None) -> Projection:
        """As its inner filter."""
        seen: Projection = self.inner.project(state.state, sensor, pose)
        return seen

    def update(
        self,
        state: WithResidual,
        sensor: SensorModel,
        z: Any,
        pose: Any = None,
        projection: Projection | None = None,
    ) -> tuple[WithResidual, Innovation]:
        """Correct the residual of ``z``; components that are NaN were not measured."""
        m = sensor.space.size
        within(len(state.left), m, "smooth_variable_structure")
        seen = self.project(state, sensor, pose) if projection is None else projection
        v, now = sensor.residual(z, seen.z), state.state
        missing = isnan(v)
        _, _, nis, loglik, count = condition(now.mean, None, v, seen.S, seen.cross)
        S, cross = without_missing(seen.S, seen.cross, v)
        R, _ = without_missing(sensor.R(now.mean, pose), seen.cross, v)
        e = np.asarray(where(missing, 0.0, v))
        width = sqrt(diagonal_of(R)) * self.boundary
        part = (absolute(e) + self.convergence * state.left[:m]) / maximum(absolute(e), width)
        known = S - R
        reached = known + R * self.share
        K = gain(cross, reached) * part[None]
        mean = now.mean + apply(K, e)
        left = absolute(e - apply(gain(known, reached), part * e))  # e - H K e
        # Joseph's form on roots needs no H, with P = L L' and H L = A:
        # (L - K A) (L - K A)' + K (S - A A') K'.
        L = factor(now.cov)
        A = transpose(whiten(L, cross))
        D = factor(S - symmetric_product(A, A))
        kept, noise = L - product(K, A), product(K, D)
        cov = symmetric_product(kept, kept) + symmetric_product(noise, noise)
        sound: Any = 0.0
        for i in range(m):  # of noise so small beside H P H' only rounding is left
            sound = where(less(D[i, i] * D[i, i], LEAST * S[i, i]), math.nan, sound)
        for i in range(len(mean)):
            sound = where(less(absolute(mean[i]) + cov[i, i], math.inf), sound, math.nan)
        mean, nis, loglik = mean + sound, nis + sound, loglik + sound
        left = np.asarray(where(missing, state.left[:m], left))
        told = Innovation(v, seen.S, nis, loglik, count, finite(nis))
        after = Gaussian.trusted(mean, cov)
        return WithResidual(after, np.concatenate([left, state.left[m:]])), told
