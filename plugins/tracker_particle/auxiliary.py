"""The auxiliary particle filter (Pitt and Shephard 1999): parents are chosen in sight of z."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Annotated, Any

import attrs
import numpy as np

from tracker.protocols import MotionModel, SensorModel
from tracker.types import Array, Gaussian, History, Innovation, Projection, Record, brief
from tracker_particle import alone, draws, records, twofold
from tracker_particle.belief import Particles, spread
from tracker_particle.likelihood import projected, seen, surprise, weighed
from tracker_particle.parameters import a_count
from tracker_particle.propagation import chosen, log_sum, noise, picked, root, wide
from tracker_particle.resampling import SYSTEMATIC, Scheme, scheme
from tracker_particle.start import begun


@attrs.frozen(eq=False)
class Offspring:
    """Predicted particles together with what they were made of, so that parents can still be chosen.

    Shapes:
        particles, one child of each parent; centres ``(n, N, *batch)``, where the parents go without
        noise; spread ``(n, k, 1 or N, *batch)``, a root of the noise; noise ``(k, N, *batch)``,
        standard normals: child = centre + spread noise.
    """

    particles: Particles
    centres: Array = attrs.field(repr=brief)
    spread: Array = attrs.field(repr=brief)
    noise: Array = attrs.field(repr=brief)

    def moments(self) -> Gaussian:
        """Mean and covariance of the children."""
        return self.particles.moments()


@attrs.frozen
class AuxiliaryFilter:
    """Chooses parents by how likely the measurement is where they go without noise.

    The first stage resamples parents with the likelihood at ``f(x)``, the second weighs their
    children by what that likelihood got wrong. It resamples in every update, and is at its best
    where the process noise is small beside what a measurement tells: at its worst where it is large,
    for then ``f(x)`` says little about a child. ``loglik`` is the product of the two stages' means.

    Reference: Pitt and Shephard 1999, Filtering via simulation: auxiliary particle filters, JASA
        94(446), section 3; its estimate of the likelihood: Pitt 2002.
    Laws: those of kind "filter" for what is random; on linear problems with Gaussian noise it
        converges to the Kalman filter as 1/sqrt(N).
    """

    particles: Annotated[int, "1"] = attrs.field(default=1000, validator=a_count)
    resampling: Scheme = attrs.field(default=SYSTEMATIC, converter=scheme)

    needs = ()
    random = True
    smoothers = ("backward_simulation",)
    tags = ("opaque",)
    why_opaque = "it draws random numbers and resamples"

    def beyond_moments(self, motion: MotionModel) -> str:  # noqa: ARG002 - the protocol
        """What it believes that mean and covariance do not say."""
        return "particles"

    def begin(
        self,
        prior: Gaussian | Particles | Offspring,
        *,
        rng: np.random.Generator | Sequence[np.random.Generator] | None = None,
        motion: MotionModel | None = None,
    ) -> Particles | Offspring:
        """Particles drawn from the prior; ``rng`` is one generator, or one for each lane."""
        if isinstance(prior, Offspring):
            return prior
        return begun(prior, self.particles, rng, motion)

    def predict(
        self,
        state: Particles | Offspring,
        motion: MotionModel,
        dt: Any,
        u: Any = None,
        t: Any = None,
    ) -> Offspring:
        """One child of each particle, ``dt`` seconds later."""
        weights = _children(state).log_weights
        if alone.are(weights, motion):
            later: Offspring = alone.predicted(self, state, weights.shape[1:], motion, dt, u, t)
            return later
        parents = _children(state)
        points = parents.points
        G = root(motion.Q(points, dt))
        centres = motion.f(points, dt, wide(u), t)
        drawn = noise(parents, points.shape[1], G.shape[1])
        children = attrs.evolve(
            parents,
            points=centres + spread(G, drawn),
            step=parents.step + 1,
            circular=tuple(motion.space.circular),
        )
        batch = points.shape[2:]
        whole = np.broadcast_to(G, (*G.shape[:3], *batch))  # so that lanes can be told apart
        return Offspring(children, centres, whole, drawn)

    def project(
        self, state: Particles | Offspring, sensor: SensorModel, pose: Any = None
    ) -> Projection:
        """The moments of what the particles would measure."""
        cloud = _children(state)
        return projected(cloud.points, cloud.weights, cloud.circular, sensor, pose)

    def update(
        self,
        state: Particles | Offspring,
        sensor: SensorModel,
        z: Any,
        pose: Any = None,
        projection: Projection | None = None,
    ) -> tuple[Particles, Innovation]:
        """Choose parents in sight of ``z``, then weigh their children."""
        weights = _children(state).log_weights
        if alone.are(weights, sensor):
            return alone.updated(self, state, weights.shape[1:], sensor, z, pose, projection)
        if isinstance(state, Particles):  # nobody's children: there are no parents to choose
            return weighed(state, sensor, z, pose, projection)
        before = state.particles
        first = seen(state.centres, sensor, z, pose).log_likelihood
        stage, expected = log_sum(before.log_weights + first)
        measured = ~np.isnan(z).all(axis=0)
        ancestors, _ = chosen(before, np.exp(stage), self.resampling, draws.FIRST_STAGE, measured)
        G = picked(state.spread, ancestors)
        points = picked(state.centres, ancestors) + spread(G, state.noise)
        what = seen(points, sensor, z, pose)
        count = len(stage)
        second = what.log_likelihood - np.take_along_axis(first, ancestors, axis=0)
        weights, gained = log_sum(second - np.log(count))
        weights = np.where(measured, weights, before.log_weights)
        dead = 0.0 * before.points.sum(axis=(0, 1))
        loglik = np.where(measured, expected + gained, dead)
        after = attrs.evolve(
            before,
            points=np.where(measured, points, before.points),
            log_weights=weights,
            step=before.step + 1,
            circular=tuple(sensor.state.circular),
        )
        told = seen(before.points, sensor, z, pose)
        return after, surprise(before.weights, told, projection, sensor, z, loglik)

    def why_not_whole(self, motion: MotionModel, sensors: Sequence[SensorModel]) -> str:
        """In words, why records are filtered step by step with these models, or ''."""
        if self.resampling != SYSTEMATIC:
            return f"parents are chosen by the {self.resampling} scheme"
        passes = functools.partial(_passes, self.particles)
        return records.why_not(passes, motion, sensors)

    def whole(
        self,
        state: Particles | Offspring,
        motion: MotionModel,
        sensors: Sequence[SensorModel],
        record: Record,
        start: float | None,
        history: History,
    ) -> bool:
        """Fill in the history of a record, if that can be done at once: whether it was done."""
        if isinstance(state, Offspring):  # it has been predicted already
            return False
        rule = records.Rule(
            self.predict, self.update, _as_it_is, 0.0, self.resampling,
            functools.partial(_passes, len(state.log_weights)), records.PARTICLES,
        )  # fmt: skip
        return records.filtered(rule, state, motion, sensors, record, start, history)


def _as_it_is(state: Particles) -> Particles:
    return state


def _passes(
    count: int, motion: MotionModel, sensors: Sequence[SensorModel], dt: Array, inputs: int
) -> records.Passes | str:
    found = records.roots(motion, dt)
    if isinstance(found, str):
        return found
    columns, noise = found
    if columns is None:  # a child's would be its parent's, which is chosen later
        return f"the noise of motion {records.name_of(motion)!r} differs from particle to particle"
    n = motion.space.size
    ahead = twofold.moving(motion, columns, inputs)
    weighs = [twofold.weighing(sensor, n) for sensor in sensors]
    why = records.passes_of(motion, sensors, ahead, weighs)
    if why:
        return why
    counted = [(done, [*own, float(count), 0.0], flags) for done, own, flags in weighs]
    return records.Passes(ahead, counted, noise, columns, rows=2 * n + 1, pace=2)


def _children(state: Particles | Offspring) -> Particles:
    return state.particles if isinstance(state, Offspring) else state
