"""Any sensor whose measurements are off by components of the state; no measurement of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import attrs

from tracker.errors import CapabilityError, wording
from tracker.models import ComponentSensor
from tracker.models.component import signature_of
from tracker.protocols import SensorModel
from tracker.types import Axis, Space


@attrs.frozen
class _Shifted:
    """The sensor's own function, some outputs plus a component of the state."""

    function: Callable[..., Any]
    places: tuple[int, ...]
    biases: tuple[str, ...]

    @property
    def positional(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*signature_of(self.function)[0], *self.biases)))

    @property
    def keywords(self) -> tuple[str, ...]:
        return signature_of(self.function)[1]

    def __call__(self, *components: Any, **given: Any) -> Any:
        value = dict(zip(self.positional, components, strict=True))
        out = list(self.function(*(value[n] for n in signature_of(self.function)[0]), **given))
        for place, bias in zip(self.places, self.biases, strict=True):
            out[place] = out[place] + value[bias]
        return tuple(out)


def biased(sensor: SensorModel, biases: Mapping[str, str]) -> ComponentSensor:
    """The same sensor with additive errors that persist: named components of the state.

    ``biases`` tells which component of the measurement is off by which component of the state. The
    state gains those that it lacks, in the unit of the measurement; a motion gains them by
    `tracker_motion.augmented`. A filter then estimates the biases, or, as "schmidt", considers
    them. One bias may serve several components, and several sensors of a stack may share it.

    Raises:
        CapabilityError: if the sensor is not written over components, or has a derivative by hand.
        DomainError: if it does not measure a component that ``biases`` names.
    Reference:
        Bar-Shalom, Li and Kirubarajan (2001), section 11.9; Schmidt (1966).
    Laws:
        those of kind "sensor"; without a bias it is the sensor.

    Example:
    >>> from tracker_sensors import azimuth
    >>> sensor = biased(azimuth(0.01).at(sx=0.0, sy=0.0), {"azimuth": "bias"})
    >>> str(sensor.state), sensor.h([1.0, 0.0, 0.0, 0.0, 0.05]).tolist()
    ('x [m], y [m], vx [m/s], vy [m/s], bias [rad]', [0.05])
    """
    if not isinstance(sensor, ComponentSensor) or sensor.derivative is not None:
        raise CapabilityError(
            wording(
                "parameter 'sensor' of sensor 'biased'",
                got=f"a {type(sensor).__name__}"
                + (" with a derivative by hand" if hasattr(sensor, "derivative") else ""),
                expected="a sensor written over components (tracker.models.ComponentSensor)",
                do="write its h as a function of named components, and let derivatives follow",
            )
        )
    places = sensor.space.indices(*biases)
    new = {
        bias: Axis(bias, sensor.space.axes[place].unit)
        for place, bias in zip(places, biases.values(), strict=True)
        if bias not in sensor.state.names
    }
    return attrs.evolve(
        sensor,
        name="biased",
        measure=_Shifted(sensor.measure, places, tuple(biases.values())),
        state=sensor.state + Space(tuple(new.values())),
        parts=sensor.parts or (sensor.name,),
    )
