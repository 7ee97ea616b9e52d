"""The laws hold for every choice of operators, not only for the defaults that the registry makes."""

from __future__ import annotations

from typing import Any

from tracker.testing import Check, parametrize_checks
from tracker_optimise import NSGA2, DifferentialEvolution, Genetic, Imperialist, ParticleSwarm

VARIANTS = [
    Genetic(selection="rank", crossover="blend", mutation="polynomial"),
    Genetic(selection="roulette", crossover="arithmetic", mutation="uniform", mutation_rate=0.1),
    Genetic(population=41, crossover="simulated_binary", elite=0, contestants=3),
    ParticleSwarm(neighbourhood="ring", inertia=0.7),
    ParticleSwarm(constriction=True, cognitive=2.05, social=2.05, population=31),
    Imperialist(revolution=0.1, imperialists=8),
    Imperialist(unite=True, deviation=0.0),
    NSGA2(population=50, objectives=3, constraints=1),
    DifferentialEvolution(strategy="rand1exp", mutation=(0.6, 0.6), population=30),
]


@parametrize_checks(VARIANTS)
def test_variants_obey_the_laws(component: Any, check: Check) -> None:
    check(component)
