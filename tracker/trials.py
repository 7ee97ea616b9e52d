"""Many settings of an estimator's numbers tried on the same runs: every setting and run is a lane.

Which settings to try, and what is good about a score, is decided elsewhere.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Collection, Sequence
from typing import Any

import attrs
import numpy as np

from tracker import estimation
from tracker.algebra import at_once
from tracker.compile import fuse
from tracker.compile import run as compiled
from tracker.compile.fuse import TOTALS, WINDOW
from tracker.compile.values import entries, form_of
from tracker.errors import CapabilityError, DomainError, ShapeError, TrackerError, wording
from tracker.estimation import Estimator, record_lanes
from tracker.models.graph import Graph, Node
from tracker.models.parameters import numbers_of, with_numbers
from tracker.recursion import begin, is_random
from tracker.threads import each
from tracker.types import Array, Gaussian, Record

__all__ = ["TOTALS", "Trials", "numbers", "place", "retuned"]

Place = tuple[str, str]
"""Whose number - "motion", "filter", "adapter", "sensor0" and so on - and what it is called."""

ERRORS = frozenset({"squared_error", "nees"})
"""The totals that are differences from the truth."""

TILE_BYTES = 32_000_000
"""Of measurements and truths that a compiled call reads: more does not make it faster."""


# ---------------------------------------------------------------------------- names of numbers
def numbers(estimator: Estimator) -> dict[str, Any]:
    """The numbers of an estimator's parts by the names that `tracker.tune` knows them by.

    Example:
    >>> import tracker as tk
    >>> scene = tk.scenario("line", axes=1)
    >>> numbers(tk.estimator("kf", motion=scene.motion, sensor=scene.sensor))
    {'motion.density': ..., 'sensor.sigma': ...}
    """
    one = len(estimator.sensors) == 1
    return {
        f"{'sensor' if one and owner == 'sensor0' else owner}.{name}": value
        for owner, component in compiled.owners(estimator).items()
        for name, value in numbers_of(component).items()
    }


def place(estimator: Estimator, name: str) -> Place:
    """Where the number called ``name`` is.

    Raises:
        DomainError: if there is none of that name, or it differs between lanes already.
    """
    offered = numbers(estimator)
    owner, _, own = name.partition(".")
    if owner == "sensor0" and f"sensor.{own}" in offered:
        name = f"sensor.{own}"
    if name not in offered:
        near = difflib.get_close_matches(name, offered, n=1)
        raise DomainError(
            wording(
                "argument 'parameters'",
                got=repr(name),
                expected=f"numbers of the estimator's parts: {', '.join(offered) or 'it has none'}",
                do=f"write {near[0]!r}" if near else "take one of these",
            )
        )
    if np.ndim(offered[name]):
        raise DomainError(
            wording(
                f"parameter {name!r}",
                got=f"values of shape {np.shape(offered[name])}",
                expected="one number, to begin with",
                do="give the estimator a single value",
            )
        )
    return ("sensor0" if owner == "sensor" else owner), own


def retuned(estimator: Estimator, places: Sequence[Sequence[Place]], values: Any) -> Estimator:
    """The estimator with other numbers: one value, a float or lanes, for each group of places.

    Raises:
        TrackerError: what a component says to numbers that it refuses.
    """
    parts = compiled.owners(estimator) | _parts(estimator, places, values)
    sensors = tuple(parts[f"sensor{i}"] for i in range(len(estimator.sensors)))
    return attrs.evolve(
        estimator,
        motion=parts["motion"],
        filter=parts["filter"],
        adapter=parts["adapter"],
        sensors=sensors,
    )


def _parts(estimator: Estimator, places: Sequence[Sequence[Place]], values: Any) -> dict[str, Any]:
    """The components whose numbers change, with other numbers."""
    given: dict[str, dict[str, Any]] = {}
    for group, value in zip(places, values, strict=True):
        for owner, name in group:
            given.setdefault(owner, {})[name] = value
    owners = compiled.owners(estimator)
    return {owner: with_numbers(owners[owner], numbers_) for owner, numbers_ in given.items()}


# ------------------------------------------------------------------------------------- trials
class Trials:
    """Runs that settings of some numbers are tried on; called with settings, it returns what they score.

    It holds the runs in the form in which they are read, and fills in nothing but numbers at a call.

    ``wanted`` are names of `TOTALS`; those of errors need the truth. ``together`` is how many settings a
    call will have, as a rule. ``draws`` gives the generator of a run, for filters that draw random
    numbers: every setting sees the same ones.

    Shapes:
        record of any batch shape, each lane a run; prior likewise, or shared; truth
        ``(T, n, *batch)``.

    Raises:
        ShapeError, DomainError: when record, prior and models do not fit together.
        CapabilityError: if what is wanted cannot be had: errors without truth, mismatch of several
        sensors.
    Laws:
        what a setting scores does not depend on its company, nor on ``workers``.
    """

    def __init__(
        self,
        estimator: Estimator,
        places: Sequence[Sequence[Place]],
        record: Record,
        prior: Gaussian,
        start: float | None,
        truth: Array | None,
        wanted: Collection[str],
        *,
        together: int = 1,
        workers: int = 1,
        draws: Callable[[int], np.random.Generator] | None = None,
    ) -> None:
        self.wanted = [name for name in TOTALS if name in wanted]
        told = not ERRORS.isdisjoint(wanted)
        _check(estimator, record, truth if told else None, wanted)
        prior = estimation.fitting(estimator, record, prior, start)
        self.estimator, self.places, self.start = estimator, places, start
        self.record, self.prior, runs = estimation.in_a_row(record, prior)
        self.runs = runs
        self.truth: Array | None = None
        if told and truth is not None:
            self.truth = np.reshape(truth, (*np.shape(truth)[:2], runs))
        self.workers, self.draws = workers, draws
        self.reason = compiled.reason(self._lanes(self._present()))
        tiles = -(-together // self._most())
        self.size = -(-together // tiles)  # tiles of one size, hardly filled up
        self._idle: list[compiled.Prepared] = []
        self._begins = not self.reason and self._begins_by_numbers()

    def __call__(self, values: Array) -> dict[str, Array]:
        """Sums over time of what is wanted, for settings ``(d, k)``.

        Shapes:
            each total ``(1, k, runs)``, squared mismatches ``(m, k, runs)``. NaN where a run was
            lost, and for a setting that a component refuses.

        """
        settings = np.array(values, dtype=np.float64)
        refused = self._refused(settings)
        k, size = settings.shape[1], self.size
        out = np.full((self._count, k, self.runs), np.nan)
        work = self._on_arrays if self.reason else self._compiled

        def tile(first: int) -> None:
            chosen = np.minimum(np.arange(first, first + size), k - 1)  # the last one fills it up
            found = work(settings[:, chosen]).reshape(self._count, size, self.runs)
            out[:, first : first + size] = found[:, : k - first]

        if len(refused) < k:
            each(tile, range(0, k, size), self.workers)
            out[:, refused] = np.nan
        cuts = np.cumsum([self._m if name == "mismatch" else 1 for name in self.wanted])[:-1]
        return dict(zip(self.wanted, np.split(out, cuts), strict=True))

    # ------------------------------------------------------------------------------ inside
    @property
    def _m(self) -> int:
        return int(self.estimator.sensors[0].space.size)

    @property
    def _count(self) -> int:
        return len(self.wanted) + (self._m - 1 if "mismatch" in self.wanted else 0)

    def _present(self) -> Array:
        """The numbers as the estimator has them, ``(d, 1)``."""
        owners = compiled.owners(self.estimator)
        firsts = [group[0] for group in self.places]
        return np.array([[numbers_of(owners[owner])[name]] for owner, name in firsts], dtype=float)

    def _most(self) -> int:
        """Settings in a tile; not a matter of workers."""
        n = self.estimator.motion.space.size
        if self.reason:
            members = int(getattr(self.estimator.filter, "width", 1))
            return max(1, estimation.together(n, members) // self.runs)
        width = self.record.z.shape[1] + (0 if self.truth is None else n)
        bytes_ = 8 * len(self.record) * int(width) * self.runs
        return max(1, TILE_BYTES // bytes_)

    def _refused(self, settings: Array) -> list[int]:
        """Which settings some component refuses; in their places is then one that is accepted."""
        if not self._refuses(settings):
            return []
        every = range(settings.shape[1])
        refused = [i for i in every if self._refuses(settings[:, i : i + 1])]
        good = [i for i in every if i not in refused]
        if good:
            settings[:, refused] = settings[:, good[:1]]
        return refused

    def _refuses(self, settings: Array) -> bool:
        try:
            _parts(self.estimator, self.places, settings)
        except TrackerError:
            return True
        return False

    def _lanes(self, values: Array) -> Estimator:
        """The estimator of these settings ``(d, k)``, each repeated over all runs."""
        return retuned(self.estimator, self.places, np.repeat(values, self.runs, axis=1))

    def _repeated(self, k: int) -> tuple[Record, Gaussian, Array | None]:
        index = np.tile(np.arange(self.runs), k)
        truth = None if self.truth is None else self.truth[..., index]
        return record_lanes(self.record, index), self.prior[index], truth

    # ---------------------------------------------------------------------------- compiled
    def _compiled(self, values: Array) -> Array:
        try:
            ready = self._idle.pop()
        except IndexError:  # every worker makes its own, once
            keep = tuple(f"total {name}" for name in self.wanted)
            record, prior, truth = self._repeated(values.shape[1])
            lanes = self._lanes(values)
            ready = compiled.prepared(lanes, record, prior, self.start, keep, truth)
        for group, row in zip(self.places, np.repeat(values, self.runs, axis=1), strict=True):
            for owner, name in group:
                ready.put(f"{owner}.{name}", row)
        if self._begins:
            ready.begin(self._lanes(values))
        ready()
        found = ready.totals()
        self._idle.append(ready)
        return found

    def _begins_by_numbers(self) -> bool:
        """Whether what is carried into the first step depends on a number that is varied."""
        if not compiled.begins_otherwise(self.estimator):
            return False
        graph = Graph()
        nodes = [graph.input(f"number{i}") for i in range(len(self.places))]
        try:
            traced = compiled.owners(self.estimator)
            traced |= _parts(self.estimator, self.places, nodes)
            sensors = [traced[f"sensor{i}"] for i in range(len(self.estimator.sensors))]
            pose = None if self.record.pose is None else self.record.pose[0]
            with at_once():
                begun = begin(
                    traced["filter"], traced["adapter"], traced["motion"], sensors,
                    self.prior[:1], pose if pose is None or pose.ndim == 1 else pose[:, :1],
                )  # fmt: skip
            found = entries(form_of(begun, 1), begun)
        except (*compiled.FAILURES, TrackerError):
            return True  # it cannot be told: then it is computed anew every time
        flat = [entry for values in found.values() for value in values for entry in np.ravel(value)]
        return any(isinstance(entry, Node) and entry.op != "const" for entry in flat)

    # --------------------------------------------------------------------------- on arrays
    def _on_arrays(self, values: Array) -> Array:
        alone = values.shape[1] * self.runs == 1  # products over one lane take other code paths
        settings = np.repeat(values, 2, axis=1) if alone else values
        rng = None
        if is_random(self.estimator.filter) and self.draws is not None:
            rng = [self.draws(run) for _ in range(settings.shape[1]) for run in range(self.runs)]
        with at_once():
            found = self._summed(self._lanes(settings), *self._repeated(settings.shape[1]), rng)
        return found[:, :1] if alone else found

    def _summed(
        self, estimator: Estimator, record: Record, prior: Gaussian, truth: Any, rng: Any
    ) -> Array:
        lanes = prior.batch
        total = np.zeros((self._count, *lanes))
        ring = np.zeros((WINDOW, 2 * self._m, *lanes))
        kept: Any = np.zeros((2 * self._m + 1, *lanes))
        for step, _, _, belief, innovation in estimation.steps(
            estimator, record, prior, self.start, rng
        ):
            now = None if truth is None else truth[step]
            found = fuse.summands(
                estimator.motion.space, belief.moments(), innovation, now, self.wanted
            )
            if "mismatch" in self.wanted:
                oldest: Any = ring[step % WINDOW].copy()
                v: Any = innovation.residual
                found["mismatch"], kept, ring[step % WINDOW] = fuse.mismatched(
                    kept, oldest, v, innovation.S
                )
            rows = [row for name in self.wanted for row in found[name]]
            for i, value in enumerate(rows):
                total[i] += value
        return total


def _check(estimator: Estimator, record: Record, truth: Any, wanted: Collection[str]) -> None:
    if not len(record) or 0 in record.batch:
        raise DomainError(
            wording("the record", got="no rows or no runs", expected="something to score",
                    do="give at least one row and one run")
        )  # fmt: skip
    if "mismatch" in wanted and len(estimator.sensors) > 1:
        raise CapabilityError(
            wording("the degree of mismatch", got=f"{len(estimator.sensors)} sensors",
                    expected="one, which measures at every row",
                    do="join them to a stack (tracker_sensors.stack), or tune for 'innovation'")
        )  # fmt: skip
    if ERRORS.isdisjoint(wanted):
        return
    if truth is None:
        raise CapabilityError(
            wording("errors of an estimator", got="no truth", expected="what was true at every row",
                    do="pass truth=..., or tune for 'likelihood' or 'innovation'")
        )  # fmt: skip
    shape = (len(record), estimator.motion.space.size, *record.batch)
    if np.shape(truth) != shape:
        raise ShapeError(
            wording("argument 'truth'", got=f"shape {np.shape(truth)}",
                    expected=f"{shape}: {estimator.motion.space}", do="give the state at every row")
        )  # fmt: skip
