"""Optimisers that are asked and told, batched over restarts, one module per published method."""

from importlib import import_module
from typing import Any

_HOME = {
    "CMAES": "cma_es",
    "DifferentialEvolution": "differential_evolution",
    "Genetic": "genetic",
    "Imperialist": "imperialist",
    "NSGA2": "nsga2",
    "ParticleSwarm": "particle_swarm",
    "crowding": "sorting",
    "fronts": "sorting",
    "hypervolume": "sorting",
}
__all__ = sorted(_HOME)  # noqa: PLE0605 - kept beside what it names


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"tracker_optimise.{_HOME[name]}"), name)
    raise AttributeError(f"module 'tracker_optimise' has no attribute {name!r}")
