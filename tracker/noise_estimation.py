"""Noise of a linear system by maximum likelihood from records alone: expectation maximisation for Q and R.

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
from tracker.models.linearise import linearise
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
    """Q and R of a linear system, from what the smoother says of its noise, again and again.

    ``process`` and ``measurement`` say what may become of Q and of R, which begin as the estimator's:
    any covariance ("full"), its diagonal alone ("diagonal"), a multiple of what it is ("scaled"), or
    nothing else ("fixed"). One pair is found for all runs ``together``, or one for each run. It ends when
    the log-likelihood rises by less than ``tolerance`` times its size, or after ``iterations``.

    What was not measured is expected, not ignored. The maximum may be a local one, and Q in full from
    few measured components need not be unique.

    Shapes:
        record of any batch shape, its lanes being runs; prior likewise or shared, at ``start``.

    Raises:
        CapabilityError: for models that are not linear, several sensors, or a noise adapter.
        DomainError: if Q is sought and time steps differ, or a covariance to be scaled is singular.

    Reference:
        Shumway and Stoffer (1982), An approach to time series smoothing and forecasting using the EM
        algorithm, eq. 9-14, with A = F and the initial moments known; missing components after
        Shumway and Stoffer (2000), section 4.4.
    Laws:
        the log-likelihood never falls.

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
    for role, model in (("motion", estimator.motion), ("sensor", estimator.sensors[0])):
        check_capabilities("expectation maximisation", ("linear",), role, model)
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
    limit = _constraint(process, Q, "Q"), _constraint(measurement, R, "R")
    found: list[Array] = []
    done = False
    with at_once():
        while True:
            loglik, moments = rows.smoothed(Q, R)
            found.append(np.asarray(loglik.sum()) if together else loglik)
            if len(found) > 1:
                done = bool(np.all(found[-1] - found[-2] <= tolerance * np.abs(found[-1])))
            if done or len(found) > iterations:
                break
            if process != "fixed":
                Q = limit[0](rows.process(moments, together))
            if measurement != "fixed":
                R = limit[1](rows.measurement(moments, R, together))
    kept = (Q[..., 0], R[..., 0]) if together else (Q, R)
    tuned = attrs.evolve(
        estimator,
        motion=with_process_noise(estimator.motion, kept[0])
        if process != "fixed"
        else estimator.motion,
        sensors=(with_noise(estimator.sensors[0], kept[1]),)
        if measurement != "fixed"
        else estimator.sensors,
    )
    return NoiseEstimate(*kept, np.array(found), done, tuned)


def _constraint(form: str, given: Array, name: str) -> Callable[[Array], Array]:
    """From the expected products of the noise to the covariance of that form that is most likely."""
    if form == "diagonal":
        own = np.eye(len(given))[..., None]
        return lambda expected: expected * own
    if form != "scaled":
        return lambda expected: expected
    with np.errstate(all="ignore"):
        inverse = np.moveaxis(np.linalg.pinv(np.moveaxis(given, -1, 0), hermitian=True), 0, -1)
    size = len(given)
    whole = np.linalg.matrix_rank(np.moveaxis(given, -1, 0), hermitian=True)
    if (whole < size).any():
        raise DomainError(
            wording(f"{name} to be scaled", got=f"a matrix of rank {int(whole.min())}",
                    expected=f"a regular one, rank {size}", do="use 'diagonal' or 'full'")
        )  # fmt: skip
    return lambda expected: given * (np.einsum("ij...,ji...->...", inverse, expected) / size)


@attrs.frozen(eq=False)
class _Moments:
    """Smoothed moments, and what links them, before the first row and at each row.

    Shapes:
        mean ``(T + 1, n, runs)``, cov ``(T + 1, n, n, runs)``, links ``(T, n, n, runs)``: the smoother's
        gain from each to the next.
    """

    mean: Array
    cov: Array
    links: Array


@attrs.frozen(eq=False)
class _Rows:
    """A record whose runs are one axis."""

    estimator: Estimator
    record: Record
    prior: Gaussian
    start: float | None
    dt: Array
    """Seconds to each row from the one before, ``(T,)`` or ``(T, runs)``."""

    @classmethod
    def of(
        cls, estimator: Estimator, record: Record, prior: Gaussian, start: float | None
    ) -> _Rows:
        if not len(record):
            raise DomainError(
                wording("the record", got="no rows", expected="measurements", do="give some")
            )
        whole = estimation.fitting(estimator, record, prior, start)
        flat, state, _ = estimation.in_a_row(record, whole)
        first = flat.t[:1] if start is None else np.full_like(flat.t[:1], start)
        return cls(estimator, flat, state, start, np.diff(np.concatenate([first, flat.t]), axis=0))

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

    def pose(self, k: int) -> Any:
        sensor, pose = self.estimator.sensors[0], self.record.pose
        return None if pose is None or not sensor.pose_space.size else pose[k]

    def ahead(self, x: Array, k: int) -> tuple[Any, Any]:
        """Where states before row k are at row k without noise, and the transition."""
        record, dt = self.record, self.dt[k]
        u = None if record.u is None else record.u[k]
        return linearise(self.estimator.motion, x, dt, u, record.t[k] - dt)

    def noise(self) -> tuple[Array, Array]:
        """The models' own, ``(n, n, 1)`` and ``(m, m, 1)``."""
        x, used = self.prior.mean[:, :1], self.dt[self.dt > 0.0]
        pose = self.pose(0)
        where = pose if pose is None or pose.ndim == 1 else pose[:, :1]
        Q = self.estimator.motion.Q(x, float(used.flat[0]) if used.size else 0.0)
        R = self.estimator.sensors[0].R(x, where)
        return tuple(np.array(filled(M, 2, (1,)), dtype=np.float64) for M in (Q, R))  # type: ignore[return-value]

    # ------------------------------------------------------------------------ expectation
    def smoothed(self, Q: Array, R: Array) -> tuple[Array, _Moments]:
        """Log-likelihood ``(runs,)``, and smoothed moments, with this noise."""
        motion = with_process_noise(self.estimator.motion, Q)
        tuned = attrs.evolve(
            self.estimator, motion=motion, sensors=(with_noise(self.estimator.sensors[0], R),)
        )
        ahead, filtered = [], [self.prior]
        loglik = np.zeros(self.runs)
        for _, _, predicted, state, innovation in estimation.steps(
            tuned, self.record, self.prior, self.start
        ):
            ahead.append(predicted.moments())
            filtered.append(state.moments())
            loglik += innovation.loglik
        steps, n = len(ahead), self.prior.n
        mean, cov = np.empty((steps + 1, n, self.runs)), np.empty((steps + 1, n, n, self.runs))
        links = np.empty((steps, n, n, self.runs))
        mean[-1], cov[-1] = filtered[-1].mean, filtered[-1].cov
        for k in range(steps - 1, -1, -1):
            before = filtered[k]
            _, F = self.ahead(before.mean, k)
            G = links[k] = gain(transpose(product(F, before.cov)), ahead[k].cov)
            mean[k] = before.mean + apply(G, mean[k + 1] - ahead[k].mean)
            cov[k] = before.cov + congruence(G, cov[k + 1] - ahead[k].cov)
        return loglik, _Moments(mean, cov, links)

    # ----------------------------------------------------------------------- maximisation
    def process(self, moments: _Moments, together: bool) -> Array:
        """Mean of the expected ``w w'`` over the steps that take time, ``(n, n, 1 or runs)``."""
        mean, cov = moments.mean, moments.cov
        total, count = np.zeros(cov.shape[1:]), np.zeros(self.runs)
        for k in range(len(self.record)):
            ahead, F = self.ahead(mean[k], k)
            w = mean[k + 1] - ahead
            cross = product(F, product(moments.links[k], cov[k + 1]))  # F cov(x_k, x_k+1)
            found = w[:, None] * w[None] + cov[k + 1] + congruence(F, cov[k])
            taken = np.broadcast_to(self.dt[k] > 0.0, (self.runs,)).astype(float)
            total += (found - cross - transpose(cross)) * taken
            count += taken
        return _mean(total, count, together)

    def measurement(self, moments: _Moments, R: Array, together: bool) -> Array:
        """Mean of the expected ``v v'`` over the rows in which something was measured."""
        sensor, z = self.estimator.sensors[0], self.record.z
        m = R.shape[0]
        R = np.broadcast_to(R, (m, m, self.runs))
        total, count = np.zeros((m, m, self.runs)), np.zeros(self.runs)
        whole = np.eye(m)[..., None]
        for k in range(len(self.record)):
            x, P = moments.mean[k + 1], moments.cov[k + 1]
            expected, H = linearise(sensor, x, self.pose(k))
            v = sensor.residual(z[k], expected)
            seen = (~np.isnan(v)).astype(float)
            v = np.where(np.isnan(v), 0.0, v)
            both = seen[:, None] * seen[None]
            # The noise of what was not measured, given the rest: v_m = B v_o + something of R - B R_o B'.
            inner = both * R + whole * (1.0 - seen)[None]
            B = gain(R * seen[None], inner) * seen[None]
            found = congruence(B, (v[:, None] * v[None] + congruence(H, P)) * both)
            some = (seen.sum(axis=0) > 0.0).astype(float)
            total += (found + R - congruence(B, both * R)) * some
            count += some
        return _mean(total, count, together)


def _mean(total: Array, count: Array, together: bool) -> Array:
    if together:
        total, count = total.sum(axis=-1, keepdims=True), count.sum(keepdims=True)
    out = total / np.maximum(count, 1.0)
    return 0.5 * (out + out.swapaxes(0, 1))
