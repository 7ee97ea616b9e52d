"""Measurement noise by covariance matching in small steps: the linear counterpart of the fuzzy one."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.adaptation import untuned, with_scaled_noise
from tracker.models import isnan, maximum, where
from tracker.protocols import MotionModel, SensorModel
from tracker.types import PARAMETER, Gaussian, Step
from tracker_adaptive.fuzzy_measurement_noise import Scaled
from tracker_adaptive.mismatch import Squares, diagonal_of
from tracker_adaptive.settings import between
from tracker_kalman.inner import at_least

OWNER = "adapter 'innovation_matching'"


@attrs.frozen(eq=False)
class InnovationMatching:
    """Each variance of the measurement noise is lowered by a part of its degree of mismatch.

    ``R(i,i) <- R(i,i) - gain * DOM(i,i)`` with ``DOM = S - C`` and C the mean of ``r r'`` over a
    window; never below ``floor`` times the sensor's own variance. With a gain of one,
    ``R = C - H P H'``. A component that was not measured teaches nothing; nothing moves until a
    window has passed of which half was measured.

    Numbers:
        window: steps in the mean of squares.
        gain: part of the mismatch that a step removes, in (0, 1]; may differ per lane.
        floor: least variance, in variances of the sensor; may differ per lane.

    Raises:
        DomainError: for numbers out of range.
    Source: paper 4, eq. 3-3 to 3-6; Maybeck, Stochastic Models, Estimation and Control 2, 1982, 10.3.
    Laws: those of kind "adapter".
    """

    window: int = attrs.field(default=25, validator=at_least(1, OWNER))
    gain: Any = attrs.field(
        default=0.1, validator=between(0.0, 1.0 + 1e-12, OWNER), metadata=PARAMETER
    )
    floor: Any = attrs.field(
        default=1e-3, validator=between(0.0, np.inf, OWNER), metadata=PARAMETER
    )

    tunes = ("R",)

    def begin(self, motion: MotionModel, sensor: SensorModel, prior: Gaussian, pose: Any) -> Scaled:  # noqa: ARG002 - the protocol
        """Nothing in the window, the sensor's own noise."""
        m, batch = sensor.space.size, prior.mean.shape[1:]
        return Scaled(Squares.of(self.window, m, batch), np.ones((m, *batch)))

    def tuned(
        self, memory: Scaled, motion: MotionModel, sensor: SensorModel
    ) -> tuple[MotionModel, SensorModel]:
        """The motion, and the sensor with its variances scaled."""
        return motion, with_scaled_noise(sensor, memory.scale)

    def adapt(self, memory: Scaled, step: Step, motion: MotionModel, sensor: SensorModel) -> Scaled:  # noqa: ARG002 - the protocol
        """After one more step."""
        v = step.innovation.residual
        squares = memory.squares.after(v * v)
        own = diagonal_of(untuned(sensor).R(step.predicted.mean, step.pose))
        dom = (diagonal_of(step.innovation.S) - squares.mean) / own
        moved = maximum(memory.scale - self.gain * dom, self.floor)
        moved = where(squares.trusted, moved, memory.scale)
        return Scaled(squares, where(isnan(v), memory.scale, moved))
