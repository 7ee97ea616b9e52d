"""NSGA-II: several objectives at once, by non-dominated sorting, crowding and constraint domination."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np
import numpy.typing as npt

from tracker.types import Array, brief
from tracker_optimise import box, parameters, sorting, variation
from tracker_optimise.draws import Keys, uniforms


@attrs.frozen(eq=False)
class Parents:
    """Children that wait for their cost, and their parents, best first, in the unit cube."""

    box: box.Box
    key: Keys = attrs.field(repr=brief)
    generation: int
    asked: Array = attrs.field(repr=brief)
    kept: Array = attrs.field(repr=brief)
    kept_cost: Array = attrs.field(repr=brief)


@attrs.frozen
class NSGA2:
    """Non-dominated sorting genetic algorithm II, with constraints.

    The cost of a candidate is its ``objectives``, all to be minimised, and below them its
    ``constraints``: numbers that are at most 0 where the constraint holds. Parents and children
    together are sorted into fronts; within a front the least crowded come first; the best half
    goes on. Parents of the next children win tournaments of two, in which everybody takes part
    twice; children come from simulated binary crossover and polynomial mutation.

    ``mutation_rate=None`` mutates one parameter in a child on average.

    Where the best front is in pieces, one may be lost early and is not found again: of ZDT3's five, in
    8 of 320 restarts of 250 generations. It is not the method alone: pymoo 0.6.2 lost none in 258, and with its
    tournament, by dominance and not by front (Deb's program, too; the paper prints the front), this
    program loses one in 2 of 240. Restarts are the remedy.

    Raises:
        DomainError: for parameters out of range; the population must be even.

    Reference:
        Deb, Pratap, Agarwal and Meyarivan, A fast and elitist multiobjective genetic algorithm:
        NSGA-II, 2002. A parameter is crossed with probability 1/2, as in Deb's program. Its indices
        of distribution are 20 and 20; 15 and 20 are what is commonly used, and the default.
        Violations of several constraints are added.

    Laws:
        Only comparisons of objectives decide, and differences within a front. See
        `tracker.testing`, kind optimiser.
    """

    population: int = attrs.field(default=100, validator=parameters.count(4, even=True))
    objectives: int = attrs.field(default=2, validator=parameters.count(1))
    constraints: int = attrs.field(default=0, validator=parameters.count(0))
    crossover_rate: float = attrs.field(default=0.9, validator=parameters.number(0.0, 1.0))
    crossover_index: float = attrs.field(default=15.0, validator=parameters.number(0.0))
    mutation_rate: float | None = attrs.field(
        default=None, validator=parameters.optional(parameters.number(0.0, 1.0))
    )
    mutation_index: float = attrs.field(default=20.0, validator=parameters.number(0.0))

    @property
    def rows(self) -> int:
        """How many numbers the cost of a candidate has: objectives, then constraints."""
        return self.objectives + self.constraints

    def begin(
        self,
        bounds: Any,
        *,
        rng: np.random.Generator | Sequence[np.random.Generator],
        restarts: tuple[int, ...] = (),
        start: Any = None,
    ) -> Parents:
        """A first population, uniform in the bounds."""
        first = box.begin(bounds, self.population, rng, restarts, start)
        nothing = np.full((self.rows, *first.asked.shape[1:]), math.inf)
        return Parents(first.box, first.key, 0, first.asked, first.asked, nothing)

    def ask(self, memory: Parents) -> Array:
        """The children, ``(d, population, *restarts)``."""
        return memory.box.outside(memory.asked)

    def survivors(self, memory: Parents) -> tuple[Array, Array]:
        """The best so far, best first: ``(d, population, *restarts)`` and their cost ``(rows, ...)``."""
        return memory.box.outside(memory.kept), memory.kept_cost

    def tell(self, memory: Parents, cost: Array) -> Parents:
        """The next children, given the cost ``(rows, population, *restarts)`` of these."""
        shape = memory.asked.shape
        d, count = shape[:2]
        value = box.told(cost, memory.asked, self.rows)
        value = np.where(np.isinf(value).any(axis=0), math.inf, value)  # half a cost is none
        lanes = value.shape[2]
        x = np.concatenate([box.flat(memory.asked), box.flat(memory.kept)], axis=1)
        value = np.concatenate([value, memory.kept_cost.reshape(value.shape)], axis=1)
        order = np.empty((count, lanes), dtype=np.intp)
        for lane in range(lanes):
            order[:, lane] = self._best(x[:, :, lane], value[:, :, lane])
        kept, kept_cost = box.picked(x, order), box.picked(value, order)

        half = count // 2
        u = uniforms(memory.key, memory.generation, 2 * count + half + 3 * d * half + 2 * d * count)
        duels, cross, mix, which, how = box.parts(
            u, [2 * count, half, 3 * d * half, d * count, d * count]
        )
        places = variation.permutations(duels.reshape(count, 2, lanes))
        winners = np.minimum(places[::2], places[1::2])  # parents are sorted: the first is better
        first, second = (box.picked(kept, winners[:, side]) for side in (0, 1))
        spread, swap, touched = mix.reshape(3, d, half, lanes)
        one, two = variation.simulated_binary(first, second, spread, self.crossover_index)
        one, two = np.where(swap < 0.5, one, two), np.where(swap < 0.5, two, one)
        crossed = (cross < self.crossover_rate) & (touched < 0.5)
        one, two = np.where(crossed, one, first), np.where(crossed, two, second)
        children = variation.within(np.concatenate([one, two], axis=1))
        rate = 1.0 / d if self.mutation_rate is None else self.mutation_rate
        step = variation.polynomial_step(children, how.reshape(children.shape), self.mutation_index)
        children += np.where(which.reshape(children.shape) < rate, step, 0.0)
        return Parents(
            memory.box,
            memory.key,
            memory.generation + 1,
            variation.within(children).reshape(shape),
            kept.reshape(shape),
            kept_cost.reshape(self.rows, *shape[1:]),
        )

    def _best(self, x: Array, value: Array) -> npt.NDArray[np.intp]:
        """Places of the better half, best first."""
        objectives, limits = value[: self.objectives], value[self.objectives :]
        violation = np.add.reduce(np.maximum(limits, 0.0), axis=0)
        violation[_repeated(x)] = math.inf
        order: list[npt.NDArray[np.intp]] = []
        for front in sorting.fronts(objectives, violation, self.population):
            alone = -sorting.crowding(objectives[:, front])
            order.append(front[alone.argsort(kind="stable")])
        return np.concatenate(order)[: self.population]


def _repeated(x: Array) -> npt.NDArray[np.bool_]:
    """Which individuals ``(d, N)`` are the same as one before."""
    rows = np.ascontiguousarray(x.T)
    _, first = np.unique(rows.view(f"V{rows.itemsize * len(x)}")[:, 0], return_index=True)
    out = np.ones(len(rows), dtype=bool)
    out[first] = False
    return out
