"""Who measured whom: gates and associations, one module per published method."""

from importlib import import_module
from typing import Any

_HOME = {
    "ChiSquareGate": "chi_square_gate",
    "GlobalNearestNeighbour": "global_nearest_neighbour",
    "NearestNeighbour": "nearest_neighbour",
}
__all__ = list(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'tracker_association' has no attribute {name!r}")
    return getattr(import_module(f"tracker_association.{_HOME[name]}"), name)
