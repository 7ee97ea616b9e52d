"""The bootstrap particle filter (Gordon, Salmond and Smith 1993): particles move as the model says."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Annotated, Any

import attrs
import numpy as np

from tracker.protocols import MotionModel, SensorModel
from tracker.types import Gaussian, History, Innovation, Projection, Record
from tracker_particle import alone, records
from tracker_particle.belief import Particles
from tracker_particle.likelihood import projected, weighed
from tracker_particle.parameters import a_count, a_share
from tracker_particle.propagation import propagated, resampled
from tracker_particle.resampling import SYSTEMATIC, Scheme, scheme
from tracker_particle.start import begun


@attrs.frozen
class BootstrapFilter:
    """Particles drawn through the motion and weighed by the likelihood of what was measured.

    Before a prediction the lanes whose effective sample size has fallen below ``threshold`` times
    the number of particles are resampled. Motion and sensor may be anything: noise need not reach
    all components (a singular Q is a source less), R may differ from particle to particle, and no
    derivatives are asked for. ``nis`` is that of a Gaussian with the particles' moments; ``loglik``
    is the particles' own unbiased estimate of the likelihood.

    Reference: Gordon, Salmond and Smith 1993, Novel approach to nonlinear/non-Gaussian Bayesian
        state estimation, IEE Proceedings F 140(2); Arulampalam, Maskell, Gordon and Clapp 2002,
        A tutorial on particle filters, algorithm 4.
    Laws: those of kind "filter" for what is random; on linear problems with Gaussian noise it
        converges to the Kalman filter as 1/sqrt(N).

    Example:
    >>> import tracker as tk
    >>> scenario = tk.scenario("growth")
    >>> simulation = scenario.simulate(seed=1, runs=2)
    >>> estimator = tk.estimator(
    ...     BootstrapFilter(particles=200), motion=scenario.motion, sensor=scenario.sensor)
    >>> history = tk.filter(
    ...     estimator, simulation.record, simulation.prior, start=simulation.start,
    ...     rng=np.random.default_rng(2))
    >>> history.filtered.mean.shape, bool(history.innovation.ok.all())
    ((100, 1, 2), True)
    """

    particles: Annotated[int, "1"] = attrs.field(default=1000, validator=a_count)
    threshold: Annotated[float, "1"] = attrs.field(default=0.5, validator=a_share)
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
        prior: Gaussian | Particles,
        *,
        rng: np.random.Generator | Sequence[np.random.Generator] | None = None,
        motion: MotionModel | None = None,
    ) -> Particles:
        """Particles drawn from the prior; ``rng`` is one generator, or one for each lane."""
        return begun(prior, self.particles, rng, motion)

    def predict(
        self, state: Particles, motion: MotionModel, dt: Any, u: Any = None, t: Any = None
    ) -> Particles:
        """Each particle ``dt`` seconds later, after resampling where it is due."""
        weights = state.log_weights
        if alone.are(weights, motion):
            later: Particles = alone.predicted(self, state, weights.shape[1:], motion, dt, u, t)
            return later
        return propagated(resampled(state, self.resampling, self.threshold), motion, dt, u, t)

    def project(self, state: Particles, sensor: SensorModel, pose: Any = None) -> Projection:
        """The moments of what the particles would measure."""
        return projected(state.points, state.weights, state.circular, sensor, pose)

    def update(
        self,
        state: Particles,
        sensor: SensorModel,
        z: Any,
        pose: Any = None,
        projection: Projection | None = None,
    ) -> tuple[Particles, Innovation]:
        """Weigh the particles; components that are NaN were not measured."""
        weights = state.log_weights
        if alone.are(weights, sensor):
            return alone.updated(self, state, weights.shape[1:], sensor, z, pose, projection)
        return weighed(state, sensor, z, pose, projection)

    def why_not_whole(self, motion: MotionModel, sensors: Sequence[SensorModel]) -> str:
        """In words, why records are filtered step by step with these models, or ''."""
        return records.why_not(records.usual_passes, motion, sensors)

    def whole(
        self,
        state: Particles,
        motion: MotionModel,
        sensors: Sequence[SensorModel],
        record: Record,
        start: float | None,
        history: History,
    ) -> bool:
        """Fill in the history of a record, if that can be done at once: whether it was done."""
        rule = records.Rule(
            self.predict, self.update,
            functools.partial(resampled, scheme=self.resampling, threshold=self.threshold),
            self.threshold, self.resampling, records.usual_passes, records.PARTICLES,
        )  # fmt: skip
        return records.filtered(rule, state, motion, sensors, record, start, history)
