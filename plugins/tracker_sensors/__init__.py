"""What sensors measure of a target: one module per sensor, and `stack` for several at once."""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tracker_sensors.azimuth import azimuth
    from tracker_sensors.azimuth_elevation import azimuth_elevation
    from tracker_sensors.azimuth_height import azimuth_height
    from tracker_sensors.biased import biased
    from tracker_sensors.conical_angle import conical_angle
    from tracker_sensors.doppler_frequency import doppler_frequency
    from tracker_sensors.multipath_delays import multipath_delays
    from tracker_sensors.passive_sonar import passive_sonar
    from tracker_sensors.position import position
    from tracker_sensors.position_velocity import position_velocity
    from tracker_sensors.range_azimuth import range_azimuth
    from tracker_sensors.range_only import range_only
    from tracker_sensors.range_rate import range_rate
    from tracker_sensors.relative_position import relative_position
    from tracker_sensors.stack import stack
    from tracker_sensors.time_difference import time_difference

__all__ = [
    "azimuth",
    "azimuth_elevation",
    "azimuth_height",
    "biased",
    "conical_angle",
    "doppler_frequency",
    "multipath_delays",
    "passive_sonar",
    "position",
    "position_velocity",
    "range_azimuth",
    "range_only",
    "range_rate",
    "relative_position",
    "stack",
    "time_difference",
]


class _Package(ModuleType):
    """Importing the module of a factory binds that name here: to the factory, not to the module."""

    def __setattr__(self, name: str, value: Any) -> None:
        factory = getattr(value, name, value) if isinstance(value, ModuleType) else value
        super().__setattr__(name, factory)


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{name}"), name)


sys.modules[__name__].__class__ = _Package
