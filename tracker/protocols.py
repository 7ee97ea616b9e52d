"""Every contract between components: read this first. Nothing here computes anything.

Letters: ``n`` state components, ``m`` measurement components, ``p`` pose components, ``q`` input
components, ``*batch`` any trailing axes, possibly none. Components come first, batch axes last.
SI units, radians, seconds, float64. "Shared": an axis of the batch may have length 1 where all
lanes have the same value, and must then be there: ``(n, n, 1)``, never ``(n, n)``, beside a state of
shape ``(n, 1000)``.

A component is any object with these methods; nothing is inherited. The laws named below are checked
by `tracker.testing`; ``tracker check NAME`` prints them. Three ways to be a good citizen:

* be a value: no method changes the object, no argument is modified, no state is kept;
* be a batch: ``f(x)[..., i] == f(x[..., i])`` for any batch shape, ``()`` and ``(2, 0)`` included;
* be explicit: time step, input and pose are arguments, randomness is an argument called ``rng``.

Models written as component functions (`tracker.models.ComponentMotion`, `ComponentSensor`) have all
optional capabilities at once: derivatives, Hessians, joint linearisation, tracing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
import numpy.typing as npt

from tracker.types import (
    Array,
    Association,
    Gaussian,
    History,
    Innovation,
    Projection,
    Record,
    Scan,
    Space,
    Step,
    Tracks,
)


# ------------------------------------------------------------------------------------- models
@runtime_checkable
class MotionModel(Protocol):
    """How a state changes in ``dt`` seconds, and how uncertain that is.

    Laws: the Jacobian is the derivative of f; Q is symmetric positive semi-definite; two half steps
    equal one step, in f and in Q; dt = 0 is the identity with Q = 0.
    """

    @property
    def space(self) -> Space:
        """The state space, ``n`` components."""
        ...

    def f(self, x: Array, dt: Any, u: Any = None, t: Any = None) -> Array:
        """State after dt: x ``(n, *batch)``, dt scalar or ``(*batch)``, u ``(q, *batch)`` or None,
        t the time at the start of the step. Returns ``(n, *batch)``.
        """
        ...

    def jacobian(self, x: Array, dt: Any, u: Any = None, t: Any = None) -> Array:
        """Derivative of f by the state, ``(n, n, *batch)``, shared axes allowed."""
        ...

    def Q(self, x: Array, dt: Any) -> Array:
        """Covariance of the process noise of the step, ``(n, n, *batch)``, shared axes allowed."""
        ...


@runtime_checkable
class SensorModel(Protocol):
    """What a sensor at ``pose`` measures of a state, and how noisily.

    Laws: the Jacobian is the derivative of h *through* `residual`; `residual` wraps at the cut; R is
    symmetric positive semi-definite.
    """

    @property
    def space(self) -> Space:
        """The measurement space, ``m`` components; it knows which of them are circular."""
        ...

    @property
    def pose_space(self) -> Space:
        """The pose the sensor is given at each step, ``p`` components; empty if it stands still."""
        ...

    @property
    def state(self) -> Space:
        """The state space that x must be in."""
        ...

    def h(self, x: Array, pose: Any = None) -> Array:
        """Noise-free measurement: x ``(n, *batch)``, pose ``(p,)`` or ``(p, *batch)``.
        Returns ``(m, *batch)``.
        """
        ...

    def jacobian(self, x: Array, pose: Any = None) -> Array:
        """Derivative of h by the state, ``(m, n, *batch)``, shared axes allowed."""
        ...

    def R(self, x: Array, pose: Any = None) -> Array:
        """Covariance of the measurement noise, ``(m, m, *batch)``, shared axes allowed."""
        ...

    def residual(self, z: Array, zhat: Array) -> Array:
        """``z - zhat``, wrapped where circular: the only legal subtraction of measurements."""
        ...


# Optional capabilities. A pipeline checks them when it is built and names them in its error.
@runtime_checkable
class HasHessian(Protocol):
    """Second derivatives ``(m, n, n, *batch)``, for second-order filters."""

    def hessian(self, x: Array, *arguments: Any) -> Array:
        """Second derivatives by the state."""
        ...


@runtime_checkable
class HasLinearise(Protocol):
    """Value and Jacobian in one call, the Jacobian as an array or as `tracker.types.Columns`."""

    def linearise(self, x: Array, *arguments: Any) -> tuple[Array, Any]:
        """Value and Jacobian together: nothing is computed twice."""
        ...


@runtime_checkable
class HasExpand(Protocol):
    """Value, Jacobian and Hessians in one call, for second-order filters that must be fast.

    Without it they call `HasLinearise` (or ``f``, ``h`` and ``jacobian``) and `HasHessian`.
    """

    def expand(self, x: Array, *arguments: Any) -> tuple[Array, Any, Any]:
        """Value, Jacobian as of `HasLinearise`, and Hessians as an array or `tracker.types.Block`."""
        ...


@runtime_checkable
class HasComponents(Protocol):
    """Written over components, so that it can run on graph nodes and be compiled."""

    @property
    def why_opaque(self) -> str:
        """'' if it can be traced, else the reason."""
        ...


@runtime_checkable
class Invertible(Protocol):
    """A sensor whose measurement gives a first estimate of the state, or of a part of it."""

    def prior(self, z: Array, pose: Any = None, rest: Gaussian | None = None) -> Gaussian:
        """A Gaussian over the state from one measurement ``(m, *batch)``; what the measurement does
        not tell is as in ``rest``, which may be missing where nothing is left to tell.
        """
        ...


# ------------------------------------------------------------------------------------ filters
class Belief(Protocol):
    """The state of a filter: a Gaussian, a square root, a mixture, particles."""

    def moments(self) -> Gaussian:
        """Mean and covariance."""
        ...


S = TypeVar("S", bound=Belief)


@runtime_checkable
class HasBegin(Protocol):
    """A filter whose state is not a Gaussian: how its own kind of belief begins.

    A belief is a frozen attrs class whose fields are arrays (components first, batch last), beliefs,
    tuples of these, or plain settings. Metadata `tracker.types.SYMMETRIC` or `LOWER` on a field
    tells what structure its matrices have. A filter that draws random numbers has ``random = True``,
    takes ``rng`` (a generator, or a sequence with one per lane) by keyword here and nowhere else,
    and keeps in its belief what makes later draws reproducible. One whose belief has parts for each
    mode of a motion takes ``motion=None`` too, and is given the estimator's; one that has parts for
    each measured component takes ``sensors=None``.
    """

    def begin(self, prior: Gaussian) -> Any:
        """The belief that a Gaussian is; a belief of its own kind is returned as it is."""
        ...


@runtime_checkable
class BeyondMoments(Protocol):
    """A filter whose beliefs say more than mean and covariance, and the smoothers that make use of it.

    ``smoothers`` are names of registered ones, with "beliefs" in their ``needs``. Any other sees the
    moments alone: after such a filter that is said in words, and refused after one that draws random
    numbers.
    """

    smoothers: tuple[str, ...]

    def beyond_moments(self, motion: MotionModel) -> str:
        """What they are, as "a mixture of 2 modes"; '' where, with this motion, moments are all."""
        ...


@runtime_checkable
class WorksRecords(Protocol):
    """A filter with machine code of its own for whole records: not a step program, but draws, say, and a loop.

    Law: the history is that of its methods, step by step.
    """

    def why_not_whole(self, motion: MotionModel, sensors: Sequence[SensorModel]) -> str:
        """In words, why it cannot do so with these models, here and now; '' if it can."""
        ...

    def whole(
        self,
        state: Any,
        motion: MotionModel,
        sensors: Sequence[SensorModel],
        record: Record,
        start: float | None,
        history: History,
    ) -> bool:
        """Fill in the moments and innovations of an allocated history, from what `begin` made of the
        prior; True if that was done, False if the record must be filtered step by step after all.
        """
        ...


class Filter(Protocol[S]):
    """Bayes' rule, approximated: predict through a motion, update with a measurement.

    A Gaussian filter writes these three over the verbs of `tracker.algebra`, once; the same methods
    then run on arrays of lanes, on one run, and on graph nodes.

    Laws: covariances stay symmetric positive semi-definite; equal to the Kalman filter on
    linear-Gaussian problems; a NaN component equals a sensor without it; NIS and NEES lie in their
    chi-square bands on matched models.
    """

    @property
    def needs(self) -> tuple[str, ...]:
        """Capabilities that motion and sensor must have: 'jacobian', 'hessian', 'linear'."""
        ...

    def predict(self, state: S, motion: MotionModel, dt: Any, u: Any = None, t: Any = None) -> S:
        """The state ``dt`` seconds later."""
        ...

    def project(self, state: S, sensor: SensorModel, pose: Any = None) -> Projection:
        """The measurement that the state predicts, for gate, associator and update alike."""
        ...

    def update(
        self,
        state: S,
        sensor: SensorModel,
        z: Any,
        pose: Any = None,
        projection: Projection | None = None,
    ) -> tuple[S, Innovation]:
        """The state after measurement z ``(m, *batch)``; given a projection, it is not recomputed."""
        ...


class Smoother(Protocol):
    """Estimates given the whole record instead of its past.

    One that goes back step by step may be compiled: it then has a method ``step(filtered, predicted,
    smoothed, motion, dt, u, t)``, over the verbs of `tracker.algebra`, from the moments filtered at k, those
    predicted at k + 1 and the smoothed belief there to the smoothed belief at k. The belief is a Gaussian,
    or what its method ``begin(filtered)`` makes of the last filtered moments: a value as that of a filter
    (`HasBegin`), with ``moments()``. One that needs the beliefs of a filter is given these in the place of
    moments, begins with the last of them by its ``begin``, and may say in ``follows`` which
    registered filter leaves such, and have a method ``why_not_after(filter)`` that says in words why it
    cannot follow another, '' if it can.

    Laws: the last step equals the filter; in the linear-Gaussian case the result is the batch
    least-squares solution.
    """

    @property
    def needs(self) -> tuple[str, ...]:
        """Capabilities that the motion must have; "beliefs" if moments alone do not tell it enough."""
        ...

    def smooth(self, history: History, motion: MotionModel) -> History:
        """The history with its ``smoothed`` trajectory filled in."""
        ...


A = TypeVar("A")


class NoiseAdapter(Protocol[A]):
    """Re-tunes noise from innovations: a recursion of its own beside the filter's.

    What it remembers is a value, as a belief is (`HasBegin`): a frozen attrs class of arrays with
    components first and batch last; for the last so many steps of something, a
    `tracker.adaptation.Window`. Every sensor of an estimator has its own memory.

    Laws: Q and R stay positive semi-definite; matched noise is a fixed point in expectation; models
    given are never changed.
    """

    @property
    def tunes(self) -> tuple[str, ...]:
        """What it re-tunes: 'Q', 'R' or both. Who tunes Q serves estimators of one sensor."""
        ...

    def begin(self, motion: MotionModel, sensor: SensorModel, prior: Gaussian, pose: Any) -> A:
        """What it remembers before the first step."""
        ...

    def tuned(
        self, memory: A, motion: MotionModel, sensor: SensorModel
    ) -> tuple[MotionModel, SensorModel]:
        """The models for the next step: see `tracker.adaptation`, with_noise and with_process_noise."""
        ...

    def adapt(self, memory: A, step: Step, motion: MotionModel, sensor: SensorModel) -> A:
        """What it remembers after a step that used these, tuned, models; NaN residuals say nothing."""
        ...


# -------------------------------------------------------------------------------- association
class Gate(Protocol):
    """Which detections could belong to which track.

    Laws: a larger probability gates no less; the threshold depends only on m.
    """

    def threshold(self, m: int) -> float:
        """Largest squared Mahalanobis distance that passes, for m measured components."""
        ...

    def admits(self, distance: Array, m: int) -> npt.NDArray[np.bool_]:
        """Flags for squared distances of any shape; NaN never passes."""
        ...


class Associator(Protocol):
    """Who measured whom.

    Laws: rows of the weights sum to one; a detection is given away at most once; pairs outside the
    gate have weight exactly zero; the answer follows a permutation of tracks or detections.
    """

    def associate(self, distance: Array, admitted: npt.NDArray[np.bool_]) -> Association:
        """From squared distances and gate flags, both ``(tracks, D, *batch)``."""
        ...


class Initiator(Protocol):
    """Starts tracks from detections that nobody claimed."""

    def start(self, scan: Scan, unclaimed: npt.NDArray[np.bool_], sensor: SensorModel) -> Tracks:
        """New tracks, possibly none."""
        ...


class Deleter(Protocol):
    """Decides which tracks have ended."""

    def keep(self, tracks: Tracks) -> npt.NDArray[np.bool_]:
        """One flag per track."""
        ...


# ----------------------------------------------------------------------- optimisers, planners
class Optimiser(Protocol[A]):
    """Ask for candidates, tell their cost; minimises. Restarts are lanes, each with its own numbers.

    What it remembers is a value, as a belief is (`HasBegin`), with the restarts as batch axes; it
    carries what makes its draws reproducible, so that `ask` and `tell` are functions of their
    arguments. The loop around it is `tracker.optimise`.

    Two more methods are optional: ``finished(memory)``, flags ``(*restarts)`` of those that have come
    to their end; ``survivors(memory)``, candidates and costs that one of several objectives keeps.

    Laws: stays in bounds; the best so far never gets worse; the budget is exact; adding a constant
    to the cost changes nothing; a restart does not depend on its company; NaN is the worst cost.
    """

    @property
    def population(self) -> int:
        """How many candidates it asks for at a time."""
        ...

    @property
    def rows(self) -> int:
        """How many numbers the cost of a candidate has: objectives, and constraints if it takes any."""
        ...

    def begin(
        self,
        bounds: Array,
        *,
        rng: np.random.Generator | Sequence[np.random.Generator],
        restarts: tuple[int, ...] = (),
        start: Array | None = None,
    ) -> A:
        """Start inside ``bounds (d, 2)``; ``start (d, k)`` or ``(d, k, *restarts)`` is asked first.

        ``rng`` is a generator, or one for each restart, and is used here alone.
        """
        ...

    def ask(self, memory: A) -> Array:
        """Candidates ``(d, population, *restarts)``."""
        ...

    def tell(self, memory: A, cost: Array) -> A:
        """Learn the cost ``(rows, population, *restarts)`` of these candidates."""
        ...


class ObserverPath(Protocol):
    """Where an observer is at each time.

    Laws: there is a pose at every time, also before the start; it goes, and does not jump.
    """

    def pose(self, t: Any) -> Array:
        """Pose ``(p, *t.shape)``."""
        ...


class Planner(Protocol):
    """Chooses where an observer goes next. Law: it obeys its limits."""

    def plan(self, belief: Belief, pose: Array, t: float, horizon: float) -> ObserverPath:
        """A path from ``pose`` at time ``t``, good for ``horizon`` seconds."""
        ...


# ------------------------------------------------------------------------- metrics, scenarios
class Metric(Protocol):
    """Judges what `tracker.filter` or `tracker.smooth` made of runs whose truth is known; less is better.

    Laws: a run is judged by itself; nothing beats the truth; a lost run never scores as a good one.
    """

    def score(self, history: History, truth: Array) -> Array:
        """Numbers ``(k, *batch)`` from a history and the true states ``(T, n, *batch)``."""
        ...


class Scenario(Protocol):
    """A problem with a known answer: what is simulated, and what an estimator is told about it."""

    @property
    def name(self) -> str:
        """Its name in the registry."""
        ...

    @property
    def motion(self) -> MotionModel:
        """The motion model that an estimator should assume."""
        ...

    @property
    def sensor(self) -> SensorModel | Sequence[SensorModel]:
        """The sensor, or sensors, that measured."""
        ...

    def simulate(self, seed: int, runs: int | Sequence[int] = 1, *, condition: int = 0) -> Any:
        """A `tracker.simulation.Simulation` of some runs; the same seed, run and condition give the
        same bits in any company.
        """
        ...
