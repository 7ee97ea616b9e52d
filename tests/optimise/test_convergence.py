"""How often each optimiser finds the minimum of three functions that everybody knows.

The shares were measured over 300 restarts (60 for the adapters) with another seed; the tests ask for
what a share lower by three standard errors reaches but once in 10,000 times.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import tracker as tk
from tracker_optimise import (
    CMAES,
    DifferentialEvolution,
    Genetic,
    Imperialist,
    ParticleSwarm,
)

pytestmark = [pytest.mark.statistical]

BUDGET = 6000
FALSE_ALARM = 1e-4


def sphere(x: Any) -> Any:
    return (x**2).sum(axis=0)


def rosenbrock(x: Any) -> Any:
    return (100.0 * (x[1:] - x[:-1] ** 2) ** 2 + (1.0 - x[:-1]) ** 2).sum(axis=0)


def rastrigin(x: Any) -> Any:
    return (x**2 - 10.0 * np.cos(2.0 * np.pi * x) + 10.0).sum(axis=0)


FUNCTIONS: dict[str, tuple[Callable[[Any], Any], Any, float]] = {
    "sphere": (sphere, [[-4.0, 6.0]] * 5, 0.01),
    "rosenbrock": (rosenbrock, [[-2.0, 2.5]] * 3, 0.3),
    "rastrigin": (rastrigin, [[-5.12, 4.0]] * 3, 0.5),  # the next best minima have 0.99
}

MEASURED = {
    "genetic": (Genetic(), {"sphere": 1.0, "rosenbrock": 0.85, "rastrigin": 1.0}),
    "particle_swarm": (ParticleSwarm(), {"sphere": 1.0, "rosenbrock": 1.0, "rastrigin": 0.967}),
    "ring": (
        ParticleSwarm(neighbourhood="ring"),
        {"sphere": 1.0, "rosenbrock": 0.983, "rastrigin": 0.843},
    ),
    "constriction": (
        ParticleSwarm(constriction=True, cognitive=2.05, social=2.05),
        {"sphere": 1.0, "rosenbrock": 1.0, "rastrigin": 0.963},
    ),
    "imperialist": (Imperialist(), {"sphere": 1.0, "rosenbrock": 0.993}),
    "revolution": (Imperialist(revolution=0.1), {"sphere": 1.0, "rosenbrock": 1.0}),
    "differential_evolution": (
        DifferentialEvolution(),
        {"sphere": 1.0, "rosenbrock": 1.0, "rastrigin": 0.933},
    ),
    "cma_es": (CMAES(), {"sphere": 1.0, "rosenbrock": 1.0, "rastrigin": 0.667}),
}


@pytest.mark.parametrize(
    ("name", "function"),
    [(name, function) for name, (_, shares) in MEASURED.items() for function in shares],
)
def test_it_finds_the_minimum_as_often_as_was_measured(name: str, function: str) -> None:
    optimiser, shares = MEASURED[name]
    adapter = name in {"differential_evolution", "cma_es"}
    restarts, measured_over = (15 if function == "rastrigin" else 6, 60) if adapter else (40, 300)
    cost, bounds, tolerance = FUNCTIONS[function]
    found = tk.optimise(cost, bounds, optimiser, evaluations=BUDGET, restarts=restarts, seed=5)
    # Of no failure in n the rule of three makes a share of 1 - 3 / n.
    share = min(shares[function], 1.0 - 3.0 / measured_over)
    share -= 3.0 * math.sqrt(share * (1.0 - share) / measured_over)
    wanted = int(binom.ppf(FALSE_ALARM, restarts, share))
    assert wanted > 0
    hits = int((found.cost[0] < tolerance).sum())
    assert hits >= wanted, f"{hits} of {restarts} restarts find the minimum, {wanted} should"


@pytest.mark.parametrize("revolution", [0.0, 0.1])
def test_imperialists_are_trapped_where_there_are_many_minima(revolution: float) -> None:
    """On Rastrigin's function 10 % of restarts find the minimum, with revolution 17 %.

    No fault of this program, and worth knowing: who uses it there takes many restarts. Of 40 at
    most 20 succeed; at a share of 24 % (17 % and three standard errors) but once in 10,000 times more.
    """
    cost, bounds, tolerance = FUNCTIONS["rastrigin"]
    optimiser = Imperialist(revolution=revolution)
    found = tk.optimise(cost, bounds, optimiser, evaluations=BUDGET, restarts=40, seed=5)
    assert (found.cost[0] < tolerance).sum() <= 20
