"""Differential evolution, asked and told: SciPy mutates and crosses, selection is done here."""

from __future__ import annotations

import inspect
import math
from collections.abc import Sequence
from typing import Any, ClassVar

import attrs
import numpy as np

from tracker.types import Array, brief
from tracker_optimise import box, parameters
from tracker_optimise.draws import Keys, uniforms

STRATEGIES = tuple(
    f"{base}{differences}{crossing}"
    for crossing in ("bin", "exp")
    for base, differences in (
        ("best", 1), ("best", 2), ("rand", 1), ("rand", 2), ("randtobest", 1), ("currenttobest", 1),
    )
)  # fmt: skip


@attrs.frozen(eq=False)
class Vectors:
    """Trial vectors that wait for their cost, and the population they challenge, in the unit cube."""

    box: box.Box
    key: Keys = attrs.field(repr=brief)
    generation: int
    asked: Array = attrs.field(repr=brief)
    kept: Array = attrs.field(repr=brief)
    kept_cost: Array = attrs.field(repr=brief)


class _TrialsAreKnown(Exception):
    """SciPy has handed over the trial vectors."""


@attrs.frozen
class DifferentialEvolution:
    """Differential evolution: `scipy.optimize.differential_evolution`, one generation at a time.

    SciPy is given the population, its ranks as costs, and one generation to go; the trial vectors
    that it wants evaluated are what `ask` returns. A trial vector replaces its target if its cost is
    lower. ``mutation`` is drawn anew between its two values in every generation.

    Raises:
        DomainError: for parameters out of range.

    Reference:
        Storn and Price 1997; the strategies are those of SciPy.

    Laws:
        Only comparisons of costs matter. See `tracker.testing`, kind optimiser.
    """

    rows: ClassVar[int] = 1

    population: int = attrs.field(default=50, validator=parameters.count(5))
    strategy: str = attrs.field(default="best1bin", validator=parameters.one_of(STRATEGIES))
    mutation: tuple[float, float] = attrs.field(
        default=(0.5, 1.0), converter=tuple, validator=parameters.span(0.0, 2.0)
    )
    recombination: float = attrs.field(default=0.7, validator=parameters.number(0.0, 1.0))

    def begin(
        self,
        bounds: Any,
        *,
        rng: np.random.Generator | Sequence[np.random.Generator],
        restarts: tuple[int, ...] = (),
        start: Any = None,
    ) -> Vectors:
        """A first population, uniform in the bounds."""
        first = box.begin(bounds, self.population, rng, restarts, start)
        nothing = np.full(first.asked.shape[1:], math.inf)
        return Vectors(first.box, first.key, 0, first.asked, first.asked, nothing)

    def ask(self, memory: Vectors) -> Array:
        """The trial vectors, ``(d, population, *restarts)``."""
        return memory.box.outside(memory.asked)

    def tell(self, memory: Vectors, cost: Array) -> Vectors:
        """The next trial vectors, given the cost ``(1, population, *restarts)`` of these."""
        shape = memory.asked.shape
        value = box.told(cost, memory.asked)[0]
        before = memory.kept_cost.reshape(value.shape)
        better = value < before
        kept = np.where(better, box.flat(memory.asked), box.flat(memory.kept))
        value = np.where(better, value, before)
        # The best comes first: SciPy would swap it there, and trials answer to places.
        best = value.argmin(axis=0)
        order = np.repeat(np.arange(shape[1])[:, None], value.shape[1], axis=1)
        np.put_along_axis(order, best[None], 0, axis=0)
        order[0] = best
        kept = box.picked(kept, order)
        value = np.take_along_axis(value, order, axis=0)
        ranks = value.argsort(axis=0, kind="stable").argsort(axis=0).astype(np.float64)
        seeds = (uniforms(memory.key, memory.generation, 1)[0] * 2.0**53).astype(np.int64)
        trials = np.empty_like(kept)
        for lane, seed in enumerate(seeds.tolist()):
            trials[:, :, lane] = self._trials(kept[:, :, lane], ranks[:, lane], seed)
        return Vectors(
            memory.box,
            memory.key,
            memory.generation + 1,
            trials.reshape(shape),
            kept.reshape(shape),
            value.reshape(shape[1:]),
        )

    def _trials(self, x: Array, ranks: Array, seed: int) -> Array:
        from scipy.optimize import differential_evolution

        seen: list[Array] = []

        def cost(asked: Array) -> Array:
            seen.append(np.array(asked))
            if len(seen) == 1:
                return ranks
            raise _TrialsAreKnown

        # SciPy called it seed up to 1.14.
        named = "rng" if "rng" in inspect.signature(differential_evolution).parameters else "seed"
        try:
            differential_evolution(
                cost,
                [(0.0, 1.0)] * len(x),
                strategy=self.strategy,
                mutation=self.mutation,
                recombination=self.recombination,
                init=x.T,
                maxiter=1,
                tol=0.0,
                polish=False,
                updating="deferred",
                vectorized=True,
                **{named: np.random.default_rng(seed)},
            )
        except _TrialsAreKnown:
            return seen[1]
        raise AssertionError("SciPy's differential evolution evaluated no trial vectors")
