"""Variational Bayes around any Gaussian filter: state and measurement noise together (Särkkä 2009)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from tracker.adaptation import with_scaled_noise
from tracker.algebra import apply, gain, symmetric_product
from tracker.models import isnan, less, maximum, sqrt, where
from tracker.protocols import MotionModel, SensorModel
from tracker.types import PARAMETER, Gaussian, Innovation, Projection
from tracker_adaptive.noisy_belief import room_for, within
from tracker_adaptive.settings import between
from tracker_kalman.inner import at_least, conditioning_filter, needs_of_inner, tags_of_inner
from tracker_kalman.reweighted import conditioned_with

OWNER = "filter 'variational_bayes'"
LEAST = 1.0
"""The least that ``shape`` fades to: a noise unmeasured for ages is as vague as after one sample."""


@attrs.frozen(eq=False)
class WithNoise:
    """A Gaussian state, and an inverse gamma density of each variance over the sensor's own.

    Shapes:
        shape, rate ``(k, *batch)``: the variances' harmonic mean is ``rate / shape``.
    """

    state: Gaussian
    shape: Any
    rate: Any

    def moments(self) -> Gaussian:
        """Mean and covariance of the state."""
        return self.state


@attrs.frozen(eq=False)
class VariationalBayes:
    """Any Gaussian filter that finds the variances of the measurement noise as it goes.

    Each variance of the sensor times an unknown factor, of inverse gamma density. The update finds the
    best independent densities of state and factors in turns, a fixed number of times, so that it can
    be compiled: with the noise ``rate / shape`` the state, with its residual ``e`` after the update the
    factor, ``rate = rate- + (e^2 + (H P H')(i,i)) / (2 R(i,i))``, ``shape = shape- + 1/2``. Between
    steps both fade by ``forgetting`` (not in a step of no time), which keeps the mean and adds doubt.

    ``inner``: any filter whose belief is a Gaussian, or its name; the sensor is seen through its
    projection. In an estimator of several sensors the factors belong to components by their place,
    whichever sensor has them. Correlations of R stay the sensor's own.

    Numbers:
        inner: the filter that it is written around.
        forgetting: in (0, 1]; 0.98 remembers some 50 measurements. May differ per lane.
        worth: how many measurements the given noise counts as when it begins; may differ per lane.
        iterations: turns in an update.

    Raises:
        DomainError: for numbers out of range.
    Source: Särkkä and Nummenmaa, Recursive noise adaptive Kalman filtering by variational Bayesian
        approximations, IEEE Transactions on Automatic Control 54 (2009), algorithm 1; beyond linear
        models, Särkkä and Hartikainen (2013).
    Laws: those of kind "filter" that do not take the given noise for the true one.
    """

    inner: Any = attrs.field(default="ekf1", converter=conditioning_filter)
    forgetting: Any = attrs.field(
        default=0.98, validator=between(0.0, 1.0 + 1e-12, OWNER), metadata=PARAMETER
    )
    worth: Any = attrs.field(
        default=10.0, validator=between(0.0, np.inf, OWNER), metadata=PARAMETER
    )
    iterations: int = attrs.field(default=3, validator=at_least(1, OWNER))

    needs, tags = needs_of_inner, tags_of_inner

    def begin(self, prior: Any, *, sensors: Sequence[Any] | None = None) -> WithNoise:
        """The given state, with the sensors' own noise."""
        if isinstance(prior, WithNoise):
            return prior
        zero = np.zeros((room_for(sensors), *prior.mean.shape[1:]), dtype=prior.mean.dtype)
        half = zero + 0.5 * np.asarray(self.worth)
        return WithNoise(prior, half, half)

    def predict(
        self, state: WithNoise, motion: MotionModel, dt: Any, u: Any = None, t: Any = None
    ) -> WithNoise:
        """As its inner filter; what is known of the noise fades."""
        ahead = self.inner.predict(state.state, motion, dt, u, t)
        kept = where(less(0.0, dt), self.forgetting, 1.0)
        shape = maximum(state.shape * kept, where(less(state.shape, LEAST), state.shape, LEAST))
        return WithNoise(ahead, shape, state.rate * (shape / state.shape))

    def project(self, state: WithNoise, sensor: SensorModel, pose: Any = None) -> Projection:
        """As its inner filter, with the noise known so far."""
        seen: Projection = self.inner.project(state.state, self._tuned(state, sensor), pose)
        return seen

    def _tuned(self, state: WithNoise, sensor: SensorModel) -> SensorModel:
        m = sensor.space.size
        within(len(state.shape), m, "variational_bayes")
        return with_scaled_noise(sensor, state.rate[:m] / state.shape[:m])

    def update(
        self,
        state: WithNoise,
        sensor: SensorModel,
        z: Any,
        pose: Any = None,
        projection: Projection | None = None,
    ) -> tuple[WithNoise, Innovation]:
        """Condition on ``z`` and learn its noise; components that are NaN were not measured."""
        m = sensor.space.size
        tuned = self._tuned(state, sensor)
        seen = self.inner.project(state.state, tuned, pose) if projection is None else projection
        v = sensor.residual(z, seen.z)
        missing = isnan(v)
        before, found = state.rate[:m] / state.shape[:m], state.rate[:m]
        shape = state.shape[:m] + where(missing, 0.0, 0.5)

        def together(v: Any, known: Any, R: Any, _measured: Any) -> Any:
            nonlocal found
            noise = R
            for _ in range(self.iterations):
                scale = where(missing, 1.0, found / shape / before)
                root = sqrt(scale)
                noise = R * (root[:, None] * root[None])
                B = gain(noise, known + noise)
                e, left = apply(B, v), symmetric_product(B, known)
                rows = []
                for i in range(m):
                    learnt = 0.5 * before[i] * (e[i] * e[i] + left[i, i]) / R[i, i]
                    rows.append(state.rate[i] + where(missing[i], 0.0, learnt))
                found = _stacked(rows)
            root = sqrt(where(missing, 1.0, found / shape / before))
            return R * (root[:, None] * root[None])

        after, told = conditioned_with(together, state.state, tuned, z, pose, seen)
        rest = state.shape[m:], state.rate[m:]
        return (
            WithNoise(after, np.concatenate([shape, rest[0]]), np.concatenate([found, rest[1]])),
            told,
        )


def _stacked(rows: list[Any]) -> Any:
    out = np.empty((len(rows), *np.shape(rows[0])), dtype=np.asarray(rows[0]).dtype)
    for i, row in enumerate(rows):
        out[i] = row
    return out
