"""A fixed-interval smoother behind the interacting multiple model filter; filters live elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from tracker.algebra import congruence, dense, product, residual
from tracker.errors import CapabilityError, wording
from tracker.models.linearise import linearise
from tracker.protocols import MotionModel
from tracker.types import Array, Beliefs, Gaussian, History, Trajectory
from tracker_kalman.imm import ModeMixture, embedded, mixed, modes_of, part, posterior

CERTAIN = 1e-13
"""Directions with less variance than this, relative to that of the components, are certain."""


@attrs.frozen
class ModeSmoother:
    """Goes back through the filtered states of all modes, one step for each pair of modes.

    What the future says of a state in mode j at k + 1 is the quotient of its smoothed and its
    predicted density. The filtered state of mode i at k is predicted through the motion of j and
    meets that quotient: this gives the smoothed state of the pair, and, in how well the two agree,
    how likely it is that i came before j. Pairs with the same i are then mixed into one. No
    motion is inverted and no measurement is used twice. Where mixing has left a smoothed density wider
    than the predicted one, the quotient is taken as flat in that direction.

    The motion is linearised at the filtered states, whatever the filters were. The history must hold
    beliefs: smooth with an estimator that has this smoother. For a motion of a single mode moments
    are enough, and the result is that of "rts".

    Raises:
        CapabilityError: if the history lacks the beliefs of a motion with several modes.
    Reference:
        Helmick, Blair and Hoffman (1995), Fixed-Interval Smoothing for Markovian Switching Systems,
        IEEE Trans. Information Theory 41 (6), pp. 1845-1855, for pairs of modes and their merging; its
        backward filter is replaced by the quotient.
    Laws:
        those of kind "smoother"; one mode equals "rts"; the order of the modes does not matter.
    """

    needs = ("beliefs", "jacobian")
    follows = "imm"
    tags = ("opaque",)
    why_opaque = "it looks at the eigenvectors of covariances"

    def smooth(self, history: History, motion: MotionModel) -> History:
        """The history with its ``smoothed`` trajectory, and the smoothed modes in its beliefs.

        ``history.beliefs.smoothed[k].probabilities`` ``(modes, *batch)`` are those of the modes at step
        k, given the whole record. The last step equals the filter.
        """
        return self.modes(history, motion)[0]

    def modes(
        self, history: History, motion: MotionModel
    ) -> tuple[History, tuple[ModeMixture, ...]]:
        """The same, and the smoothed states of all modes with their probabilities, one a step."""
        predicted, filtered = _beliefs(history, motion)
        mean, cov = np.empty_like(history.filtered.mean), np.empty_like(history.filtered.cov)
        done: list[ModeMixture] = []
        with np.errstate(all="ignore"):
            for k in range(len(history) - 1, -1, -1):
                state = filtered[k]
                if done:
                    u = None if history.u is None else history.u[k + 1]
                    dt = history.t[k + 1] - history.t[k]
                    state = _back(state, predicted[k + 1], done[-1], motion, dt, u, history.t[k])
                done.append(state)
                moments = state.moments()
                mean[k], cov[k] = moments.mean, moments.cov
        known = tuple(reversed(done))
        beliefs = Beliefs(tuple(predicted), tuple(filtered), known)
        return attrs.evolve(history, smoothed=Trajectory(mean, cov), beliefs=beliefs), known


def _back(
    filtered: ModeMixture,
    predicted: ModeMixture,
    smoothed: ModeMixture,
    motion: Any,
    dt: Any,
    u: Any,
    t: Any,
) -> ModeMixture:
    """Smoothed modes at k, from those filtered at k and predicted and smoothed at k + 1."""
    modes = modes_of(motion)
    count = len(modes)
    before = [member.moments() for member in filtered.members]
    chances = [[1.0]] if count == 1 else motion.transition(dt)
    pairs: list[list[Any]] = [[None] * count for _ in range(count)]
    joint: list[list[Any]] = [[None] * count for _ in range(count)]
    for j, mode in enumerate(modes):
        given = u if count == 1 else motion.inputs(j, u)
        future = _Future.of(predicted.members[j].moments(), smoothed.members[j].moments(), mode)
        told = []
        for i in range(count):
            places = filtered.places[i], filtered.places[j]
            prior = None if filtered.prior is None else part(filtered.prior, filtered.places[j])
            pairs[i][j], fit = _paired(before[i], places, prior, future, mode, dt, given, t)
            told.append(fit)
        came = [chances[i][j] * filtered.probabilities[i] for i in range(count)]
        shares, _ = posterior(came, told)
        chance = smoothed.probabilities[
            j
        ]  # zero where nothing leads to j, which has no shares then
        for i in range(count):
            joint[i][j] = np.where(chance == 0.0, 0.0, shares[i] * chance)
    members, probabilities = [], []
    for i, own in enumerate(filtered.places):
        total = sum(joint[i][1:], joint[i][0])
        probabilities.append(total)
        weights = np.stack([np.where(total > 0.0, w / total, 1.0 / count) for w in joint[i]])
        flags = tuple(filtered.circular[p] for p in own)
        whole = [tuple(range(len(own)))] * count
        members.append(mixed(pairs[i], weights, whole, flags))
    return attrs.evolve(filtered, members=tuple(members), probabilities=np.stack(probabilities))


# -------------------------------------------------------------------------------- one pair
@attrs.frozen(eq=False)
class _Future:
    """What the future says of a mode's state x: ``exp(h' v - v' D v / 2)`` with ``v = W (x - centre)``.

    Shapes:
        centre ``(n, *batch)``; W ``(*batch, n, n)``; D (a diagonal) and h ``(*batch, n)``.
    """

    centre: Any
    W: Array
    D: Array
    h: Array

    @classmethod
    def of(cls, predicted: Gaussian, smoothed: Gaussian, mode: Any) -> _Future:
        """The quotient of two Gaussians, in directions in which both are independent."""
        P, S = _last(predicted.cov), _last(smoothed.cov)
        scale = np.sqrt(np.maximum(np.einsum("...ii->...i", P), 0.0))
        inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0.0)
        variances, directions = _eigen(P * inverse[..., :, None] * inverse[..., None, :])
        known = variances > CERTAIN
        root = np.where(known, 1.0 / np.sqrt(np.where(known, variances, 1.0)), 0.0)
        W = root[..., :, None] * directions.swapaxes(-1, -2) * inverse[..., None, :]
        left = W @ S @ W.swapaxes(-1, -2)
        left += np.where(known, 0.0, 1.0)[..., :, None] * np.eye(left.shape[-1])
        ratios, directions = _eigen(left)
        W = directions.swapaxes(-1, -2) @ W
        ratios = np.minimum(np.maximum(ratios, CERTAIN), 1.0)
        flags = mode.space.circular
        moved = residual(smoothed.mean, predicted.mean, flags if any(flags) else False)
        s = _times(W, np.moveaxis(moved, 0, -1))
        return cls(predicted.mean, W, 1.0 / ratios - 1.0, s / ratios)


def _paired(
    state: Gaussian,
    places: tuple[Sequence[int], Sequence[int]],
    prior: Gaussian | None,
    future: _Future,
    mode: Any,
    dt: Any,
    u: Any,
    t: Any,
) -> tuple[Gaussian, Any]:
    """A mode's filtered state given the future of another mode, and the log-likelihood of that."""
    mine, theirs = places
    common = [p for p in theirs if p in mine]
    of_mine, of_theirs = [mine.index(p) for p in common], [theirs.index(p) for p in common]
    start = embedded(part(state, of_mine), of_theirs, len(theirs), prior)
    ahead, F = linearise(mode, start.mean, dt, u, t)
    F = dense(F)
    C = congruence(F, start.cov) + mode.Q(start.mean, dt)
    cross = product(F[:, of_theirs], state.cov[of_mine])  # of what follows with the state
    flags = mode.space.circular
    moved = residual(ahead, future.centre, flags if any(flags) else False)
    W, D, h = future.W, future.D, future.h
    m = _times(W, np.moveaxis(moved, 0, -1))
    V = W @ _last(C) @ W.swapaxes(-1, -2)
    X = W @ _last(cross)
    # With B = (I + D V)^-1 and g = h - D m: x + X' B g, and P - X' B D X.
    inside = np.eye(len(theirs)) + D[..., :, None] * V
    lost = ~np.isfinite(inside).all(axis=(-1, -2))
    inside[lost] = np.eye(len(theirs))  # NaN in what follows, and no reason to stop the others
    g = h - D * m
    solved = np.linalg.solve(inside, np.concatenate([g[..., None], D[..., :, None] * X], axis=-1))
    pull, less_ = solved[..., 0], X.swapaxes(-1, -2) @ solved[..., 1:]
    mean = state.mean + np.moveaxis(_times(X.swapaxes(-1, -2), pull), -1, 0)
    cov = state.cov - np.moveaxis((less_ + less_.swapaxes(-1, -2)) / 2.0, (-2, -1), (0, 1))
    fit = (h * m - 0.5 * D * m * m).sum(axis=-1) + 0.5 * (g * _times(V, pull)).sum(axis=-1)
    fit = fit - 0.5 * np.log(np.linalg.det(inside))
    return Gaussian.trusted(mean, cov), np.where(lost, np.nan, fit)


def _last(matrix: Any) -> Any:
    """Matrix axes last, as NumPy's linear algebra has them."""
    return np.moveaxis(matrix, (0, 1), (-2, -1))


def _times(matrix: Any, vector: Any) -> Any:
    return (matrix @ vector[..., None])[..., 0]


def _eigen(matrix: Any) -> tuple[Any, Any]:
    """Eigenvalues and eigenvectors; of a lane that is not finite, NaN instead of an error."""
    lost = ~np.isfinite(matrix).all(axis=(-1, -2))
    values, vectors = np.linalg.eigh(np.where(lost[..., None, None], 0.0, matrix))
    return np.where(lost[..., None], np.nan, values), vectors


def _beliefs(history: History, motion: Any) -> tuple[Sequence[ModeMixture], Sequence[ModeMixture]]:
    """Predicted and filtered beliefs of all modes; of a single mode the moments are enough."""
    kept = history.beliefs
    if kept is not None and all(isinstance(b, ModeMixture) for b in kept.filtered):
        return kept.predicted, kept.filtered
    if len(modes_of(motion)) > 1:
        raise CapabilityError(
            wording(
                "argument 'history' of the smoother of modes",
                got="moments without the beliefs of a filter of modes",
                expected="a history of filter 'imm' that holds them",
                do="filter with tk.estimator('imm', ..., smoother='imm_smoother')",
            )
        )
    n, batch = history.filtered.mean.shape[1], history.filtered.batch
    whole, sure = (tuple(range(n)),), np.ones((1, *batch))

    def of(trajectory: Trajectory) -> list[ModeMixture]:
        flags = motion.space.circular
        steps = range(len(history))
        return [ModeMixture((trajectory.at(k),), sure, whole, flags) for k in steps]

    return of(history.predicted), of(history.filtered)
