"""A fixed-interval smoother behind the interacting multiple model filter; filters live elsewhere."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from tracker.algebra import (
    apply,
    beside,
    congruence,
    dense,
    factor,
    product,
    residual,
    symmetric_product,
    transpose,
    triangularise,
    whiten,
)
from tracker.algebra.solving import dot
from tracker.errors import CapabilityError, TraceError, wording
from tracker.models import absolute, isnan, less, log, sqrt, where
from tracker.models.graph import plain
from tracker.models.linearise import linearise
from tracker.protocols import MotionModel
from tracker.types import Beliefs, Gaussian, History, Trajectory
from tracker_kalman.imm import ModeMixture, embedded, mixed, modes_of, part, posterior
from tracker_kalman.mixture import chosen
from tracker_kalman.two_filter import singular_root, whiten_across

CERTAIN = 1e-13
"""Directions with less variance than this, relative to that of the components, are certain."""

FINEST = 1e-10
"""A smoothed deviation is not smaller than this share of the predicted one, lest it be zero."""

LARGEST = 1100
"""Pairs of modes, times the cube of their components, in a compiled step: 4 modes of 4 components."""


@attrs.frozen
class ModeSmoother:
    """Goes back through the filtered states of all modes, one step for each pair of modes.

    What the future says of a state in mode j at k + 1 is the quotient of its smoothed and its
    predicted density. The filtered state of mode i at k is predicted through the motion of j and
    meets that quotient: this gives the smoothed state of the pair, and, in how well the two agree,
    how likely it is that i came before j. Pairs with the same i are then mixed into one. No
    motion is inverted and no measurement is used twice. Where mixing has left a smoothed density wider
    than the predicted one, the quotient is taken as flat.

    Covariances are sums of congruences, and the quotient is held as a root: they stay positive
    semi-definite whatever the rounding, even where the future knows many orders more than the filter.

    The motion is linearised at the filtered states, whatever the filters were. The history must hold
    beliefs: smooth with an estimator that has this smoother. For a motion of a single mode moments
    are enough, and the result is that of "rts". Compiled up to 4 modes of 4 components, 2 of 6, 1 of 10.

    Shapes:
        beliefs over any batch; see `ModeMixture`.

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

    def begin(self, filtered: Any) -> ModeMixture:
        """At the end of the record smoothed modes are the filtered ones; a Gaussian is a single mode."""
        if isinstance(filtered, ModeMixture):
            members = tuple(member.moments() for member in filtered.members)
            return attrs.evolve(filtered, members=members)
        n, batch = len(filtered.mean), filtered.mean.shape[1:]
        return ModeMixture((filtered,), np.ones((1, *batch)), (tuple(range(n)),), (False,) * n)

    def step(
        self,
        filtered: Any,
        predicted: Any,
        smoothed: ModeMixture,
        motion: MotionModel,
        dt: Any,
        u: Any = None,
        t: Any = None,
    ) -> ModeMixture:
        """Smoothed modes at k, from those filtered at k and predicted and smoothed at k + 1.

        Raises:
            CapabilityError: if these are not those of the motion's modes.
        """
        before, ahead = self.begin(filtered), self.begin(predicted)
        modes = modes_of(motion)
        _same_modes(before, modes)
        if before.probabilities.dtype.hasobject:
            _small_enough(before)
        own = before.members
        chances = [[1.0]] if len(modes) == 1 else motion.transition(dt)  # type: ignore[attr-defined]  # it has modes
        places = range(len(modes))
        pairs: list[list[Any]] = [[] for _ in places]
        joint: list[list[Any]] = [[] for _ in places]
        for j, mode in enumerate(modes):
            given = u if len(modes) == 1 else motion.inputs(j, u)  # type: ignore[attr-defined]  # as above
            future = _Future.of(ahead.members[j], smoothed.members[j], mode.space.circular)
            told = []
            for i in places:
                theirs = before.places[j]
                prior = None if before.prior is None else part(before.prior, theirs)
                pair, fit = _paired(
                    own[i], (before.places[i], theirs), prior, future, mode, dt, given, t
                )
                pairs[i].append(chosen(less(absolute(fit), math.inf), pair, own[i]))
                told.append(fit)
            came = [chances[i][j] * before.probabilities[i] for i in places]
            shares, _ = posterior(came, told)
            chance = smoothed.probabilities[j]
            for i in places:  # zero where nothing leads to j, which has no shares then
                known = where(less(0.0, chance), shares[i] * chance, 0.0)
                joint[i].append(where(isnan(chance), math.nan, known))
        members, probabilities = [], []
        for i, own_places in enumerate(before.places):
            total = sum(joint[i][1:], joint[i][0])
            probabilities.append(total)
            possible = less(0.0, total)
            safe = where(possible, total, 1.0)
            weights = [where(possible, w / safe, 1.0 / len(modes)) for w in joint[i]]
            flags = tuple(motion.space.circular[p] for p in own_places)
            whole = [tuple(range(len(own_places)))] * len(modes)
            members.append(mixed(pairs[i], np.stack(weights), whole, flags))
        return attrs.evolve(before, members=tuple(members), probabilities=np.stack(probabilities))

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
                if not done:
                    state = self.begin(state)
                else:
                    u = None if history.u is None else history.u[k + 1]
                    dt = history.t[k + 1] - history.t[k]
                    state = self.step(
                        state, predicted[k + 1], done[-1], motion, dt, u, history.t[k]
                    )
                done.append(state)
                moments = state.moments()
                mean[k], cov[k] = moments.mean, moments.cov
        known = tuple(reversed(done))
        beliefs = Beliefs(tuple(predicted), tuple(filtered), known)
        return attrs.evolve(history, smoothed=Trajectory(mean, cov), beliefs=beliefs), known


# -------------------------------------------------------------------------------- one pair
@attrs.frozen(eq=False)
class _Future:
    """What the future says of a mode's state x, as ``exp(s' v - |K' (v - s)|^2 / 2)`` of ``L v = x - centre``.

    Shapes:
        centre, s ``(n, *batch)``; L, lower triangular, and K ``(n, n, *batch)``.
    """

    centre: Any
    L: Any
    K: Any
    s: Any

    @classmethod
    def of(cls, predicted: Gaussian, smoothed: Gaussian, circular: tuple[bool, ...]) -> _Future:
        """The quotient of two Gaussians, in deviations from the first one, whose root is L.

        In these the second has the covariance ``T T'``, and the quotient the information
        ``(T T')^-1 - 1 = T^-T (1 - T' T) T^-1``, of which K is a root.
        """
        n = len(predicted.mean)
        L = _certain(predicted.cov)
        narrow = whiten(L, factor(smoothed.cov))
        floor = np.zeros_like(L)
        for i in range(n):  # of a direction that is certain the future says nothing
            floor[i, i] = where(less(0.0, L[i, i]), FINEST, 1.0)
        T = triangularise(beside(narrow, floor))
        unit = np.eye(n).reshape(n, n, *(1,) * (T.ndim - 2))
        rest = unit - symmetric_product(transpose(T), transpose(T))
        K = whiten_across(T, singular_root(rest, np.ones(n)))
        moved = residual(smoothed.mean, predicted.mean, circular)
        return cls(predicted.mean, L, K, whiten(L, moved))


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
    F, Q = dense(F), mode.Q(start.mean, dt)
    C = congruence(F, start.cov) + Q
    # What follows, x = ahead + A e with e of variance one, and the state's regression B on e.
    A = factor(C)
    B = transpose(whiten(A, product(F[:, of_theirs], state.cov[of_mine])))
    # In e the future is the measurement y of W' e, with noise of variance one, and a tilt.
    m = whiten(future.L, residual(ahead, future.centre, mode.space.circular))
    Y = whiten(future.L, A)
    W, y = product(transpose(Y), future.K), apply(transpose(future.K), future.s - m)
    n = len(y)
    unit = np.broadcast_to(np.eye(n + 1, n).reshape(n + 1, n, *(1,) * (W.ndim - 2)),
                           (n + 1, n, *W.shape[2:])).astype(W.dtype)  # fmt: skip
    whole = triangularise(beside(unit, np.concatenate([W, y[None]])))
    root = whole[:n, :n]
    tilt = whiten(root, apply(transpose(Y), future.s))
    found = whole[n, :n] + tilt
    e, left = whiten_across(root, found), whole[n, n]
    fit = dot(future.s, m) + 0.5 * (dot(tilt, found + whole[n, :n]) - left * left)
    for i in range(n):
        fit = fit - log(root[i, i])
    # What e does not tell of the state, and what is left of e: both are sums of congruences.
    G = transpose(whiten_across(A, transpose(B)))
    own = -product(G, F[:, of_theirs])
    kept = np.zeros((len(mine), len(mine), *own.shape[2:]), dtype=own.dtype)
    for i in range(len(mine)):
        kept[i, i] = 1.0
    for place, column in enumerate(of_mine):
        kept[:, column] = kept[:, column] + own[:, place]
    if prior is not None:  # what the state lacks is as uncertain as it was at first
        blank = start.cov.copy()
        blank[of_theirs], blank[:, of_theirs] = 0.0, 0.0
        Q = congruence(F, blank) + Q
    half = transpose(whiten(root, transpose(B)))
    cov = congruence(kept, state.cov) + congruence(G, Q) + symmetric_product(half, half)
    return Gaussian.trusted(state.mean + apply(B, e), cov), fit


def _certain(P: Any) -> Any:
    """The factor of a covariance, with columns of zeros for directions that are certain."""
    n = len(P)
    L = np.zeros_like(P)
    for j in range(n):
        pivot = P[j, j] - dot(L[j, :j], L[j, :j])
        known = less(CERTAIN * P[j, j], pivot)
        lost = where(isnan(pivot), math.nan, 0.0)
        size = sqrt(where(known, pivot, 1.0))
        L[j, j] = plain(where(known, size, lost))
        inverse = where(known, 1.0 / size, lost)
        for i in range(j + 1, n):
            L[i, j] = plain((P[i, j] - dot(L[i, :j], L[j, :j])) * inverse)
    return L


def _same_modes(mixture: ModeMixture, modes: Sequence[Any]) -> None:
    if len(mixture.members) != len(modes):
        raise CapabilityError(
            wording(
                "argument 'history' of the smoother of modes",
                got="moments without the beliefs of a filter of modes"
                if len(mixture.members) == 1
                else f"beliefs in {len(mixture.members)} modes for a motion of {len(modes)}",
                expected="a history of filter 'imm' that holds them",
                do="filter with tk.estimator('imm', ..., smoother='imm_smoother')",
            )
        )


def _small_enough(mixture: ModeMixture) -> None:
    count, n = len(mixture.members), max(map(len, mixture.places))
    if count**2 * n**3 > LARGEST:
        raise TraceError(f"{count} modes of {n} components are too many to unroll")


def _beliefs(history: History, motion: Any) -> tuple[Sequence[ModeMixture], Sequence[ModeMixture]]:
    """Predicted and filtered beliefs of all modes; of a single mode the moments are enough."""
    kept, whole = history.beliefs, ModeSmoother()
    if kept is not None and all(isinstance(b, ModeMixture) for b in kept.filtered):
        return kept.predicted, kept.filtered
    predicted, filtered = (
        [whole.begin(trajectory.at(k)) for k in range(len(history))]
        for trajectory in (history.predicted, history.filtered)
    )
    if filtered:
        _same_modes(filtered[0], modes_of(motion))
    return predicted, filtered
