"""The loop around an optimiser: ask, evaluate, tell, within a budget; how optimisers move is theirs.

Restarts are lanes: all candidates of all restarts go to the cost in one call. A restart's numbers
depend on the seed and its own number alone, not on the others, nor on whether it was interrupted.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import attrs
import numpy as np
import numpy.typing as npt

from tracker.errors import CapabilityError, ConfigError, DomainError, ShapeError, wording
from tracker.protocols import Optimiser
from tracker.registry import optimisers
from tracker.types import Array, brief

__all__ = ["Optimisation", "load_optimisation", "optimise"]

Cost = Callable[[Array], Any]

_WORST = np.array(np.inf)  # ufuncs take arrays faster than Python's numbers

RUNNING, BUDGET, TARGET, STALLED, FINISHED = range(5)
REASONS = ("running", "budget", "target", "stalled", "finished")


@attrs.frozen(eq=False)
class Optimisation:
    """The result of `optimise`; given to it again as ``resume``, it goes on from there.

    Shapes:
        x ``(d, rows, restarts)``: for each number of the cost the candidate where it was lowest, for
        one objective simply the best; cost ``(rows, restarts)``: these lowest costs.
        evaluated ``(G,)``: evaluations of a restart up to the end of each generation; best
        ``(G, rows, restarts)``: the lowest cost up to then; mean ``(G, rows, restarts)``: over the
        finite costs of that generation. A restart that has stopped keeps its best, and has NaN there.
        evaluations ``(restarts,)``: what each has used. reason: why each stopped.
    """

    optimiser: Any
    bounds: Array = attrs.field(repr=brief)
    seed: int
    numbers: tuple[int, ...] = attrs.field(repr=False)
    x: Array = attrs.field(repr=brief)
    cost: Array = attrs.field(repr=brief)
    evaluated: Array = attrs.field(repr=brief)
    best: Array = attrs.field(repr=brief)
    mean: Array = attrs.field(repr=brief)
    evaluations: Array = attrs.field(repr=brief)
    memory: Any = attrs.field(repr=False)
    pending: Array = attrs.field(repr=False)
    """Costs ``(rows, k, active)`` of the first k candidates of a generation the budget cut off."""
    waited: Array = attrs.field(repr=False)
    """Generations since each restart got better by the tolerance; and its cost then, ``(2, restarts)``."""
    stopped: Array = attrs.field(repr=False)

    @property
    def reason(self) -> tuple[str, ...]:
        """Why each restart stopped: "budget", "target", "stalled" or "finished" (by the optimiser)."""
        return tuple(REASONS[k] for k in self.stopped)

    @property
    def winner(self) -> int:
        """The place of the restart with the lowest cost.

        Raises:
            CapabilityError: if the cost has several rows: see `survivors`.
        """
        if len(self.cost) != 1:
            raise CapabilityError(
                wording("the best candidate", got=f"a cost of {len(self.cost)} rows", do="use survivors()",
                        expected="one objective")
            )  # fmt: skip
        return int(np.argmin(self.cost[0]))

    @property
    def best_x(self) -> Array:
        """The best candidate of all restarts, ``(d,)``."""
        return self.x[:, 0, self.winner]

    @property
    def best_cost(self) -> float:
        """Its cost."""
        return float(self.cost[0, self.winner])

    def survivors(self) -> tuple[Array, Array]:
        """What an optimiser of several objectives has kept: ``(d, P, restarts)``, cost ``(rows, P, restarts)``.

        Candidates of a generation that the budget cut off are not among them.

        Raises:
            CapabilityError: if the optimiser keeps none.
        """
        if not hasattr(self.optimiser, "survivors"):
            raise CapabilityError(
                wording(f"optimiser {type(self.optimiser).__name__}", got="no survivors",
                        expected="an optimiser of several objectives", do="use 'nsga2', or best_x")
            )  # fmt: skip
        kept: tuple[Array, Array] = self.optimiser.survivors(self.memory)
        return kept

    def __str__(self) -> str:
        used = sorted(set(self.evaluations.tolist()))
        many = f"{len(self.numbers)} restarts" if len(self.numbers) > 1 else "1 restart"
        upto = "-".join(str(n) for n in (used[:1] + used[-1:] if len(used) > 1 else used))
        head = f"{type(self.optimiser).__name__}: {many}, {upto} evaluations each, seed {self.seed}"
        if len(self.cost) != 1:
            return head
        low, median, high = np.percentile(self.cost[0], (0, 50, 100))
        why = ", ".join(f"{self.reason.count(r)} by {r}" for r in REASONS if r in self.reason)
        return f"{head}; cost {low:.6g} (median {median:.6g}, worst {high:.6g}); ended: {why}"

    def save(self, path: str | Path) -> Path:
        """Write everything to one ``.npz`` file; `load_optimisation` reads it back, to be resumed.

        Raises:
            CapabilityError: if the optimiser is not in the registry: a file names it, and no class.
        """
        from tracker.io.arrays import save_arrays

        save_arrays(Path(path), *self.written())
        return Path(path)

    def written(self) -> tuple[dict[str, Array], dict[str, Any]]:
        """All of it as arrays and plain values, for `restored`.

        Raises:
            CapabilityError: if the optimiser is not in the registry.
        """
        name = _registered(self.optimiser)
        leaves: list[Any] = []
        _mapped(leaves.append, self.memory)
        arrays = {f"memory/{k}": v for k, v in enumerate(leaves) if isinstance(v, np.ndarray)}
        arrays |= {name: getattr(self, name) for name in _ARRAYS}
        metadata = {
            "kind": "optimisation",
            "optimiser": name,
            "parameters": _settings(self.optimiser),
            "seed": self.seed,
            "numbers": list(self.numbers),
            "statics": {str(k): v for k, v in enumerate(leaves) if not isinstance(v, np.ndarray)},
        }
        return arrays, metadata


_ARRAYS = (
    "bounds", "x", "cost", "evaluated", "best", "mean", "evaluations", "pending", "waited", "stopped",
)  # fmt: skip


def load_optimisation(path: str | Path) -> Optimisation:
    """A result that `Optimisation.save` wrote.

    Raises:
        ConfigError: if the file is not one.
        UnknownComponent: if its optimiser is not installed.
    """
    from tracker.io.arrays import load_arrays

    arrays, metadata = load_arrays(Path(path))
    if metadata.get("kind") != "optimisation":
        raise ConfigError(
            wording(str(path), got=f"a file of kind {metadata.get('kind')!r}",
                    expected="an optimisation", do="give a file written by Optimisation.save")
        )  # fmt: skip
    return restored(arrays, metadata)


def restored(arrays: Mapping[str, Array], metadata: Mapping[str, Any]) -> Optimisation:
    """What `Optimisation.written` made arrays of.

    Raises:
        UnknownComponent: if its optimiser is not installed.
    """
    optimiser = optimisers.make(metadata["optimiser"], **metadata["parameters"])
    numbers = tuple(metadata["numbers"])
    rngs = [_generator(0, number) for number in numbers]
    blank = optimiser.begin(arrays["bounds"], rng=rngs, restarts=(len(numbers),))
    statics = metadata["statics"]
    leaves = iter(range(len(arrays) + len(statics)))

    def filled(_blank: Any) -> Any:
        k = next(leaves)
        return statics[str(k)] if str(k) in statics else arrays[f"memory/{k}"]

    kept = {name: arrays[name] for name in _ARRAYS}
    memory = _mapped(filled, blank)
    return Optimisation(
        optimiser=optimiser, seed=metadata["seed"], numbers=numbers, memory=memory, **kept
    )


def optimise(
    cost: Cost,
    bounds: Any = None,
    optimiser: str | Optimiser[Any] | None = None,
    *,
    evaluations: int,
    restarts: int | Sequence[int] | None = None,
    seed: int | None = None,
    start: Any = None,
    target: float | None = None,
    patience: int | None = None,
    tolerance: float = 0.0,
    resume: Optimisation | None = None,
) -> Optimisation:
    """Search the parameters within ``bounds`` for which ``cost`` is lowest.

    The budget is ``evaluations`` of the cost in every restart, and exact: the last generation is cut
    off where it would go beyond. A restart ends early when its cost comes to ``target`` or below;
    when it has not become better by more than ``tolerance`` for ``patience`` generations; or when its
    optimiser is finished. Its place in the calls of ``cost`` is then taken up by the others. A target
    and patience are for one objective; candidates that break a constraint do not count for them.

    Shapes:
        bounds ``(d, 2)``, rows [low, high]; ``cost`` takes candidates ``(d, population, active)``,
        the restarts that are still active on the last axis, and returns ``(objectives, population,
        active)``, or ``(population, active)`` for one objective. NaN is the worst cost.
        start ``(d, k)`` or ``(d, k, restarts)``: individuals that belong to the first population.

    ``optimiser`` is "particle_swarm" if none is given, ``seed`` 0. ``restarts`` is how many, one if
    not given, or the numbers of those wanted: restart 3 is the same in any company.
    ``resume`` is a result to go on from: ``evaluations`` counts what it has used; bounds, optimiser,
    restarts, seed and start are its own; a restart that ended early stays so. What comes of it
    equals one search with the larger budget.

    Raises:
        DomainError: if the budget, the bounds or the individuals to start from make no sense; if
            what is resumed is given what is its own.
        CapabilityError: for a target or patience with an optimiser of several objectives.
        ShapeError: if shapes do not fit.

    Example:
    >>> import tracker as tk
    >>> def bowl(x):
    ...     return ((x - 0.3) ** 2).sum(axis=0)
    >>> found = tk.optimise(bowl, [[-1, 1]] * 3, evaluations=5000, restarts=4, seed=7)
    >>> found.best_x.round(3).tolist(), found.evaluations.tolist()
    ([0.3, 0.3, 0.3], [5000, 5000, 5000, 5000])
    """
    _check(evaluations, patience, tolerance)
    if resume is None:
        begun = _begun(
            bounds,
            "particle_swarm" if optimiser is None else optimiser,
            1 if restarts is None else restarts,
            0 if seed is None else seed,
            start,
        )
    else:
        given = {
            "bounds": bounds,
            "optimiser": optimiser,
            "restarts": restarts,
            "seed": seed,
            "start": start,
        }
        for name in [name for name, value in given.items() if value is not None]:
            raise DomainError(
                wording(f"argument {name!r}", got="a value beside resume", do="leave it out",
                        expected="what is resumed to bring its own")
            )  # fmt: skip
        begun = resume
    for name, value in (("target", target), ("patience", patience)):
        if value is not None:
            _check_watched(name, begun.optimiser)
    return _Search(cost, begun, evaluations, target, patience, tolerance).run()


def _check(evaluations: int, patience: int | None, tolerance: float) -> None:
    if int(evaluations) != evaluations or evaluations < 1:
        raise DomainError(
            wording("argument 'evaluations'", got=repr(evaluations), do="pass for example 5000",
                    expected="how often the cost may be evaluated in each restart, at least once")
        )  # fmt: skip
    if patience is not None and patience < 1:
        raise DomainError(
            wording("argument 'patience'", got=patience, expected="at least one generation, or None",
                    do="pass for example 20")
        )  # fmt: skip
    if not tolerance >= 0.0:
        raise DomainError(
            wording("argument 'tolerance'", got=tolerance, expected="0 or more", do="pass 0.0")
        )


def _check_watched(name: str, optimiser: Any) -> None:
    """Whether there is one number to watch, and, beside constraints, a record of who obeys them."""
    objectives = getattr(optimiser, "objectives", optimiser.rows)
    if objectives != 1 or (optimiser.rows > 1 and not hasattr(optimiser, "survivors")):
        what = f"{objectives} objectives" if objectives != 1 else "constraints, and no survivors"
        raise CapabilityError(
            wording(f"argument {name!r} of optimise", got=f"{type(optimiser).__name__} with {what}",
                    expected="one objective: a front has no lowest cost to watch",
                    do="leave it out; the budget ends the search")
        )  # fmt: skip


def _generator(seed: int, number: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))


def _begun(
    bounds: Any,
    optimiser: str | Optimiser[Any],
    restarts: int | Sequence[int],
    seed: int,
    start: Any,
) -> Optimisation:
    """A search of which nothing has been evaluated."""
    if bounds is None:
        raise DomainError(
            wording("argument 'bounds'", got=None, expected="(d, 2), rows [low, high]",
                    do="pass the bounds of every parameter")
        )  # fmt: skip
    chosen = optimisers.make(optimiser) if isinstance(optimiser, str) else optimiser
    numbers = tuple(range(restarts)) if isinstance(restarts, int) else tuple(restarts)
    if not numbers:
        raise DomainError(
            wording("argument 'restarts'", got=repr(restarts), expected="at least one restart",
                    do="pass for example 1, or [3] for restart 3 alone")
        )  # fmt: skip
    rngs = [_generator(seed, number) for number in numbers]
    memory = chosen.begin(bounds, rng=rngs, restarts=(len(numbers),), start=start)
    pairs = np.array(bounds, dtype=np.float64)
    d, count, rows = len(pairs), len(numbers), chosen.rows
    nothing = np.full((rows, count), np.inf)
    none = np.empty((0, rows, count))
    return Optimisation(
        optimiser=chosen,
        bounds=pairs,
        seed=seed,
        numbers=numbers,
        x=np.full((d, rows, count), np.nan),
        cost=nothing,
        evaluated=np.empty(0, dtype=np.int64),
        best=none,
        mean=none,
        evaluations=np.zeros(count, dtype=np.int64),
        memory=memory,
        pending=np.empty((rows, 0, count)),
        waited=np.stack([np.zeros(count), nothing[0]]),
        stopped=np.zeros(count, dtype=np.int64),
    )


class _Search:
    """A search on its way: what `optimise` writes on until it makes a value of it."""

    def __init__(
        self,
        cost: Cost,
        begun: Optimisation,
        evaluations: int,
        target: float | None,
        patience: int | None,
        tolerance: float,
    ) -> None:
        self.evaluate, self.begun, self.budget = cost, begun, evaluations
        self.target, self.patience, self.tolerance = target, patience, tolerance
        self.optimiser = begun.optimiser
        self.finished = getattr(self.optimiser, "finished", None)
        self.rows, self.population = self.optimiser.rows, self.optimiser.population
        self.memory = begun.memory
        self.x, self.cost = begun.x.copy(), begun.cost.copy()
        self.used, self.waited = begun.evaluations.copy(), begun.waited.copy()
        self.stopped = np.where(begun.stopped == BUDGET, RUNNING, begun.stopped)
        self.active = np.flatnonzero(self.stopped == RUNNING)
        self.now = int(self.used[self.active[0]]) if self.active.size else 0
        self.costs: list[Array] = []
        self.lanes: list[npt.NDArray[np.intp]] = []
        self.bests: list[Array] = []

    def run(self) -> Optimisation:
        """Generations until the budget is used, or every restart has ended."""
        pending = self.begun.pending
        watched = not (self.finished is self.patience is self.target is None)
        memory = self.memory
        if self.active.size < self.cost.shape[1]:
            memory = _lanes(memory, self.active)
        while self.active.size and self.now < self.budget:
            x = self.optimiser.ask(memory)
            first, last = pending.shape[1], min(self.population, self._left(pending))
            if last - first < self.population:
                x = x[:, first:last]
            value = self._evaluated(x)
            self.now += last - first
            self._note(x, value)
            if first:
                value = np.concatenate([pending, value], axis=1)
            self.costs.append(value)
            self.lanes.append(self.active)
            self.bests.append(self.cost)
            if last < self.population:
                pending = value
                break
            pending = value[:, :0]
            memory = self.optimiser.tell(memory, value)
            if watched:
                memory = self._after_a_generation(memory)
        self.used[self.active] = self.now
        self.stopped[self.active] = BUDGET
        everybody = self.active.size == self.cost.shape[1]
        self.memory = memory if everybody else _merged(self.memory, memory, self.active)
        return self._result(pending)

    def _left(self, pending: Array) -> int:
        return int(pending.shape[1]) + self.budget - self.now

    def _evaluated(self, x: Array) -> Array:
        """The cost ``(rows, k, active)`` of candidates ``(d, k, active)``, NaN being infinity."""
        given = np.asarray(self.evaluate(x), dtype=np.float64)
        wanted = (self.rows, *x.shape[1:])
        if given.shape != wanted:
            if self.rows != 1 or given.shape != wanted[1:]:
                raise ShapeError(
                    wording("the cost of candidates " + str(x.shape), got=f"shape {given.shape}",
                            expected=f"(objectives, population, active restarts) = {wanted}",
                            do="return one number per candidate and objective")
                )  # fmt: skip
            given = given[None]
        value: Array = np.fmin(given, _WORST)
        return value

    def _note(self, x: Array, value: Array) -> None:
        """The best so far, and where; costs are not written over, as the history keeps them."""
        everybody, count = self.active.size == self.cost.shape[1], self.active.size
        before = self.cost if everybody else self.cost[:, self.active]
        lowest = np.minimum.reduce(value, axis=1)
        better = lowest < before
        if not np.count_nonzero(better):
            return
        lowest, there = np.minimum(lowest, before), value.argmin(axis=1)
        if count > 1:
            there = there * count + np.arange(count)
        found = x.reshape(len(x), -1).take(there, axis=1)
        if everybody:
            self.cost = lowest
            np.copyto(self.x, found, where=better)
        else:
            self.cost = self.cost.copy()
            self.cost[:, self.active] = lowest
            self.x[:, :, self.active] = np.where(better, found, self.x[:, :, self.active])

    def _after_a_generation(self, memory: Any) -> Any:
        """Let those restarts go that have ended."""
        active = self.active
        ended = np.zeros(active.size, dtype=np.int64)
        if self.finished is not None and np.count_nonzero(flags := self.finished(memory)):
            ended[flags] = FINISHED
        if self.patience is not None:
            best, (waited, reference) = self._lowest(memory), self.waited[:, active]
            better = best < reference - self.tolerance
            self.waited[0, active] = waited = np.where(better, 0, waited + 1)
            self.waited[1, active] = np.where(better, best, reference)
            ended[waited >= self.patience] = STALLED
        if self.target is not None:
            ended[self._lowest(memory) <= self.target] = TARGET
        if not np.count_nonzero(ended):
            return memory
        gone = ended != RUNNING
        self.used[active] = self.now
        self.stopped[active] = ended
        self.memory = _merged(self.memory, memory, active)
        self.active = active[~gone]
        return _lanes(memory, np.flatnonzero(~gone))

    def _lowest(self, memory: Any) -> Array:
        """The lowest cost ``(active,)`` so far of what obeys the constraints; infinity if nothing does."""
        if self.rows == 1:
            return self.cost[0, self.active]  # type: ignore[no-any-return]
        kept = self.optimiser.survivors(memory)[1]
        return np.where((kept[1:] <= 0.0).all(axis=0), kept[0], np.inf).min(axis=0)  # type: ignore[no-any-return]

    def _result(self, pending: Array) -> Optimisation:
        begun, count = self.begun, len(self.begun.numbers)
        # A generation that had been cut off is now whole, or longer: its line is written anew.
        kept = len(begun.evaluated) - bool(begun.pending.shape[1] and self.costs)
        mean = [begun.mean[:kept]]
        sizes = [value.shape[1] for value in self.costs]
        at = int(begun.evaluated[kept - 1]) if kept else 0
        evaluated: Any = np.append(begun.evaluated[:kept], at + np.cumsum(sizes, dtype=np.int64))
        # Generations of as many candidates and the same restarts are worked together.
        alike = [(size, id(lanes)) for size, lanes in zip(sizes, self.lanes, strict=True)]
        first = [k for k in range(len(alike)) if k == 0 or alike[k] != alike[k - 1]]
        for k, end in itertools.pairwise([*first, len(sizes)]):
            lines = np.full((end - k, self.rows, count), np.nan)
            lines[:, :, self.lanes[k]] = _mean(np.stack(self.costs[k:end]))
            mean.append(lines)
        bests = [begun.best[:kept], *(one[None] for one in self.bests)]
        if not self.active.size:
            pending = np.empty((self.rows, 0, 0))
        return attrs.evolve(
            begun,
            x=self.x,
            cost=self.cost,
            evaluated=evaluated,
            best=np.concatenate(bests),
            mean=np.concatenate(mean),
            evaluations=self.used,
            memory=self.memory,
            pending=pending,
            waited=self.waited,
            stopped=self.stopped,
        )


def _mean(value: Array) -> Array:
    """Mean over the finite costs ``(G, rows, k, lanes)`` of each generation; NaN if there is none.

    A running sum has the same bits for any number of lanes; NumPy's sum has not.
    """
    finite = np.isfinite(value)
    total = np.add.accumulate(np.where(finite, value, 0.0), axis=2)[:, :, -1]
    count = np.add.reduce(finite, axis=2)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


# ------------------------------------------------------------------- lanes of an optimiser's memory
def _mapped(function: Callable[..., Any], value: Any, *others: Any) -> Any:
    """A value like this one, with the function's answer in place of every array and static value."""
    if isinstance(value, tuple):
        return tuple(_mapped(function, *each) for each in zip(value, *others, strict=True))
    if not attrs.has(type(value)):
        return function(value, *others)
    made = object.__new__(type(value))
    for field in attrs.fields(type(value)):
        parts = [getattr(one, field.name) for one in (value, *others)]
        object.__setattr__(made, field.name, _mapped(function, *parts))
    return made


def _lanes(memory: Any, places: npt.NDArray[np.intp]) -> Any:
    """Some restarts of a memory; what all share stays."""

    def some(value: Any) -> Any:
        if not isinstance(value, np.ndarray) or value.shape[-1] == 1:
            return value
        return np.ascontiguousarray(value[..., places])

    return _mapped(some, memory)


def _merged(memory: Any, part: Any, places: npt.NDArray[np.intp]) -> Any:
    """A memory with some restarts written over."""
    if not places.size:
        return memory

    def written(value: Any, news: Any) -> Any:
        if not isinstance(value, np.ndarray) or value.shape[-1] == 1:
            return news
        out = value.copy()
        out[..., places] = news
        return out

    return _mapped(written, memory, part)


# ------------------------------------------------------------------------------------- in files
def _settings(optimiser: Any) -> Mapping[str, Any]:
    return {
        field.alias or field.name: getattr(optimiser, field.name)
        for field in attrs.fields(type(optimiser))
        if field.init
    }


def _registered(optimiser: Any) -> str:
    """The name under which the registry has its class."""
    home = f"{type(optimiser).__module__}:{type(optimiser).__qualname__}"
    for component in optimisers:
        if component.target == home:
            return component.name
    raise CapabilityError(
        wording(f"optimiser {type(optimiser).__name__}", got="a class that is not registered",
                expected="one that a file can name", do="register it: docs, how to write a plugin")
    )  # fmt: skip
