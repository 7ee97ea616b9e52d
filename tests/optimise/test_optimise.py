"""The loop around optimisers: budgets, history, early ends, starts, files, and words for mistakes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import attrs
import numpy as np
import pytest

import tracker as tk
from tracker_optimise import CMAES, NSGA2, Genetic, Imperialist, ParticleSwarm

BOX = [[-1.0, 1.0]] * 4


def bowl(x: Any) -> Any:
    return ((x - 0.3) ** 2).sum(axis=0)


def rippled(x: Any) -> Any:
    return (x**2 - np.cos(9.0 * x) + 1.0).sum(axis=0)


def test_history_is_what_was_evaluated() -> None:
    seen: list[Any] = []

    def cost(x: Any) -> Any:
        seen.append(bowl(x))
        seen[-1][0, 1] = np.nan
        return seen[-1]

    found = tk.optimise(cost, BOX, "genetic", evaluations=230, restarts=3, seed=1)
    assert found.evaluated.tolist() == [50, 100, 150, 200, 230]
    assert [len(one) for one in seen] == [50, 50, 50, 50, 30]
    lowest = [np.nanmin(one, axis=0) for one in seen]
    assert np.array_equal(found.best[:, 0], np.minimum.accumulate(lowest))
    assert found.mean[:, 0] == pytest.approx(np.array([np.nanmean(one, axis=0) for one in seen]))
    assert found.reason == ("budget",) * 3
    assert found.best_cost == found.cost.min() == bowl(found.best_x)
    assert "3 restarts, 230 evaluations each, seed 1" in str(found)


def test_a_restart_that_has_ended_leaves_the_calls_and_keeps_its_result() -> None:
    shapes: list[Any] = []

    def cost(x: Any) -> Any:
        shapes.append(x.shape)
        return bowl(x)

    found = tk.optimise(cost, BOX, "genetic", evaluations=4000, restarts=6, seed=2, target=1e-3)
    ended = np.array([why == "target" for why in found.reason])
    assert (found.cost[0, ended] <= 1e-3).all()
    assert (found.cost[0, ~ended] > 1e-3).all()
    assert ended.any()
    assert len({n for *_, n in shapes}) > 2, "restarts should end at different times"
    assert sum(p * n for _, p, n in shapes) == found.evaluations.sum()
    for k in range(6):
        alone = tk.optimise(
            bowl, BOX, "genetic", evaluations=4000, restarts=[k], seed=2, target=1e-3
        )
        used = len(alone.evaluated)
        assert alone.evaluations[0] == found.evaluations[k]
        assert np.array_equal(alone.best[:, 0, 0], found.best[:used, 0, k])
        assert np.isnan(found.mean[used:, 0, k]).all()
        assert np.array_equal(alone.x[..., 0], found.x[..., k])


def test_patience_ends_a_search_that_gets_no_better() -> None:
    """On a flat cost nothing ever gets better, so that it ends after the first and ten more."""
    flat = tk.optimise(lambda x: 0.0 * x[0], BOX, "genetic", evaluations=5000, patience=10)
    assert flat.evaluations.tolist() == [11 * 50]
    assert flat.reason == ("stalled",)
    slow = tk.optimise(bowl, BOX, "particle_swarm", evaluations=5000, patience=10, tolerance=1.0)
    fast = tk.optimise(bowl, BOX, "particle_swarm", evaluations=5000, patience=10)
    assert slow.evaluations[0] < fast.evaluations[0]


@pytest.mark.parametrize("name", tk.optimisers.names())
def test_what_is_saved_and_resumed_equals_one_search(name: str, tmp_path: Path) -> None:
    optimiser = NSGA2(objectives=1, population=20) if name == "nsga2" else name
    options: dict[str, Any] = {"target": 2e-3, "patience": 40}
    whole = tk.optimise(bowl, BOX, optimiser, evaluations=1230, restarts=5, seed=3, **options)
    found = tk.optimise(bowl, BOX, optimiser, evaluations=317, restarts=5, seed=3, **options)
    for budget in (318, 318, 600, 1230, 1230):
        found = tk.load_optimisation(found.save(tmp_path / "search.npz"))
        found = tk.optimise(bowl, resume=found, evaluations=budget, **options)
    for field in ("x", "cost", "evaluated", "best", "mean", "evaluations", "waited", "pending"):
        a, b = getattr(whole, field), getattr(found, field)
        assert np.array_equal(a, b, equal_nan=True), field
    assert found.reason == whole.reason
    assert type(found.optimiser) is type(whole.optimiser)


def test_a_start_is_used_and_helps() -> None:
    start = np.full((4, 1), 0.2999)
    for name in ("genetic", "particle_swarm", "imperialist", "differential_evolution", "cma_es"):
        first = tk.optimise(bowl, BOX, name, evaluations=50, restarts=2, start=start)
        assert (first.best[0] <= bowl(start) + 1e-12).all(), name
    each = np.array([[0.1, 0.3]] * 4)[:, None]
    two = tk.optimise(bowl, BOX, "genetic", evaluations=50, restarts=2, start=each)
    assert two.cost[0, 1] < 1e-12 < two.cost[0, 0]


def test_restarts_begin_apart_and_one_can_be_asked_for_alone() -> None:
    four = tk.optimise(rippled, BOX, evaluations=400, restarts=4, seed=9)
    third = tk.optimise(rippled, BOX, evaluations=400, restarts=[2], seed=9)
    assert np.array_equal(third.x[..., 0], four.x[..., 2])
    assert len(set(four.cost[0])) == 4
    other = tk.optimise(rippled, BOX, evaluations=400, restarts=[2], seed=10)
    assert not np.array_equal(other.x, third.x)


def test_a_cost_may_leave_out_the_axis_of_objectives_when_there_is_one() -> None:
    a = tk.optimise(bowl, BOX, evaluations=200, seed=1)
    b = tk.optimise(lambda x: bowl(x)[None], BOX, evaluations=200, seed=1)
    assert np.array_equal(a.x, b.x)


def test_a_cost_that_is_nowhere_finite_ends_with_the_budget() -> None:
    for name in tk.optimisers.names():
        optimiser = NSGA2(objectives=1) if name == "nsga2" else name
        found = tk.optimise(lambda x: np.nan * x[0], BOX, optimiser, evaluations=300)
        assert found.evaluations.tolist() == [300]
        assert found.cost.tolist() == [[np.inf]]
        assert np.isnan(found.x).all()
        assert np.isnan(found.mean).all()


def test_cma_es_ends_by_itself_when_nothing_is_left_to_find() -> None:
    found = tk.optimise(bowl, BOX, CMAES(population=12), evaluations=50000, restarts=2)
    assert found.reason == ("finished", "finished")
    assert found.evaluations.max() < 10000
    assert found.best_cost < 1e-9


class Unknown(ParticleSwarm):
    pass


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: tk.optimise(bowl, BOX, evaluations=0), "argument 'evaluations'"),
        (lambda: tk.optimise(bowl, BOX, evaluations=2.5), "argument 'evaluations'"),
        (lambda: tk.optimise(bowl, evaluations=9), "argument 'bounds'"),
        (lambda: tk.optimise(bowl, BOX[0], evaluations=9), r"bounds: got shape \(2,\)"),
        (lambda: tk.optimise(bowl, [[1, 0]], evaluations=9), "bounds of parameter 0"),
        (lambda: tk.optimise(bowl, [[0, np.inf]], evaluations=9), "bounds of parameter 0"),
        (lambda: tk.optimise(bowl, BOX, evaluations=9, restarts=0), "argument 'restarts'"),
        (lambda: tk.optimise(bowl, BOX, evaluations=9, patience=0), "argument 'patience'"),
        (lambda: tk.optimise(bowl, BOX, evaluations=9, tolerance=np.nan), "argument 'tolerance'"),
        (lambda: tk.optimise(bowl, BOX, "particel_swarm", evaluations=9), "did you mean"),
        (lambda: tk.optimise(lambda x: x[:2], BOX, evaluations=9), r"expected \(objectives"),
        (lambda: tk.optimise(bowl, BOX, "nsga2", evaluations=9), r"= \(2, 9, 1\)"),
        (lambda: tk.optimise(bowl, BOX, evaluations=9, start=[[2.0]] * 4), "outside the bounds"),
        (lambda: tk.optimise(bowl, BOX, evaluations=9, start=[[0.0]] * 3), "to start from"),
        (lambda: tk.optimise(bowl, BOX, evaluations=9).survivors(), "no survivors"),
        (lambda: Genetic(population=2, elite=2), "parameter 'elite'"),
        (lambda: Genetic(selection="best"), "one of tournament"),
        (lambda: Genetic(mutation_rate=1.5), "mutation_rate"),
        (lambda: ParticleSwarm(inertia=(0.9, 0.4, 0.1)), "two numbers"),
        (lambda: Imperialist(imperialists=26), "at most half"),
    ],
)
def test_mistakes_are_told_in_words(call: Any, words: str) -> None:
    with pytest.raises(tk.TrackerError, match=words):
        call()


def test_what_is_resumed_brings_its_own_bounds() -> None:
    found = tk.optimise(bowl, BOX, evaluations=60)
    with pytest.raises(tk.TrackerError, match="leave it out"):
        tk.optimise(bowl, BOX, evaluations=90, resume=found)
    again = tk.optimise(bowl, evaluations=30, resume=found)
    assert again.evaluations.tolist() == [60], "a smaller budget is used up already"


@pytest.mark.parametrize(
    "given", [{"bounds": BOX}, {"optimiser": "genetic"}, {"restarts": 4}, {"seed": 0}, {"start": [[0.0]] * 4}],
    ids=lambda given: next(iter(given)),
)  # fmt: skip
def test_what_is_its_own_is_refused_beside_resume(given: dict[str, Any]) -> None:
    found = tk.optimise(bowl, BOX, evaluations=60)
    with pytest.raises(
        tk.TrackerError, match=f"argument '{next(iter(given))}': got a value beside"
    ):
        tk.optimise(bowl, evaluations=90, resume=found, **given)


@pytest.mark.parametrize("end", [{"target": 0.1}, {"patience": 3}])
def test_a_front_has_no_lowest_cost_to_watch(end: dict[str, Any]) -> None:
    def two(x: Any) -> Any:
        return np.stack([bowl(x), -bowl(x)])

    with pytest.raises(tk.TrackerError, match=r"NSGA2 with 2 objectives.*no lowest cost"):
        tk.optimise(two, BOX, "nsga2", evaluations=900, **end)


def test_what_breaks_a_constraint_is_not_at_the_target() -> None:
    """The bowl's bottom is at 0.3, and x must be 0.8: it costs 0.25 at least, and 0 is not allowed."""

    def bounded(x: Any) -> Any:
        return np.stack([(x[0] - 0.3) ** 2, 0.8 - x[0]])

    optimiser = NSGA2(objectives=1, constraints=1, population=20)
    options: dict[str, Any] = {"restarts": 3, "seed": 1}
    never = tk.optimise(bounded, BOX, optimiser, evaluations=2000, target=0.2, **options)
    assert never.reason == ("budget",) * 3
    found = tk.optimise(bounded, BOX, optimiser, evaluations=4000, target=0.251, **options)
    assert found.reason == ("target",) * 3
    x, cost = found.survivors()
    allowed = np.where(cost[1] <= 0.0, cost[0], np.inf)
    assert (allowed.min(axis=0) <= 0.251).all()
    assert (np.take_along_axis(x[0], allowed.argmin(axis=0)[None], axis=0) >= 0.8).all()
    # The lowest cost of all is soon 0; that of the allowed gets better for longer than that.
    stalled = tk.optimise(bounded, BOX, optimiser, evaluations=20000, patience=40, **options)
    assert stalled.reason == ("stalled",) * 3
    kept = stalled.survivors()[1]
    assert np.where(kept[1] <= 0.0, kept[0], np.inf).min(axis=0) == pytest.approx(0.25, abs=2e-3)

    def nowhere(x: Any) -> Any:
        return np.stack([x[0], 1.0 + 0.0 * x[0]])

    assert tk.optimise(nowhere, BOX, optimiser, evaluations=200, target=9.0).reason == ("budget",)


def test_a_file_names_an_optimiser_and_no_class(tmp_path: Path) -> None:
    found = tk.optimise(bowl, BOX, Unknown(), evaluations=60)
    with pytest.raises(tk.TrackerError, match="not registered"):
        found.save(tmp_path / "search.npz")
    chosen = attrs.evolve(ParticleSwarm(), inertia=(0.8, 0.3), neighbourhood="ring")
    saved = tk.optimise(bowl, BOX, chosen, evaluations=60).save(tmp_path / "search.npz")
    assert tk.load_optimisation(saved).optimiser == chosen
    tk.monte_carlo(
        tk.estimator(
            filter="kf", motion=tk.scenario("line").motion, sensor=tk.scenario("line").sensor
        ),
        tk.scenario("line"),
        runs=2,
    ).save(tmp_path / "campaign.npz")
    with pytest.raises(tk.TrackerError, match="expected an optimisation"):
        tk.load_optimisation(tmp_path / "campaign.npz")


def test_a_multi_objective_result_has_a_front_and_no_winner() -> None:
    found = tk.optimise(
        lambda x: np.stack([x[0], 1.0 - x[0] + x[1]]), [[0, 1]] * 2, "nsga2", evaluations=1000
    )
    x, cost = found.survivors()
    assert x.shape == (2, 100, 1)
    assert cost.shape == (2, 100, 1)
    assert found.x.shape == (2, 2, 1)
    with pytest.raises(tk.TrackerError, match="one objective"):
        _ = found.best_x
    assert "1000 evaluations" in str(found)
