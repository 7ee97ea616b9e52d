"""CMA-ES, asked and told: the package cmaes adapts mean, step and covariance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import attrs
import numpy as np
import numpy.typing as npt

from tracker.types import Array, brief
from tracker_optimise import box, parameters
from tracker_optimise.draws import BEGIN, Keys, uniforms

_HUGE = 1e300
_HISTORY = "_funhist_values"


@attrs.frozen(eq=False)
class Strategy:
    """What `cmaes` knows, all its changing numbers in one column per restart, in the unit cube."""

    box: box.Box
    key: Keys = attrs.field(repr=brief)
    generation: int
    asked: Array = attrs.field(repr=brief)
    numbers: Array = attrs.field(repr=brief)
    ended: npt.NDArray[np.bool_] = attrs.field(repr=brief)


@attrs.frozen
class CMAES:
    """Covariance matrix adaptation evolution strategy, through the package `cmaes`.

    It begins at the first given individual, else at a place uniform in the bounds, with standard
    deviation ``step`` times their width. A candidate that falls out of bounds is drawn again, up to a
    hundred times, and then put back on them. A restart ends when `cmaes` sees no progress: costs
    within 1e-12 for long, a step that no longer moves the mean, a degenerate covariance.

    Needs ``pip install tracker-lab[optimise]``.

    Raises:
        DomainError: for parameters out of range.

    Reference:
        Hansen, The CMA evolution strategy: a tutorial, arXiv:1604.00772; Nomura and Shibata, cmaes: a
        simple yet practical Python library for CMA-ES, arXiv:2402.01373.

    Laws:
        Only the order of costs matters, and their differences for the end. See `tracker.testing`.
    """

    rows: ClassVar[int] = 1

    population: int = attrs.field(default=50, validator=parameters.count(4))
    step: float = attrs.field(default=0.3, validator=parameters.number(0.0, open_=True))

    def begin(
        self,
        bounds: Any,
        *,
        rng: np.random.Generator | Sequence[np.random.Generator],
        restarts: tuple[int, ...] = (),
        start: Any = None,
    ) -> Strategy:
        """Where the strategies begin, and their first candidates; the first is the mean itself."""
        first = box.begin(bounds, self.population, rng, restarts, start)
        mean = box.flat(first.asked)[:, 0]
        asked = np.empty((len(mean), self.population, mean.shape[1]))
        packed = []
        for lane, seed in enumerate(_seeds(first.key, BEGIN + 1)):
            one = self._made(mean[:, lane])
            packed.append(_packed(one))
            asked[:, :, lane] = _asked(one, seed)
        asked[:, 0] = mean
        held = _columns(packed, len(_packed(self._made(np.full(len(mean), 0.5)))))
        ended = np.zeros(first.asked.shape[2:], dtype=bool)
        return Strategy(
            first.box,
            first.key,
            0,
            asked.reshape(first.asked.shape),
            held.reshape(len(held), *first.asked.shape[2:]),
            ended,
        )

    def ask(self, memory: Strategy) -> Array:
        """Candidates, ``(d, population, *restarts)``."""
        return memory.box.outside(memory.asked)

    def finished(self, memory: Strategy) -> npt.NDArray[np.bool_]:
        """Which restarts have come to their end, ``(*restarts)``."""
        return memory.ended

    def tell(self, memory: Strategy, cost: Array) -> Strategy:
        """The strategies after learning the cost ``(1, population, *restarts)``."""
        value = np.clip(box.told(cost, memory.asked)[0], -_HUGE, _HUGE)
        x = box.flat(memory.asked)
        held = memory.numbers.reshape(len(memory.numbers), x.shape[2])
        asked, ended, packed = np.empty_like(x), np.empty(x.shape[2], dtype=bool), []
        blank = self._made(np.full(len(x), 0.5))
        for lane, seed in enumerate(_seeds(memory.key, memory.generation)):
            one = _unpacked(blank, held[:, lane])
            rows = np.ascontiguousarray(x[:, :, lane].T)
            one.tell(list(zip(rows, value[:, lane].tolist(), strict=True)))
            packed.append(_packed(one))  # before its covariance is decomposed, and kept so
            ended[lane] = one.should_stop()
            asked[:, :, lane] = _asked(one, seed)
        return Strategy(
            memory.box,
            memory.key,
            memory.generation + 1,
            asked.reshape(memory.asked.shape),
            _columns(packed, len(held)).reshape(memory.numbers.shape),
            ended.reshape(memory.ended.shape),
        )

    def _made(self, mean: Array) -> Any:
        import cmaes

        unit = np.repeat([[0.0, 1.0]], len(mean), axis=0)
        return cmaes.CMA(
            mean=np.array(mean),
            sigma=self.step,
            bounds=unit,
            population_size=self.population,
            seed=0,
        )


# ------------------------------------------------------------- a strategy as a row of numbers
def _seeds(key: Keys, generation: int) -> list[int]:
    """A seed for each restart; it is a function of its key and the generation alone."""
    seeds: list[int] = (uniforms(key, generation, 1)[0] * 2.0**32).astype(np.int64).tolist()
    return seeds


def _asked(one: Any, seed: int) -> Array:
    """A population, ``(d, P)``."""
    one.reseed_rng(seed)
    return np.stack([one.ask() for _ in range(one.population_size)], axis=1)


def _state(one: Any) -> dict[str, Any]:
    """What `cmaes` pickles of a strategy."""
    state: dict[str, Any] = one.__getstate__()
    if one.generation == 0 and _HISTORY in state:
        state[_HISTORY] = np.zeros_like(state[_HISTORY])  # cmaes leaves what was in memory
    return state


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float, np.ndarray, np.number)) and not isinstance(value, bool)


def _packed(one: Any) -> Array:
    """All its numbers in a row."""
    return np.concatenate(
        [np.ravel(value) for _, value in sorted(_state(one).items()) if _is_number(value)]
    )


def _unpacked(blank: Any, numbers: Array) -> Any:
    """A strategy like the blank one with these numbers."""
    state, at = _state(blank), 0
    for name, value in sorted(state.items()):
        if _is_number(value):
            size = np.size(value)
            entry = numbers[at : at + size]
            at += size
            if isinstance(value, np.ndarray):
                state[name] = entry.reshape(value.shape).copy()
            else:
                state[name] = int(entry[0]) if isinstance(value, int) else float(entry[0])
    made = object.__new__(type(blank))
    made.__setstate__(state)
    return made


def _columns(packed: list[Array], size: int) -> Array:
    return np.stack(packed, axis=1) if packed else np.empty((size, 0))
