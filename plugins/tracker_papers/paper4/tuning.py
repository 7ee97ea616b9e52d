"""Off-line tuning as the thesis does it: optimisers look for the numbers of fuzzy systems.

The cost of a candidate is a whole filter run; all candidates of all restarts are lanes of one run.
Optimisers and the loop around them are `tracker_optimise` and `tracker.optimisation`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import attrs
import numpy as np

import tracker as tk
from tracker.metrics.errors import error
from tracker.types import Array, Gaussian, Record
from tracker_papers.paper4 import methods
from tracker_papers.paper4.scores import cross_mismatch, mismatch, rms

OPTIMISERS: Mapping[str, tuple[str, dict[str, Any]]] = MappingProxyType({
    "ga": ("genetic", {}),
    "pso": ("particle_swarm", {"inertia": (0.9, 0.0)}),
    "ica": ("imperialist", {}),
})  # fmt: skip
"""The three of the thesis, at its constants where it gives any: C1 = C2 = 2, inertia to zero."""

STRONGER: Mapping[str, tuple[str, dict[str, Any]]] = MappingProxyType({
    "de": ("differential_evolution", {}),
    "cma-es": ("cma_es", {}),
    "pso, constricted": ("particle_swarm", {"constriction": True, "cognitive": 2.05, "social": 2.05}),
})  # fmt: skip
"""Optimisers that the thesis names as future work."""

TRAINING = 1
"""Condition of the runs that are tuned on; no other study uses it."""

LANES = 1536
"""Filter runs at once: histories of more leave the cache without any gain."""


@attrs.frozen(eq=False)
class Problem:
    """An adapter to be tuned on runs of a scenario, one for each restart.

    ``bounds`` ``(d, 2)`` of its numbers; ``build`` makes the adapter of numbers ``(d, *batch)``.
    ``largest`` is the largest mismatch of the filter without adapter on these runs, by block of
    numbers, in variances told: it sets the bounds.
    """

    scene: tk.Scenario
    name: str
    bounds: Array = attrs.field(repr=False)
    adapted: Callable[[Array], Any] = attrs.field(repr=False)
    largest: Array = attrs.field(repr=False)
    simulation: Any = attrs.field(repr=False)
    objective: str = "dom"

    @property
    def restarts(self) -> int:
        """As many as there are runs to tune on."""
        return len(self.simulation.runs)

    def estimator(self, numbers: Array) -> Any:
        """The filter with the adapter of these numbers."""
        return methods.estimator(self.scene, self.name, self.adapted(numbers))

    def cost(self, candidates: Array) -> Array:
        """Cost of candidates ``(d, population, restarts)``: ``(population, restarts)``.

        "dom" is eq. 3-19 in the linear example; under water, where entries differ by orders of
        magnitude, each RMS is divided by the variance told. "error" is the RMSE of the position,
        which only a simulation knows.
        """
        d, population, restarts = candidates.shape
        lanes = candidates.reshape(d, -1)
        out = np.empty(population * restarts)
        block = max(1, LANES // restarts) * restarts
        for first in range(0, len(out), block):
            part = slice(first, min(first + block, len(out)))
            out[part] = self._run(lanes[:, part])
        return out.reshape(population, restarts)

    def _run(self, numbers: Array) -> Array:
        times = numbers.shape[1] // self.restarts
        record, prior = self.simulation.record, self.simulation.prior
        many = Record(record.t, np.tile(np.asarray(record.z), (1, 1, times)), pose=record.pose)
        begin = Gaussian.trusted(np.tile(prior.mean, (1, times)), np.tile(prior.cov, (1, 1, times)))
        history = tk.filter(self.estimator(numbers), many, begin, start=self.simulation.start)
        with np.errstate(all="ignore"):
            if self.objective == "error":
                truth = np.tile(self.simulation.truth, (1, 1, times))
                off = error(truth, np.asarray(history.filtered.mean), self.scene.motion.space)
                places = list(self.scene.motion.space.position)
                if (
                    len(places) == 1
                ):  # the linear example: position, velocity and acceleration alike
                    places = list(range(self.scene.motion.space.size))
                return np.asarray(rms(off)[places].sum(axis=0))
            found = rms(mismatch(history).dom)
            if self.scene.motion.space.size == 3:
                return np.asarray(1000.0 * found.sum(axis=0))
            return np.asarray((found / told_variances(self.scene)[:, None]).sum(axis=0))


def told_variances(scene: tk.Scenario) -> Array:
    """The diagonal of the R that estimators are told, ``(m,)``."""
    x = scene.prior.mean[:, None]
    pose = None if scene.pose is None else scene.pose[0]
    R = np.asarray(scene.sensor.R(x, pose))
    return np.array(np.diagonal(R.reshape(*R.shape[:2], -1)[..., 0]))


def true_variances(scene: tk.Scenario, what: str) -> Array:
    """The diagonal of the true R, ``(m,)``, or of the true Q, ``(n,)``."""
    if what == "R":
        return told_variances(attrs.evolve(scene, sensor=scene.true_sensor))
    Q = np.asarray(scene.true_motion.Q(scene.prior.mean[:, None], 1.0))
    return np.array(np.diagonal(Q.reshape(*Q.shape[:2], -1)[..., 0]))


def problem(
    scene: tk.Scenario,
    name: str,
    adapter: Any,
    restarts: int,
    seed: int,
    *,
    shared: Sequence[int],
    objective: str = "dom",
) -> Problem:
    """Tune on one run for each restart; bounds by the mismatch of the filter without adapter.

    ``shared`` says which block of numbers each entry of the adapter takes, so that both sensors may
    share a system.
    """
    made = scene.simulate(seed, restarts, condition=TRAINING)
    plain = methods.estimator(scene, name)
    history = tk.filter(plain, made.record, made.prior, start=made.start)
    if "Q" in adapter.tunes:
        dom = np.abs(mismatch(history).dom)
        whole = np.concatenate([dom, cross_mismatch(history)[:, None] ** 2], axis=1)
        x = scene.prior.mean[:, None]
        unit = np.einsum("ii...->i...", np.asarray(scene.motion.Q(x, 1.0)))[..., 0]
    else:
        whole, unit = np.abs(mismatch(history).dom), told_variances(scene)
    # the window's first, empty part says nothing about the noise
    largest = np.median(whole[24:].max(axis=0), axis=-1) / unit
    blocks = np.array(
        [
            float(np.mean([largest[i] for i, b in enumerate(shared) if b == block]))
            for block in range(max(shared) + 1)
        ]
    )
    if hasattr(adapter, "system"):
        limits, build = methods.bounds(blocks), _spread(adapter, shared, 15, methods.with_numbers)
    else:
        limits = methods.network_bounds(blocks)
        build = _spread(adapter, shared, 3 * methods.UNITS, methods.with_network)
    return Problem(scene, name, limits, build, blocks, made, objective)


def _spread(
    adapter: Any, shared: Sequence[int], size: int, build: Callable[[Any, Array, int], Any]
) -> Callable[[Array], Any]:
    """The adapter of some numbers, of which each entry takes its own block of ``size``."""

    def adapted(numbers: Array) -> Any:
        spread = np.concatenate([numbers[size * b : size * b + size] for b in shared])
        return build(adapter, spread, len(shared))

    return adapted


@attrs.frozen(eq=False)
class Tuned:
    """What optimisers found: for each the numbers ``(d, restarts)`` and the cost ``(restarts,)`` of the
    best, and the best cost after each generation ``(generations, restarts)``.
    """

    problem: Problem
    numbers: Mapping[str, Array] = attrs.field(repr=False)
    cost: Mapping[str, Array] = attrs.field(repr=False)
    history: Mapping[str, Array] = attrs.field(repr=False)
    evaluations: int
    """Of each restart of each optimiser, the same for all."""

    def estimators(self) -> dict[str, Any]:
        """For each optimiser a function of run numbers: run k is filtered with what restart k found."""
        return {name: self._dealt(numbers) for name, numbers in self.numbers.items()}

    def best(self, name: str) -> Array:
        """The numbers of lowest cost, ``(d,)``."""
        return self.numbers[name][:, int(np.argmin(self.cost[name]))]

    def median(self, name: str) -> Array:
        """The numbers of median cost, ``(d,)``: what a user who tunes once should expect."""
        order = np.argsort(self.cost[name])
        return self.numbers[name][:, int(order[len(order) // 2])]

    def _dealt(self, numbers: Array) -> Callable[[Any], Any]:
        def built(places: Any) -> Any:
            lanes = np.asarray(places) % numbers.shape[1]
            return self.problem.estimator(np.ascontiguousarray(numbers[:, lanes]))

        return built


def tune(
    problem: Problem,
    optimisers: Mapping[str, tuple[str, dict[str, Any]]],
    *,
    population: int,
    generations: int,
    seed: int,
) -> Tuned:
    """Every optimiser on the same runs with the same budget, ``population`` times ``generations``."""
    numbers, cost, history = {}, {}, {}
    budget = population * generations
    for label, (name, options) in optimisers.items():
        more = {"generations": generations} if name == "particle_swarm" else {}
        one = tk.optimisers.make(name, **{"population": population} | more | options)
        found = tk.optimise(
            problem.cost,
            problem.bounds,
            one,
            evaluations=budget,
            restarts=problem.restarts,
            seed=seed,
        )
        numbers[label], cost[label] = found.x[:, 0], found.cost[0]
        history[label] = found.best[:, 0]
    return Tuned(problem, numbers, cost, history, budget)
