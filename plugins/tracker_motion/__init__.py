"""How targets move: one module per motion model, and `discretisation`, which they share."""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tracker_motion.acceleration_input import acceleration_input
    from tracker_motion.augmented import augmented
    from tracker_motion.constant_acceleration import constant_acceleration
    from tracker_motion.constant_velocity import constant_velocity
    from tracker_motion.coordinated_turn import coordinated_turn
    from tracker_motion.linear import linear
    from tracker_motion.switching import switching

__all__ = [
    "acceleration_input",
    "augmented",
    "constant_acceleration",
    "constant_velocity",
    "coordinated_turn",
    "linear",
    "switching",
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
