"""Laws of optimisers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import strategies as st

from tracker.optimisation import Optimisation, optimise
from tracker.testing.calls import Call, Given, calls_of
from tracker.testing.law import Case, agree, law
from tracker.types import Array

_D = 3
_GENERATIONS = 4


def _bounds(case: Case, d: int = _D) -> Array:
    """Bounds near and far, narrow and wide."""
    width = 10.0 ** case.rng.uniform(-3.0, 3.0, d)
    low = case.rng.uniform(-2.0, 2.0, d) * 10.0 ** case.rng.uniform(-3.0, 3.0, d)
    return np.stack([low, low + width], axis=1)


def _told(optimiser: Any, case: Case, batch: tuple[int, ...] = ()) -> Array:
    """Costs of some generations; sums and differences of them are exact in floating point."""
    shape = (_GENERATIONS, optimiser.rows, optimiser.population, *batch)
    return case.rng.integers(-(2**20), 2**20, shape) / 2.0**10


def _walk(optimiser: Any, seeds: Array, bounds: Array, told: Array, start: Any = None) -> Array:
    """What is asked, ``(generations + 1, d, population, *restarts)``, given what is told."""
    rngs = [np.random.default_rng(int(seed)) for seed in seeds.reshape(-1)]
    memory = optimiser.begin(bounds, rng=rngs, restarts=seeds.shape, start=start)
    asked = [optimiser.ask(memory)]
    for cost in told:
        memory = optimiser.tell(memory, cost)
        asked.append(optimiser.ask(memory))
    return np.stack(asked)


def _seeds(case: Case, batch: tuple[int, ...] = ()) -> Array:
    return np.asarray(case.rng.integers(0, 2**32, batch))


@calls_of("optimiser")
def optimiser_calls(optimiser: Any, case: Case, batch: tuple[int, ...]) -> list[Call]:
    """How an optimiser is called."""
    given = (
        Given("seeds", _seeds(case, (1, *batch)), 1),
        Given("bounds", _bounds(case), None),
        Given("cost", _told(optimiser, case, batch), 3),
    )

    def walk(one: Any, seeds: Array, *arguments: Any) -> tuple[Array]:
        return (_walk(one, seeds.reshape(seeds.shape[1:]), *arguments),)

    return [Call("ask after tell", walk, given, (3,), batch)]


def _bowl(optimiser: Any, bottom: Array, seen: list[Array] | None = None) -> Callable[[Array], Any]:
    """The squared distance from the bottom, in every objective, and no constraint violated."""
    objectives = getattr(optimiser, "objectives", optimiser.rows)

    def cost(x: Array) -> Array:
        if seen is not None:
            seen.append(x)
        height = ((x - bottom.reshape(-1, *(1,) * (x.ndim - 1))) ** 2).sum(axis=0)
        out = np.full((optimiser.rows, *x.shape[1:]), -1.0)
        out[:objectives] = height
        return out

    return cost


def _same(one: Optimisation, other: Optimisation, told: str) -> None:
    for name in ("x", "cost", "evaluated", "best", "mean", "evaluations"):
        a, b = (np.asarray(getattr(result, name)) for result in (one, other))
        assert np.array_equal(a, b, equal_nan=True), f"{told} ({name} differs)"


@law("optimiser", name="stays in bounds", examples=6)
def stays_in_bounds(optimiser: Any, case: Case) -> None:
    """Candidates are ``(d, population, *restarts)`` and never outside the bounds, whatever is told."""
    for batch in ((), (3,), (2, 0)):
        for d in (1, _D):
            bounds = _bounds(case, d)
            if d > 1:
                bounds[1, 1] = bounds[1, 0]  # a parameter that is held
            told = _told(optimiser, case, batch)
            told[case.rng.uniform(size=told.shape) < 0.2] = np.nan
            told[1], told[2] = np.nan, np.inf
            asked = _walk(optimiser, _seeds(case, batch), bounds, told)
            wanted = (_GENERATIONS + 1, d, optimiser.population, *batch)
            assert asked.shape == wanted, f"asks for shape {asked.shape[1:]}, not {wanted[1:]}"
            low, high = bounds.T.reshape(2, d, *(1,) * (1 + len(batch)))
            assert np.isfinite(asked).all(), "a candidate is not finite"
            assert ((asked >= low) & (asked <= high)).all(), "a candidate is outside the bounds"


@law("optimiser", name="budget is exact", examples=6)
def budget_is_exact(optimiser: Any, case: Case) -> None:
    """The cost is evaluated as often as was allowed, less only where a restart came to its end."""
    budget = case.draw(st.integers(1, 4 * optimiser.population))
    seen: list[Array] = []
    cost = _bowl(optimiser, np.zeros(_D), seen)
    bounds = np.array([[-1.0, 1.0]] * _D)
    found = optimise(cost, bounds, optimiser, evaluations=budget, restarts=2, seed=budget)
    asked = sum(x.shape[1] * x.shape[2] for x in seen)
    assert asked == found.evaluations.sum(), (
        "the result does not tell how often the cost was called"
    )
    for used, why in zip(found.evaluations, found.reason, strict=True):
        assert used == budget or (used < budget and why == "finished"), (
            f"{used} evaluations of a budget of {budget}, ended by {why}"
        )


@law("optimiser", name="best never gets worse", examples=4)
def best_never_gets_worse(optimiser: Any, case: Case) -> None:
    """The best so far never gets worse, and is the cost of the candidate that is said to have it."""
    bounds, seed = _bounds(case), int(_seeds(case))
    cost = _bowl(optimiser, bounds.mean(axis=1))
    found = optimise(
        cost, bounds, optimiser, evaluations=5 * optimiser.population, restarts=3, seed=seed
    )
    assert (np.diff(found.best, axis=0) <= 0.0).all(), "the best so far gets worse"
    assert np.array_equal(found.best[-1], found.cost), "the history ends at another cost"
    for row in range(optimiser.rows):
        again = cost(found.x[:, row])[row]
        assert np.array_equal(again, found.cost[row]), "the best candidate has another cost"


@law("optimiser", name="a constant added changes nothing", examples=4)
def constant_added(optimiser: Any, case: Case) -> None:
    """A constant added to the objectives changes no bit of what is asked, where the sums are exact."""
    seeds, bounds, told = _seeds(case, (2,)), _bounds(case), _told(optimiser, case, (2,))
    moved = told.copy()
    moved[:, : getattr(optimiser, "objectives", optimiser.rows)] += float(
        2 ** case.rng.integers(8, 20)
    )
    assert np.array_equal(
        _walk(optimiser, seeds, bounds, told), _walk(optimiser, seeds, bounds, moved)
    ), "a constant added to the cost changes what is asked: use differences, or the order"


@law("optimiser", name="follows its bounds", examples=4)
def follows_its_bounds(optimiser: Any, case: Case) -> None:
    """In bounds that are moved and widened, candidates with the same costs move and widen with them."""
    seeds, told = _seeds(case), _told(optimiser, case)
    unit, bounds = np.array([[0.0, 1.0]] * _D), _bounds(case)
    low, width = bounds[:, :1], bounds[:, 1:] - bounds[:, :1]
    here = _walk(optimiser, seeds, unit, told)
    there = (_walk(optimiser, seeds, bounds, told) - low) / width
    # What is left of a parameter after its bounds are far from 0 and close together.
    rounding = 1e-15 * (np.abs(bounds) / width).max()
    agree(there, here, 1e-9 + rounding, "the search depends on units or origin", scale=1.0)


@law("optimiser", name="independent of its company", examples=4)
def independent_of_its_company(optimiser: Any, case: Case) -> None:
    """The same seed gives a restart the same bits, alone or in any company."""
    seeds, bounds, told = _seeds(case, (3,)), _bounds(case), _told(optimiser, case, (3,))
    together = _walk(optimiser, seeds, bounds, told)
    for k in range(3):
        alone = _walk(optimiser, seeds[k], bounds, told[..., k])
        assert np.array_equal(alone, together[..., k]), (
            f"restart {k} asks for something else when it is alone: key its numbers by its own rng"
        )
    two = _walk(optimiser, seeds[:2] * 0 + seeds[0], bounds, told[..., :1].repeat(2, axis=-1))
    assert np.array_equal(two[..., 0], two[..., 1]), "equal restarts differ"
    assert not np.array_equal(together[..., 0], together[..., 1]), (
        "restarts with different generators ask for the same: they are not independent"
    )


@law("optimiser", name="NaN is the worst cost", examples=4)
def nan_is_the_worst(optimiser: Any, case: Case) -> None:
    """A cost of NaN has the effect of an infinite one, and is never the best."""
    seeds, bounds, told = _seeds(case, (2,)), _bounds(case), _told(optimiser, case, (2,))
    holes = case.rng.uniform(size=told.shape) < 0.3
    missing, infinite = (
        _walk(optimiser, seeds, bounds, np.where(holes, hole, told)) for hole in (np.nan, np.inf)
    )
    assert np.array_equal(missing, infinite), "NaN is told apart from infinity"
    bowl = _bowl(optimiser, np.zeros(_D))

    def half(x: Array) -> Any:
        return np.where(x[0] < 0.1, np.nan, bowl(x))

    found = optimise(
        half,
        np.array([[-1.0, 1.0]] * _D),
        optimiser,
        evaluations=6 * optimiser.population,
        seed=int(seeds[0]),
    )
    assert np.isfinite(found.cost).all(), "the best cost is NaN or infinite"
    assert (found.x[0] >= 0.1).all(), "the best candidate has a cost of NaN"


@law("optimiser", name="starts where it is told", examples=3)
def starts_where_told(optimiser: Any, case: Case) -> None:
    """The first of the individuals to start from is asked for first."""
    bounds = _bounds(case)
    share = case.rng.uniform(size=(_D, 2, 3))
    low, width = bounds[:, :1, None], np.diff(bounds, axis=1)[:, :, None]
    start = np.minimum(low + share * width, bounds[:, 1:, None])
    none = np.empty((0, optimiser.rows, optimiser.population, 3))
    asked = _walk(optimiser, _seeds(case, (3,)), bounds, none, start)[0]
    gap = np.abs(asked[:, :1] - start[:, :1]) / width
    rounding = 1e-15 * float((np.abs(bounds) / width[:, 0]).max())
    assert gap.max() <= 1e-12 + rounding, "what is given to start from is not asked for first"


@law("optimiser", name="resumes", examples=3)
def resumes(optimiser: Any, case: Case) -> None:
    """A search that is cut off anywhere and resumed equals one that is not."""
    whole = 4 * optimiser.population
    cuts = sorted(case.draw(st.integers(1, whole)) for _ in range(2))
    bounds, seed = _bounds(case), int(_seeds(case))
    cost = _bowl(optimiser, bounds.mean(axis=1))
    once = optimise(cost, bounds, optimiser, evaluations=whole, restarts=2, seed=seed)
    found = optimise(cost, bounds, optimiser, evaluations=cuts[0], restarts=2, seed=seed)
    for budget in (cuts[1], whole):
        found = optimise(cost, evaluations=budget, resume=found)
    _same(once, found, f"cut off after {cuts} evaluations and resumed, it ends elsewhere")


@law("optimiser", name="finds the bottom of a bowl", examples=2)
def finds_the_bottom(optimiser: Any, case: Case) -> None:
    """In 60 generations, four parameters and three restarts it comes far nearer than chance does.

    At populations of 50, the best of as many uniform candidates has a median squared distance of
    0.016; 0.002 is asked for.
    """
    bottom = case.rng.uniform(-0.6, 0.6, 4)
    found = optimise(
        _bowl(optimiser, bottom),
        np.array([[-1.0, 1.0]] * 4),
        optimiser,
        evaluations=60 * optimiser.population,
        restarts=3,
        seed=int(_seeds(case)),
    )
    lowest = float(found.cost[0].min())
    assert lowest < 2e-3, f"the bottom of a bowl is missed: the best cost is {lowest:.3g}, not 0"
