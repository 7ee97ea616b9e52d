"""One generation of each algorithm beside its description, written out in loops, with the same numbers."""

from __future__ import annotations

import math
from typing import Any

import attrs
import numpy as np
import pytest

import tracker as tk
from tracker_optimise import DifferentialEvolution, Genetic, Imperialist, ParticleSwarm, draws

UNIT = [[0.0, 1.0]] * 3


def begun(optimiser: Any, seed: int = 1, generations: int = 3, d: int = 3) -> tuple[Any, Any]:
    """A memory after some generations on rough ground, and the costs of what it asks for."""
    memory = optimiser.begin(UNIT[:1] * d, rng=np.random.default_rng(seed))
    for _ in range(generations):
        memory = optimiser.tell(memory, rough(optimiser.ask(memory)))
    return memory, rough(optimiser.ask(memory))


def rough(x: Any) -> Any:
    return (np.sin(37.0 * x) + 3.0 * (x - 0.4) ** 2).sum(axis=0)[None]


# ------------------------------------------------------------------------------ particle swarm
@pytest.mark.parametrize(
    "optimiser",
    [
        ParticleSwarm(population=9, generations=7),
        ParticleSwarm(population=9, neighbourhood="ring", neighbours=2),
        ParticleSwarm(population=9, constriction=True, cognitive=2.05, social=2.3),
    ],
)
def test_a_swarm_flies_as_equations_3_1_and_3_2_say(optimiser: ParticleSwarm) -> None:
    memory, cost = begun(optimiser)
    d, count = 3, optimiser.population
    r = draws.uniforms(memory.key, memory.generation, 2 * d * count).reshape(2, d, count)
    own, own_cost = memory.own.copy(), memory.own_cost.copy()
    for i in range(count):
        if cost[0, i] < own_cost[i]:
            own[:, i], own_cost[i] = memory.asked[:, i], cost[0, i]
    after = optimiser.tell(memory, cost)
    for i in range(count):
        if optimiser.neighbourhood == "global":
            around = range(count)
        else:
            around = [(i + k) % count for k in range(-2, 3)]
        guide = min(around, key=lambda j: own_cost[j])
        for j in range(d):
            x, v = memory.asked[j, i], memory.velocity[j, i]
            pull = optimiser.cognitive * r[0, j, i] * (own[j, i] - x)
            pull += optimiser.social * r[1, j, i] * (own[j, guide] - x)
            if optimiser.constriction:
                phi = optimiser.cognitive + optimiser.social
                v = 2.0 / abs(2.0 - phi - math.sqrt(phi**2 - 4.0 * phi)) * (v + pull)
            else:
                w = 0.9 + (0.4 - 0.9) * min(memory.generation / optimiser.generations, 1.0)
                v = w * v + pull
            v = min(max(v, -0.5), 0.5)
            inside = 0.0 <= x + v <= 1.0
            assert after.asked[j, i] == pytest.approx(min(max(x + v, 0.0), 1.0), abs=1e-14)
            assert after.velocity[j, i] == pytest.approx(v if inside else 0.0, abs=1e-14)


def test_the_constriction_is_that_of_clerc_and_kennedy() -> None:
    assert ParticleSwarm(constriction=True, cognitive=2.05, social=2.05)._constriction == (
        pytest.approx(0.72984, abs=1e-5)
    )
    with pytest.raises(tk.TrackerError, match="more than 4"):
        ParticleSwarm(constriction=True)


# --------------------------------------------------------------------------- genetic algorithm
def test_one_point_crossover_swaps_the_tails_and_reproduction_copies() -> None:
    rng = np.random.default_rng(6)
    first, second = rng.uniform(size=(2, 5, 300, 1))
    cross, cut = rng.uniform(size=(2, 300, 1))
    parents = np.concatenate([first, second], axis=1)
    children = Genetic(crossover_rate=0.7)._crossed(parents, cross, cut)
    cuts = []
    for k in range(300):
        one, two, a, b = (
            v[:, 0] for v in (children[:, k], children[:, k + 300], first[:, k], second[:, k])
        )
        if cross[k, 0] >= 0.7:
            assert np.array_equal([one, two], [a, b])
            continue
        cuts.append(int((one == a).sum()))
        assert np.array_equal(one, np.r_[a[: cuts[-1]], b[cuts[-1] :]])
        assert np.array_equal(two, np.r_[b[: cuts[-1]], a[cuts[-1] :]])
    assert set(cuts) == {1, 2, 3, 4}
    assert abs(len(cuts) - 210) < 5.0 * math.sqrt(300 * 0.21)


def test_the_elite_is_the_best_of_all_so_far() -> None:
    optimiser = Genetic(population=12, elite=3)
    memory = optimiser.begin(UNIT, rng=np.random.default_rng(3))
    seen = np.empty(0)
    for _ in range(8):
        cost = rough(optimiser.ask(memory))
        seen = np.sort(np.concatenate([seen, cost[0]]))
        memory = optimiser.tell(memory, cost)
        assert np.array_equal(memory.elite_cost, seen[:3])
        assert rough(memory.box.outside(memory.elite))[0] == pytest.approx(seen[:3], abs=1e-12)


@pytest.mark.statistical
@pytest.mark.parametrize("selection", ["tournament", "rank", "roulette"])
def test_parents_are_chosen_as_often_as_the_scheme_says(selection: str) -> None:
    """Chi-square over 10 ranks and 40,000 choices; false alarm 1e-4 each."""
    optimiser = Genetic(population=10, selection=selection, elite=0, contestants=3, pressure=1.6)
    value = np.array([0.0, 1.0, 1.5, 2.0, 4.0, 4.5, 7.0, 8.0, 9.0, 10.0])[:, None]
    turns = 3 if selection == "tournament" else 1
    u = np.random.default_rng(8).uniform(size=(40000 * turns, 1))
    chosen = optimiser._selected(u, value, np.arange(10)[:, None], 10)[:, 0]
    rank = np.arange(10)
    if selection == "tournament":
        share = ((10 - rank) ** 3 - (9 - rank) ** 3) / 1000.0
    elif selection == "rank":  # the line from 1.6 to 0.4, over each slot of a tenth
        share = (1.6 - 1.2 * (rank + 0.5) / 10.0) / 10.0
    else:
        share = (10.0 - value[:, 0]) / (10.0 - value[:, 0]).sum()
    seen = np.bincount(chosen, minlength=10)
    live = share > 0.0
    assert (seen[~live] == 0).all()
    from scipy.stats import chi2

    distance = ((seen - 40000 * share)[live] ** 2 / (40000 * share)[live]).sum()
    assert distance < chi2.ppf(1.0 - 1e-4, live.sum() - 1)


def test_blended_and_arithmetic_children_lie_where_they_must() -> None:
    for crossover, beyond in (("blend", 0.5), ("arithmetic", 0.0)):
        optimiser = Genetic(crossover=crossover, mutation_rate=0.0, blend=0.5)
        first, second = np.random.default_rng(2).uniform(0.4, 0.6, (2, 3, 500, 1))
        cross, mix = np.zeros((500, 1)), np.random.default_rng(4).uniform(size=(3000, 1))
        mix = mix if crossover == "blend" else mix[:500]
        both = optimiser._crossed(np.concatenate([first, second], axis=1), cross, mix)
        gap = np.abs(second - first) * beyond
        low = np.tile(np.minimum(first, second) - gap, (1, 2, 1))
        high = np.tile(np.maximum(first, second) + gap, (1, 2, 1))
        assert ((both >= low - 1e-15) & (both <= high + 1e-15)).all()
        reach = ((both - low) / (high - low)).ravel()
        assert reach.min() < 0.02
        assert reach.max() > 0.98
    assert both[:, :500] + both[:, 500:] == pytest.approx(first + second)  # arithmetic keeps sums


# ---------------------------------------------------------------------- imperialist competition
@attrs.define
class Empire:
    imperialist: int
    colonies: list[int]


def empires_of(memory: Any, count: int) -> list[Empire]:
    found = []
    for k, imperialist in enumerate(memory.ruler.tolist()):
        members = np.flatnonzero(memory.empire == k).tolist()
        if members:
            assert imperialist in members
            found.append(Empire(imperialist, [c for c in members if c != imperialist]))
    assert sum(1 + len(e.colonies) for e in found) == count
    return found


def competed(empires: list[Empire], cost: Any, u: Any, share: float) -> list[Empire]:
    """Exchange, total power, competition and collapse, as Atashpaz-Gargari and Lucas tell them."""
    for empire in empires:
        best = min(empire.colonies, key=lambda c: cost[c], default=empire.imperialist)
        if cost[best] < cost[empire.imperialist]:
            empire.colonies.remove(best)
            empire.colonies.append(empire.imperialist)
            empire.imperialist = best
    total = [
        cost[e.imperialist] + share * (np.mean(cost[e.colonies]) - 0.0 if e.colonies else 0.0)
        for e in empires
    ]
    lead = max(total) - np.array(total)
    p = lead / lead.sum() if lead.sum() > 0.0 else 0.0 * lead
    winner = int(np.argmax(p - u[: len(empires)]))
    weakest = int(np.argmax(total))
    if winner != weakest:
        loser = empires[weakest]
        if loser.colonies:
            lost = max(loser.colonies, key=lambda c: cost[c])
            loser.colonies.remove(lost)
            empires[winner].colonies.append(lost)
        else:
            empires[winner].colonies.append(loser.imperialist)
            loser.imperialist = -1
    for empire in empires:
        if empire is not empires[winner] and not empire.colonies and empire.imperialist >= 0:
            empires[winner].colonies.append(empire.imperialist)
            empire.imperialist = -1
    return [e for e in empires if e.imperialist >= 0]


@pytest.mark.parametrize("seed", range(5))
def test_empires_compete_as_published_until_one_is_left(seed: int) -> None:
    """Costs from 0, so that the published total power and ours are the same number."""
    optimiser = Imperialist(population=20, imperialists=4, share=0.3)
    rng = np.random.default_rng(seed)
    memory = optimiser.begin(UNIT, rng=rng)
    memory = optimiser.tell(memory, rng.uniform(size=(1, 20)))
    left = 4
    for _ in range(60):
        cost = rng.uniform(size=20)
        cost -= cost.min()
        before = empires_of(memory, 20)
        alive = [k for k in range(4) if (memory.empire == k).any()]
        u = draws.uniforms(memory.key, memory.generation, 4)[:, 0][alive]
        # A collapsed empire keeps its place among the numbers drawn.
        expected = competed(before, cost, u, optimiser.share)
        memory = optimiser.tell(memory, cost[None])
        after = empires_of(memory, 20)
        assert sorted((e.imperialist, sorted(e.colonies)) for e in after) == sorted(
            (e.imperialist, sorted(e.colonies)) for e in expected
        )
        left = len(after)
    assert left == 1


def test_empires_are_founded_in_proportion_to_power() -> None:
    optimiser = Imperialist(population=50, imperialists=3)
    cost = np.concatenate([[0.0, 6.0, 8.0], np.linspace(9.0, 20.0, 47)])[None]
    memory = optimiser.begin(UNIT, rng=np.random.default_rng(0))
    memory = optimiser.tell(memory, cost)
    assert memory.ruler.tolist() == [0, 1, 2]
    # Powers 8, 2 and 0 of 47 colonies: 37.6 and 9.4.
    assert np.bincount(memory.empire).tolist() == [1 + 38, 1 + 9, 1]


@pytest.mark.parametrize("d", [2, 3, 8])
def test_colonies_move_up_to_twice_the_way_and_off_by_at_most_45_degrees(d: int) -> None:
    optimiser = Imperialist(population=400, imperialists=1)
    rng = np.random.default_rng(d)
    x = rng.uniform(0.45, 0.55, (d, 400))
    there = np.zeros(400, dtype=np.intp)
    far, turn = rng.uniform(size=400), rng.uniform(size=(d + 1, 400))
    moved = optimiser._assimilated(x, there, far.copy(), turn.copy()) - x
    way = x[:, :1] - x
    length, distance = (np.sqrt((v**2).sum(axis=0)) for v in (moved[:, 1:], way[:, 1:]))
    assert length == pytest.approx(2.0 * far[1:] * distance, rel=1e-9)
    cosine = (moved * way).sum(axis=0)[1:] / (length * distance)
    assert cosine == pytest.approx(np.cos((turn[0, 1:] - 0.5) * math.pi / 2.0), abs=1e-9)
    assert cosine.min() < math.cos(0.98 * math.pi / 4)
    assert not moved[:, 0].any(), "an imperialist moves"


def test_a_world_of_one_dimension_has_no_side_to_turn_to() -> None:
    optimiser = Imperialist(population=10, imperialists=1)
    x = np.array([[0.5, 0.2, 0.9, 0.5]])
    there = np.zeros(4, dtype=np.intp)
    far, turn = np.full(4, 0.5), np.full((2, 4), 0.5)
    assert optimiser._assimilated(x, there, far.copy(), turn.copy()) == pytest.approx(
        np.full((1, 4), 0.5)
    )
    turn[0] = 0.9
    moved = optimiser._assimilated(x, there, far.copy(), turn.copy())
    assert np.abs(moved - (x + np.cos(0.4 * math.pi / 2.0) * (0.5 - x))).max() < 1e-9


def test_revolution_moves_the_share_of_colonies_that_is_asked_for() -> None:
    """2,000 colonies and a share of 0.3: within 5 standard deviations (false alarm 6e-7)."""
    still = Imperialist(population=2000, imperialists=5, assimilation=1e-12)
    stirred = attrs.evolve(still, revolution=0.3)
    memory, cost = begun(still, generations=1)
    after = stirred.tell(memory, cost)
    moved = (np.abs(after.asked - memory.asked) > 1e-9).any(axis=0)
    colonies = np.ones(2000, dtype=bool)
    colonies[after.ruler] = False
    assert not moved[~colonies].any()
    assert abs(moved.sum() - 0.3 * 1995) < 5.0 * math.sqrt(0.21 * 1995)


def test_a_restart_ends_when_its_world_is_one_empire() -> None:
    found = tk.optimise(
        rough, UNIT, Imperialist(population=20, imperialists=3, unite=True), evaluations=20000,
        restarts=6, seed=1,
    )  # fmt: skip
    assert set(found.reason) == {"finished"}
    assert (found.evaluations % 20 == 0).all()
    assert (found.memory.empire == found.memory.empire[:1]).all()


# ------------------------------------------------------------------------ differential evolution
def test_a_trial_vector_replaces_its_own_target_if_it_is_better() -> None:
    optimiser = DifferentialEvolution(population=12)
    memory, cost = begun(optimiser)
    after = optimiser.tell(memory, cost)
    kept = {
        tuple(memory.asked[:, i] if cost[0, i] < memory.kept_cost[i] else memory.kept[:, i])
        for i in range(12)
    }
    assert {tuple(column) for column in after.kept.T} == kept
    assert after.kept_cost[0] == after.kept_cost.min()
    assert rough(after.box.outside(after.kept))[0] == pytest.approx(after.kept_cost, abs=1e-12)


def test_trial_vectors_are_those_of_the_strategy() -> None:
    """rand1bin with crossing always: every trial is a + F (b - c) of three different others."""
    optimiser = DifferentialEvolution(
        population=6, strategy="rand1bin", mutation=(0.7, 0.7), recombination=1.0
    )
    x = np.random.default_rng(1).uniform(0.45, 0.55, (3, 6))
    trials = optimiser._trials(x, np.arange(6.0), 3)
    for k in range(6):
        others = [i for i in range(6) if i != k]
        made = [
            x[:, a] + 0.7 * (x[:, b] - x[:, c])
            for a in others for b in others for c in others if len({a, b, c}) == 3
        ]  # fmt: skip
        assert min(np.abs(trials[:, k] - one).max() for one in made) < 1e-12


# ----------------------------------------------------------------------- only the order matters
@pytest.mark.parametrize(
    "optimiser",
    [Genetic(), Genetic(selection="rank"), ParticleSwarm(), DifferentialEvolution()],
    ids=lambda o: type(o).__name__,
)
def test_only_the_order_of_costs_matters_where_that_is_said(optimiser: Any) -> None:
    a = b = optimiser.begin(UNIT, rng=np.random.default_rng(4))
    for _ in range(6):
        cost = rough(optimiser.ask(a))
        a, b = optimiser.tell(a, cost), optimiser.tell(b, np.exp(3.0 * cost))
        assert np.array_equal(optimiser.ask(a), optimiser.ask(b))
