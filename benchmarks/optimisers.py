"""What an optimiser costs beside the cost that it minimises: own time of a generation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import measure
import numpy as np
import peers
from common import MICRO, PROBLEM, REFERENCE_US, SEED, STATIONS, STEPS, one_run, optional, table

import tracker as tk

DIMENSIONS, POPULATION, GENERATIONS, ROUNDS = 10, 50, 40, 41
RESTARTS = 30
LIMIT = 50.0
"""Microseconds of ask and tell, one objective, one restart, where filterpy takes `REFERENCE_US` a step."""

OWN: dict[str, dict[str, Any]] = {
    "particle_swarm": {},
    "particle_swarm, ring": {"neighbourhood": "ring"},
    "genetic": {},
    "genetic, blend": {"crossover": "blend"},
    "imperialist": {},
    "imperialist, revolution": {"revolution": 0.1},
    "nsga2, 100": {"population": 100},
}
ADAPTERS: dict[str, dict[str, Any]] = {"differential_evolution": {}, "cma_es": {}}


def bowl(x: Any) -> Any:
    return ((x - 0.3) ** 2).sum(axis=0)[None]


def two_bowls(x: Any) -> Any:
    return np.stack([bowl(x)[0], bowl(x + 0.2)[0]])


def walked(label: str, parameters: dict[str, Any], restarts: int) -> tuple[Any, list[Any]]:
    """An optimiser, and what it remembers and is told in each generation of a search."""
    optimiser = tk.optimisers.make(label.split(",", maxsplit=1)[0], **parameters)
    cost = bowl if optimiser.rows == 1 else two_bowls
    rngs = [np.random.default_rng(k) for k in range(restarts)]
    memory = optimiser.begin([[-1.0, 1.0]] * DIMENSIONS, rng=rngs, restarts=(restarts,))
    steps = []
    for _ in range(GENERATIONS):
        value = cost(optimiser.ask(memory))
        steps.append((memory, value))
        memory = optimiser.tell(memory, value)
    return optimiser, steps


def repeated(label: str, parameters: dict[str, Any], restarts: int) -> Callable[[], None]:
    """All of its generations again, without the cost."""
    optimiser, steps = walked(label, parameters, restarts)

    def again() -> None:
        for memory, value in steps:
            optimiser.ask(memory)
            optimiser.tell(memory, value)

    return again


def searched(label: str, parameters: dict[str, Any]) -> Callable[[], None]:
    """The whole loop, with a cost that is known beforehand."""
    optimiser, steps = walked(label, parameters, 1)

    def again() -> None:
        values = iter([value for _, value in steps])
        tk.optimise(
            lambda _: next(values),
            [[-1.0, 1.0]] * DIMENSIONS,
            optimiser,
            evaluations=optimiser.population * GENERATIONS,
        )

    return again


def yardstick() -> Callable[[], Any] | None:
    """filterpy's EKF over a record."""
    simulation = tk.scenario("two_stations", steps=STEPS).simulate(SEED, 1)
    z, mean, cov = one_run(simulation)
    return optional(
        "filterpy", lambda: peers.filterpy_ekf(z, mean, cov, stations=STATIONS, **PROBLEM)
    )


def overhead() -> dict[str, tuple[float, float, float, float]]:
    """Microseconds of a generation: ask and tell of one restart; with the loop; per restart of many; and of
    one, where filterpy takes `REFERENCE_US` (NaN without filterpy).
    """
    out = {}
    peer = yardstick()
    for rounds, group in ((ROUNDS, OWN), (7, ADAPTERS)):
        for label, parameters in group.items():
            made = optional(label, lambda a=label, b=parameters: (  # type: ignore[misc]
                repeated(a, b, 1), searched(a, b), repeated(a, b, RESTARTS)
            ))  # fmt: skip
            if made is None:
                continue
            works = dict(zip(("one", "loop", "many"), made, strict=True))
            seconds = measure.interleaved(works | ({"filterpy": peer} if peer else {}), rounds)
            one, loop, many = (
                float(np.median(seconds[name])) / GENERATIONS * MICRO for name in works
            )
            scaled = np.nan
            if peer:
                ratio = measure.ratio(seconds["one"], seconds["filterpy"])
                scaled = REFERENCE_US * ratio * STEPS / GENERATIONS
            out[label] = (one, loop, many / RESTARTS, scaled)
    return out


def optimisers() -> None:
    """Own time of a generation at population 50 and ten parameters, the cost left out."""
    rows = []
    for label, (one, loop, many, scaled) in overhead().items():
        judged = label in OWN and "nsga2" not in label and np.isfinite(scaled)
        verdict = ("held" if scaled <= LIMIT else "MISSED") if judged else "-"
        cells = (f"{value:,.1f}" for value in (one, loop, many, scaled))
        rows.append((label, *cells, verdict))
    header = ("optimiser", "ask and tell", "in tk.optimise", f"each of {RESTARTS} restarts",
              f"ask and tell, where filterpy takes {REFERENCE_US}", f"at most {LIMIT:g}")  # fmt: skip
    table("microseconds of a generation", header, rows)
