"""Particle swarm optimisation: individuals fly, drawn to the best they and their neighbours have seen."""

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

_CRITICAL = 4.0
"""Above this sum of the attractions the swarm explodes without constriction (Clerc and Kennedy)."""


@attrs.frozen(eq=False)
class Swarm:
    """What the swarm remembers, positions and velocities in the unit cube."""

    box: box.Box
    key: Keys = attrs.field(repr=brief)
    generation: int
    asked: Array = attrs.field(repr=brief)
    velocity: Array = attrs.field(repr=brief)
    own: Array = attrs.field(repr=brief)
    own_cost: Array = attrs.field(repr=brief)


def _pair(value: Any) -> Any:
    """One number stands for a schedule that does not change."""
    return tuple(value) if isinstance(value, (tuple, list)) else (value, value)


@attrs.frozen
class ParticleSwarm:
    """Particle swarm: ``V = w V + c1 r1 (P - X) + c2 r2 (G - X)``, ``X = X + V``.

    P is the best place that a particle has seen, G the best that its neighbourhood has seen, r1 and
    r2 are uniform in (0, 1) for each parameter. The inertia w falls on a line from its first to its
    second value over the first ``generations`` generations, and then stays.

    * ``neighbourhood="global"``: everybody; ``"ring"``: ``neighbours`` on each side and oneself.
    * ``constriction=True``: ``V = chi (V + c1 ... + c2 ...)`` with
      ``chi = 2 / |2 - phi - sqrt(phi^2 - 4 phi)|``, ``phi = c1 + c2 > 4``; no inertia then.
    * A particle that leaves the bounds is put back on them, and its velocity there becomes 0; no
      velocity exceeds ``fastest`` times the width of the bounds.

    Units:
        everything is relative to the width of the bounds.

    Raises:
        DomainError: for parameters out of range, or a constriction with ``c1 + c2 <= 4``.

    Reference:
        Paper 4, eq. 3-1 and 3-2 (c1 = c2 = 2, w falling); Kennedy and Eberhart 1995; Shi and
        Eberhart 1999 (inertia from 0.9 to 0.4); Clerc and Kennedy 2002 (constriction); Eberhart and
        Kennedy 1995 (neighbourhood of the ring).

    Laws:
        Only comparisons of costs matter. See `tracker.testing`, kind optimiser.
    """

    rows: ClassVar[int] = 1

    population: int = attrs.field(default=50, validator=parameters.count(2))
    inertia: tuple[float, float] = attrs.field(
        default=(0.9, 0.4), converter=_pair, validator=parameters.span(0.0, 2.0)
    )
    generations: int = attrs.field(default=100, validator=parameters.count(1))
    cognitive: float = attrs.field(default=2.0, validator=parameters.number(0.0))
    social: float = attrs.field(default=2.0, validator=parameters.number(0.0))
    constriction: bool = False
    neighbourhood: str = attrs.field(
        default="global", validator=parameters.one_of(("global", "ring"))
    )
    neighbours: int = attrs.field(default=1, validator=parameters.count(1))
    fastest: float = attrs.field(default=0.5, validator=parameters.number(0.0, open_=True))

    def __attrs_post_init__(self) -> None:
        if self.constriction and self.cognitive + self.social <= _CRITICAL:
            raise DomainError(
                wording(
                    "particle swarm with constriction",
                    got=f"cognitive + social = {self.cognitive + self.social:g}",
                    expected="more than 4",
                    do="pass for example cognitive=2.05, social=2.05",
                )
            )

    def begin(
        self,
        bounds: Any,
        *,
        rng: np.random.Generator | Sequence[np.random.Generator],
        restarts: tuple[int, ...] = (),
        start: Any = None,
    ) -> Swarm:
        """A first swarm: places uniform in the bounds, velocities half way to another such place.

        Reference:
            Clerc 2012, Standard particle swarm optimisation, section 3.
        """
        d = len(np.asarray(bounds))
        first = box.begin(bounds, self.population, rng, restarts, start, d * self.population)
        velocity = 0.5 * (first.spare.reshape(first.asked.shape) - first.asked)
        worst = np.full(first.asked.shape[1:], math.inf)
        return Swarm(first.box, first.key, 0, first.asked, velocity, first.asked, worst)

    def ask(self, memory: Swarm) -> Array:
        """Where the particles are, ``(d, population, *restarts)``."""
        return memory.box.outside(memory.asked)

    def tell(self, memory: Swarm, cost: Array) -> Swarm:
        """The swarm after one flight, given the cost ``(1, population, *restarts)`` of where it is."""
        shape = memory.asked.shape
        d, count = shape[:2]
        value = box.told(cost, memory.asked)[0]
        x, velocity = box.flat(memory.asked), box.flat(memory.velocity)
        best = memory.own_cost.reshape(value.shape)
        own = np.where(value < best, x, box.flat(memory.own))
        best = np.minimum(value, best)

        r = uniforms(memory.key, memory.generation, 2 * d * count).reshape(2, *x.shape)
        pull = own - x
        pull *= r[0]
        pull *= self.cognitive
        towards = self._guide(own, best) - x
        towards *= r[1]
        towards *= self.social
        pull += towards
        if self.constriction:
            moved = velocity + pull
            moved *= self._constriction
        else:
            moved = velocity * self._inertia(memory.generation)
            moved += pull
        np.maximum(moved, -self.fastest, out=moved)
        np.minimum(moved, self.fastest, out=moved)
        there = x + moved
        back = variation.within(there.copy())
        np.copyto(moved, 0.0, where=back != there)
        return Swarm(
            memory.box,
            memory.key,
            memory.generation + 1,
            back.reshape(shape),
            moved.reshape(shape),
            own.reshape(shape),
            best.reshape(shape[1:]),
        )

    def _inertia(self, generation: int) -> float:
        first, last = self.inertia
        return first + (last - first) * min(generation / self.generations, 1.0)

    @property
    def _constriction(self) -> float:
        phi = self.cognitive + self.social
        return 2.0 / abs(2.0 - phi - math.sqrt(phi * phi - 4.0 * phi))

    def _guide(self, own: Array, best: Array) -> Array:
        """The best place in each particle's neighbourhood, ``(d, 1 or P, lanes)``."""
        if self.neighbourhood == "global":
            return box.picked(own, best.argmin(axis=0)[None])
        around = _ring(len(best), self.neighbours)
        nearest = best[around].argmin(axis=0)
        return box.picked(own, around[nearest, np.arange(len(best))[:, None]])


@functools.cache
def _ring(count: int, neighbours: int) -> npt.NDArray[np.intp]:
    """Neighbours of each particle, ``(k, count)``: oneself first, then outwards."""
    away = [0, *(side * step for step in range(1, neighbours + 1) for side in (-1, 1))]
    around: npt.NDArray[np.intp] = (np.arange(count) + np.array(away)[:, None]) % count
    return around
