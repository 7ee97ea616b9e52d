"""Targets that only listen to be found: starts and estimates that do without the range."""

from importlib import import_module
from typing import Any

_HOME = {
    "RangeParameterised": "range_parameterised",
}
__all__ = list(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'tracker_passive' has no attribute {name!r}")
    return getattr(import_module(f"tracker_passive.{_HOME[name]}"), name)
