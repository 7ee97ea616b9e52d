"""Dominance, fronts, crowding and hypervolume: hand cases, and definitions written out in loops."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from tracker.errors import ShapeError
from tracker_optimise import crowding, fronts, hypervolume
from tracker_optimise.sorting import dominance

GIVEN = json.loads(
    (Path(__file__).parents[1] / "reference/data/nsga2/zdt.json").read_text(encoding="utf-8")
)


def test_the_hand_case_of_sorting() -> None:
    case = GIVEN["sorting"]
    cost = np.array(case["F"]).T
    assert [front.tolist() for front in fronts(cost)] == case["fronts"]
    assert hypervolume(cost, [6.0, 7.0]) == pytest.approx(case["hv_ref_6_7"], abs=1e-12)


def test_the_hand_case_of_crowding() -> None:
    case = GIVEN["crowding"]
    textbook = [math.inf if d is None else 2.0 * d for d in case["cd_pymoo"]]
    assert crowding(np.array(case["F"]).T) == pytest.approx(textbook, abs=1e-12)


def beats(f: np.ndarray, v: np.ndarray, i: int, j: int) -> bool:
    """Definition 1 of Deb et al. 2002."""
    if v[i] == 0.0 and v[j] == 0.0:
        return bool(np.all(f[:, i] <= f[:, j]) and np.any(f[:, i] < f[:, j]))
    return bool(v[i] < v[j])


@pytest.mark.parametrize("objectives", [1, 2, 3])
@pytest.mark.parametrize("constrained", [False, True])
def test_fronts_are_those_of_the_definition(objectives: int, constrained: bool) -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        f = rng.integers(0, 6, (objectives, 17)).astype(float)  # ties are common
        v = np.maximum(rng.integers(-4, 4, 17), 0).astype(float) if constrained else np.zeros(17)
        left, expected = set(range(17)), []
        while left:
            front = [j for j in sorted(left) if not any(beats(f, v, i, j) for i in left)]
            expected.append(front)
            left -= set(front)
        found = [front.tolist() for front in fronts(f, v)]
        assert found == expected
        enough = fronts(f, v, enough=8)
        assert [front.tolist() for front in enough] == expected[: len(enough)]
        assert sum(map(len, enough[:-1])) < 8 <= sum(map(len, enough))


def test_an_infinite_cost_is_in_the_last_front_and_does_no_harm() -> None:
    f = np.array([[1.0, 2.0, np.inf, np.inf, 3.0], [3.0, 2.0, np.inf, np.inf, 1.0]])
    assert [front.tolist() for front in fronts(f)] == [[0, 1, 4], [2, 3]]
    assert not np.isnan(crowding(np.full((2, 5), np.inf))).any()


def test_equal_candidates_do_not_dominate_each_other() -> None:
    assert not dominance([[1.0, 1.0], [2.0, 2.0]]).any()


def test_crowding_of_the_definition() -> None:
    rng = np.random.default_rng(6)
    f = rng.uniform(size=(3, 12))
    expected = np.zeros(12)
    for row in f:
        order = np.argsort(row)
        expected[order[0]] = expected[order[-1]] = math.inf
        for k in range(1, 11):
            gap = row[order[k + 1]] - row[order[k - 1]]
            expected[order[k]] += gap / (row.max() - row.min())
    assert crowding(f) == pytest.approx(expected, rel=1e-12)


def test_an_objective_that_is_the_same_for_all_says_nothing() -> None:
    told = crowding([[0.0, 1.0, 4.0], [2.0, 2.0, 2.0]])
    assert told[1] in {1.0, math.inf}
    assert not np.isnan(told).any()


@pytest.mark.parametrize("name", ["zdt1", "zdt2"])
def test_hypervolume_of_a_fine_front_is_the_analytic_one(name: str) -> None:
    f1 = np.linspace(0.0, 1.0, 20001)
    f2 = 1.0 - np.sqrt(f1) if name == "zdt1" else 1.0 - f1**2
    exact = GIVEN["analytic_hv_ref_1.1"][name]
    assert hypervolume([f1, f2], [1.1, 1.1]) == pytest.approx(exact, abs=1e-4)


def test_hypervolume_in_three_dimensions_is_that_of_a_union_of_boxes() -> None:
    rng = np.random.default_rng(7)
    corners = rng.integers(0, 6, (3, 9)).astype(float)
    cells = np.stack(np.meshgrid(*[np.arange(7)] * 3, indexing="ij")).reshape(3, -1)
    inside = (corners[:, :, None] <= cells[:, None]).all(axis=0).any(axis=0)
    assert hypervolume(corners, [7.0, 7.0, 7.0]) == inside.sum()


def test_what_does_not_reach_the_reference_has_no_volume() -> None:
    assert hypervolume([[2.0], [0.0]], [1.0, 1.0]) == 0.0
    assert hypervolume(np.empty((2, 0)), [1.0, 1.0]) == 0.0
    assert hypervolume([[0.25, 0.5]], [1.0]) == 0.75


def test_costs_of_several_restarts_are_refused_in_words() -> None:
    with pytest.raises(ShapeError, match="one restart"):
        fronts(np.zeros((2, 4, 3)))
