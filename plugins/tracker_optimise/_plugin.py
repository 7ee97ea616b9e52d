"""The component records of optimisers; nothing heavy is imported here."""

from tracker.hookspecs import hookimpl
from tracker.registry import Component, Registry


@hookimpl
def tracker_components(registry: Registry) -> None:
    """Offer the optimisers of this package."""
    for component in _COMPONENTS:
        registry.add(component)


_COMPONENTS = (
    Component(
        kind="optimiser",
        name="genetic",
        target="tracker_optimise.genetic:Genetic",
        summary="Genetic algorithm on real parameters: selection, crossover, reproduction, mutation.",
        paper="4",
        tags=("evolutionary", "random"),
    ),
    Component(
        kind="optimiser",
        name="particle_swarm",
        target="tracker_optimise.particle_swarm:ParticleSwarm",
        summary="Particle swarm with inertia schedule or constriction, global or on a ring.",
        paper="4",
        equations=("3-1", "3-2"),
        tags=("swarm", "random"),
    ),
    Component(
        kind="optimiser",
        name="imperialist",
        target="tracker_optimise.imperialist:Imperialist",
        summary="Imperialist competitive algorithm: colonies move to imperialists, empires compete.",
        paper="4",
        equations=("3-4", "3-5", "3-6"),
        tags=("swarm", "random"),
    ),
    Component(
        kind="optimiser",
        name="nsga2",
        target="tracker_optimise.nsga2:NSGA2",
        summary="NSGA-II: several objectives and constraints, by sorting into fronts and crowding.",
        paper="Deb, Pratap, Agarwal and Meyarivan 2002",
        tags=("evolutionary", "multi-objective", "constraints", "random"),
    ),
    Component(
        kind="optimiser",
        name="differential_evolution",
        target="tracker_optimise.differential_evolution:DifferentialEvolution",
        summary="Differential evolution through SciPy, one generation at a time.",
        paper="Storn and Price 1997",
        tags=("evolutionary", "random"),
    ),
    Component(
        kind="optimiser",
        name="cma_es",
        target="tracker_optimise.cma_es:CMAES",
        summary="CMA-ES through the package cmaes: adapts mean, step and covariance.",
        paper="Hansen 2016",
        tags=("evolutionary", "random"),
        requires={"cmaes": "tracker-lab[optimise]"},
    ),
)
