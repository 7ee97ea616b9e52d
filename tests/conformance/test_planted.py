"""Planted mistakes: the kit must name the law that each of them breaks, and pass what is clean."""

from __future__ import annotations

import re
from typing import Any

import attrs
import numpy as np
import pytest
from hypothesis import strategies as st

from tracker.adaptation import with_noise, with_scaled_process_noise
from tracker.errors import DomainError, ShapeError
from tracker.models import isnan, maximum, where
from tracker.testing import check_component, kit, parametrize_checks
from tracker.types import PLANAR, Association, Gaussian, Space
from tracker_association.chi_square_gate import ChiSquareGate
from tracker_association.global_nearest_neighbour import GlobalNearestNeighbour
from tracker_kalman.ekf1 import ExtendedKalmanFilter
from tracker_kalman.rts import RauchTungStriebel
from tracker_optimise.genetic import Genetic
from tracker_optimise.imperialist import Imperialist
from tracker_optimise.particle_swarm import ParticleSwarm
from tracker_particle.backward_simulation import BackwardSimulation
from tracker_particle.bootstrap import BootstrapFilter

STATIONS = np.array([[1.0, 1.0], [400.0, 110.0]])  # paper 0, eq. 34, in metres


def over(x: Any, space: Space = PLANAR) -> Any:
    x = np.asarray(x, dtype=float)
    if x.ndim == 0 or len(x) != space.size:
        raise ShapeError(f"got {x.shape}, expected ({space.size}, *batch)")
    return x


@attrs.frozen
class TwoStations:
    """Two bearings by hand, in NumPy alone: nothing is derived from a graph."""

    sigma: float = 0.03

    space = Space.of("left [rad] circular", "right [rad] circular")
    pose_space = Space.of("sx [m]", "sy [m]")
    state = PLANAR

    def __attrs_post_init__(self) -> None:
        if not np.isfinite(self.sigma):
            raise DomainError("sigma must be finite")

    def offsets(self, x: Any, pose: Any) -> Any:
        x, pose = over(x), np.asarray(pose, dtype=float)
        pose = pose.reshape(2, *(1,) * (x.ndim - 1)) if pose.ndim == 1 else pose
        return [x[:2] - s.reshape(2, *(1,) * (x.ndim - 1)) - pose for s in STATIONS]

    def h(self, x: Any, pose: Any = None) -> Any:
        return np.stack([np.arctan2(d[1], d[0]) for d in self.offsets(x, pose)])

    def row(self, dx: Any, dy: Any) -> tuple[Any, Any]:
        return -dy, dx  # eq. 31

    def jacobian(self, x: Any, pose: Any = None) -> Any:
        out = np.zeros((2, 4, *np.shape(x)[1:]))
        for i, (dx, dy) in enumerate(self.offsets(x, pose)):
            out[i, 0], out[i, 1] = np.asarray(self.row(dx, dy)) / (dx**2 + dy**2)
        return out

    def bends(self, dx: Any, dy: Any) -> tuple[Any, Any]:
        return 2 * dx * dy, -2 * dx * dy  # eq. 33, corrected

    def hessian(self, x: Any, pose: Any = None) -> Any:
        out = np.zeros((2, 4, 4, *np.shape(x)[1:]))
        for i, (dx, dy) in enumerate(self.offsets(x, pose)):
            square = (dx**2 + dy**2) ** 2
            out[i, 0, 0], out[i, 1, 1] = np.asarray(self.bends(dx, dy)) / square
            out[i, 0, 1] = out[i, 1, 0] = (dy**2 - dx**2) / square
        return out

    def R(self, x: Any, pose: Any = None) -> Any:
        return self.sigma**2 * np.eye(2).reshape(2, 2, *(1,) * (np.ndim(x) - 1))

    def residual(self, z: Any, zhat: Any) -> Any:
        return np.pi - (np.pi - (z - zhat)) % (2 * np.pi)


class SwappedColumns(TwoStations):
    def row(self, dx, dy):
        return dx, -dy  # eq. 32 as printed


class WrongHessian(TwoStations):
    def bends(self, dx, dy):
        return -2 * dx, -2 * dy  # eq. 33 as printed


class MissingWrap(TwoStations):
    def residual(self, z, zhat):
        return z - zhat


class WrapsToMinusPi(TwoStations):
    def residual(self, z, zhat):
        return (z - zhat + np.pi) % (2 * np.pi)  # in [0, 2 pi)


class UndeclaredCircle(TwoStations):
    space = Space.of("left [rad]", "right [rad]")

    def residual(self, z, zhat):
        return z - zhat


class MutatedInput(TwoStations):
    def h(self, x, pose=None):
        out = super().h(x, pose)
        if isinstance(x, np.ndarray) and x.flags.writeable:
            x[0] -= STATIONS[0, 0]
        return out


class BroadcastError(TwoStations):
    def R(self, x, pose=None):
        flat = np.reshape(x, (4, -1))
        return np.stack([super(BroadcastError, self).R(lane) for lane in flat.T], -1).reshape(
            2, 2, *np.shape(x)[1:]
        )


class GlobalRandomState(TwoStations):
    def h(self, x, pose=None):
        return super().h(x, pose) + 1e-14 * np.random.normal()  # noqa: NPY002 - the mistake


class FreshEntropy(TwoStations):
    def h(self, x, pose=None):
        return super().h(x, pose) + 1e-9 * np.random.default_rng().normal()


class NegativeVariance(TwoStations):
    def R(self, x, pose=None):
        return super().R(x, pose) - 2 * self.sigma**2 * np.eye(2)[0].reshape(
            2, 1, *(1,) * (np.ndim(x) - 1)
        ) * np.eye(2)[0].reshape(1, 2, *(1,) * (np.ndim(x) - 1))


class IgnoresPose(TwoStations):
    def offsets(self, x, pose):
        return super().offsets(x, np.zeros(2))


class Unchecked(TwoStations):
    def offsets(self, x, pose):
        return super().offsets(np.resize(x, (4, *np.shape(x)[1:])), pose)


class AcceptsNaN(TwoStations):
    def __attrs_post_init__(self):
        pass


class LeavesItsConstantsBehind(TwoStations):
    def __reduce__(self):
        return type(self), (2 * self.sigma,)


@attrs.frozen
class Constant:
    """Constant velocity by hand."""

    space = PLANAR
    linear = True

    def f(self, x: Any, dt: Any, u: Any = None, t: Any = None) -> Any:
        x = over(x)
        return np.concatenate([x[:2] + dt * x[2:], x[2:]])

    def lanes(self, x: Any, dt: Any) -> Any:
        return np.broadcast_to(np.asarray(dt, dtype=float), np.shape(x)[1:])

    def jacobian(self, x: Any, dt: Any, u: Any = None, t: Any = None) -> Any:
        step = self.lanes(x, dt)
        out = np.zeros((4, 4, *step.shape))
        for i in range(4):
            out[i, i] = 1.0
        out[0, 2] = out[1, 3] = step
        return out

    def entries(self, dt: Any) -> tuple[Any, Any, Any]:
        return dt**3 / 3, dt**2 / 2, dt

    def Q(self, x: Any, dt: Any) -> Any:
        step = self.lanes(x, dt)
        out = np.zeros((4, 4, *step.shape))
        a, b, c = self.entries(step)
        for i in (0, 1):
            out[i, i], out[i, i + 2], out[i + 2, i], out[i + 2, i + 2] = a, b, b, c
        return out


class NoiseDoesNotCompose(Constant):
    def entries(self, dt):
        return dt**4 / 4, dt**3 / 2, dt**2


class NoiseWithoutTime(Constant):
    def entries(self, dt):
        return 0 * dt + 1 / 3, 0 * dt + 0.5, 0 * dt + 1.0


class IndefiniteNoise(Constant):
    def entries(self, dt):
        return dt**3 / 3, dt**2, dt


class EulerStep(Constant):
    def f(self, x, dt, u=None, t=None):
        x = super().f(x, dt)
        x[2:] = x[2:] * (1 - 0.01 * dt)
        return x


class OneStepForAll(Constant):
    def lanes(self, x, dt):
        return super().lanes(x, np.ravel(dt)[0] if np.size(dt) else 0.0)


class RaisesTheCovariance(ExtendedKalmanFilter):
    def update(self, state, sensor, z, pose=None, projection=None):
        after, told = super().update(state, sensor, z, pose, projection)
        return Gaussian.trusted(after.mean, 2 * state.cov - after.cov), told  # eq. 23 as printed


class MissingIsZero(ExtendedKalmanFilter):
    def update(self, state, sensor, z, pose=None, projection=None):
        return super().update(state, sensor, np.where(np.isnan(z), 0.0, z), pose, projection)


class CountsTwice(ExtendedKalmanFilter):
    def update(self, state, sensor, z, pose=None, projection=None):
        once, _ = super().update(state, sensor, z, pose, projection)
        return super().update(once, sensor, z, pose)


class Unsymmetric(ExtendedKalmanFilter):
    why_opaque = "written for lanes"

    def update(self, state, sensor, z, pose=None, projection=None):
        after, told = super().update(state, sensor, z, pose, projection)
        cov = np.array(after.cov)
        cov[0, 1] *= 1 + 1e-13
        return Gaussian.trusted(after.mean, cov), told


class PlainSubtraction(ExtendedKalmanFilter):
    def update(self, state, sensor, z, pose=None, projection=None):
        seen = self.project(state, sensor, pose)
        v = z - seen.z
        return super().update(state, Straight(sensor, v), seen.z + v, pose, seen)


@attrs.frozen
class Straight:
    sensor: Any
    v: Any

    def residual(self, z, zhat):
        return self.v


class Overconfident(ExtendedKalmanFilter):
    def update(self, state, sensor, z, pose=None, projection=None):
        after, told = super().update(state, sensor, z, pose, projection)
        return Gaussian.trusted(after.mean, 0.5 * after.cov), told


class SpreadsNaN(ExtendedKalmanFilter):
    why_opaque = "written for lanes"

    def update(self, state, sensor, z, pose=None, projection=None):
        after, told = super().update(state, sensor, z, pose, projection)
        return Gaussian.trusted(after.mean + 0.0 * np.sum(after.mean), after.cov), told


class AnotherOnNodes(ExtendedKalmanFilter):
    def update(self, state, sensor, z, pose=None, projection=None):
        after, told = super().update(state, sensor, z, pose, projection)
        shift = 1e-6 if after.mean.dtype.hasobject else 0.0
        return Gaussian.trusted(after.mean + shift, after.cov), told


class WorksRecordsOtherwise(BootstrapFilter):
    def whole(self, state, motion, sensors, record, start, history):
        done = super().whole(state, motion, sensors, record, start, history)
        history.filtered.mean[-1] += 0.01
        return done


class ForgetsTheFuture(RauchTungStriebel):
    def step(self, filtered, predicted, smoothed, motion, dt, u=None, t=None):
        return filtered


class SmoothsTheEnd(RauchTungStriebel):
    def smooth(self, history, motion):
        out = super().smooth(history, motion)
        out.smoothed.cov[-1] *= 0.9
        return out


class Reflected(RauchTungStriebel):
    def step(self, filtered, predicted, smoothed, motion, dt, u=None, t=None):
        right = super().step(filtered, predicted, smoothed, motion, dt, u, t)
        return Gaussian.trusted(right.mean, filtered.cov + (filtered.cov - right.cov))


class ForgetsTheirFuture(BackwardSimulation):
    def smooth(self, history, motion):
        return attrs.evolve(history, smoothed=history.filtered)


class OfMoreNoise(BackwardSimulation):
    def smooth(self, history, motion):
        return super().smooth(history, with_scaled_process_noise(motion, np.array(4.0)))


class WeighsInPlace(BackwardSimulation):
    def smooth(self, history, motion):
        out = super().smooth(history, motion)
        history.beliefs.filtered[0].log_weights[:] += 1.0
        return out


class OpenToNaN(ChiSquareGate):
    def admits(self, distance, m):
        return ~(np.asarray(distance) > self.threshold(m))


class BackwardsGate(ChiSquareGate):
    def threshold(self, m):
        return 10.0 / m


class GivesTwice(GlobalNearestNeighbour):
    def associate(self, distance, admitted):
        d2 = np.where(admitted, distance, np.inf)
        weights = np.zeros((d2.shape[0], d2.shape[1] + 1, *d2.shape[2:]))
        best = np.concatenate([d2, np.full_like(d2[:, :1], 1e9) if d2.shape[1] else np.ones(
            (d2.shape[0], 1, *d2.shape[2:]))], axis=1).argmin(axis=1)[:, None]  # fmt: skip
        np.put_along_axis(weights, best, 1.0, axis=1)
        return Association(weights)


class LooksOutsideTheGate(GlobalNearestNeighbour):
    def associate(self, distance, admitted):
        return super().associate(distance, ~np.isnan(distance))


class FirstComeFirstServed(GlobalNearestNeighbour):
    def associate(self, distance, admitted):
        out = np.zeros((distance.shape[0], distance.shape[1] + 1, *distance.shape[2:]))
        for lane in np.ndindex(*distance.shape[2:]):
            free = list(range(distance.shape[1]))
            for track in range(distance.shape[0]):
                mine = [d for d in free if admitted[(track, d, *lane)]]
                chosen = mine[0] if mine else distance.shape[1]
                out[(track, chosen, *lane)] = 1.0
                free = [d for d in free if d != chosen]
        return Association(out)


class HalfAWeight(GlobalNearestNeighbour):
    def associate(self, distance, admitted):
        return Association(0.5 * super().associate(distance, admitted).weights)


class FlyingOut(ParticleSwarm):
    def ask(self, memory):
        return super().ask(memory) * 1.5


class RelativeCost(Imperialist):
    def tell(self, memory, cost):
        return super().tell(memory, np.asarray(cost) ** 2)


class SharedNumbers(ParticleSwarm):
    def begin(self, bounds, *, rng, restarts=(), start=None):
        first = rng[0] if not isinstance(rng, np.random.Generator) and len(rng) else rng
        return super().begin(bounds, rng=first, restarts=restarts, start=start)


class LikesNaN(Genetic):
    def tell(self, memory, cost):
        return super().tell(memory, np.where(np.isnan(cost), -1e9, cost))


class KnowsItsUnits(ParticleSwarm):
    def ask(self, memory):
        x = super().ask(memory)
        return np.clip(np.round(x, 1), memory.box.low, memory.box.high)


class IgnoresTheStart(Genetic):
    def begin(self, bounds, *, rng, restarts=(), start=None):
        return super().begin(bounds, rng=rng, restarts=restarts)


class Climbs(ParticleSwarm):
    def tell(self, memory, cost):
        return super().tell(memory, -np.nan_to_num(cost, nan=1e9, posinf=1e9))


@attrs.frozen(eq=False)
class Variances:
    """Memory of `Forgetting`: a variance for each measured component, and what was seen of it."""

    values: Any


@attrs.frozen(eq=False)
class Forgetting:
    """Measurement noise by hand: a moving average of ``v^2 - H P H'``, floored."""

    keep: float = 0.97

    tunes = ("R",)

    def __attrs_post_init__(self) -> None:
        if not np.isfinite(self.keep):
            raise DomainError("keep must be finite")

    def begin(self, motion: Any, sensor: Any, prior: Any, pose: Any) -> Any:
        R = np.asarray(sensor.R(prior.mean, pose))
        own = np.stack([R[i, i] for i in range(len(R))])
        return Variances(own + np.zeros((len(R), *prior.mean.shape[1:])))

    def tuned(self, memory: Any, motion: Any, sensor: Any) -> Any:
        m, batch = len(memory.values), memory.values.shape[1:]
        R = np.zeros((m, m, *batch), dtype=memory.values.dtype)
        for i in range(m):
            R[i, i] = memory.values[i]
        return motion, with_noise(sensor, R)

    def found(self, v: Any, known: Any) -> Any:
        return v * v - known

    def floor(self, value: Any) -> Any:
        return maximum(value, 1e-4)

    def adapt(self, memory: Any, step: Any, motion: Any, sensor: Any) -> Any:
        v, S = step.innovation.residual, step.innovation.S
        R = sensor.R(step.predicted.mean, step.pose)
        new = []
        for i in range(len(v)):
            old = memory.values[i]
            value = self.floor(
                self.keep * old + (1.0 - self.keep) * self.found(v[i], S[i, i] - R[i, i])
            )
            new.append(self.learnt(v[i], value, old))
        out = np.empty_like(memory.values)
        out[:] = new
        return Variances(out)

    def learnt(self, v: Any, new: Any, old: Any) -> Any:
        return where(isnan(v), old, new)


class WrongSign(Forgetting):
    def found(self, v, known):
        return 18.0 - (v * v - known)


class ForgetsThePrediction(Forgetting):
    def found(self, v, known):
        return v * v + known  # the sign of H P H' as easily mistaken


class WithoutFloor(Forgetting):
    def floor(self, value):
        return value


class LearnsFromNothing(Forgetting):
    def learnt(self, v, new, old):
        return where(isnan(v), 0.9 * old, new)


class OverwritesItsMemory(Forgetting):
    def adapt(self, memory, step, motion, sensor):
        out = super().adapt(memory, step, motion, sensor)
        if memory.values.dtype != object:
            memory.values[:] = out.values
        return out


class TouchesTheOther(Forgetting):
    def tuned(self, memory, motion, sensor):
        _, tuned = super().tuned(memory, motion, sensor)
        return with_scaled_process_noise(motion, 1.3 + 0.0 * memory.values[[0] * 4]), tuned


class BeginsAnew(Forgetting):
    def begin(self, motion, sensor, prior, pose):
        return Variances(9.0 + 0.0 * super().begin(motion, sensor, prior, pose).values)


class LearnsFromNeighbours(Forgetting):
    def adapt(self, memory, step, motion, sensor):
        values = super().adapt(memory, step, motion, sensor).values
        if values.dtype != object and values.ndim > 1 and values.shape[-1] > 1:
            values = 0.5 * values + 0.5 * np.nanmean(values, axis=-1, keepdims=True)
        return Variances(values)


class AdaptsOtherwiseOnNodes(Forgetting):
    def found(self, v, known):
        return v * v - known + (0.0 if isinstance(v, (float, np.ndarray)) else 0.01)


@attrs.frozen
class Eastward:
    """A path by hand."""

    speed: float = 2.0

    def __attrs_post_init__(self) -> None:
        if not np.isfinite(self.speed):
            raise DomainError("speed must be finite")

    def pose(self, t):
        t = np.asarray(t, dtype=float)
        return np.stack([self.speed * t, np.zeros_like(t)])


class OnlyForward(Eastward):
    def pose(self, t):
        return np.where(np.asarray(t) < 0.0, np.nan, super().pose(t))


class Jumps(Eastward):
    def pose(self, t):  # where a leg ends it begins anew elsewhere
        return super().pose(t) + np.where(np.asarray(t) > 321.0, 4.0, 0.0)


class AllTimesAsOne(Eastward):
    def pose(self, t):
        return super().pose(t) - np.mean(
            super().pose(t), axis=tuple(range(1, np.ndim(t) + 1)), keepdims=True
        )


class Largest:
    """A metric by hand: the largest error of each state."""

    def score(self, history, truth):
        return np.abs(truth - history.estimate.mean).max(axis=0)


class MoreIsBetter(Largest):
    def score(self, history, truth):
        return 1.0 / (1.0 + super().score(history, truth))


class SkipsTheLost(Largest):
    def score(self, history, truth):
        return np.nan_to_num(np.abs(truth - history.estimate.mean)).mean(axis=0)


class MeanOverRuns(Largest):
    def score(self, history, truth):
        each = super().score(history, truth)
        return each if each.ndim == 1 else each - each.mean(axis=1, keepdims=True) + 1.0


CLEAN = [
    Eastward(),
    Largest(),
    Forgetting(),
    TwoStations(),
    Constant(),
    ExtendedKalmanFilter(),
    RauchTungStriebel(),
    ChiSquareGate(),
    GlobalNearestNeighbour(),
    ParticleSwarm(),
]

PLANTED = [
    (SwappedColumns(), "jacobian"),
    (WrongHessian(), "hessian"),
    (RaisesTheCovariance(), "an update never raises the covariance"),
    (MissingWrap(), "wraps at the cut"),
    (NoiseDoesNotCompose(), "Q composes"),
    (MutatedInput(), "read-only input"),
    (BroadcastError(), "lane by lane"),
    (GlobalRandomState(), "no global random state"),
    (FreshEntropy(), "same call, same answer"),
    (WrapsToMinusPi(), "wraps at the cut"),
    (UndeclaredCircle(), "continuous through the residual"),
    (NegativeVariance(), "R is a covariance"),
    (IgnoresPose(), "pose is used"),
    (IgnoresPose(), "follows a translation"),
    (Unchecked(), "shape error"),
    (AcceptsNaN(), "refuses NaN parameters"),
    (LeavesItsConstantsBehind(), "pickles"),
    (NoiseWithoutTime(), "zero step"),
    (IndefiniteNoise(), "Q is a covariance"),
    (EulerStep(), "f composes"),
    (OneStepForAll(), "time step per lane"),
    (MissingIsZero(), "a missing component equals a sensor without it"),
    (MissingIsZero(), "a missing measurement changes nothing"),
    (CountsTwice(), "equals the textbook filter"),
    (Unsymmetric(), "covariance is a covariance"),
    (PlainSubtraction(), "subtracts through the residual"),
    (Overconfident(), "NEES in its band"),
    (Overconfident(), "NIS in its band"),
    (SpreadsNaN(), "a diverged lane harms no neighbour"),
    (AnotherOnNodes(), "compiled agrees with arrays"),
    (AnotherOnNodes(), "interpretations agree"),
    (WorksRecordsOtherwise(), "compiled agrees with arrays"),
    (ForgetsTheFuture(), "equals batch least squares"),
    (SmoothsTheEnd(), "last step equals the filter"),
    (Reflected(), "never above the filter"),
    (ForgetsTheirFuture(), "never above the filter on average"),
    (OfMoreNoise(), "equals batch least squares on average"),
    (WeighsInPlace(), "keeps the history"),
    (OpenToNaN(), "NaN never passes"),
    (BackwardsGate(), "threshold depends only on m"),
    (GivesTwice(), "a detection is given away at most once"),
    (LooksOutsideTheGate(), "outside the gate is zero"),
    (FirstComeFirstServed(), "follows permutations"),
    (HalfAWeight(), "rows sum to one"),
    (WrongSign(), "moves towards the truth"),
    (ForgetsThePrediction(), "matched noise is a fixed point"),
    (WithoutFloor(), "noise stays a covariance"),
    (LearnsFromNothing(), "what was not measured teaches nothing"),
    (OverwritesItsMemory(), "models are not changed"),
    (TouchesTheOther(), "tunes what it says"),
    (BeginsAnew(), "begins with the given noise"),
    (LearnsFromNeighbours(), "a diverged lane harms no neighbour"),
    (AdaptsOtherwiseOnNodes(), "compiled agrees with arrays"),
    (FlyingOut(), "stays in bounds"),
    (RelativeCost(), "a constant added changes nothing"),
    (SharedNumbers(), "independent of its company"),
    (LikesNaN(), "NaN is the worst cost"),
    (KnowsItsUnits(), "follows its bounds"),
    (IgnoresTheStart(), "starts where it is told"),
    (Climbs(), "finds the bottom of a bowl"),
    (OnlyForward(), "a pose at every time"),
    (Jumps(), "goes, does not jump"),
    (AllTimesAsOne(), "lane by lane"),
    (MoreIsBetter(), "nothing beats the truth"),
    (SkipsTheLost(), "a lost run is told"),
    (MeanOverRuns(), "lane by lane"),
]


@pytest.mark.parametrize(
    ("component", "law"), PLANTED, ids=[f"{type(c).__name__}: {law}" for c, law in PLANTED]
)
def test_the_kit_names_the_law_that_a_mistake_breaks(component: Any, law: str) -> None:
    report = check_component(component)
    assert law in report.failed, f"the kit does not see the mistake; it says\n{report}"
    few = len(report.failed) < len(report.ran) / 2
    assert few, f"a single mistake is blamed on too many laws\n{report}"


@pytest.mark.parametrize("component", CLEAN, ids=lambda c: type(c).__name__)
def test_a_clean_component_is_green(component: Any) -> None:
    report = check_component(component)
    assert report.ok, f"the kit finds a mistake where none was planted\n{report}"
    assert len(report.ran) >= kit.FLOOR[report.kind]


@parametrize_checks([SwappedColumns()], expected_failures={"jacobian": "eq. 32 as printed"})
def test_the_three_lines_of_a_plugin_author(component, check):
    check(component)


def test_an_expected_failure_is_reported_with_its_reason() -> None:
    report = check_component(SwappedColumns(), expected_failures={"jacobian": "eq. 32 as printed"})
    assert report.ok
    assert report.expected_failures == ("jacobian",)
    assert "jacobian: expected failure: eq. 32 as printed" in str(report)


def test_an_expected_failure_that_passes_is_red() -> None:
    report = check_component(TwoStations(), expected_failures={"jacobian": "no longer true"})
    assert report.failed == ("jacobian",)
    assert "take the excuse out" in str(report)


def test_an_expected_failure_that_does_not_apply_is_red() -> None:
    why = {"prior reproduces its measurement": "one bearing has no range"}
    report = check_component(TwoStations(), expected_failures=why)
    assert report.failed == tuple(why)
    assert "does not even apply" in str(report)


@pytest.mark.parametrize("excuses", [{"jacobain": "a typing error"}, {"jacobian": " "}])
def test_an_excuse_needs_a_law_and_a_reason(excuses: dict[str, str]) -> None:
    with pytest.raises(DomainError, match="expected_failures"):
        check_component(TwoStations(), expected_failures=excuses)
    with pytest.raises(DomainError, match="expected_failures"):
        parametrize_checks([TwoStations()], expected_failures=excuses)


def test_a_kit_that_skips_is_red(monkeypatch: pytest.MonkeyPatch) -> None:
    few = tuple(attrs.evolve(law, unless=lambda _: "not today") for law in kit.laws("sensor"))
    monkeypatch.setattr(kit, "laws", lambda _: few)
    report = check_component(TwoStations())
    assert report.failed == (kit.ENOUGH,)
    assert not report.ran
    assert "laws that are skipped prove nothing" in str(report)
    marks = parametrize_checks([TwoStations()])
    ((_, check),) = (row.values for row in marks.args[1])
    with pytest.raises(AssertionError, match="only 0 laws"):
        check(TwoStations())


def first_check(component: Any, law: str, **regions: Any) -> kit.Check:
    rows = [row.values for row in parametrize_checks([component], **regions).args[1]]
    return next(check for _, check in rows if check.law == law)


def test_a_law_of_which_no_example_ran_is_broken() -> None:
    nowhere = st.floats(0, 1).filter(lambda _: False)
    with pytest.raises(AssertionError, match="Unsatisfi"):
        first_check(TwoStations(), "shape error", states=nowhere)(TwoStations())


def test_a_component_is_tried_where_it_is_at_home() -> None:
    seen: list[float] = []

    class Watched(TwoStations):
        def h(self, x, pose=None):
            seen.extend(np.ravel(over(x)[0]))
            return super().h(x, pose)

    home = st.floats(2.0, 3.0).map(lambda v: np.array([v, v, 0.1, 0.2]))
    where = st.just(np.array([7.0, 8.0]))
    first_check(Watched(), "shared pose", states=home, poses=where)(Watched())
    assert seen
    assert all(2.0 <= x <= 3.0 for x in seen)


def test_what_is_no_component_is_refused_in_words() -> None:
    with pytest.raises(DomainError, match=re.escape("no kind that has laws")):
        check_component(object())


def test_every_law_is_stated_in_a_sentence_and_counts_for_the_floor() -> None:
    for kind in kit.KINDS:
        names = [law.name for law in kit.laws(kind)]
        assert len(set(names)) == len(names)
        for law in kit.laws(kind):
            assert law.statement.endswith((".", ")")), f"{kind}: {law.name} is not stated"
        always = [law for law in kit.laws(kind) if law.always]
        assert len(always) == kit.FLOOR[kind], f"raise the floor of {kind} to {len(always)}"
