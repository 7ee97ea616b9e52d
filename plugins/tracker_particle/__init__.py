"""Particle filters and particle smoothers, one module per published method."""

from importlib import import_module
from typing import Any

_HOME = {
    "AuxiliaryFilter": "auxiliary",
    "BackwardSimulation": "backward_simulation",
    "BootstrapFilter": "bootstrap",
    "MarginalisedFilter": "marginalised",
    "Particles": "belief",
    "RegularisedFilter": "regularised",
}
__all__ = sorted(_HOME)  # noqa: PLE0605 - kept beside what it names


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"tracker_particle.{_HOME[name]}"), name)
    raise AttributeError(f"module 'tracker_particle' has no attribute {name!r}")
