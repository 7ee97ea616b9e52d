"""How small the errors of any estimator can be: the posterior Cramér-Rao bound along true paths.

What a record can tell at all is the question of `observability`; how large the errors of an estimator
were, that of `errors`.
"""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.algebra import at_once, condition, congruence, dense, factor, transpose, triangularise
from tracker.algebra import whiten as whitened
from tracker.errors import DomainError, ShapeError, wording
from tracker.metrics.observability import noise_free_path, told
from tracker.metrics.paths import (
    checked_rows,
    checked_scenario,
    checked_sensors,
    checked_times,
    covariance_along,
)
from tracker.models.linearise import linearise
from tracker.types import EMPTY_SPACE, Array, Space, as_array, brief


@attrs.frozen(eq=False)
class Bound:
    """A lower bound of the error covariance at each time: no estimator's is below it.

    Shapes:
        t ``(T,)``; cov ``(T, n, n, *batch)``.
    """

    space: Space
    t: Array = attrs.field(repr=brief)
    cov: Array = attrs.field(repr=brief)

    @property
    def sigma(self) -> Array:
        """Least root mean square error of each component, ``(T, n, *batch)``."""
        return np.sqrt(np.einsum("tii...->ti...", self.cov))  # type: ignore[no-any-return]

    @property
    def position(self) -> Array:
        """Least root mean square error of the position, ``(T, *batch)``: what `rmse` may not pass."""
        places = list(self.space.position)
        return np.sqrt((self.sigma[:, places] ** 2).sum(axis=1))  # type: ignore[no-any-return]


def posterior_bound(
    motion: Any,
    sensors: Any,
    t: Array,
    truth: Array,
    prior: Array,
    *,
    start: float | None = None,
    pose: Array | None = None,
    sensor: Any = None,
    measured: Any = None,
    u: Array | None = None,
) -> Bound:
    """The posterior Cramér-Rao bound, its expectations taken over simulated true paths.

    Tichavský's recursion ``J+ = D22 - D21 (J + D11)^-1 D12`` with additive Gaussian noise, written
    without inverses of J or of a noise that all paths share: with F and Q such means over paths that
    ``D22 = Q^-1`` and ``D12 = -F' Q^-1``, what is left of D11 is ``V = E (F_i - F)' Q_i^-1 (F_i - F)``,
    and the bound is predicted as ``F (C^-1 + V)^-1 F' + Q``. On linear problems it is the
    covariance of the Kalman filter.

    Shapes:
        t ``(T,)``; truth ``(T, n, *batch, runs)``: expectations are means over the last axis; prior,
        the covariance at time ``start`` (by default t[0]; never after it), ``(n, n, *batch)`` or
        ``(n, n)``; pose ``(T, p)``; sensor ``(T,)``, which of several ``sensors``; measured
        ``(T, m, *batch, runs)``, flags; u ``(T, q)``. The state at ``start``, where the first step is linearised, is the one that
        moves to ``truth[0]`` without noise.

    Raises:
        ShapeError: if truth has no axis of runs, or something does not fit t.
        DomainError: if times run backwards, the prior is no covariance, or it is not said which of
            several sensors measured; if paths differ in Jacobian where the process noise is singular:
            no such bound exists then.
    Reference:
        Tichavský, Muravchik and Nehorai (1998), Posterior Cramér-Rao bounds for discrete-time nonlinear
        filtering, eq. 21 and section IV-A.
    """
    paths, n = as_array(truth, "truth"), motion.space.size
    if paths.ndim < 3 or paths.shape[1] != n or not paths.size:
        raise ShapeError(
            wording(
                "argument 'truth'",
                got=f"shape {paths.shape}",
                expected=f"(T, {n}, *batch, runs), at least one time and one run, of states "
                f"({motion.space})",
                do="add an axis of length 1 for a single path: truth[..., None]",
            )
        )
    batch = paths.shape[2:-1]
    times = checked_times(t, len(paths))
    models, which = checked_sensors(motion, sensors, sensor, len(paths))
    pose = checked_rows("pose", pose, len(paths), max(m.pose_space.size for m in models))
    measured = checked_rows("measured", measured, len(paths), max(m.space.size for m in models))
    u = checked_rows("u", u, len(paths), getattr(motion, "input_space", EMPTY_SPACE).size)
    C = covariance_along("prior", prior, n, batch)
    out = np.empty((len(times), n, n, *batch))
    begin = _begin(start, float(times[0]))
    with at_once():
        x, before = _at(motion, begin, times, paths, u), begin
        for k, now in enumerate(times.tolist()):
            given = None if u is None else u[k]
            C = _predicted(motion, x, C, now - before, given, before)
            x, before = paths[k], now
            model = models[which[k]]
            size = model.pose_space.size
            where = None if pose is None or not size else pose[k, :size]
            seen = None if measured is None else measured[k]
            C = _known(C, told(model, x, where, seen))
            out[k] = C
    return Bound(motion.space, times, out)


def scenario_bound(scenario: Any, runs: int = 100, seed: int = 0) -> Bound:
    """The bound of a scenario over some of its simulated runs, missed detections included.

    Raises:
        CapabilityError: if it is no scenario. DomainError: if there is no run.

    Example:
    >>> import tracker as tk
    >>> bound = scenario_bound(tk.scenario("two_stations", steps=100), runs=20)
    >>> bound.position.shape, bool(bound.position[-1] < bound.position[0])
    ((100,), True)
    """
    checked_scenario(scenario, runs)
    made = scenario.simulate(seed, runs)
    return posterior_bound(
        scenario.motion,
        scenario.true_sensor,
        scenario.t,
        made.truth,
        scenario.prior.cov,
        start=made.start,
        pose=scenario.pose,
        measured=~np.isnan(made.record.z),
    )


# ---------------------------------------------------------------------------------- inside
def _begin(start: Any, first: float) -> float:
    """The time of the prior."""
    begin = as_array(first if start is None else start, "start")
    if begin.ndim or not -np.inf < begin <= first:
        raise DomainError(
            wording(
                "argument 'start'",
                got=f"{start} s",
                expected=f"one time, not after the first one at {first} s",
                do="cut the path, or move the prior",
            )
        )
    return float(begin)


def _at(motion: Any, begin: float, times: Array, paths: Array, u: Any) -> Any:
    """The states at the time of the prior."""
    if begin == times[0]:
        return paths[0]
    given = None if u is None else u[[0, 0]]
    both = np.array([begin, times[0]])
    return noise_free_path(motion, both, np.stack([paths[0], paths[0]]), given)[0]


def _predicted(motion: Any, x: Any, C: Any, dt: float, u: Any, t: float) -> Any:
    F = dense(linearise(motion, x, dt, u, t)[1])
    Q = np.asarray(motion.Q(x, dt))
    if _one(F) and _one(Q):
        return np.asarray(congruence(F[..., 0], C)) + Q[..., 0]
    F = np.broadcast_to(F, (*F.shape[:2], *x.shape[1:]))
    Q = np.broadcast_to(Q, F.shape)
    root = factor(Q)
    if _one(Q):
        mean, noise = F.mean(axis=-1), Q[..., 0]
    else:
        _full(root)
        unit = np.broadcast_to(
            np.eye(len(Q)).reshape(len(Q), len(Q), *(1,) * (Q.ndim - 2)), Q.shape
        )
        W = whitened(root, unit)  # Q^-1 = W' W
        information = np.einsum("ki...,kj...->ij...", W, W)
        half = factor(information.mean(axis=-1))
        inverse = whitened(half, unit[..., 0])
        noise = np.einsum("ki...,kj...->ij...", inverse, inverse)
        weighed = np.einsum("ik...,kj...->ij...", information, F).mean(axis=-1)
        mean = np.einsum("ik...,kj...->ij...", noise, weighed)
    spread = F - mean[..., None]
    if np.abs(spread).max(initial=0.0) > 0.0:
        _full(root, spread)
        C = _known(C, whitened(root, spread))  # (C^-1 + V)^-1
    return np.asarray(congruence(mean, C)) + noise


def _one(matrix: Array) -> bool:
    """Whether a matrix is the same for all runs, to the last bit."""
    return bool(matrix.shape[-1] == 1 or (matrix == matrix[..., :1]).all())


def _full(root: Array, used: Array | None = None) -> None:
    """Refuse noise that is singular in a direction that matters."""
    diagonal = np.einsum("ii...->i...", root)
    flat = (diagonal <= 1e-12 * diagonal.max(axis=0)).any(axis=tuple(range(1, diagonal.ndim)))
    bad = flat if used is None else flat & (np.abs(used) > 0).any(axis=tuple(range(1, used.ndim)))
    if bad.any():
        raise DomainError(
            wording(
                "argument 'motion'",
                got=f"process noise that is singular in component {int(bad.argmax())}, where the "
                "motion's Jacobian differs from path to path",
                expected="noise on every component that moves nonlinearly",
                do="use a motion model with a little noise there; without any, the state is a "
                "function of the first one, and the bound is that of a parameter",
            )
        )


def _known(C: Any, rows: Any) -> Any:
    """``(C^-1 + E rows' rows)^-1``, with the mean over the last axis."""
    runs = rows.shape[-1]
    stacked = np.moveaxis(rows, (-1, 1), (1, 0)) / np.sqrt(
        runs
    )  # (n, runs, m, *batch)... flattened
    n = stacked.shape[0]
    tall = stacked.reshape(n, -1, *stacked.shape[3:])
    U = triangularise(tall)
    gained = np.einsum("ij...,jk...->ik...", C, U)
    S = np.asarray(congruence(transpose(U), C))
    S = S + np.eye(n).reshape(n, n, *(1,) * (S.ndim - 2))
    blank = np.zeros(C.shape[1:])
    return np.asarray(condition(blank, C, blank, S, gained)[1])
