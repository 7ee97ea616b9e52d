"""The genetic algorithm on real parameters: selection, crossover, reproduction, mutation."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any, ClassVar

import attrs
import numpy as np
import numpy.typing as npt

from tracker.errors import DomainError, wording
from tracker.types import Array, brief
from tracker_optimise import box, parameters, variation
from tracker_optimise.draws import Keys, uniforms

SELECTIONS = ("tournament", "rank", "roulette")
CROSSOVERS = ("one_point", "arithmetic", "blend", "simulated_binary")
MUTATIONS = ("gaussian", "uniform", "polynomial")

_LEAST = np.array(1e-300)
"""The quantile of 0 is infinite."""


@attrs.frozen(eq=False)
class Generation:
    """Children that wait for their cost, and the best of all before them, in the unit cube."""

    box: box.Box
    key: Keys = attrs.field(repr=brief)
    generation: int
    asked: Array = attrs.field(repr=brief)
    elite: Array = attrs.field(repr=brief)
    elite_cost: Array = attrs.field(repr=brief)


@attrs.frozen
class Genetic:
    """Genetic algorithm on real genes, with the usual operators to choose from.

    The population is ranked; parents are selected; a pair of them is crossed with probability
    ``crossover_rate``, or else reproduced (copied unchanged); each gene mutates with probability
    ``mutation_rate`` (None: one gene in a child on average). The ``elite`` best of all so far compete
    with the children and are not evaluated again.

    * ``selection``: "tournament" of ``contestants``; "rank", a roulette whose slots fall linearly
      with the rank, the best ``pressure`` times the average; "roulette", slots as large as a cost is
      better than the worst.
    * ``crossover``: "one_point", the thesis's: cut at one place and swap the tails; "arithmetic", a
      random weighted mean; "blend", each gene uniform between the parents' and ``blend`` times
      their difference beyond (BLX-alpha); "simulated_binary" with ``crossover_index``.
    * ``mutation``: "gaussian" with ``mutation_size`` times the width of the bounds, put back on them;
      "uniform" in the bounds; "polynomial" with ``mutation_index``.

    Raises:
        DomainError: for parameters out of range.

    Reference:
        Paper 4, section 3.1 (one point, two random parents, reproduction, mutation); Goldberg and Deb
        1991 (tournament); Baker 1985 (rank); Eshelman and Schaffer 1993 (blend); Deb and Agrawal 1995
        (simulated binary); Deb and Goyal 1996 (polynomial).

    Laws:
        With tournament or rank only comparisons of costs matter; a roulette sees differences of
        costs, so that an added constant changes it by rounding at most. See `tracker.testing`.
    """

    rows: ClassVar[int] = 1

    population: int = attrs.field(default=50, validator=parameters.count(2))
    selection: str = attrs.field(default="tournament", validator=parameters.one_of(SELECTIONS))
    crossover: str = attrs.field(default="one_point", validator=parameters.one_of(CROSSOVERS))
    mutation: str = attrs.field(default="gaussian", validator=parameters.one_of(MUTATIONS))
    crossover_rate: float = attrs.field(default=0.9, validator=parameters.number(0.0, 1.0))
    mutation_rate: float | None = attrs.field(
        default=None, validator=parameters.optional(parameters.number(0.0, 1.0))
    )
    elite: int = attrs.field(default=2, validator=parameters.count(0))
    contestants: int = attrs.field(default=2, validator=parameters.count(1))
    pressure: float = attrs.field(default=1.8, validator=parameters.number(1.0, 2.0, open_=True))
    blend: float = attrs.field(default=0.5, validator=parameters.number(0.0))
    crossover_index: float = attrs.field(default=15.0, validator=parameters.number(0.0))
    mutation_size: float = attrs.field(default=0.1, validator=parameters.number(0.0))
    mutation_index: float = attrs.field(default=20.0, validator=parameters.number(0.0))

    def __attrs_post_init__(self) -> None:
        if self.elite >= self.population:
            raise DomainError(
                wording("parameter 'elite'", got=self.elite, do="keep one or two",
                        expected=f"fewer than the population of {self.population}")
            )  # fmt: skip

    def begin(
        self,
        bounds: Any,
        *,
        rng: np.random.Generator | Sequence[np.random.Generator],
        restarts: tuple[int, ...] = (),
        start: Any = None,
    ) -> Generation:
        """A first population, uniform in the bounds."""
        first = box.begin(bounds, self.population, rng, restarts, start)
        elite = first.asked[:, : self.elite]
        nothing = np.full(elite.shape[1:], math.inf)
        return Generation(first.box, first.key, 0, first.asked, elite, nothing)

    def ask(self, memory: Generation) -> Array:
        """The children, ``(d, population, *restarts)``."""
        return memory.box.outside(memory.asked)

    def tell(self, memory: Generation, cost: Array) -> Generation:
        """The next generation, given the cost ``(1, population, *restarts)`` of this one."""
        d, count, *restarts = memory.asked.shape
        value = box.told(cost, memory.asked)[0]
        x, lanes = box.flat(memory.asked), value.shape[1]
        if self.elite:
            value = np.concatenate([value, memory.elite_cost.reshape(self.elite, lanes)])
            x = np.concatenate([x, box.flat(memory.elite)], axis=1)
        order = value.argsort(axis=0, kind="stable")
        kept = order[: self.elite]
        pairs = (count + 1) // 2
        genes = d * count
        turns = self.contestants if self.selection == "tournament" else 1
        per_gene = self.crossover in {"blend", "simulated_binary"}
        drawn = uniforms(
            memory.key,
            memory.generation,
            2 * pairs * turns + pairs + (2 * d if per_gene else 1) * pairs + genes,
        )
        select, cross, mix, which = box.parts(
            drawn, [2 * pairs * turns, pairs, (2 * d if per_gene else 1) * pairs, genes]
        )

        ranks = self._selected(select, value, order, count)
        parents = box.picked(x, order.take(ranks) if lanes == 1 else _at(order, ranks))
        children = self._crossed(parents, cross, mix)[:, :count]
        return Generation(
            memory.box,
            memory.key,
            memory.generation + 1,
            self._mutated(children, which).reshape(memory.asked.shape),
            box.picked(x, kept).reshape(d, self.elite, *restarts) if self.elite else memory.elite,
            _at(value, kept).reshape(self.elite, *restarts),
        )

    def _selected(
        self, u: Array, value: Array, order: npt.NDArray[np.intp], count: int
    ) -> npt.NDArray[np.intp]:
        """Ranks of the parents, ``(2 pairs, lanes)``, among the ``count`` best."""
        if self.selection == "tournament":
            drawn = u.reshape(self.contestants, len(u) // self.contestants, u.shape[1])
            lowest = functools.reduce(np.minimum, drawn)
            best: npt.NDArray[np.intp] = (lowest * count).astype(np.intp)
            return best
        if self.selection == "rank":
            # The density over rank / count falls on a line from s to 2 - s; its inverse distribution.
            s = self.pressure
            share = (s - np.sqrt(s * s - 4.0 * (s - 1.0) * u)) / (2.0 * (s - 1.0))
            return _places(share * count, count)
        sorted_ = _at(value, order[:count])
        top = np.where(np.isfinite(sorted_), sorted_, -math.inf).max(axis=0, initial=-math.inf)
        slots = np.where(np.isfinite(sorted_), top - sorted_, 0.0)
        edges = np.cumsum(slots, axis=0)
        all_ = edges[-1]
        even = np.arange(1.0, count + 1.0)[:, None]
        edges = np.where(all_ > 0.0, edges, even)  # all are equally good: each has one slot
        beyond = edges[:, None] <= u * edges[-1]
        return _places(np.add.reduce(beyond, axis=0, dtype=np.intp), count)

    def _crossed(self, parents: Array, cross: Array, mix: Array) -> Array:
        """Children of parents ``(d, 2 pairs, lanes)``, like them first those of one side, then of the other.

        ``mix`` is written over.
        """
        d, lanes, pairs = len(parents), parents.shape[2], len(cross)
        first, second = parents[:, :pairs], parents[:, pairs:]
        copied = cross >= self.crossover_rate
        if self.crossover == "one_point":
            # Cut after 1 to d - 1 genes; a cut after all of them leaves copies.
            mix *= d - 1
            mix[copied] = d
            tail, children = _genes(d) > mix, parents.copy()
            np.copyto(children[:, :pairs], second, where=tail)
            np.copyto(children[:, pairs:], first, where=tail)
            return children
        if self.crossover == "simulated_binary":
            spread, swap = mix.reshape(2, d, pairs, lanes)
            low, high = variation.simulated_binary(first, second, spread, self.crossover_index)
            # The pair is sorted by value: a fair coin for each gene says whose child is the lower.
            one, two = np.where(swap < 0.5, low, high), np.where(swap < 0.5, high, low)
            one, two = np.where(copied, first, one), np.where(copied, second, two)
        elif self.crossover == "blend":
            mix *= 1.0 + 2.0 * self.blend
            mix -= self.blend
            share = mix.reshape(2, d, pairs, lanes)
            one = _between(first, second, np.where(copied, 0.0, share[0]))
            two = _between(first, second, np.where(copied, 1.0, share[1]))
        else:
            one = _between(first, second, np.where(copied, 0.0, mix))
            two = _between(first, second, np.where(copied, 1.0, 1.0 - mix))
        return np.concatenate([one, two], axis=1)

    def _mutated(self, children: Array, which: Array) -> Array:
        """Children ``(d, P, lanes)`` with some genes mutated, given uniforms of as many numbers.

        A uniform that is below the rate chooses its gene; divided by the rate it is a uniform again,
        and says how the gene mutates.
        """
        rate = 1.0 / len(children) if self.mutation_rate is None else self.mutation_rate
        genes, chance = np.ascontiguousarray(children).ravel(), which.ravel()
        mutant = (chance < rate).nonzero()[0]
        u, before = chance[mutant] / (rate or 1.0), genes[mutant]
        if self.mutation == "gaussian":
            u = _quantile()(np.maximum(u, _LEAST, out=u))
            u *= self.mutation_size
            after = before + u
        elif self.mutation == "uniform":
            after = u
        else:
            before = variation.within(before)
            after = before + variation.polynomial_step(before, u, self.mutation_index)
        genes[mutant] = after
        return variation.within(genes)


@functools.cache
def _genes(count: int) -> npt.NDArray[np.intp]:
    """Their numbers, ``(d, 1, 1)``."""
    return np.arange(count)[:, None, None]


@functools.cache
def _quantile() -> Any:
    """That of the normal distribution; SciPy is imported when it is used first."""
    from scipy.special import ndtri

    return ndtri


def _between(first: Array, second: Array, share: Array) -> Array:
    """First where the share is 0, second where it is 1, exactly."""
    out: Array = (1.0 - share) * first
    out += share * second
    return out


def _places(slots: Any, count: int) -> npt.NDArray[np.intp]:
    """Slots as places; rounding may lead one beyond the last."""
    places: npt.NDArray[np.intp] = np.minimum(slots, count - 1).astype(np.intp)
    return places


def _at(x: Any, index: npt.NDArray[np.intp]) -> Any:
    """Entries of ``x (P, lanes)`` at places ``index (k, lanes)`` of their own lane."""
    lanes = x.shape[1]
    return x.take(index * lanes + np.arange(lanes)) if lanes != 1 else x.take(index)
