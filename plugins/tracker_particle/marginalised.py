"""The marginalised (Rao-Blackwellised) particle filter: what is linear is left to Kalman filters."""

from __future__ import annotations

import math
import operator
import weakref
from collections.abc import MutableMapping, Sequence
from typing import Annotated, Any

import attrs
import numpy as np

from tracker.algebra import lanes
from tracker.errors import CapabilityError, DomainError, TrackerError, wording
from tracker.models.linearise import linearise
from tracker.protocols import MotionModel, SensorModel
from tracker.types import (
    Array,
    Columns,
    Gaussian,
    History,
    Innovation,
    Projection,
    Record,
    Space,
    brief,
)
from tracker_particle import alone, conditional, draws, records
from tracker_particle.belief import Flags, centred, even, mean_of, outer, spread
from tracker_particle.likelihood import distance
from tracker_particle.parameters import a_count, a_share
from tracker_particle.propagation import chosen, due, log_sum, picked, root, wide
from tracker_particle.resampling import SYSTEMATIC, Scheme, scheme
from tracker_particle.start import needed

_TRIALS = 4
_SLACK = 1e-9


@attrs.frozen(eq=False)
class MarginalisedParticles:
    """Particles over some components, each with a Gaussian over the others.

    ``linear`` are the places of the others in the state.

    Shapes:
        points ``(k, N, *batch)``, the components that are not linear, in order; means
        ``(l, N, *batch)`` and covs ``(l, l, 1 or N, *batch)`` of the linear ones given those, k + l
        = n; log_weights ``(N, *batch)``; key ``(2, *batch)``.
    """

    points: Array = attrs.field(repr=brief)
    means: Array = attrs.field(repr=brief)
    covs: Array = attrs.field(repr=brief)
    log_weights: Array = attrs.field(repr=brief)
    key: draws.Keys = attrs.field(repr=False)
    step: int = 0
    linear: tuple[int, ...] = ()
    circular: Flags = ()

    @property
    def weights(self) -> Array:
        """Weights, ``(N, *batch)``."""
        return np.asarray(np.exp(self.log_weights))

    @property
    def others(self) -> tuple[int, ...]:
        """Places of the components that particles stand for."""
        n = len(self.points) + len(self.means)
        return tuple(i for i in range(n) if i not in self.linear)

    @property
    def states(self) -> Array:
        """Each particle with the mean of its linear components, ``(n, N, *batch)``."""
        out = np.empty((len(self.points) + len(self.means), *self.log_weights.shape))
        out[list(self.others)], out[list(self.linear)] = self.points, self.means
        return out

    def moments(self) -> Gaussian:
        """Mean and covariance: those of the particles' means, and the mean of their covariances."""
        weights = self.weights
        mean, d = centred(self.states, weights, self.circular)
        cov = outer(d, weights)
        cov[_block(self.linear)] += _mean_matrix(self.covs, weights)
        return Gaussian.trusted(mean, cov)


def _some_names(names: Sequence[str] | None) -> tuple[str, ...] | None:
    return None if names is None else tuple(names)


@attrs.frozen
class MarginalisedFilter:
    """Particles for what is not linear, a Kalman filter in each of them for what is.

    ``linear`` names the components that motion and sensor must be linear in, whatever the others
    are: ``f(x) = g(others) + A(others) linear``, and so for h. They are the velocities by default. The
    matrices are columns of the models' Jacobians; whether they are independent of the linear
    components is checked, and a model that is not linear in them is refused. Fewer dimensions are
    left to chance, so that far fewer particles do: for a position sensor and nearly constant
    velocity, only the position is sampled. With every component linear it is the Kalman filter.

    Noise of the two parts may be correlated; where particles differ neither in A nor in noise, they
    share one covariance.

    Reference: Schön, Gustafsson and Nordlund 2005, Marginalized particle filters for mixed
        linear/nonlinear state-space models, IEEE Transactions on Signal Processing 53(7), algorithm
        1 with eq. 18 to 25 in the form of one joint prediction, conditioned on the particle drawn.
    Laws: those of kind "filter" for what is random; equal to the Kalman filter where every component
        is linear.
    """

    linear: Annotated[tuple[str, ...] | None, "1"] = attrs.field(
        default=None, converter=_some_names
    )
    particles: Annotated[int, "1"] = attrs.field(default=1000, validator=a_count)
    threshold: Annotated[float, "1"] = attrs.field(default=0.5, validator=a_share)
    resampling: Scheme = attrs.field(default=SYSTEMATIC, converter=scheme)

    needs = ("jacobian",)
    random = True
    smoothers = ()
    tags = ("opaque",)
    why_opaque = "it draws random numbers and resamples"

    def beyond_moments(self, motion: MotionModel) -> str:  # noqa: ARG002 - the protocol
        """What it believes that mean and covariance do not say."""
        return "particles with a Kalman filter each"

    def begin(
        self,
        prior: Gaussian | MarginalisedParticles,
        *,
        rng: np.random.Generator | Sequence[np.random.Generator] | None = None,
        motion: MotionModel | None = None,
    ) -> MarginalisedParticles:
        """Particles drawn from the prior, each with the Gaussian of the rest given its place.

        Raises:
            DomainError: if the state has no component of a name in ``linear``.
            CapabilityError: without a generator, or without a motion that names the components.
        """
        if isinstance(prior, MarginalisedParticles):
            return prior
        if motion is None:
            raise CapabilityError(
                wording(
                    "argument 'motion'",
                    got="nothing",
                    expected="the motion model, whose space names the linear components",
                    do="pass motion=..., as tracker.filter does",
                )
            )
        places = _places(self.linear, motion.space)
        key = draws.keys(needed(rng), prior.batch)
        drawn = _drawn(prior.mean[:, None], prior.cov[:, :, None], places, self.particles, key, 0)
        log_weights = even(self.particles, prior.batch)
        return MarginalisedParticles(
            *drawn, log_weights, key, 1, places, tuple(motion.space.circular)
        )

    def predict(
        self,
        state: MarginalisedParticles,
        motion: MotionModel,
        dt: Any,
        u: Any = None,
        t: Any = None,
    ) -> MarginalisedParticles:
        """Draw the nonlinear components ahead; condition the linear ones on what was drawn."""
        weights = state.log_weights
        if alone.are(weights, motion):
            later: MarginalisedParticles = alone.predicted(
                self, state, weights.shape[1:], motion, dt, u, t
            )
            return later
        state = self._resampled(state)
        x = state.states
        given = (dt, wide(u), t)
        _refuse_nonlinear(motion, motion.Q, state, x, given)
        ahead, F = linearise(motion, x, *given)
        A = _columns(F, state.linear)
        cov = lanes.congruence(A, state.covs) + motion.Q(x, dt)
        points, means, covs = _drawn(
            ahead, cov, state.linear, x.shape[1], state.key, state.step, draws.NOISE
        )
        return attrs.evolve(
            state, points=points, means=means, covs=covs, step=state.step + 1,
            circular=tuple(motion.space.circular),
        )  # fmt: skip

    def project(
        self, state: MarginalisedParticles, sensor: SensorModel, pose: Any = None
    ) -> Projection:
        """The moments of what the particles would measure, their own uncertainty included."""
        weights, x = state.weights, state.states
        h, H = linearise(sensor, x, wide(pose))
        C = _columns(H, state.linear)
        heaviest = weights.argmax(axis=0)
        index = np.reshape(heaviest, (1, 1, *np.shape(heaviest)))
        near = np.take_along_axis(h, index, axis=1)
        d = sensor.residual(h, near)
        shift = mean_of(d, weights)
        d = d - shift[:, None]
        CP = lanes.product(C, state.covs)
        S = lanes.symmetric_product(CP, C) + sensor.R(x, wide(pose))
        _, dx = centred(x, weights, state.circular)
        cross = outer(dx, weights, d)
        cross[list(state.linear)] += np.swapaxes(_mean_matrix(CP, weights), 0, 1)
        z = sensor.residual(near[:, 0] + shift, np.zeros_like(shift))
        return Projection(z, outer(d, weights) + _mean_matrix(S, weights), cross)

    def update(
        self,
        state: MarginalisedParticles,
        sensor: SensorModel,
        z: Any,
        pose: Any = None,
        projection: Projection | None = None,
    ) -> tuple[MarginalisedParticles, Innovation]:
        """Weigh by the likelihood given the particle; each particle's Kalman filter takes ``z`` too."""
        batch = state.log_weights.shape[1:]
        if alone.are(state.log_weights, sensor):
            return alone.updated(self, state, batch, sensor, z, pose, projection)
        x, weights = state.states, state.weights
        where = wide(pose)
        _refuse_nonlinear(sensor, sensor.R, state, x, (where,))
        h, H = linearise(sensor, x, where)
        C = _columns(H, state.linear)
        CP = lanes.product(C, state.covs)
        S = lanes.symmetric_product(CP, C) + sensor.R(x, where)
        missing = np.isnan(z)
        column = np.where(missing[:, None], h[:, :1], z[:, None])
        v = sensor.residual(column, h)
        lost = np.isnan(v).any(axis=0)  # the sensor has no answer at such a particle
        # What is not measured is so for all particles of a lane: they can go on sharing matrices.
        inert, cross = lanes.without_missing(S, np.swapaxes(CP, 0, 1), z[:, None])
        means, covs, _, density, _ = lanes.condition(
            state.means, state.covs, np.where(lost | missing[:, None], 0.0, v), inert, cross
        )
        density = density + 0.5 * lanes.LOG_TAU * np.add.reduce(missing, axis=0)
        lost |= np.isnan(density)
        after, loglik = log_sum(state.log_weights + np.where(lost, -math.inf, density))
        unseen = missing.all(axis=0)
        dead = 0.0 * x.sum(axis=(0, 1))
        told = _mean_residual(v, S, weights, projection, sensor, z, missing)
        loglik = np.where(unseen, dead, loglik)
        nis = distance(*told, missing) + 0.0 * loglik
        innovation = Innovation(
            *told, nis, loglik, np.add.reduce(~missing, axis=0, dtype=np.float64), np.isfinite(nis)
        )
        belief = attrs.evolve(
            state,
            means=np.where(unseen | lost, state.means, means),
            covs=np.where(unseen, state.covs, covs),
            log_weights=np.where(unseen, state.log_weights, after),
            circular=tuple(sensor.state.circular),
        )
        return belief, innovation

    def why_not_whole(self, motion: MotionModel, sensors: Sequence[SensorModel]) -> str:
        """In words, why records are filtered step by step with these models, or ''."""
        return records.why_not(self._passes, motion, sensors)

    def whole(
        self,
        state: MarginalisedParticles,
        motion: MotionModel,
        sensors: Sequence[SensorModel],
        record: Record,
        start: float | None,
        history: History,
    ) -> bool:
        """Fill in the history of a record, if that can be done at once: whether it was done."""
        if state.covs.shape[2] != 1:  # particles do not share it
            return False
        rule = records.Rule(
            self.predict, self.update, self._resampled, self.threshold, self.resampling,
            self._passes, _FORM,
        )  # fmt: skip
        return records.filtered(rule, state, motion, sensors, record, start, history)

    def _passes(
        self, motion: MotionModel, sensors: Sequence[SensorModel], dt: Array, inputs: int
    ) -> records.Passes | str:
        try:
            linear, n = _places(self.linear, motion.space), motion.space.size
        except TrackerError as error:  # `begin` says so, too
            return str(error)
        if records.differs(motion):
            return (
                f"the noise of motion {records.name_of(motion)!r} differs from particle to particle"
            )
        if not linear:
            return "no component is linear"
        noise, place = records.by_time_step(dt, motion.Q, n)
        ahead = conditional.moving(motion, linear, inputs)
        weighs = [conditional.weighing(sensor, n, linear) for sensor in sensors]
        given = np.moveaxis(noise, 2, 0).reshape(-1, n * n)
        more = len(linear) * (len(linear) + 1) // 2
        return records.passes_of(motion, sensors, ahead, weighs) or records.Passes(
            ahead, weighs, (given, place), n - len(linear), more
        )

    def _resampled(self, state: MarginalisedParticles) -> MarginalisedParticles:
        weights = state.weights
        lacking = due(weights, self.threshold)
        if not np.any(lacking):
            return state
        ancestors, after = chosen(state, weights, self.resampling, draws.RESAMPLING, lacking)
        return attrs.evolve(
            state,
            points=picked(state.points, ancestors),
            means=picked(state.means, ancestors),
            covs=picked(state.covs, ancestors),
            log_weights=after,
        )


# ------------------------------------------------------------------------------------- inside
def _triangle(state: MarginalisedParticles) -> Array:
    return state.covs[:, :, 0][np.triu_indices(len(state.covs))]


def _later(
    state: MarginalisedParticles,
    rows: Array,
    log_weights: Array,
    step: int,
    circular: Flags,
    triangle: Array,
    *_: Any,
) -> MarginalisedParticles:
    """As the loop over a record has left it."""
    size = len(state.linear)
    covs = np.empty((size, size, 1))
    i, j = np.triu_indices(size)
    covs[i, j, 0] = covs[j, i, 0] = triangle
    points, means = rows[list(state.others)], rows[list(state.linear)]
    return MarginalisedParticles(
        points, means, covs, log_weights, state.key, step, state.linear, circular
    )


_FORM = records.Form(operator.attrgetter("states"), _triangle, _later)


def _places(names: tuple[str, ...] | None, space: Space) -> tuple[int, ...]:
    if names is None:
        found = space.velocity
        if not found:
            raise DomainError(
                wording(
                    "parameter 'linear'",
                    got="nothing",
                    expected=f"names of components, as the state ({space}) has no velocities",
                    do="name the components that motion and sensor are linear in",
                )
            )
        return found
    return tuple(sorted(space.index(name) for name in names))


def _block(places: tuple[int, ...]) -> Any:
    return np.ix_(places, places)


def _mean_matrix(values: Array, weights: Array) -> Array:
    """The mean over the particles of matrices ``(a, b, 1 or N, *batch)``."""
    if values.shape[2] == 1:
        return np.array(np.broadcast_to(values[:, :, 0], (*values.shape[:2], *weights.shape[1:])))
    return np.asarray(np.einsum("abs...,s...->ab...", values, weights))


def _mean_residual(
    v: Array,
    S: Array,
    weights: Array,
    projection: Projection | None,
    sensor: SensorModel,
    z: Any,
    missing: Any,
) -> tuple[Array, Array]:
    if projection is not None:
        mean, whole = sensor.residual(z, projection.z), projection.S
    else:
        mean = mean_of(v, weights)
        whole = outer(v - mean[:, None], weights) + _mean_matrix(S, weights)
    return np.where(missing, math.nan, mean), whole


def _columns(F: Any, places: tuple[int, ...]) -> Array:
    """Some columns of a Jacobian, ``(rows, l, 1 or N, *batch)``."""
    whole = F.dense() if isinstance(F, Columns) else F
    return np.ascontiguousarray(whole[:, list(places)])


def _drawn(
    mean: Array,
    cov: Array,
    places: tuple[int, ...],
    count: int,
    key: draws.Keys,
    step: int,
    purpose: int = draws.START,
) -> tuple[Array, Array, Array]:
    """Draws of the nonlinear components, and the linear ones given them.

    Shapes:
        mean ``(n, 1 or N, *batch)``; cov ``(n, n, 1 or N, *batch)``.
    Reference:
        Schön, Gustafsson and Nordlund 2005, eq. 18 to 25: the joint Gaussian of both parts,
        conditioned on the one.
    """
    others = [i for i in range(len(mean)) if i not in places]
    own = list(places)
    inner, cross = cov[np.ix_(others, others)], cov[np.ix_(own, others)]
    G = root(inner)
    moved = spread(G, draws.normals(key, step, purpose, G.shape[1], count))
    points = mean[others] + moved
    batch = moved.shape[2:]
    if others:
        K = lanes.gain(cross, inner)
        means = mean[own] + np.einsum("ij...,j...->i...", K, moved)
        covs = cov[_block(places)] - lanes.product(K, np.swapaxes(cross, 0, 1))
        lanes.mirror(covs)
    else:
        means, covs = np.array(mean[own]), cov[_block(places)]
    each = (len(own), count, *batch)
    covs = np.broadcast_to(covs, (*covs.shape[:3], *batch))
    return points, np.array(np.broadcast_to(means, each)), np.array(covs)


def _refuse_nonlinear(
    model: Any, noise_of: Any, state: MarginalisedParticles, x: Array, given: tuple[Any, ...]
) -> None:
    """Refuse a model that is not linear in the linear components; each model is looked at once.

    Raises:
        CapabilityError: naming the model and the components.
    """
    try:
        known = _LINEAR.setdefault(model, set())
    except TypeError:  # it cannot be remembered
        known = set()
    if state.linear in known:
        return
    few = x[:, :_TRIALS]
    around = np.sqrt(np.einsum("ii...->i...", np.broadcast_to(
        state.covs[:, :, :_TRIALS], (*state.covs.shape[:2], *few.shape[1:])
    )))  # fmt: skip
    here = _matrices(model, noise_of, state.linear, few, given)
    for factor in (1.0, -2.7):
        moved = few.copy()
        moved[list(state.linear)] += factor * around
        for a, b in zip(here, _matrices(model, noise_of, state.linear, moved, given), strict=True):
            size = np.abs(a).max(initial=0.0)
            if np.abs(a - b).max(initial=0.0) > _SLACK * size:
                names = ", ".join(_space(model).names[i] for i in state.linear)
                raise CapabilityError(
                    wording(
                        f"{type(model).__name__} {getattr(model, 'name', '')!r}",
                        got="a Jacobian or a noise that changes with components that are to be linear",
                        expected=f"a model that is linear in {names}, whatever the others are",
                        do="name other components in linear=..., or use filter 'bootstrap'",
                    )
                )
    # Over no time every motion is linear, and what is not finite has not been seen.
    if np.all(given[0]) if hasattr(model, "f") else np.isfinite(here[0]).any():
        known.add(state.linear)


_LINEAR: MutableMapping[Any, set[tuple[int, ...]]] = weakref.WeakKeyDictionary()
"""Which models have been seen to be linear in which components."""


def _matrices(
    model: Any, noise_of: Any, places: tuple[int, ...], x: Array, given: tuple[Any, ...]
) -> list[Array]:
    """Columns of the Jacobian, and the noise, where they are finite."""
    F = _columns(linearise(model, x, *given)[1], places)
    return [np.where(np.isfinite(m), m, 0.0) for m in (F, noise_of(x, given[0]))]


def _space(model: Any) -> Space:
    space: Space = getattr(model, "state", None) or model.space
    return space
