"""Noise with a fading memory of the innovations, after Sage and Husa (1969)."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.adaptation import untuned, with_relative_noise, with_scaled_process_noise
from tracker.models import isnan, less, maximum, minimum, sqrt, where
from tracker.protocols import MotionModel, SensorModel
from tracker.types import PARAMETER, SYMMETRIC, Gaussian, Step
from tracker_adaptive.innovation_adaptive import HIGHEST, after_update, noises
from tracker_adaptive.mismatch import corrections, diagonal_of
from tracker_adaptive.settings import between

OWNER = "adapter 'sage_husa'"
FAR = 25.0
"""Squares are cut at this multiple of what was expected, five standard deviations."""


@attrs.frozen(eq=False)
class Fading:
    """The noises, and the power of the forgetting factor that the next weight is made of.

    Shapes:
        R, in the sensor's own standard deviations, ``(m, m, *batch)`` or None; Q, the scale of the
        motion's own, ``(n, *batch)`` or None; power ``(1, *batch)``.
    """

    R: Any = attrs.field(metadata=SYMMETRIC)
    Q: Any
    power: Any


@attrs.frozen(eq=False)
class SageHusa:
    """Noise covariances averaged over all innovations, the older the less.

    ``R <- (1 - d) R + d (e e' + H P+ H')`` with e the residual after the update and
    ``d = (1 - b) / (1 - b^(k+1))``, b the forgetting factor. This form, and not the original
    ``v v' - H P- H'``, is a sum of covariances, so that R can never lose its sign. Components that
    were not measured keep their variance.

    R is that of measurements divided by the sensor's own standard deviations at the time. Where these
    do not change it is the paper's; where they depend on state or pose they go on doing so, while a
    mean of R itself would be that of long ago. It begins with the sensor's correlations there, and a
    variance that the sensor says is zero stays so.

    Process noise likewise: each variance of the motion's own Q times ``(1 - d) + d c``, with c the
    square of the state's correction over its expectation (cut at 25), instead of the original
    ``K v v' K' + P+ - F P+ F'``, which need not be positive. Means of the noises are taken to be zero.

    Tuning both at once is known to be ambiguous: R explains what Q could.

    Numbers:
        forgetting: b, in (0, 1); 0.98 remembers some 50 steps. May differ per lane.
        worth: how many steps the given noise counts as when it begins; may differ per lane.
        tunes: "R", "Q" or both.
        floor: least scale of process noise; R has none, and needs none.

    Raises:
        DomainError: for numbers out of range.
    Source: Sage and Husa, Adaptive filtering with unknown prior statistics, Joint Automatic Control
        Conference 1969; the positive form of R after Myers and Tapley (1976) and Mohamed and Schwarz
        (1999).
    Laws: those of kind "adapter".
    """

    forgetting: Any = attrs.field(
        default=0.98, validator=between(0.0, 1.0, OWNER), metadata=PARAMETER
    )
    worth: Any = attrs.field(
        default=10.0, validator=between(0.0, np.inf, OWNER), metadata=PARAMETER
    )
    tunes: tuple[str, ...] = attrs.field(default=("R",), converter=noises)
    floor: Any = attrs.field(
        default=1e-6, validator=between(0.0, np.inf, OWNER), metadata=PARAMETER
    )

    def begin(self, motion: MotionModel, sensor: SensorModel, prior: Gaussian, pose: Any) -> Fading:  # noqa: ARG002 - the protocol
        """The models' own noise."""
        n, *batch = prior.mean.shape
        return Fading(
            self._given(sensor, prior, pose) if "R" in self.tunes else None,
            np.ones((n, *batch)) if "Q" in self.tunes else None,
            np.zeros((1, *batch)) + np.asarray(self.forgetting) ** (1.0 + np.asarray(self.worth)),
        )

    def _given(self, sensor: SensorModel, prior: Gaussian, pose: Any) -> Any:
        """Correlations of the sensor, over the lanes of the prior, or its own if it differs per lane."""
        R = np.asarray(sensor.R(prior.mean, pose))
        R = R.reshape(*R.shape, *(1,) * (prior.mean.ndim + 1 - R.ndim))
        batch = np.broadcast_shapes(R.shape[2:], prior.mean.shape[1:])
        inverse = _inverse_roots(diagonal_of(R))
        out = np.broadcast_to(R * (inverse[:, None] * inverse[None]), (*R.shape[:2], *batch)).copy()
        for i in range(len(out)):
            out[i, i] = 1.0
        return out

    def tuned(
        self, memory: Fading, motion: MotionModel, sensor: SensorModel
    ) -> tuple[MotionModel, SensorModel]:
        """The sensor with the noise found, the motion with its own, scaled."""
        return (
            motion if memory.Q is None else with_scaled_process_noise(motion, memory.Q),
            sensor if memory.R is None else with_relative_noise(sensor, memory.R),
        )

    def adapt(self, memory: Fading, step: Step, motion: MotionModel, sensor: SensorModel) -> Fading:
        """After one more step."""
        b = self.forgetting
        weight = ((1.0 - b) / (1.0 - memory.power))[0]
        R, Q = memory.R, memory.Q
        if R is not None:
            R = self._measurement(R, weight, step, sensor)
        if Q is not None:
            found, expected = corrections(step, motion.space.circular)
            ratio = minimum(found / expected, FAR)
            moved = minimum(maximum(Q * (1.0 + weight * (ratio - 1.0)), self.floor), HIGHEST)
            Q = where(isnan(found), Q, moved)
        nothing = less(step.innovation.count, 0.5)
        return Fading(R, Q, where(nothing, memory.power, memory.power * b))

    @staticmethod
    def _measurement(R: Any, weight: Any, step: Step, sensor: SensorModel) -> Any:
        x, own = step.predicted.mean, untuned(sensor)
        left, known, missing = after_update(step, with_relative_noise(own, R).R(x, step.pose))
        inverse = _inverse_roots(diagonal_of(own.R(x, step.pose)))
        left = left * inverse
        kept = where(missing, 1.0, sqrt(1.0 - weight))
        seen = where(missing, 0.0, weight)
        out = np.empty(known.shape, dtype=known.dtype)
        for i in range(len(left)):
            for j in range(i, len(left)):
                part = where(less(seen[i], seen[j]), seen[i], seen[j])
                new = part * (left[i] * left[j] + known[i, j] * (inverse[i] * inverse[j]))
                out[i, j] = out[j, i] = kept[i] * kept[j] * R[i, j] + new
        return out


def _inverse_roots(variances: Any) -> Any:
    """One over each standard deviation; 0 for one that is told to be zero, and so stays."""
    some = less(0.0, variances)
    return where(some, 1.0 / sqrt(where(some, variances, 1.0)), 0.0)
