"""Backward simulation over particles (Godsill, Doucet and West 2004): whole paths given all data."""

from __future__ import annotations

import math
from typing import Annotated, Any

import attrs
import numpy as np

from tracker.algebra import at_once, residual
from tracker.errors import CapabilityError, wording
from tracker.models.parameters import lanes_of_component
from tracker.protocols import MotionModel
from tracker.recursion import is_random, lanes_of
from tracker.types import Array, History, Trajectory
from tracker_particle import draws
from tracker_particle.belief import Particles, moments
from tracker_particle.parameters import a_count
from tracker_particle.propagation import factored

NAME = "backward_simulation"
"""As registered: a filter whose particles it can go back through has it among its ``smoothers``."""

_SAME = 1e-9


@attrs.frozen
class BackwardSimulation:
    """Smooths by drawing paths backwards through the particles that a filter left.

    A path begins at a particle of the last step, and at each earlier step takes the particle i with
    probability ``w_i p(x_next | x_i)``. The smoothed moments at a step are those of its particles,
    weighted by the mean of these probabilities over all paths: less noisy than the moments of the
    paths drawn, and the filter's own at the last step. The cost of a step is particles times
    ``trajectories``.

    Paths can be drawn only through motion whose noise reaches all components. Where it does not, and
    over steps of no time, a path goes back to the parent of its particle and nowhere else.
    Randomness is that of the beliefs: the same filtered record gives the same paths.

    Raises:
        CapabilityError: if the history holds no beliefs of particles, as those of the filters
            "bootstrap", "auxiliary" and "regularised".
    Reference: Godsill, Doucet and West 2004, Monte Carlo smoothing for nonlinear time series, JASA
        99(465), algorithm 1.
    Laws: the last step equals the filter; on linear problems with Gaussian noise it converges to the
        Rauch-Tung-Striebel smoother.
    """

    trajectories: Annotated[int, "1"] = attrs.field(default=100, validator=a_count)

    needs = ("beliefs",)
    follows = "bootstrap"

    def why_not_after(self, filter_: Any) -> str:
        """In words, why it cannot follow a filter; '' if it can, or nobody knows."""
        known = (NAME,) if is_random(filter_) else ()
        if NAME in getattr(filter_, "smoothers", known):
            return ""
        name = type(filter_).__name__
        return wording(
            f"smoother {type(self).__name__} after filter {name}",
            got="beliefs that are no particles with weights alone",
            expected="those of the filters 'bootstrap', 'auxiliary' or 'regularised'",
            do="use one of these, or leave the smoother out",
        )

    def smooth(self, history: History, motion: MotionModel) -> History:
        """The history with its ``smoothed`` trajectory."""
        mean, cov = np.empty_like(history.filtered.mean), np.empty_like(history.filtered.cov)
        for lane, at, past in _lanes(history):
            for k, weights, _ in self._back(past, lanes_of_component(motion, at) if at else motion):
                belief = past.beliefs.filtered[k]
                own = moments(belief.points, weights, belief.circular)
                mean[(k, slice(None), *lane)] = own.mean
                cov[(k, slice(None), slice(None), *lane)] = own.cov
        return attrs.evolve(history, smoothed=Trajectory(mean, cov))

    def paths(self, history: History, motion: MotionModel) -> Array:
        """The paths themselves, ``(T, n, trajectories, *batch)``: draws of the whole trajectory."""
        steps, n, *batch = history.filtered.mean.shape
        out = np.empty((steps, n, self.trajectories, *batch))
        for lane, at, past in _lanes(history):
            for k, _, points in self._back(past, lanes_of_component(motion, at) if at else motion):
                out[(k, slice(None), slice(None), *lane)] = points
        return out

    def _back(self, history: History, motion: MotionModel) -> Any:
        """From the last step to the first: step, weights of its particles, points of the paths."""
        beliefs, t, u = _particles(history), history.t, history.u
        points: Any = None
        with at_once():
            for k in range(len(beliefs) - 1, -1, -1):
                belief = beliefs[k]
                if points is None:
                    chances = belief.log_weights[:, None]
                else:
                    given = None if u is None else u[k + 1]
                    dt = float(t[k + 1] - t[k])
                    ahead = motion.f(belief.points, dt, given, float(t[k]))
                    spread = motion.Q(belief.points, dt)
                    chances = belief.log_weights[:, None] + _transition(
                        points, ahead, spread, tuple(motion.space.circular)
                    )
                weights = np.exp(chances - chances.max(axis=0))
                weights /= np.add.reduce(weights, axis=0)
                total = np.cumsum(weights, axis=0)
                numbers = draws.uniforms(belief.key, belief.step, draws.BACKWARD, self.trajectories)
                index = np.add.reduce(total <= numbers * total[-1], axis=0)
                points = belief.points[:, np.minimum(index, len(total) - 1)]
                points = np.where(np.isnan(total[-1]), math.nan, points)
                yield k, weights.mean(axis=1), points


def _transition(later: Array, ahead: Array, Q: Array, circular: tuple[bool, ...]) -> Array:
    """Logarithm of ``p(later | particle)`` up to a constant, ``(N, M)``.

    Shapes:
        later ``(n, M)``; ahead ``(n, N)``, where particles go without noise; Q ``(n, n, 1 or N)``.
    """
    L = factored(Q)[..., None]
    d = residual(later[:, None], ahead[:, :, None], circular)
    size = np.abs(later).max(axis=1) + np.abs(ahead).max(axis=1)
    total: Any = 0.0
    for j in range(len(d)):
        known = np.asarray(L[j, j] > 0.0)
        y = d[j] / np.where(known, L[j, j], 1.0)
        # Without noise of its own a component must be where the others put it.
        missed = np.where(np.abs(d[j]) <= _SAME * size[j], 0.0, -math.inf)
        total = total + np.where(
            known, -0.5 * y * y - np.log(np.where(known, L[j, j], 1.0)), missed
        )
        for i in range(j + 1, len(d)):
            d[i] -= L[i, j] * y
    return np.asarray(total)


def _lanes(history: History) -> Any:
    """Each lane: its index, how to cut a model to it, and its own history."""
    batch = history.filtered.batch
    if not batch:
        yield (), None, history
        return
    for lane in np.ndindex(*batch):
        yield lane, lane[-1] if len(lane) == 1 else None, _lane(history, lane)


def _lane(history: History, lane: tuple[int, ...]) -> History:
    at: Any = (..., *lane)

    def cut(value: Any, axes: int) -> Any:
        return value if value is None or value.ndim == axes else value[at]

    beliefs = history.beliefs
    if beliefs is not None:
        for index in reversed(lane):
            beliefs = lanes_of(beliefs, index)
    return attrs.evolve(history, t=cut(history.t, 1), u=cut(history.u, 2), beliefs=beliefs)


def _particles(history: History) -> tuple[Particles, ...]:
    found = () if history.beliefs is None else history.beliefs.filtered
    kinds = sorted({type(b).__name__ for b in found if not isinstance(b, Particles)})
    if history.beliefs is None or kinds:
        raise CapabilityError(
            wording(
                "smoother 'backward_simulation'",
                got=f"beliefs of kind {', '.join(kinds)}" if kinds else "a history without beliefs",
                expected="particles at each step, as the filter 'bootstrap' leaves them",
                do="use tracker.smooth with an estimator of filter 'bootstrap', 'auxiliary' or "
                "'regularised' and smoother 'backward_simulation'",
            )
        )
    return found
