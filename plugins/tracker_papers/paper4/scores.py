"""What the thesis measures of a run - J1 to J4, the degree of mismatch, the RMSE of each state - and
running a scenario for it.

Which filters are compared stands in `methods`; verdicts and pictures are made of these numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import attrs
import numpy as np

import tracker as tk
from tracker.algebra import at_once
from tracker.metrics.consistency import nees
from tracker.metrics.errors import error, squared_position_error
from tracker.metrics.noise import measurement_noise
from tracker.recursion import is_random
from tracker.simulation import stream
from tracker.types import Array, History

WINDOW = 25
"""Steps in the sample covariance of innovations (eq. 3-5)."""

LATE = 100
"""What adapting comes to is judged over so many steps at the end."""

TILE = 128
"""Runs worked at once."""


@attrs.frozen(eq=False)
class Mismatch:
    """The diagonals of S, of the sample C of eq. 3-5, and of their difference DOM (eq. 3-6).

    The thesis sets C to zero until a window has passed. DOM is zero there as well: were it S, the
    first 24 steps alone would cost twice what the thesis prints for 500 (``dom_from_the_start``).

    Shapes:
        each ``(T, m, *batch)``.
    """

    theory: Array = attrs.field(repr=False)
    sample: Array = attrs.field(repr=False)
    window: int = WINDOW

    @property
    def dom(self) -> Array:
        """``S - C``, zero until a window has passed."""
        out = self.dom_from_the_start
        out[: self.window - 1] = 0.0
        return out

    @property
    def dom_from_the_start(self) -> Array:
        """``S - C`` with C zero until a window has passed: there it is S itself."""
        return np.asarray(self.theory - self.sample)


def mismatch(history: History, window: int = WINDOW) -> Mismatch:
    """Theory and sample of each innovation's variance.

    Laws:
        equal to `tracker_adaptive.degree_of_mismatch` (tests/papers/test_paper_4.py).
    Source: paper 4, eq. 3-3 to 3-6.
    """
    residual = np.asarray(history.innovation.residual)
    return Mismatch(
        np.einsum("tii...->ti...", history.innovation.S),
        _moving(residual, residual, window),
        window,
    )


def cross_mismatch(history: History, window: int = WINDOW) -> Array:
    """``DOM(1, 2)``, ``(T, *batch)``: what eq. 3-21 squares."""
    residual, S = np.asarray(history.innovation.residual), np.asarray(history.innovation.S)
    return np.asarray(S[:, 0, 1] - _moving(residual[:, 0], residual[:, 1], window))


def _moving(a: Array, b: Array, window: int) -> Array:
    total = np.cumsum(a * b, axis=0)
    out = np.zeros_like(total)
    out[window - 1 :] = total[window - 1 :]
    out[window:] -= total[:-window]
    return out / window


def by_restart(values: Array, restarts: int) -> Array:
    """Means over the runs that each restart was dealt; restarts of different optimisers got the same."""
    return np.array([np.nanmean(values[k::restarts]) for k in range(restarts)])


def rms(values: Array) -> Array:
    """Root mean square over time, the first axis."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


@attrs.frozen(eq=False)
class Outcome:
    """One estimator over some runs.

    Shapes:
        rmse ``(n, runs)`` of each state over time (J3); j2, dom and late_dom ``(m, runs)``: RMSE of
        the measured quantities, RMS of the degree of mismatch, its mean over the last steps;
        late_R ``(m, runs)``: mean of the measurement noise that was used in the last steps; nees
        ``(runs,)``: mean over time, over n; position ``(T, runs)``: error; mean_square ``(T, n)``.
    """

    rmse: Array = attrs.field(repr=False)
    j2: Array = attrs.field(repr=False)
    dom: Array = attrs.field(repr=False)
    late_dom: Array = attrs.field(repr=False)
    late_R: Array = attrs.field(repr=False)
    nees: Array = attrs.field(repr=False)
    position: Array = attrs.field(repr=False)
    mean_square: Array = attrs.field(repr=False)
    mean_square_measured: Array = attrs.field(repr=False)

    @property
    def place(self) -> Array:
        """RMSE of the position in each run, ``(runs,)``."""
        return rms(self.position)

    @property
    def ok(self) -> Any:
        """Which runs stayed finite, ``(runs,)``."""
        return np.isfinite(self.place)

    def cost(self, alpha: float = 1000.0) -> Array:
        """Eq. 3-19: ``alpha`` times the sum over the measured components of the RMS of DOM."""
        return np.asarray(alpha * self.dom.sum(axis=0))


@attrs.frozen(eq=False)
class Outcomes:
    """Several estimators over the same runs; J1, the RMS of the noise, is none of theirs: ``(m, runs)``."""

    scene: tk.Scenario
    j1: Array = attrs.field(repr=False)
    of: Mapping[str, Outcome]

    def __getitem__(self, name: str) -> Outcome:
        return self.of[name]


def measured(
    scene: tk.Scenario,
    estimators: Mapping[str, Any],
    runs: int | Sequence[int],
    seed: int,
    *,
    condition: int = 0,
    told: Callable[[], None] = lambda: None,
) -> Outcomes:
    """Run estimators over the same simulated runs.

    An entry of ``estimators`` may be a function of the places of the runs, for an estimator whose
    parameters differ between runs. ``told`` is called after each of the estimators.
    """
    numbers = list(range(runs)) if isinstance(runs, int) else list(runs)
    pieces = [numbers[k : k + TILE] for k in range(0, len(numbers), TILE)]
    made = [scene.simulate(seed, piece, condition=condition) for piece in pieces]
    noise = [rms(_between(scene, one.record.z, seen(scene, one.truth))) for one in made]
    out: dict[str, Outcome] = {}
    for name, one in estimators.items():
        parts, first = [], 0
        for simulation in made:
            count = len(simulation.runs)
            built = one(np.arange(first, first + count)) if callable(one) else one
            rng = None
            if is_random(built.filter):
                rng = [stream(seed, run, "filter", condition) for run in simulation.runs]
            history = tk.filter(
                built, simulation.record, simulation.prior, start=simulation.start, rng=rng
            )
            parts.append(_scored(simulation.truth, history, scene))
            first += count
        out[name] = _joined(parts)
        told()
    return Outcomes(scene, np.concatenate(noise, axis=-1), out)


def _between(scene: tk.Scenario, z: Any, h: Array) -> Array:
    """Differences of measurements ``(T, m, *batch)``, through the sensor's residual."""
    found = scene.sensor.residual(np.moveaxis(np.asarray(z), 1, 0), np.moveaxis(h, 1, 0))
    return np.moveaxis(np.asarray(found), 0, 1)


def seen(scene: tk.Scenario, x: Array) -> Array:
    """What the scenario's sensor measures of states ``(T, n, *batch)`` without noise, ``(T, m, *batch)``."""
    across = np.moveaxis(x, 1, 0)
    with at_once():
        return np.moveaxis(np.asarray(scene.sensor.h(across, _poses(scene, across))), 1, 0)


def _poses(scene: tk.Scenario, x: Array) -> Any:
    """The sensors' poses at the times of states ``(n, T, *batch)``, or None."""
    if scene.pose is None:
        return None
    pose = np.asarray(scene.pose)[: x.shape[1]].T
    return np.broadcast_to(
        pose.reshape(*pose.shape, *(1,) * (x.ndim - 2)), (len(pose), *x.shape[1:])
    )


def used_process_noise(estimator: Any, prior: Any, history: History) -> Array:
    """The diagonal of the Q that was used at each step: ``P- - F P F'``, ``(T, n, *batch)``.

    For motions that are linear and the same at every step, as all of the thesis's are.
    """
    before = np.concatenate([prior.cov[None], np.asarray(history.filtered.cov)[:-1]])
    F = np.asarray(estimator.motion.jacobian(prior.mean, 1.0))
    F = F.reshape(*F.shape[:2], -1)[..., 0]
    moved = np.einsum("ij,tjk...,ik->ti...", F, before, F, optimize=True)
    return np.asarray(np.einsum("tii...->ti...", history.predicted.cov) - moved)


def _diagonal(covariances: Array) -> Array:
    return np.asarray(np.einsum("tii...->ti...", covariances))


def _scored(truth: Array, history: History, scene: tk.Scenario) -> Outcome:
    space = scene.motion.space
    mean = np.asarray(history.filtered.mean)
    off = error(truth, mean, space)
    steps = len(mean)
    late = steps - min(LATE, steps)
    with np.errstate(all="ignore"):
        found = mismatch(history)
        measured_off = _between(scene, seen(scene, truth), seen(scene, mean))
        return Outcome(
            rms(off),
            rms(measured_off),
            rms(found.dom),
            np.asarray(np.mean(found.dom[late:], axis=0)),
            np.asarray(np.mean(_diagonal(measurement_noise(history, late)), axis=0)),
            np.asarray(np.mean(nees(off, history.filtered.cov), axis=0) / space.size),
            np.sqrt(squared_position_error(off, space)),
            np.asarray(np.sum(off**2, axis=-1)),
            np.asarray(np.sum(measured_off**2, axis=-1)),
        )


def _joined(parts: Sequence[Outcome]) -> Outcome:
    runs = sum(part.position.shape[-1] for part in parts)
    values = {}
    for field in attrs.fields(Outcome):
        pieces = [getattr(part, field.name) for part in parts]
        if field.name.startswith("mean_square"):
            values[field.name] = np.sum(pieces, axis=0) / runs
        else:
            values[field.name] = np.concatenate(pieces, axis=-1)
    return Outcome(**values)


@attrs.frozen(eq=False)
class Followed:
    """One run of several estimators with every step: what single-run figures show.

    Shapes:
        truth ``(T, n)``; z and clean ``(T, m)``: measured, and without noise; mean ``(T, n)``,
        theory, sample and R ``(T, m)``, Q ``(T, n)`` by estimator: R and Q are what was used.
    """

    scene: tk.Scenario
    truth: Array = attrs.field(repr=False)
    z: Array = attrs.field(repr=False)
    clean: Array = attrs.field(repr=False)
    mean: Mapping[str, Array] = attrs.field(repr=False)
    theory: Mapping[str, Array] = attrs.field(repr=False)
    sample: Mapping[str, Array] = attrs.field(repr=False)
    R: Mapping[str, Array] = attrs.field(repr=False)
    Q: Mapping[str, Array] = attrs.field(repr=False)

    def dom(self, name: str) -> Array:
        """``S - C`` of an estimator."""
        return Mismatch(self.theory[name], self.sample[name]).dom


def follow(scene: tk.Scenario, estimators: Mapping[str, Any], run: int, seed: int) -> Followed:
    """One run, every step."""
    made = scene.simulate(seed, [run])
    parts: dict[str, dict[str, Array]] = {key: {} for key in ("mean", "theory", "sample", "R", "Q")}
    for name, one in estimators.items():
        built = one(np.array([run])) if callable(one) else one
        history = tk.filter(built, made.record, made.prior, start=made.start)
        found = mismatch(history)
        parts["mean"][name] = np.asarray(history.filtered.mean)[..., 0]
        parts["theory"][name], parts["sample"][name] = found.theory[..., 0], found.sample[..., 0]
        parts["R"][name] = _diagonal(measurement_noise(history))[..., 0]
        parts["Q"][name] = used_process_noise(built, made.prior, history)[..., 0]
    return Followed(
        scene,
        made.truth[..., 0],
        np.asarray(made.record.z)[..., 0],
        seen(scene, made.truth)[..., 0],
        **parts,
    )
