"""What a record can tell of the state at all: observability, Fisher information, and the words for it.

How large errors may become is the question of `bounds`; whether an estimate knows its own, that of
`consistency`. Nothing here depends on measured values, only on where and how was measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from tracker.algebra import at_once, dense, factor, transpose, whiten
from tracker.errors import ShapeError, TrackerError, wording
from tracker.metrics.paths import (
    checked_rows,
    checked_scenario,
    checked_sensors,
    checked_times,
    covariance_along,
)
from tracker.models.linearise import linearise
from tracker.types import EMPTY_SPACE, Array, Space, as_array, brief

LITTLE = 1e-3
"""A direction counts as unobservable if the record says less of it than this times what the prior did."""

ALONG_SIGHT = 0.99
"""Cosine from which a direction lies along the line of sight."""


def observability_matrix(
    motion: Any, sensor: Any, x: Any, dt: Any, pose: Any = None, *, steps: int | None = None
) -> Array:
    """``[H; H F; H F^2; ...]`` at a state: full column rank where it is observable in as many steps.

    Its condition number depends on the units of the states; that of `observability` does not.

    Shapes:
        x ``(n, *batch)``; ``steps`` blocks, by default n; result ``(steps * m, n, *batch)``.
    Reference:
        paper 4, eq. 2-16; Bar-Shalom, Li and Kirubarajan (2001), eq. 1.7.1-3.

    Example:
    >>> from tracker_motion import constant_velocity
    >>> from tracker_sensors import position
    >>> matrix = observability_matrix(constant_velocity(0.1), position(1.0), np.zeros(4), 1.0)
    >>> matrix.shape, int(np.linalg.matrix_rank(matrix)), round(float(np.linalg.cond(matrix)), 3)
    ((8, 4), 4, 3.759)
    """
    x = np.asarray(x, dtype=np.float64)
    F, H = dense(linearise(motion, x, dt)[1]), dense(linearise(sensor, x, pose)[1])
    batch = x.shape[1:]
    F, block = _over(F, batch), _over(H, batch)
    blocks = []
    for _ in range(len(x) if steps is None else steps):
        blocks.append(block)
        block = np.einsum("mi...,ij...->mj...", block, F)
    return np.concatenate(blocks)


def _over(matrix: Any, batch: tuple[int, ...]) -> Array:
    return np.broadcast_to(matrix, (*matrix.shape[:2], *batch))


@attrs.frozen(eq=False)
class Observability:
    """How much a record says of the state at its first time, without what a prior said.

    ``ratios`` are the eigenvalues of the information where the scale (a prior's covariance) is one,
    in rising order: how many times more than the prior the record says of a direction. The ratio of
    an observable direction grows with every measurement; that of an unobservable one is zero.

    Shapes:
        information ``(n, n, *batch)`` and scale alike; ratios ``(n, *batch)``; directions
        ``(n, n, *batch)``: column i belongs to ratio i, as a change of the state by one standard
        deviation of the scale; along_sight ``(n, *batch)``: whether that change moves the target
        along its line of sight at all times.
    """

    space: Space
    information: Array = attrs.field(repr=brief)
    scale: Array = attrs.field(repr=brief)
    ratios: Array = attrs.field(repr=brief)
    directions: Array = attrs.field(repr=brief)
    along_sight: Any = attrs.field(repr=brief)

    @property
    def rank(self) -> Any:
        """Number of directions of which the record says something, ``(*batch)``."""
        return (self.ratios >= LITTLE).sum(axis=0)

    @property
    def condition(self) -> Any:
        """Largest over smallest ratio, ``(*batch)``; infinite where a direction is not seen at all."""
        with np.errstate(all="ignore"):
            return self.ratios[-1] / np.maximum(self.ratios[0], 0.0)

    def words(self, lane: tuple[int, ...] = ()) -> tuple[str, ...]:
        """One sentence for each unobservable direction of a lane; empty if there is none."""
        out = []
        here: Any = (..., *lane)
        for i, ratio in enumerate(self.ratios[here]):
            if not ratio < LITTLE:
                continue
            change = self._named(self.directions[here][:, i], self.scale[here])
            what = (
                "the range is unobservable: a target moved along its line of sight"
                if self.along_sight[(i, *lane)]
                else "a direction of the state is unobservable: a target with another state"
            )
            out.append(
                f"{what} ({change} at the first measurement) would have given all but the same "
                "measurements. What is said of it is what the prior said."
            )
        return tuple(out)

    def _named(self, direction: Array, scale: Array) -> str:
        sigma: Array = np.sqrt(np.diagonal(scale))
        size = np.abs(direction) / np.where(sigma > 0, sigma, 1.0)
        lead = direction[int(size.argmax())]
        signed = direction if lead >= 0 else -direction
        return ", ".join(
            f"{axis.name} {value:+.3g}{' ' + axis.unit if axis.unit else ''}"
            for axis, value, part in zip(self.space, signed, size, strict=True)
            if part >= 0.01 * size.max()
        )

    def __str__(self) -> str:
        if self.ratios.ndim > 1:
            lanes = self.rank.size
            full = int((self.rank == len(self.ratios)).sum())
            return f"observable in {full} of {lanes} lanes"
        told = self.words()
        return " ".join(told) if told else f"observable, condition {self.condition:.3g}"


def observability(
    motion: Any,
    sensors: Any,
    t: Array,
    states: Array,
    scale: Array,
    *,
    pose: Array | None = None,
    sensor: Any = None,
    measured: Any = None,
    u: Array | None = None,
    weighted: bool = True,
) -> Observability:
    """Fisher information on the first state along a path, without process noise and without a prior.

    ``sum_k (H_k Phi_k)' R_k^-1 H_k Phi_k``, with Phi the product of Jacobians from the first time
    to time k. With ``weighted=False`` the measurements all weigh the same: the observability
    Gramian. A path that the motion can follow (`noise_free_path`) shows a direction that cannot be
    observed; along an estimated path, whose corrections no target ever made, there seems to be
    information where there is none.

    Shapes:
        t ``(T,)`` or ``(T, *batch)``; states ``(T, n, *batch)``; scale ``(n, n)`` or
        ``(n, n, *batch)``, a covariance that says what a large change is (of a prior); pose
        ``(T, p, *batch)``; sensor ``(T,)``, which of several ``sensors``; measured
        ``(T, m, *batch)``, flags; u ``(T, q, *batch)``.

    Raises:
        ShapeError: if states, times and what goes with them do not fit.
        DomainError: if times run backwards, scale is no covariance, or it is not said which of
            several sensors measured.
    Reference:
        Bar-Shalom, Li and Kirubarajan (2001), section 2.7.4 and eq. 10.3.4-9; Maybeck (1979),
        Stochastic Models, Estimation and Control 1, section 5.7.
    """
    given, n = as_array(states, "states"), motion.space.size
    if given.ndim < 2 or given.shape[1] != n or not len(given):
        raise ShapeError(
            wording(
                "argument 'states'",
                got=f"shape {given.shape}",
                expected=f"(T, {n}, *batch), at least one time: {motion.space}",
                do="put time first, components second",
            )
        )
    path, steps, batch = np.moveaxis(given, 0, 1), len(given), given.shape[2:]
    t = checked_times(t, steps, batch)
    models, which = checked_sensors(motion, sensors, sensor, steps)
    pose = checked_rows("pose", pose, steps, max(m.pose_space.size for m in models))
    measured = checked_rows("measured", measured, steps, max(m.space.size for m in models))
    u = checked_rows("u", u, steps, getattr(motion, "input_space", EMPTY_SPACE).size)
    whole = covariance_along("scale", scale, n, batch)
    information = np.zeros((n, n, *batch))
    with at_once():
        Phi = transitions(motion, t, path, u)
        for i, model in enumerate(models):
            rows = np.flatnonzero(which == i)
            if rows.size:
                where = _pose_of(model, pose, rows, len(batch))
                mask = None if measured is None else np.moveaxis(measured[rows], 0, 1)
                part = told(model, path[:, rows], where, mask, weighted=weighted)
                seen = np.einsum("mn...,nj...->mj...", part, Phi[:, :, rows])
                information += np.einsum("mit...,mjt...->ij...", seen, seen)
        root = factor(whole)
        half = np.einsum("ji...,jk...->ik...", root, information)
        ratios, vectors = _eigen(np.einsum("ik...,kj...->ij...", half, root))
        directions = np.einsum("ij...,jk...->ik...", root, vectors)
        ratios, directions = _known_last(ratios, directions)
        sight = _along_sight(motion.space, models, which, pose, path, Phi, directions)
    return Observability(motion.space, information, whole, ratios, directions, sight)


def noise_free_path(
    motion: Any, t: Array, states: Array, u: Array | None = None, *, rounds: int = 3
) -> Array:
    """The path without process noise that ends in the last of some states, ``(T, n, *batch)``.

    Backwards from the end, by Newton's steps from the state that was estimated at each time: exact
    for linear motion. NaN where the motion cannot be reversed.
    """
    path = np.array(states, dtype=np.float64)
    with at_once():
        for k in range(len(path) - 2, -1, -1):
            dt, given = t[k + 1] - t[k], None if u is None else u[k + 1]
            x = path[k]
            for _ in range(1 if getattr(motion, "linear", False) else rounds):
                value, F = linearise(motion, x, dt, given, t[k])
                F = _over(dense(F), x.shape[1:])
                x = x + _solved(F, path[k + 1] - value)
            path[k] = x
    return path


def transitions(motion: Any, t: Array, path: Array, u: Array | None = None) -> Array:
    """Jacobians of each state of a path by the first, ``(n, n, T, *batch)``; path ``(n, T, *batch)``."""
    n, steps, *batch = path.shape
    out = np.empty((n, n, steps, *batch))
    out[:, :, 0] = np.eye(n).reshape(n, n, *(1,) * len(batch))
    if steps > 1:
        F = _over(dense(steps_of(motion, t, path, u)), (steps - 1, *batch))
        for k in range(steps - 1):
            out[:, :, k + 1] = np.einsum("ij...,jk...->ik...", F[:, :, k], out[:, :, k])
    return out


def steps_of(motion: Any, t: Array, path: Array, u: Array | None = None) -> Any:
    """Jacobians of the single steps of a path, all at once: times are one more batch axis."""
    lanes = path.ndim - 2
    times = np.asarray(t, dtype=np.float64)
    times = times.reshape(*times.shape, *(1,) * (lanes + 1 - times.ndim))
    given = None
    if u is not None:
        given = np.moveaxis(np.asarray(u)[1:], 0, 1)
        given = given.reshape(*given.shape, *(1,) * (lanes + 2 - given.ndim))
    return linearise(motion, path[:, :-1], np.diff(times, axis=0), given, times[:-1])[1]


def told(
    sensor: Any, path: Array, pose: Any, measured: Any = None, *, weighted: bool = True
) -> Array:
    """``R^-1/2 H`` at the states of a path, zero where a component was not measured.

    Shapes:
        path ``(n, T, *batch)``; measured ``(m, T, *batch)``; result ``(m, n, T, *batch)``.
    """
    H = _over(dense(linearise(sensor, path, pose)[1]), path.shape[1:])
    R = np.broadcast_to(sensor.R(path, pose), (len(H), len(H), *path.shape[1:]))
    if measured is not None:
        seen = np.asarray(measured)[: len(H)]
        seen = np.broadcast_to(
            seen.reshape(*seen.shape, *(1,) * (path.ndim - seen.ndim)), (len(H), *path.shape[1:])
        )
        unit = np.eye(len(H)).reshape(len(H), len(H), *(1,) * (path.ndim - 1))
        R = np.where(seen[:, None] & seen, R, unit)
        H = np.where(seen[:, None], H, 0.0)
    return whiten(factor(R), H) if weighted else H


# ---------------------------------------------------------------------------------- inside
def _pose_of(sensor: Any, pose: Any, rows: Any, lanes: int) -> Any:
    size = sensor.pose_space.size
    if not size or pose is None:
        return None
    values = np.moveaxis(np.asarray(pose)[rows, :size], 0, 1)
    return values.reshape(*values.shape, *(1,) * (lanes + 2 - values.ndim))


def _solved(A: Array, b: Array) -> Array:
    """``A^-1 b`` lane by lane; NaN where A is singular."""
    matrices, vectors = np.moveaxis(A, (0, 1), (-2, -1)), np.moveaxis(b, 0, -1)
    finite: Any = np.isfinite(matrices).all(axis=(-2, -1))
    sound = np.where(finite[..., None, None], matrices, np.eye(len(A)))
    lost = ~finite | (np.linalg.det(sound) == 0.0)
    sound = np.where(lost[..., None, None], np.eye(len(A)), sound)
    out = np.linalg.solve(sound, vectors[..., None])[..., 0]
    return np.moveaxis(np.where(lost[..., None], np.nan, out), -1, 0)


def _eigen(matrix: Array) -> tuple[Array, Array]:
    """Eigenvalues in rising order and eigenvectors in columns; NaN in a lane that is not finite."""
    stacked = np.moveaxis(0.5 * (matrix + transpose(matrix)), (0, 1), (-2, -1))
    finite: Any = np.isfinite(stacked).all(axis=(-2, -1))
    values, vectors = np.linalg.eigh(np.where(finite[..., None, None], stacked, 0.0))
    values = np.where(finite[..., None], values, np.nan)
    return np.moveaxis(values, -1, 0), np.moveaxis(vectors, (-2, -1), (0, 1))


def _known_last(ratios: Array, directions: Array) -> tuple[Array, Array]:
    """What the scale already knows exactly needs no measurement: its ratio is infinite."""
    known = (np.abs(directions) == 0.0).all(axis=0)
    if not known.any():
        return ratios, directions
    ratios = np.where(known, np.inf, ratios)
    order = np.argsort(ratios, axis=0)
    return (
        np.take_along_axis(ratios, order, axis=0),
        np.take_along_axis(directions, np.broadcast_to(order, directions.shape), axis=1),
    )


def scenario_observability(scenario: Any, runs: int = 8, seed: int = 0) -> Observability | None:
    """Of a scenario's record, along the noise-free paths from where some runs start.

    A scenario whose target follows a given path is judged along that path. None if a model has no
    derivatives.

    Raises:
        CapabilityError: if it is no scenario. DomainError: if there is no run.
    """
    checked_scenario(scenario, runs)
    motion = scenario.true_motion
    made = scenario.simulate(seed, runs if scenario.path is None else 1)
    path = np.array(made.truth)
    try:
        if scenario.path is None:
            with at_once():
                for k in range(1, len(path)):
                    before = scenario.t[k - 1]
                    path[k] = motion.f(path[k - 1], scenario.t[k] - before, None, before)
        return observability(
            motion,
            scenario.true_sensor,
            scenario.t,
            path,
            scenario.prior.cov,
            pose=scenario.pose,
            measured=~np.isnan(made.record.z),
        )
    except (TrackerError, AttributeError, TypeError, ValueError):
        return None  # no derivatives, or a model that does not take many times at once


def blind_spots(found: Observability | None) -> list[str]:
    """What most lanes cannot see, in the words of the first of them; empty if nothing."""
    if found is None:
        return []
    lanes = list(np.ndindex(*found.ratios.shape[1:]))
    told = [words for lane in lanes if (words := found.words(lane))]
    return list(told[0]) if 2 * len(told) > len(lanes) else []


def sensor_place(sensor: Any, pose: Any, space: Space) -> Any:
    """Where a sensor is, ``(d, ...)`` for the position components of a state; None if nowhere, or at several places."""
    axes = [space.names[i] for i in space.position]
    named = dict(getattr(sensor, "parameters", {}))
    if pose is not None:
        named |= dict(zip(sensor.pose_space.names, pose, strict=False))
    places = []
    for axis in axes:
        found = [value for name, value in named.items() if name.split("_")[0] == f"s{axis}"]
        if not found or any(np.shape(f) != np.shape(found[0]) for f in found):
            return None
        if any(not np.array_equal(f, found[0]) for f in found[1:]):
            return None
        places.append(np.asarray(found[0], dtype=np.float64))
    return places or None


def _along_sight(
    space: Space,
    sensors: Sequence[Any],
    which: Any,
    pose: Any,
    path: Array,
    Phi: Array,
    directions: Array,
) -> Any:
    """Whether each direction moves the target along its line of sight at every measurement."""
    out = np.ones(directions.shape[1:], dtype=np.bool_)
    position = list(space.position)
    for i, sensor in enumerate(sensors):
        rows = np.flatnonzero(which == i)
        if not rows.size:
            continue
        place = sensor_place(sensor, _pose_of(sensor, pose, rows, path.ndim - 2), space)
        if place is None:
            return np.zeros_like(out)
        sight = np.stack([path[p, rows] - s for p, s in zip(position, place, strict=True)])
        moved = np.einsum("pjt...,ji...->pit...", Phi[position][:, :, rows], directions)
        along = np.einsum("pt...,pit...->it...", sight, moved)
        lengths = np.sqrt((sight**2).sum(axis=0)) * np.sqrt((moved**2).sum(axis=0))
        out &= (np.abs(along) >= ALONG_SIGHT * lengths).all(axis=1) & (lengths > 0).any(axis=1)
    return out
