"""Innovation-based and residual-based adaptive estimation of noise (Mehra 1972; Mohamed and Schwarz 1999)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import attrs
import numpy as np

from tracker.adaptation import untuned, with_scaled_noise, with_scaled_process_noise
from tracker.algebra import apply, gain, symmetric_product, without_missing
from tracker.errors import DomainError, wording
from tracker.models import isnan, maximum, minimum, where
from tracker.models.parameters import one_of
from tracker.protocols import MotionModel, SensorModel
from tracker.types import PARAMETER, Gaussian, Step
from tracker_adaptive.mismatch import Squares, corrections, diagonal_of
from tracker_adaptive.settings import between
from tracker_kalman.inner import at_least

OWNER = "adapter 'innovation_adaptive'"
HIGHEST = 1e6
"""The most that process noise is scaled by."""


def _estimate(value: str) -> str:
    return one_of("estimate", value, ("residual", "innovation"))


def noises(value: str | Iterable[str]) -> tuple[str, ...]:
    """Which noise an adapter tunes, in the order R, Q.

    Raises:
        DomainError: if it is neither or something else.
    """
    found = {value} if isinstance(value, str) else set(value)
    if not found or not found <= {"R", "Q"}:
        raise DomainError(
            wording(
                "parameter 'tunes' of an adapter",
                got=repr(value),
                expected="'R', 'Q' or both",
                do="write tunes=('R', 'Q')",
            )
        )
    return tuple(name for name in ("R", "Q") if name in found)


@attrs.frozen(eq=False)
class Both:
    """What is remembered of each noise that is tuned, else None.

    Shapes:
        R scale ``(m, *batch)``; Q scale ``(n, *batch)``.
    """

    residuals: Squares | None
    R: Any
    corrections: Squares | None
    Q: Any


def scaled_models(
    memory: Any, motion: MotionModel, sensor: SensorModel
) -> tuple[MotionModel, SensorModel]:
    """Motion and sensor with the variances scaled that are tuned."""
    return (
        motion if memory.Q is None else with_scaled_process_noise(motion, memory.Q),
        sensor if memory.R is None else with_scaled_noise(sensor, memory.R),
    )


def after_update(step: Step, R: Any) -> tuple[Any, Any, Any]:
    """What the update left of the residual, and of ``H P H'``: ``R S^-1 v`` and ``R - R S^-1 R``.

    Exact where the filter is linear in the measurement, as all Gaussian ones are; neither H nor
    another evaluation of the sensor is needed. Zero for a component that was not measured, which
    the third answer flags.

    Shapes:
        ``(m, *batch)``, ``(m, m, *batch)``, ``(m, *batch)``.
    """
    v = step.innovation.residual
    missing = isnan(v)
    S, R = without_missing(step.innovation.S, R, v)[0], without_missing(R, R, v)[0]
    B = gain(R, S)
    return apply(B, np.asarray(where(missing, 0.0, v))), symmetric_product(B, S - R), missing


@attrs.frozen(eq=False)
class InnovationAdaptive:
    """Noise as a window of innovations shows it.

    Measurement noise, each variance by itself: ``C - H P- H'`` with C the mean square of the residuals
    before the update (estimate "innovation", Mehra), or ``C+ + H P+ H'`` with those after it
    ("residual", Mohamed and Schwarz), which is never negative. Never below ``floor`` times the
    sensor's own variance; correlations stay the sensor's own.

    Process noise: ``Q + C - (P- - P+)`` with C the mean square of the corrections, Mohamed and
    Schwarz's estimate, is far too noisy where Q is small beside P, and not positive. Here the ratio
    of the mean square of a state's corrections to what was expected is taken to one, by as much in a
    step as a window of steps asks for: each variance of the motion's own Q, whatever dt, is scaled. A
    gain shares out what it corrects as Q says, so that a state which is not measured itself, and whose
    Q is too large, takes up what its neighbours' lack.

    What was not measured teaches nothing; nothing moves until a window has passed of which half
    was measured. Tuning both at once is known to be ambiguous: R explains what Q could.

    Numbers:
        window: steps in the means.
        estimate: "residual" or "innovation", of R.
        tunes: "R", "Q" or both.
        floor: least variance, in the models' own; may differ per lane.

    Raises:
        DomainError: for numbers out of range.
    Source: Mehra, Approaches to adaptive filtering, IEEE Transactions on Automatic Control 17 (1972);
        Mohamed and Schwarz, Adaptive Kalman filtering for INS/GPS, Journal of Geodesy 73 (1999),
        eq. 18-20 (Q read as a ratio: ours).
    Laws: those of kind "adapter".
    """

    window: int = attrs.field(default=25, validator=at_least(1, OWNER))
    estimate: str = attrs.field(default="residual", converter=_estimate)
    tunes: tuple[str, ...] = attrs.field(default=("R",), converter=noises)
    floor: Any = attrs.field(
        default=1e-6, validator=between(0.0, np.inf, OWNER), metadata=PARAMETER
    )

    def begin(self, motion: MotionModel, sensor: SensorModel, prior: Gaussian, pose: Any) -> Both:  # noqa: ARG002 - the protocol
        """Nothing in the windows, the models' own noise."""
        parts: list[Any] = []
        for name, k in (("R", sensor.space.size), ("Q", motion.space.size)):
            batch = prior.mean.shape[1:]
            on = name in self.tunes
            parts += [Squares.of(self.window, k, batch), np.ones((k, *batch))] if on else [None] * 2
        return Both(*parts)

    def tuned(
        self, memory: Both, motion: MotionModel, sensor: SensorModel
    ) -> tuple[MotionModel, SensorModel]:
        """The models with their variances scaled."""
        return scaled_models(memory, motion, sensor)

    def adapt(self, memory: Both, step: Step, motion: MotionModel, sensor: SensorModel) -> Both:
        """After one more step."""
        residuals, R = memory.residuals, memory.R
        if residuals is not None:
            residuals, R = self._measurement(residuals, R, step, sensor)
        changes, Q = memory.corrections, memory.Q
        if changes is not None:
            found, expected = corrections(step, motion.space.circular)
            changes = changes.after(found / expected)
            factor = minimum(1.0 + (changes.mean - 1.0) * (1.0 / self.window), 2.0)
            moved = minimum(maximum(Q * factor, self.floor), HIGHEST)
            moved = where(changes.trusted, moved, Q)
            Q = where(isnan(found), Q, moved)
        return Both(residuals, R, changes, Q)

    def _measurement(
        self, residuals: Squares, scale: Any, step: Step, sensor: SensorModel
    ) -> tuple[Squares, Any]:
        v, S = step.innovation.residual, step.innovation.S
        R = sensor.R(step.predicted.mean, step.pose)
        own = diagonal_of(untuned(sensor).R(step.predicted.mean, step.pose))
        if self.estimate == "innovation":
            residuals = residuals.after(v * v)
            found = residuals.mean - (diagonal_of(S) - diagonal_of(R))
        else:
            left, known, missing = after_update(step, R)
            residuals = residuals.after(where(missing, np.nan, left * left))
            found = residuals.mean + diagonal_of(known)
        moved = where(residuals.trusted, maximum(found / own, self.floor), scale)
        return residuals, where(isnan(v), scale, moved)
