"""Noise by maximum likelihood from records alone: expectation maximisation for Q and R.

Estimates that a filter makes as it goes are noise adapters, which are plugins; a search for any other
number is `tracker.tuning`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import attrs
import numpy as np

from tracker import estimation
from tracker.adaptation import with_noise, with_process_noise
from tracker.algebra import apply, at_once, congruence, gain, product, transpose
from tracker.errors import CapabilityError, DomainError, wording
from tracker.estimation import Estimator, check_capabilities
from tracker.models.parameters import filled, one_of
from tracker.types import Array, Gaussian, Record, brief

__all__ = ["NoiseEstimate", "expectation_maximisation"]

FORMS = ("full", "diagonal", "scaled", "fixed")


@attrs.frozen(eq=False)
class NoiseEstimate:
    """Noise covariances that expectation maximisation has found.

    Shapes:
        Q ``(n, n)``, R ``(m, m)``, loglik ``(iterations + 1,)``: that of all runs before each iteration
        and after the last; estimated for each run by itself, these end in an axis of runs.
    """

    Q: Array = attrs.field(repr=brief)
    R: Array = attrs.field(repr=brief)
    loglik: Array = attrs.field(repr=brief)
    converged: bool
    estimator: Estimator = attrs.field(repr=False)
    """The estimator with this noise."""

    def __str__(self) -> str:
        lanes = f", {self.loglik.shape[1]} runs by themselves" if self.loglik.ndim > 1 else ""
        why = "converged" if self.converged else "not converged: raise iterations"
        first, last = (float(np.mean(self.loglik[k])) for k in (0, -1))
        sigma = "\n".join(
            f"standard deviations by {name}: "
            + ", ".join(f"{np.sqrt(np.mean(M[i, i])):.4g}" for i in range(len(M)))
            for name, M in (("Q", self.Q), ("R", self.R))
        )
        return (
            f"expectation maximisation{lanes}: {len(self.loglik) - 1} iterations, {why}; "
            f"log-likelihood {first:.6g} to {last:.6g}\n{sigma}"
        )


def expectation_maximisation(
    estimator: Estimator,
    record: Record,
    prior: Gaussian,
    *,
    start: float | None = None,
    process: str = "full",
    measurement: str = "full",
    together: bool = True,
    iterations: int = 200,
    tolerance: float = 1e-6,
) -> NoiseEstimate:
    """Q and R of a linear motion and any sensor, from what the smoother says of their noise, again and again.

    ``process`` and ``measurement`` say what may become of Q and of R, which begin as the estimator's:
    any covariance ("full"), its diagonal alone ("diagonal"), a multiple of what it is ("scaled"), or
    nothing else ("fixed"). A step of no time has no process noise. One pair is found for all runs ``together``, or one for each run. It ends when
    the log-likelihood rises by less than ``tolerance`` times its size, or after ``iterations``.

    What was not measured is expected, not ignored. The maximum may be a local one, and Q in full from
    few measured components need not be unique. A sensor that is not linear is linearised at the smoothed
    states; with it the likelihood is the filter's approximation, and need not rise at every iteration.

    Shapes:
        record of any batch shape, its lanes being runs; prior likewise or shared, at ``start``.

    Raises:
        CapabilityError: for a motion that is not linear, a sensor without a Jacobian, several sensors,
            or a noise adapter.
        DomainError: if Q is sought and time steps differ, or a covariance to be scaled is singular.

    Reference:
        Shumway and Stoffer (1982), An approach to time series smoothing and forecasting using the EM
        algorithm, eq. 9-14, with A = F and the initial moments known; missing components after
        Shumway and Stoffer (2000), section 4.4; other sensors after Särkkä (2013), Bayesian Filtering
        and Smoothing, section 12.3.3.
    Laws:
        the log-likelihood never falls where the sensor is linear.

    Example:
    >>> import tracker as tk
    >>> scene = tk.scenario("line", axes=1)
    >>> kf = tk.estimator("kf", motion=scene.motion, sensor=scene.sensor.with_parameters(sigma=9.0))
    >>> sim = scene.simulate(seed=1, runs=20)
    >>> found = expectation_maximisation(kf, sim.record, sim.prior, start=sim.start, process="scaled")
    >>> bool(abs(np.sqrt(found.R[0, 0]) / scene.sensor.parameters["sigma"] - 1) < 0.1)
    True
    """
    for name, value in (("process", process), ("measurement", measurement)):
        one_of(name, value, FORMS)
    if iterations < 1 or not tolerance >= 0.0:
        raise DomainError(
            wording("arguments 'iterations' and 'tolerance'", got=f"{iterations} and {tolerance}",
                    expected="at least one iteration, a tolerance not negative", do="leave them out")
        )  # fmt: skip
    for need, role, model in (
        ("linear", "motion", estimator.motion),
        ("jacobian", "sensor", estimator.sensors[0]),
    ):
        check_capabilities("expectation maximisation", (need,), role, model)
    if len(estimator.sensors) != 1 or estimator.adapter is not None:
        got = f"{len(estimator.sensors)} sensors" + (
            ", a noise adapter" if estimator.adapter else ""
        )
        raise CapabilityError(
            wording("the estimator", got=got, expected="one sensor, and noise that nobody else adapts",
                    do="join sensors to a stack, leave the adapter out")
        )  # fmt: skip
    rows = _Rows.of(estimator, record, prior, start)
    if process != "fixed":
        rows.check_steps()
    Q, R = rows.noise()
    if not together:
        Q, R = (np.repeat(M, rows.runs, axis=2) for M in (Q, R))
    best_Q, best_R = _constraint(process, Q, "Q"), _constraint(measurement, R, "R")
    Q, R = (best(M) if best else M for best, M in ((best_Q, Q), (best_R, R)))
    found: list[Array] = []
    done = False
    with at_once():
        while True:
            loglik, moments = rows.smoothed(Q if best_Q else None, R if best_R else None)
            found.append(np.asarray(loglik.sum()) if together else loglik)
            if len(found) > 1:
                done = bool(np.all(found[-1] - found[-2] <= tolerance * np.abs(found[-1])))
            if done or len(found) > iterations:
                break
            if best_Q:
                Q = best_Q(rows.process(moments, together))
            if best_R:
                R = best_R(rows.measurement(moments, R, together))
    kept = (Q[..., 0], R[..., 0]) if together else (Q, R)
    tuned = _with(estimator, kept[0] if best_Q else None, kept[1] if best_R else None)
    return NoiseEstimate(*kept, np.array(found), done, tuned)


def _constraint(form: str, given: Array, name: str) -> Callable[[Array], Array] | None:
    """From the expected products of the noise to the most likely covariance of that form; None if fixed."""
    if form == "fixed":
        return None
    if form == "full":
        return np.asarray
    if form == "diagonal":
        own = np.eye(len(given))[..., None]
        return lambda expected: expected * own
    size, matrices = len(given), np.moveaxis(given, -1, 0)
    rank = np.linalg.matrix_rank(matrices, hermitian=True).min()
    if rank < size:
        raise DomainError(
            wording(f"{name} to be scaled", got=f"a matrix of rank {rank}",
                    expected=f"a regular one, rank {size}", do="use 'diagonal' or 'full'")
        )  # fmt: skip
    inverse = np.moveaxis(np.linalg.pinv(matrices, hermitian=True), 0, -1)
    return lambda expected: given * (np.einsum("ij...,ji...->...", inverse, expected) / size)


@attrs.frozen(eq=False)
class _Moments:
    """Smoothed moments before the first row and at each row, and the smoother's gain from each to the next.

    Shapes:
        mean ``(T + 1, n, runs)``, cov ``(T + 1, n, n, runs)``, gains ``(T, n, n, runs)``.
    """

    mean: Array
    cov: Array
    gains: Array


@attrs.frozen(eq=False)
class _Rows:
    """A record whose runs are one axis, and the linear motion at its rows.

    Shapes:
        dt, seconds to each row from the one before, ``(T,)`` or ``(T, runs)``; F ``(T, n, n, runs)``
        and c ``(T, n, runs)``: ``x' = F x + c``.
    """

    estimator: Estimator
    record: Record
    prior: Gaussian
    start: float | None
    dt: Array
    F: Array
    c: Array

    @classmethod
    def of(
        cls, estimator: Estimator, record: Record, prior: Gaussian, start: float | None
    ) -> _Rows:
        if not len(record):
            raise DomainError(
                wording("the record", got="no rows", expected="measurements", do="give some")
            )
        whole = estimation.fitting(estimator, record, prior, start)
        flat, state, runs = estimation.in_a_row(record, whole)
        first = flat.t[:1] if start is None else np.full_like(flat.t[:1], start)
        dt = np.diff(np.concatenate([first, flat.t]), axis=0)
        motion, zero, models = estimator.motion, np.zeros((state.n, runs)), []
        for k in range(len(flat)):
            u, before = None if flat.u is None else flat.u[k], flat.t[k] - dt[k]
            models.append(
                [
                    filled(motion.jacobian(zero, dt[k], u, before), 2, (runs,)),
                    motion.f(zero, dt[k], u, before),
                ]
            )
        stacked = (np.stack(values) for values in zip(*models, strict=True))
        return cls(estimator, flat, state, start, dt, *stacked)

    @property
    def runs(self) -> int:
        return int(self.record.z.shape[-1])

    def check_steps(self) -> None:
        used = self.dt[self.dt > 0.0]
        if used.size and np.ptp(used) > 1e-9 * used.max():
            raise DomainError(
                wording("time steps", got=f"{used.min():g} to {used.max():g} s",
                        expected="equal ones, as Q belongs to one of them",
                        do="fix Q (process='fixed'), or tune the motion's own numbers with tk.tune")
            )  # fmt: skip

    def noise(self) -> tuple[Array, Array]:
        """The models' own, ``(n, n, 1)`` and ``(m, m, 1)``."""
        x, used, pose = self.prior.mean[:, :1], self.dt[self.dt > 0.0], self.record.pose
        where = None
        if pose is not None and self.estimator.sensors[0].pose_space.size:
            where = pose[0] if pose.ndim == 2 else pose[0, :, :1]
        Q = self.estimator.motion.Q(x, float(used.flat[0]) if used.size else 0.0)
        R = self.estimator.sensors[0].R(x, where)
        return _shared(Q), _shared(R)

    # ------------------------------------------------------------------------ expectation
    def smoothed(self, Q: Array | None, R: Array | None) -> tuple[Array, _Moments]:
        """Log-likelihood ``(runs,)``, and smoothed moments, with this noise (None: the models' own)."""
        tuned = _with(self.estimator, Q, R)
        ahead, filtered = [], [self.prior]
        loglik = np.zeros(self.runs)
        for _, _, predicted, state, innovation in estimation.steps(
            tuned, self.record, self.prior, self.start
        ):
            ahead.append(predicted.moments())
            filtered.append(state.moments())
            loglik += innovation.loglik
        mean, cov = np.stack([g.mean for g in filtered]), np.stack([g.cov for g in filtered])
        expected, spread = np.stack([g.mean for g in ahead]), np.stack([g.cov for g in ahead])
        F, before, after = (_merged(M) for M in (self.F, cov[:-1], spread))
        gains = _apart(gain(transpose(product(F, before)), after), len(ahead))
        for k in range(len(ahead) - 1, -1, -1):
            mean[k] += apply(gains[k], mean[k + 1] - expected[k])
            cov[k] += congruence(gains[k], cov[k + 1] - spread[k])
        return loglik, _Moments(mean, cov, gains)

    # ----------------------------------------------------------------------- maximisation
    def process(self, moments: _Moments, together: bool) -> Array:
        """Mean of the expected ``w w'`` over the steps that take time, ``(n, n, 1 or runs)``."""
        x, after = _merged(moments.mean[:-1]), _merged(moments.mean[1:])
        P, Pa = _merged(moments.cov[:-1]), _merged(moments.cov[1:])
        F = _merged(self.F)
        w = after - apply(F, x) - _merged(self.c)
        cross = product(F, product(_merged(moments.gains), Pa))  # F cov(x_k, x_k+1)
        found = w[:, None] * w[None] + Pa + congruence(F, P) - cross - transpose(cross)
        takes = self.dt > 0.0 if self.dt.ndim > 1 else self.dt[:, None] > 0.0
        return self._mean(found, np.broadcast_to(takes, (len(self.dt), self.runs)), together)

    def measurement(self, moments: _Moments, R: Array, together: bool) -> Array:
        """Mean of the expected ``v v'`` over the rows in which something was measured."""
        H, expected = (_merged(values) for values in self._seen(moments.mean[1:]))
        P, z = _merged(moments.cov[1:]), _merged(self.record.z[:, : len(H)])
        v = self.estimator.sensors[0].residual(z, expected)
        old = np.tile(np.broadcast_to(R, (*R.shape[:2], self.runs)), len(self.record))
        seen = (~np.isnan(v)).astype(float)
        v = np.where(np.isnan(v), 0.0, v)
        both = seen[:, None] * seen[None]
        # The noise of what was not measured, given the rest: B times that, and something of R - B R B'.
        B = gain(old * seen[None], both * old + np.eye(len(H))[..., None] * (1.0 - seen)) * seen
        found = congruence(B, (v[:, None] * v[None] + congruence(H, P)) * both)
        found = found + old - congruence(B, both * old)
        return self._mean(found, (seen.sum(axis=0) > 0.0).reshape(-1, self.runs), together)

    def _seen(self, x: Array) -> tuple[Array, Array]:
        """The sensor's Jacobian ``(T, m, n, runs)`` and what it would measure ``(T, m, runs)`` of states."""
        sensor, pose = self.estimator.sensors[0], self.record.pose
        where = None if pose is None or not sensor.pose_space.size else pose
        found = [
            (
                filled(sensor.jacobian(x[k], None if where is None else where[k]), 2, (self.runs,)),
                sensor.h(x[k], None if where is None else where[k]),
            )
            for k in range(len(x))
        ]
        H, expected = (np.stack(values) for values in zip(*found, strict=True))
        return H, expected

    def _mean(self, found: Array, counts: Array, together: bool) -> Array:
        """Mean over those steps that count, and over runs, of ``(n, n, T * runs)``."""
        total = np.where(counts.reshape(-1), found, 0.0)
        total = total.reshape(*found.shape[:2], *counts.shape).sum(axis=2)
        count = counts.sum(axis=0)
        if together:
            total, count = total.sum(axis=-1, keepdims=True), count.sum(keepdims=True)
        out = total / np.maximum(count, 1)
        return np.asarray(0.5 * (out + out.swapaxes(0, 1)))


def _with(estimator: Estimator, Q: Array | None, R: Array | None) -> Estimator:
    """The estimator with this noise; None is its own."""
    motion = estimator.motion if Q is None else with_process_noise(estimator.motion, Q)
    sensor = estimator.sensors[0] if R is None else with_noise(estimator.sensors[0], R)
    return attrs.evolve(estimator, motion=motion, sensors=(sensor,))


def _shared(matrix: Any) -> Array:
    return np.array(filled(matrix, 2, (1,)), dtype=np.float64)


def _merged(values: Array) -> Array:
    """``(T, ..., runs)`` as ``(..., T * runs)``: steps are lanes."""
    moved = np.moveaxis(values, 0, -2)
    return np.ascontiguousarray(moved).reshape(*moved.shape[:-2], -1)


def _apart(values: Array, steps: int) -> Array:
    """The opposite of `_merged`."""
    return np.ascontiguousarray(np.moveaxis(values.reshape(*values.shape[:-1], steps, -1), -2, 0))
