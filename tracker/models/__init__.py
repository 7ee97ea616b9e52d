"""Component functions and the models that follow from them: what an author of models imports.

The elementary functions (`atan2`, `sqrt`, `where`, ...) and the two finished model classes are
offered here; particular models are plugins.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tracker.models.functions import (
    absolute,
    acos,
    asin,
    atan,
    atan2,
    cos,
    exp,
    floor,
    hypot,
    isnan,
    less,
    log,
    maximum,
    minimum,
    sin,
    sqrt,
    tan,
    where,
    wrap,
)

if TYPE_CHECKING:
    from tracker.models.motion import ComponentMotion
    from tracker.models.parameters import one_of, positive
    from tracker.models.sensor import ComponentSensor

__all__ = [
    "ComponentMotion",
    "ComponentSensor",
    "absolute",
    "acos",
    "asin",
    "atan",
    "atan2",
    "cos",
    "diagonal",
    "exp",
    "floor",
    "hypot",
    "isnan",
    "less",
    "log",
    "maximum",
    "minimum",
    "one_of",
    "positive",
    "sin",
    "sqrt",
    "tan",
    "where",
    "wrap",
]

_LAZY = {
    "ComponentMotion": "tracker.models.motion",
    "ComponentSensor": "tracker.models.sensor",
    "positive": "tracker.models.parameters",
    "one_of": "tracker.models.parameters",
}


def diagonal(*entries: Any) -> tuple[tuple[Any, ...], ...]:
    """Rows of a diagonal matrix over components.

    Example:
    >>> diagonal(1.0, 2.0)
    ((1.0, 0.0), (0.0, 2.0))
    """
    return tuple(
        tuple(entry if i == j else 0.0 for j in range(len(entries)))
        for i, entry in enumerate(entries)
    )


def __getattr__(name: str) -> Any:
    # The model classes stand on the algebra, which itself needs the functions above.
    if name in _LAZY:
        from importlib import import_module

        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'tracker.models' has no attribute {name!r}")
