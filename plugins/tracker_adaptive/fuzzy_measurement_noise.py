"""Measurement noise from a fuzzy system that reads the degree of mismatch (paper 4, eq. 3-3 to 3-7)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import attrs
import numpy as np

from tracker.adaptation import untuned, with_scaled_noise
from tracker.models import isnan, maximum, where
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Gaussian, Step
from tracker_adaptive.fuzzy_system import FuzzySystem
from tracker_adaptive.mismatch import Squares, diagonal_of
from tracker_adaptive.settings import between, chosen, fuzzy_numbers, replaced, systems, unit_name
from tracker_kalman.inner import at_least

OWN = ("scale", "floor")
OWNER = "adapter 'fuzzy_measurement_noise'"


@attrs.frozen(eq=False)
class Scaled:
    """What is remembered: the squares in the window, and each variance over the sensor's own.

    Shapes:
        scale ``(m, *batch)``.
    """

    squares: Squares
    scale: Any


@attrs.frozen(eq=False)
class FuzzyMeasurementNoise:
    """Each variance of the measurement noise is moved by a fuzzy system that reads its mismatch.

    ``DOM = S - C`` with C the mean of ``r r'`` over a window; for each component by itself
    ``R(i,i) <- R(i,i) + unit * system(DOM(i,i) / unit)``, never below ``floor`` times the sensor's own
    variance. The unit is ``scale`` times the sensor's own variance (``unit="given"``, the thesis), or
    times the present one (``unit="present"``, ours: steps are then ratios, and an R that is wrong by
    orders of magnitude is found as fast from below as from above). A component that was not
    measured teaches nothing; nothing moves until a window has passed of which half was measured.

    Minimising DOM is not minimising errors: a window of 25 squares scatters by 28 %, and R follows.

    Numbers:
        system: one fuzzy system for all components, or one for each; None, the five rules by hand.
        scale: the input's and output's unit, in variances of the sensor.
        window: steps in the mean of squares.
        floor: least variance, in variances of the sensor.
        unit: "given" or "present".

    Raises:
        DomainError: for numbers out of range, or systems that do not fit the sensor.
    Source: paper 4, eq. 3-3 to 3-7, choices of section 8 (window 25, floor 1e-3, nothing before k = 25).
    Laws: those of kind "adapter".
    """

    system: tuple[FuzzySystem, ...] = attrs.field(default=None, converter=systems)
    scale: Any = attrs.field(default=0.125, validator=between(0.0, np.inf, OWNER))
    window: int = attrs.field(default=25, validator=at_least(1, OWNER))
    floor: Any = attrs.field(default=1e-3, validator=between(0.0, np.inf, OWNER))
    unit: str = attrs.field(default="given", converter=unit_name)

    tunes = ("R",)

    def begin(self, motion: MotionModel, sensor: SensorModel, prior: Gaussian, pose: Any) -> Scaled:  # noqa: ARG002 - the protocol
        """Nothing in the window, the sensor's own noise."""
        m, batch = sensor.space.size, prior.mean.shape[1:]
        chosen(self.system, m, f"the components of {sensor.space}")
        return Scaled(Squares.of(self.window, m, batch), np.ones((m, *batch)))

    def tuned(
        self, memory: Scaled, motion: MotionModel, sensor: SensorModel
    ) -> tuple[MotionModel, SensorModel]:
        """The motion, and the sensor with its variances scaled."""
        return motion, with_scaled_noise(sensor, memory.scale)

    def adapt(self, memory: Scaled, step: Step, motion: MotionModel, sensor: SensorModel) -> Scaled:  # noqa: ARG002 - the protocol
        """After one more step."""
        v, S = step.innovation.residual, step.innovation.S
        squares = memory.squares.after(v * v)
        own = diagonal_of(untuned(sensor).R(step.predicted.mean, step.pose))
        dom, missing, trusted = diagonal_of(S) - squares.mean, isnan(v), squares.trusted
        found = np.empty_like(memory.scale)
        for i, system in enumerate(chosen(self.system, len(v), "the components")):
            unit = self.scale * (memory.scale[i] if self.unit == "present" else 1.0)
            moved = memory.scale[i] + unit * system(dom[i] / (unit * own[i]))
            moved = where(trusted[i], maximum(moved, self.floor), memory.scale[i])
            found[i] = where(missing[i], memory.scale[i], moved)
        return Scaled(squares, found)

    @property
    def parameters(self) -> Mapping[str, Any]:
        """Its numbers, each a scalar or ``(*batch)``."""
        own = {name: getattr(self, name) for name in OWN}
        return MappingProxyType(own | fuzzy_numbers(self.system))

    def with_parameters(self, **parameters: Any) -> FuzzyMeasurementNoise:
        """The same adapter with other numbers."""
        made: FuzzyMeasurementNoise = replaced(self, OWN, parameters, "system")
        return made

    @property
    def structure(self) -> tuple[Any, ...]:
        """All but the numbers."""
        return (self.window, self.unit, tuple(s.structure for s in self.system))
