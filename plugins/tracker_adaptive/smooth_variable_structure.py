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
    congruence,
    finite,
    gain,
    product,
    transpose,
    without_missing,
)
from tracker.models import absolute, isnan, maximum, sqrt, where
from tracker.protocols import MotionModel, SensorModel
from tracker.types import PARAMETER, Gaussian, Innovation, Projection
from tracker_adaptive.noisy_belief import room_for, within
from tracker_adaptive.settings import between
from tracker_kalman.inner import gaussian_filter

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
    a canonical form. Where the state is badly observable - a range by bearings - that inverse makes
    noise into large corrections; the share keeps them small. The covariance is Joseph's for the gain
    that results, and so is positive whatever that is.

    ``inner``: any filter whose belief is a Gaussian, or its name; it predicts and projects. In an
    estimator of several sensors, what is left belongs to components by their place.

    ``inner`` predicts and projects; ``boundary`` is the width of the smoothing boundary layer in
    standard deviations of the sensor; ``convergence``, gamma in (0, 1), the share of an error that
    remains; ``share`` that of R beside ``H P H'``, above 0. All but the first may differ per lane.

    Raises:
        DomainError: for numbers out of range.
    Source: Habibi, The smooth variable structure filter, Proceedings of the IEEE 95 (2007), eq. 38-40;
        covariance after Gadsden and Habibi, A new form of the smooth variable structure filter with a
        covariance derivation, CDC 2010, eq. 2.10.
    Laws: those of kind "filter" that do not want the gain to be Kalman's.
    """

    inner: Any = attrs.field(default="ekf1", converter=gaussian_filter)
    boundary: Any = attrs.field(
        default=5.0, validator=between(0.0, 1e12, OWNER), metadata=PARAMETER
    )
    convergence: Any = attrs.field(
        default=0.1, validator=between(0.0, 1.0, OWNER), metadata=PARAMETER
    )
    share: Any = attrs.field(
        default=0.1, validator=between(0.0, 1.0 + 1e-12, OWNER), metadata=PARAMETER
    )

    @property
    def needs(self) -> tuple[str, ...]:
        """What its inner filter needs."""
        return tuple(self.inner.needs)

    @property
    def tags(self) -> tuple[str, ...]:
        """What its inner filter says of itself."""
        return tuple(getattr(self.inner, "tags", ()))

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
        return self.inner.project(state.state, sensor, pose)  # type: ignore[no-any-return]

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
        v, R, now = sensor.residual(z, seen.z), sensor.R(state.state.mean, pose), state.state
        missing = isnan(v)
        _, _, nis, loglik, count = condition(now.mean, now.cov, v, seen.S, seen.cross)
        S, cross = without_missing(seen.S, seen.cross, v)
        R, _ = without_missing(R, seen.cross, v)
        e = np.asarray(where(missing, 0.0, v))
        width = sqrt(_diagonal(R)) * self.boundary
        part = (absolute(e) + self.convergence * state.left[:m]) / maximum(absolute(e), width)
        into = gain(cross, S - R * (1.0 - self.share))
        K = into * part[None]
        # Joseph's form needs no H: (I - K H) P (I - K H)' + K R K' = P - K c' - c K' + K S K'.
        both = product(K, transpose(cross))
        cov = now.cov - (both + transpose(both)) + congruence(K, S)
        mean = now.mean + apply(K, e)
        left = where(missing, state.left[:m], absolute(e - part * e))
        nis = where(isnan(mean[0]), math.nan, nis)
        told = Innovation(v, seen.S, nis, loglik, count, finite(nis))
        after = Gaussian.trusted(mean, cov)
        return WithResidual(after, np.concatenate([left, state.left[m:]])), told


def _diagonal(A: Any) -> Any:
    return np.stack([A[i, i] for i in range(len(A))])
