"""NSGA-II: what it reaches on the ZDT problems, its operators beside Deb's program, constraints."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tracker as tk
from tracker_optimise import NSGA2, hypervolume
from tracker_optimise.variation import polynomial_step, simulated_binary

GIVEN = json.loads(
    (Path(__file__).parents[1] / "reference/data/nsga2/zdt.json").read_text(encoding="utf-8")
)


def zdt(g: Callable[[Any], Any], h: Callable[[Any, Any], Any], f: Any = None) -> Any:
    """Zitzler, Deb and Thiele 2000: f1(x1), f2 = g(x2...) h(f1, g)."""

    def cost(x: Any) -> Any:
        first = x[0] if f is None else f(x[0])
        rest = g(x[1:])
        return np.stack([first, rest * h(first, rest)])

    return cost


def mean9(x: Any) -> Any:
    return 1.0 + 9.0 * x.mean(axis=0)


def waves(x: Any) -> Any:
    return 1.0 + 10.0 * len(x) + (x**2 - 10.0 * np.cos(4.0 * np.pi * x)).sum(axis=0)


PROBLEMS = {
    "zdt1": zdt(mean9, lambda f, g: 1.0 - np.sqrt(f / g)),
    "zdt2": zdt(mean9, lambda f, g: 1.0 - (f / g) ** 2),
    "zdt3": zdt(mean9, lambda f, g: 1.0 - np.sqrt(f / g) - f / g * np.sin(10.0 * np.pi * f)),
    "zdt4": zdt(waves, lambda f, g: 1.0 - np.sqrt(f / g)),
    "zdt6": zdt(
        lambda x: 1.0 + 9.0 * x.mean(axis=0) ** 0.25,
        lambda f, g: 1.0 - (f / g) ** 2,
        lambda x: 1.0 - np.exp(-4.0 * x) * np.sin(6.0 * np.pi * x) ** 6,
    ),
}


def bounds_of(name: str) -> Any:
    rest = [-5.0, 5.0] if name == "zdt4" else [0.0, 1.0]
    return [[0.0, 1.0]] + [rest] * (GIVEN[name]["n_var"] - 1)


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_problems_are_those_of_the_reference(name: str) -> None:
    x, f = (np.array(GIVEN[name][key]).T for key in ("sample_X", "sample_F"))
    assert PROBLEMS[name](x) == pytest.approx(f, rel=1e-9)


@pytest.mark.slow
@pytest.mark.statistical
@pytest.mark.parametrize("name", PROBLEMS)
def test_it_reaches_the_hypervolumes_of_the_reference(name: str) -> None:
    """The median of ten restarts lies within the spread of the reference's ten seeds, or above.

    Medians, because about one restart in twenty misses one of the five pieces of ZDT3's front and
    never finds it again. False alarms: a median of ten falls below the smallest of ten others of the
    same distribution with probability 0.1 % (hypergeometric), over all problems 0.5 %.
    """
    found = tk.optimise(
        PROBLEMS[name], bounds_of(name), NSGA2(), evaluations=25000, restarts=10, seed=2
    )
    _, cost = found.survivors()
    volumes = [hypervolume(cost[:, :, k], GIVEN[name]["hv_ref"]) for k in range(10)]
    assert np.median(volumes) >= GIVEN[name]["nsga2_pop100_gen250"]["hv_min"], sorted(volumes)


def deb_crossover(y1: float, y2: float, u: float, index: float) -> tuple[float, float]:
    """realcross of Deb's program nsga2-gnuplot 1.1.6, in bounds 0 and 1, without its coins."""
    y1, y2 = min(y1, y2), max(y1, y2)
    children = []
    for beta in (1.0 + 2.0 * y1 / (y2 - y1), 1.0 + 2.0 * (1.0 - y2) / (y2 - y1)):
        alpha = 2.0 - beta ** -(index + 1.0)
        if u <= 1.0 / alpha:
            children.append((u * alpha) ** (1.0 / (index + 1.0)))
        else:
            children.append((1.0 / (2.0 - u * alpha)) ** (1.0 / (index + 1.0)))
    return (
        0.5 * (y1 + y2 - children[0] * (y2 - y1)),
        0.5 * (y1 + y2 + children[1] * (y2 - y1)),
    )


def deb_mutation(y: float, u: float, index: float) -> float:
    """real_mutate_ind of the same program: the step."""
    power = 1.0 / (index + 1.0)
    if u <= 0.5:
        return (2.0 * u + (1.0 - 2.0 * u) * (1.0 - y) ** (index + 1.0)) ** power - 1.0
    return 1.0 - (2.0 * (1.0 - u) + 2.0 * (u - 0.5) * y ** (index + 1.0)) ** power


def test_the_operators_are_those_of_debs_program() -> None:
    first, second, u = np.random.default_rng(3).uniform(size=(3, 400))
    first[:20], first[20:40] = 0.0, 1.0
    for index in (2.0, 15.0, 20.0):
        low, high = simulated_binary(first, second, u, index)
        step = polynomial_step(first, u, index)
        expected = [deb_crossover(*row, index) for row in zip(first, second, u, strict=True)]
        assert np.stack([low, high], axis=1) == pytest.approx(np.array(expected), abs=1e-12)
        wanted = [deb_mutation(*row, index) for row in zip(first, u, strict=True)]
        assert step == pytest.approx(wanted, abs=1e-12)
        assert (first + step >= 0.0).all()
        assert (first + step <= 1.0).all()
    same = simulated_binary(first, first, u, 15.0)
    assert np.array_equal(same[0], first)
    assert np.array_equal(same[1], first)


def binh_korn(x: Any) -> Any:
    """Binh and Korn 1997: two objectives, two constraints at most 0 where they hold."""
    return np.stack([
        4.0 * x[0] ** 2 + 4.0 * x[1] ** 2,
        (x[0] - 5.0) ** 2 + (x[1] - 5.0) ** 2,
        (x[0] - 5.0) ** 2 + x[1] ** 2 - 25.0,
        7.7 - (x[0] - 8.0) ** 2 - (x[1] + 3.0) ** 2,
    ])  # fmt: skip


def test_constraints_hold_for_what_survives() -> None:
    """And the front is that of the problem: x1 = x2 up to 3, then x2 = 3, where no constraint binds."""
    found = tk.optimise(
        binh_korn, [[0.0, 5.0], [0.0, 3.0]], NSGA2(constraints=2), evaluations=8000, seed=1
    )
    x, cost = found.survivors()
    assert (cost[2:] <= 0.0).all()
    f1, f2 = cost[0], cost[1]
    side = np.sqrt(np.maximum(f1 - 36.0, 0.0)) / 2.0
    best = np.where(f1 <= 72.0, 2.0 * (np.sqrt(f1 / 8.0) - 5.0) ** 2, (side - 5.0) ** 2 + 4.0)
    assert (f2 >= best - 1e-9).all()
    assert (f2 - best).max() < 1.5, "of a front that falls from 50 to 4"
    assert np.median(f2 - best) < 0.15
    assert np.ptp(f1) > 130.0
    assert np.array_equal(binh_korn(x), cost)


def test_where_nothing_is_feasible_the_least_violation_survives() -> None:
    def never(x: Any) -> Any:
        return np.stack([x[0], -x[0], 1.0 + (x[0] - 0.25) ** 2])

    found = tk.optimise(
        never, [[0.0, 1.0]], NSGA2(constraints=1, population=20), evaluations=1000, seed=1
    )
    x, _ = found.survivors()
    assert np.abs(x - 0.25).max() < 0.02


def test_a_candidate_with_half_a_cost_has_none() -> None:
    """If one objective is NaN, a good value of the other does not save the candidate."""

    def half(x: Any) -> Any:
        return np.stack(
            [np.where(x[0] < 0.5, -10.0, x[0]), np.where(x[0] < 0.5, np.nan, 1.0 - x[0])]
        )

    found = tk.optimise(half, [[0.0, 1.0]] * 2, NSGA2(population=20), evaluations=600, seed=4)
    x, cost = found.survivors()
    assert (x[0] >= 0.5).all()
    assert np.isfinite(cost).all()


def test_no_two_survivors_are_the_same() -> None:
    found = tk.optimise(PROBLEMS["zdt1"], [[0.0, 1.0]] * 3, NSGA2(population=20), evaluations=2000)
    x, _ = found.survivors()
    assert len(np.unique(x[:, :, 0], axis=1).T) == 20


def test_an_odd_population_is_refused() -> None:
    with pytest.raises(tk.TrackerError, match="even number"):
        NSGA2(population=25)
    assert NSGA2(objectives=3, constraints=2).rows == 5
    assert math.isclose(NSGA2().crossover_index, 15.0)
