"""Two adapters side by side, one of measurement noise and one of process noise."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import attrs

from tracker.compile.fuse import structure
from tracker.errors import DomainError, wording
from tracker.models.parameters import checked_parameters, numbers_of
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Gaussian, Step


def _adapter(value: Any, what: str) -> Any:
    if isinstance(value, str):
        from tracker.registry import default_registry

        value = default_registry().get("adapter", value).make()
    if tuple(getattr(value, "tunes", ())) != (what,):
        raise DomainError(
            wording(
                "adapter 'joint_noise'",
                got=f"{type(value).__name__}, which tunes {getattr(value, 'tunes', 'nothing')}",
                expected=f"an adapter that tunes {what!r} alone",
                do="pass another, or use it by itself",
            )
        )
    return value


def _of_measurements(value: Any) -> Any:
    return _adapter(value, "R")


def _of_motion(value: Any) -> Any:
    return _adapter(value, "Q")


@attrs.frozen(eq=False)
class Two:
    """The memories of both."""

    measurement: Any
    process: Any


@attrs.frozen(eq=False)
class JointNoise:
    """An adapter of measurement noise and one of process noise, told of the same steps.

    Named as future work in the thesis. A residual does not say which noise it is due to: both answer
    to it, and what each of them ends with depends on their speeds as much as on the data. Compare with
    either alone before trusting both.

    Numbers:
        measurement: an adapter that tunes R, or its name.
        process: an adapter that tunes Q, or its name.

    Raises:
        DomainError: if one tunes something else.
    Source: paper 4, future work.
    Laws: those of kind "adapter".
    """

    measurement: Any = attrs.field(default="fuzzy_measurement_noise", converter=_of_measurements)
    process: Any = attrs.field(default="fuzzy_process_noise", converter=_of_motion)

    tunes = ("R", "Q")

    def begin(self, motion: MotionModel, sensor: SensorModel, prior: Gaussian, pose: Any) -> Two:
        """What both begin with."""
        return Two(
            *(a.begin(motion, sensor, prior, pose) for a in (self.measurement, self.process))
        )

    def tuned(
        self, memory: Two, motion: MotionModel, sensor: SensorModel
    ) -> tuple[MotionModel, SensorModel]:
        """The motion of one, the sensor of the other."""
        _, seen = self.measurement.tuned(memory.measurement, motion, sensor)
        moved, _ = self.process.tuned(memory.process, motion, sensor)
        return moved, seen

    def adapt(self, memory: Two, step: Step, motion: MotionModel, sensor: SensorModel) -> Two:
        """After one more step."""
        return Two(
            self.measurement.adapt(memory.measurement, step, motion, sensor),
            self.process.adapt(memory.process, step, motion, sensor),
        )

    @property
    def parameters(self) -> Mapping[str, Any]:
        """The numbers of both, named "measurement_..." and "process_..."."""
        return MappingProxyType(
            {
                f"{part}_{name}": value
                for part in ("measurement", "process")
                for name, value in numbers_of(getattr(self, part)).items()
            }
        )

    def with_parameters(self, **parameters: Any) -> JointNoise:
        """The same adapters with other numbers.

        Raises:
            DomainError: for a name that neither has, or a number that is not finite.
        """
        unknown = [name for name in parameters if name not in self.parameters]
        if unknown:
            raise DomainError(
                wording(
                    "parameters of adapter 'joint_noise'",
                    got=", ".join(unknown),
                    expected=f"names among {', '.join(self.parameters)}",
                    do="correct the name",
                )
            )
        checked = checked_parameters(parameters)
        parts = {}
        for part in ("measurement", "process"):
            own, prefix = getattr(self, part), f"{part}_"
            mine = {k.removeprefix(prefix): v for k, v in checked.items() if k.startswith(prefix)}
            if hasattr(own, "with_parameters"):
                parts[part] = own.with_parameters(**mine)
            else:
                parts[part] = attrs.evolve(own, **mine)
        return attrs.evolve(self, **parts)

    @property
    def structure(self) -> tuple[Any, ...]:
        """All but the numbers."""
        return (structure(self.measurement), structure(self.process))
