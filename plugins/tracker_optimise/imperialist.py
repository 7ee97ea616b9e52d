"""The imperialist competitive algorithm: countries move towards their imperialist, empires compete."""

from __future__ import annotations

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

_TINY = 1e-300
_HUGE = 1e300
_PARALLEL = np.array(1e-9)
"""Signs that have less than this square to the way are parallel to it: they turn it the less."""

_HALF, _ONE = np.array(0.5), np.array(1.0)  # ufuncs take arrays faster than Python's numbers

Places = npt.NDArray[np.intp]


@attrs.frozen(eq=False)
class World:
    """Countries in the unit cube, the empire of each, and the place of each empire's imperialist.

    Shapes:
        empire ``(population, *restarts)``; ruler ``(imperialists, *restarts)``, meaningless for an
        empire that has collapsed.
    """

    box: box.Box
    key: Keys = attrs.field(repr=brief)
    generation: int
    asked: Array = attrs.field(repr=brief)
    empire: Places = attrs.field(repr=brief)
    ruler: Places = attrs.field(repr=brief)


@attrs.frozen
class Imperialist:
    """Imperialist competitive algorithm, all steps.

    The ``imperialists`` best countries divide the others among them, as many as their power
    allows: the power of an imperialist is how much better its cost is than the worst imperialist's.
    Then, in every generation:

    1. a colony that has become better than its imperialist takes its place;
    2. the total cost of an empire is its imperialist's and ``share`` times its colonies' mean;
    3. the weakest empire loses its weakest colony to the empire of largest ``p - u``, p being how
       much better its total cost is than the weakest's, as a share, and u uniform;
    4. an empire without colonies collapses: its imperialist becomes a colony of the winner;
    5. each colony moves towards its imperialist by a uniform share of up to ``assimilation`` times
       their distance, in a direction that is off by a uniform angle of up to ``deviation``; in more
       than two dimensions to a random side;
    6. a share ``revolution`` of the colonies moves to a random place instead.

    Distances and angles are those of parameters relative to the width of their bounds. Imperialists
    do not move; their cost is evaluated with the others', and counts. With ``unite=True`` a restart
    ends when one empire is left, as published; otherwise it goes on to the end of its budget.

    Units:
        deviation in radians.

    Raises:
        DomainError: for parameters out of range, or more imperialists than half of the countries.

    Reference:
        Paper 4, eq. 3-4 to 3-6 and section 3.1; E. Atashpaz-Gargari and C. Lucas, Imperialist
        competitive algorithm, IEEE Congress on Evolutionary Computation 2007 (assimilation 2,
        deviation pi/4, share 0.1). Shares of colonies are rounded cumulatively, so that they sum to
        their number; the number of imperialists is not printed in the thesis.

    Laws:
        Sees differences of costs: an added constant changes nothing, if the sums are exact; by
        rounding at most otherwise. See `tracker.testing`, kind optimiser.
    """

    rows: ClassVar[int] = 1

    population: int = attrs.field(default=50, validator=parameters.count(4))
    imperialists: int = attrs.field(default=5, validator=parameters.count(1))
    assimilation: float = attrs.field(default=2.0, validator=parameters.number(0.0, open_=True))
    deviation: float = attrs.field(default=math.pi / 4, validator=parameters.number(0.0, math.pi))
    share: float = attrs.field(default=0.1, validator=parameters.number(0.0))
    revolution: float = attrs.field(default=0.0, validator=parameters.number(0.0, 1.0))
    unite: bool = False

    def __attrs_post_init__(self) -> None:
        if 2 * self.imperialists > self.population:
            raise DomainError(
                wording("parameter 'imperialists'", got=self.imperialists, do="pass for example 5",
                        expected=f"at most half of the {self.population} countries")
            )  # fmt: skip

    def begin(
        self,
        bounds: Any,
        *,
        rng: np.random.Generator | Sequence[np.random.Generator],
        restarts: tuple[int, ...] = (),
        start: Any = None,
    ) -> World:
        """Countries uniform in the bounds; empires are formed when their cost is known."""
        first = box.begin(bounds, self.population, rng, restarts, start)
        nobody = np.zeros(first.asked.shape[1:], dtype=np.intp)
        return World(first.box, first.key, 0, first.asked, nobody, nobody[: self.imperialists])

    def ask(self, memory: World) -> Array:
        """The countries, ``(d, population, *restarts)``."""
        return memory.box.outside(memory.asked)

    def finished(self, memory: World) -> npt.NDArray[np.bool_]:
        """Which restarts have come to their end, ``(*restarts)``: one empire is left."""
        if not self.unite or memory.generation == 0:
            return np.zeros(memory.asked.shape[2:], dtype=bool)
        return np.asarray((memory.empire == memory.empire[:1]).all(axis=0))

    def tell(self, memory: World, cost: Array) -> World:
        """The world after a generation, given the cost ``(1, population, *restarts)`` of countries."""
        shape = memory.asked.shape
        d, count = shape[:2]
        value = box.told(cost, memory.asked)[0]
        lanes = value.shape[1]
        once = self.imperialists if memory.generation else count
        revolts = (d + 1) * count if self.revolution else 0
        sizes = [once, count, (d + 1) * count, revolts]
        u, far, turn, risings = box.parts(
            uniforms(memory.key, memory.generation, sum(sizes)), sizes
        )
        if memory.generation:
            empire = memory.empire.reshape(count, lanes).copy()
            ruler = memory.ruler.reshape(self.imperialists, lanes).copy()
            for lane in range(lanes):
                self._competed(value[:, lane], empire[:, lane], ruler[:, lane], u[:, lane])
        else:
            empire, ruler = self._founded(_spread_out(value), u)
        x = memory.asked.reshape(d, count * lanes)
        there = _flat(ruler.take(_flat(empire))).ravel()
        moved = self._assimilated(x, there, far.ravel(), turn.reshape(d + 1, count * lanes))
        if revolts:
            chance, places = risings[:count].ravel(), risings[count:].reshape(x.shape)
            rises = (chance < self.revolution) & (there != np.arange(there.size))
            moved = np.where(rises, places, moved)
        return World(
            memory.box,
            memory.key,
            memory.generation + 1,
            moved.reshape(shape),
            empire.reshape(shape[1:]),
            ruler.reshape(self.imperialists, *shape[2:]),
        )

    def _founded(self, cost: Array, u: Array) -> tuple[Places, Places]:
        """Empire of each country and imperialist of each empire, when empires are formed."""
        count, lanes = cost.shape
        order = cost.argsort(axis=0, kind="stable")
        ruler = order[: self.imperialists]
        theirs = cost.take(_flat(ruler))
        power = np.cumsum(theirs[-1:] - theirs, axis=0)
        even = np.arange(1.0, self.imperialists + 1.0)[:, None]
        power = np.where(power[-1:] > 0.0, power, even)  # all are equally strong
        colonies = count - self.imperialists
        edges = np.rint(power / power[-1:] * colonies)
        shuffled = variation.permutations(u[:colonies]).astype(np.float64)
        by_rank = np.empty((count, lanes), dtype=np.intp)
        by_rank[: self.imperialists] = np.arange(self.imperialists)[:, None]
        np.add.reduce(shuffled[:, None] >= edges, axis=1, out=by_rank[self.imperialists :])
        empire = np.empty((count, lanes), dtype=np.intp)
        empire.put(_flat(order), by_rank)
        return empire, ruler

    def _competed(self, cost: Array, empire: Places, ruler: Places, u: Array) -> None:
        """Exchange, competition and collapse in one world; empires and rulers are written over.

        A world has a handful of empires: plain Python is faster here than arrays.
        """
        members = np.bincount(empire, None, self.imperialists).tolist()
        alive = [k for k, size in enumerate(members) if size]
        if len(alive) == 1:  # who reigns is all that is open
            reigns, lowest = ruler[alive[0]], cost.argmin()
            if -_HUGE < cost[lowest] <= cost[reigns] < _HUGE:
                if cost[lowest] < cost[reigns]:
                    ruler[alive[0]] = lowest
                return
        order = cost.argsort(kind="stable")
        ranked, homes, rulers = order.tolist(), empire.tolist(), ruler.tolist()
        if not -_HUGE < cost[ranked[0]] <= cost[ranked[-1]] < _HUGE:
            cost = _spread_out(cost[:, None])[:, 0]
        # Differences are what is seen: from here on a constant added to the costs is gone.
        cost = cost - cost[ranked[0]]
        sums = np.bincount(empire, cost, self.imperialists).tolist()
        above = cost.tolist()
        best = {}
        for place in ranked:
            home = homes[place]
            if home not in best:
                best[home] = place
                if len(best) == len(alive):
                    break
        total = {}
        for k in alive:
            place = best[k]
            reigning = above[place]
            if reigning < above[rulers[k]]:
                ruler[k] = rulers[k] = place
            total[k] = reigning + self.share * (sums[k] - reigning) / max(members[k] - 1, 1)
        weakest = max(alive, key=total.__getitem__)
        top = total[weakest]
        all_ = max(sum([top - total[k] for k in alive]), _TINY)
        chance = u.tolist()
        winner = max(alive, key=lambda k: (top - total[k]) / all_ - chance[k])
        if winner != weakest:
            # Its weakest colony; an imperialist only with its empire, when no colony is left.
            lost = rulers[weakest]
            for place in reversed(ranked):
                if homes[place] == weakest and place != rulers[weakest]:
                    lost = place
                    break
            empire[lost] = winner
            members[weakest] -= 1
            members[winner] += 1
        for k in alive:
            if members[k] == 1 and k != winner:
                empire[rulers[k]] = winner

    def _assimilated(self, x: Array, there: Places, far: Array, turn: Array) -> Array:
        """Countries ``(d, P lanes)`` after moving towards those at flat places ``there``.

        The way goes ``cos(angle)`` along the straight one, and ``sin(angle)`` along what a vector of
        random signs has square to it.

        Shapes:
            uniforms far ``(P lanes,)`` for the distance, turn ``(1 + d, P lanes)`` for angle and side;
            both are written over.
        """
        towards = x.take(there, axis=1)
        towards -= x
        turn -= _HALF
        side = np.copysign(_ONE, turn[1:])
        angle = turn[0]
        angle *= 2.0 * self.deviation
        far *= self.assimilation
        along = np.cos(angle)
        along *= far
        across = np.sin(angle)
        across *= far
        size = np.add.reduce(towards * towards)
        shadow = np.add.reduce(side * towards)
        share = shadow / (size + _TINY)
        shadow *= share
        size /= np.maximum(len(x) - shadow, _PARALLEL)
        across *= np.sqrt(size)
        share *= across
        along -= share
        towards *= along
        side *= across
        towards += side
        towards += x
        return variation.within(towards)


def _flat(places: Places) -> Places:
    """Places ``(k, lanes)`` in an array ``(P, lanes)``, as places in its flat form."""
    lanes = places.shape[1]
    return places if lanes == 1 else places * lanes + np.arange(lanes)


def _spread_out(cost: Array) -> Array:
    """Costs above the lowest of their lane, finite: an infinite one is as bad as the worst finite."""
    worst = np.where(cost < _HUGE, cost, -_HUGE).max(axis=0, initial=-_HUGE)
    cost = np.maximum(np.minimum(cost, worst), -_HUGE)
    cost -= np.minimum.reduce(cost, axis=0)
    return cost
