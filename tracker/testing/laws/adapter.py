"""Laws of noise adapters, beside a Kalman filter of the kit's own on its small linear problem."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import attrs
import numpy as np

from tracker.algebra.gaussian import conditioned, predicted, projected
from tracker.compile import run as compiled
from tracker.estimation import Estimator
from tracker.estimation import filter as run
from tracker.recursion import advance, begin
from tracker.testing.calls import Call, Given, calls_of
from tracker.testing.law import Case, agree, law, not_negative, symmetric
from tracker.testing.textbook import ABSCISSA, MOTION, POSITION, F, Q, R
from tracker.types import Array, Gaussian, Record

STEPS = 40
"""More than windows are long, as a rule."""

_FIVE_SIGMA = 4.9  # two-sided, of a normal variable: 1e-6


@attrs.frozen
class Plain:
    """The Kalman filter over the algebra: what adapters are run beside."""

    needs = ("jacobian",)

    def predict(
        self, state: Gaussian, motion: Any, dt: Any, u: Any = None, t: Any = None
    ) -> Gaussian:
        """``F x`` and ``F P F' + Q``."""
        return predicted(state, motion, dt, u, t)

    def project(self, state: Gaussian, sensor: Any, pose: Any = None) -> Any:
        """``H x`` and ``H P H' + R``."""
        return projected(state, sensor, pose)

    def update(
        self, state: Gaussian, sensor: Any, z: Any, pose: Any = None, projection: Any = None
    ) -> Any:
        """Condition on z."""
        seen = projected(state, sensor, pose) if projection is None else projection
        return conditioned(state, sensor, z, seen)


PLAIN = Plain()


def _run(adapter: Any, prior: Gaussian, gaps: Array, z: Array, sensor: Any = POSITION) -> Any:
    """What is carried after some steps, with the innovation of the last."""
    carried = begin(PLAIN, adapter, MOTION, (sensor,), prior)
    innovation = None
    for dt, row in zip(gaps, z, strict=True):
        carried, _, _, innovation = advance(
            PLAIN, adapter, carried, MOTION, sensor, 0, row, float(dt)
        )
    return carried, innovation


def _tuned(
    adapter: Any, carried: Any, dt: float = 1.0, sensor: Any = POSITION
) -> tuple[Array, Array]:
    """R and Q of the next step, over all lanes."""
    motion, seen = adapter.tuned(carried.memories[0], MOTION, sensor)
    x = carried.belief.mean
    batch = x.shape[1:]
    R_, Q_ = np.asarray(seen.R(x)), np.asarray(motion.Q(x, dt))
    m = sensor.space.size
    return np.broadcast_to(R_, (m, m, *batch)), np.broadcast_to(Q_, (4, 4, *batch))


def _prior(batch: tuple[int, ...] = ()) -> Gaussian:
    lanes = (1,) * len(batch)
    mean = np.broadcast_to(np.zeros((4, *lanes)), (4, *batch)).copy()
    cov = np.diag([9.0, 25.0, 1.0, 1.0]).reshape(4, 4, *lanes)
    return Gaussian.trusted(mean, np.broadcast_to(cov, (4, 4, *batch)).copy())


def _simulated(
    rng: np.random.Generator, steps: int, batch: tuple[int, ...], r: float = 1.0, q: float = 1.0
) -> tuple[Array, Array]:
    """Time steps and measurements of targets whose noise variances are r and q times the kit's."""
    gaps = rng.choice([0.5, 1.0, 1.5], steps)
    x = np.linalg.cholesky(_prior().cov) @ rng.standard_normal((4, int(np.prod(batch, dtype=int))))
    roots = {dt: np.linalg.cholesky(q * Q(dt)) for dt in (0.5, 1.0, 1.5)}
    sigma = np.sqrt(r * np.diagonal(R))[:, None]
    z = []
    for dt in gaps.tolist():
        x = F(dt) @ x + roots[dt] @ rng.standard_normal(x.shape)
        z.append(x[:2] + sigma * rng.standard_normal((2, x.shape[1])))
    return gaps, np.stack(z).reshape(steps, 2, *batch)


def _rough(case: Case, batch: tuple[int, ...] = (), far: float = 1e6) -> tuple[Array, Array]:
    """Time steps, some of no time, and measurements with gaps, gross outliers and changing noise."""
    rng = case.rng
    gaps, z = _simulated(rng, STEPS, batch, r=float(rng.choice([1e-4, 1.0, 1e4])))
    gaps = gaps * rng.choice([0.0, 1.0, 1.0, 1.0], STEPS)
    z = np.where(rng.uniform(size=z.shape) < 0.05, far * rng.standard_normal(z.shape), z)
    return gaps, np.where(rng.uniform(size=z.shape) < 0.2, np.nan, z)


def _call(adapter: Any, mean: Any, cov: Any, gaps: Any, z: Any) -> tuple[Any, ...]:
    carried, told = _run(adapter, Gaussian.trusted(mean, cov), gaps, z)
    return (*_tuned(adapter, carried), carried.belief.mean, told.ok)


@calls_of("adapter")
def adapter_calls(_adapter: Any, case: Case, batch: tuple[int, ...]) -> list[Call]:
    """How an adapter is called: beside a filter, for some steps."""
    prior = _prior(batch)
    # A covariance learnt from outliers of a million metres is nearly singular, and makes of the last
    # bit, in which products of one and of many columns may differ, more than lanes are compared to.
    gaps, z = _rough(case, batch, far=100.0)
    given = (
        Given("mean", prior.mean, 1),
        Given("cov", prior.cov, 2),
        Given("gaps", gaps, None),
        Given("z", z, 2),
    )
    return [Call("begin, adapt and tuned", _call, given, (2, 2, 1, 0), batch)]


@law("adapter", name="noise stays a covariance")
def noise_stays_a_covariance(adapter: Any, case: Case) -> None:
    """R and Q stay symmetric, positive semi-definite and finite, whatever was measured: gaps, outliers
    of a million metres, time steps of zero, or a sensor that is far better than it says.
    """
    quiet = _simulated(case.rng, 3 * STEPS, (7,), r=1e-4)
    for batch, (gaps, z) in (((), _rough(case)), ((3,), _rough(case, (3,))), ((7,), quiet)):
        carried = begin(PLAIN, adapter, MOTION, (POSITION,), _prior(batch))
        for dt, row in zip(gaps, z, strict=True):
            carried, *_ = advance(PLAIN, adapter, carried, MOTION, POSITION, 0, row, float(dt))
            for name, noise in zip("RQ", _tuned(adapter, carried), strict=True):
                assert np.isfinite(noise).all(), f"{name} is not finite"
                symmetric(noise, f"{name} is not symmetric", 1e-12)
                for lane in np.ndindex(*batch):
                    told = f"{name} is not positive semi-definite"
                    not_negative(noise[(..., *lane)], told)
        assert np.isfinite(carried.belief.cov).all(), "the filter's covariance is no longer finite"


@law("adapter", name="begins with the given noise", examples=1)
def begins_with_the_given_noise(adapter: Any, _case: Case) -> None:
    """Before anything was measured, the models for the next step have the noise that they came with."""
    for batch in ((), (3,)):
        carried = begin(PLAIN, adapter, MOTION, (POSITION,), _prior(batch))
        for dt in (0.0, 0.5, 2.0):
            found = _tuned(adapter, carried, dt)
            for name, noise, own in zip("RQ", found, (R, Q(dt)), strict=True):
                want = np.broadcast_to(own.reshape(*own.shape, *(1,) * len(batch)), noise.shape)
                told = f"before the first step {name} is not the model's own, for dt = {dt}"
                agree(noise, want, 1e-12, told)


@law("adapter", name="tunes what it says")
def tunes_what_it_says(adapter: Any, case: Case) -> None:
    """It re-tunes what ``tunes`` names, on data that contradict the models, and leaves the other alone."""
    gaps, z = _simulated(case.rng, 3 * STEPS, (3,), r=25.0, q=25.0)
    carried, _ = _run(adapter, _prior((3,)), gaps, z)
    for name, noise, own in zip("RQ", _tuned(adapter, carried), (R, Q(1.0)), strict=True):
        same = np.allclose(noise, own[..., None], rtol=1e-9)
        if name in adapter.tunes:
            assert not same, f"it says that it tunes {name}, and never changed it"
        else:
            assert same, f"it changes {name}, but says that it tunes {' and '.join(adapter.tunes)}"


def _mean_ratios(adapter: Any, rng: np.random.Generator, steps: int, r: float, q: float) -> Any:
    """Each noise over the model's, averaged over its diagonal and over 400 lanes, with standard errors.

    The geometric mean is taken: noises are ratios, and a few large ones are not most of the truth.
    """
    lanes = 400
    gaps, z = _simulated(rng, steps, (lanes,), r, q)
    carried, _ = _run(adapter, _prior((lanes,)), gaps, z)
    out = {}
    for name, noise, own in zip("RQ", _tuned(adapter, carried), (R, Q(1.0)), strict=True):
        ratio = np.log(np.einsum("iib->ib", noise) / np.diagonal(own)[:, None]).mean(axis=0)
        out[name] = float(ratio.mean()), float(ratio.std() / np.sqrt(lanes))
    return out


MATCHED = 0.25
"""How far the logarithm of a noise may be from the truth where all is matched: 28 per cent."""


@law("adapter", name="matched noise is a fixed point", examples=1)
def matched_noise_is_a_fixed_point(adapter: Any, case: Case) -> None:
    """Told the true noise, it keeps it in expectation: over 400 lanes and 160 steps, the mean logarithm
    of each tuned noise over the true one is within 0.25 of zero (false alarm below 1e-6).
    """
    found = _mean_ratios(adapter, case.rng, 4 * STEPS, 1.0, 1.0)
    for name in adapter.tunes:
        mean, error = found[name]
        assert abs(mean) < MATCHED + _FIVE_SIGMA * error, (
            f"with matched noise {name} drifts to {np.exp(mean):.3g} times the truth "
            f"(standard error {error:.1g} of the logarithm)"
        )


@law("adapter", name="moves towards the truth", examples=1)
def moves_towards_the_truth(adapter: Any, case: Case) -> None:
    """Where one noise is nine times what the model says, or a ninth, it ends nearer to the truth than it
    began, in the mean over 400 lanes (false alarm below 1e-6).
    """
    for name in adapter.tunes:
        for true in (9.0, 1.0 / 9.0):
            r, q = (true, 1.0) if name == "R" else (1.0, true)
            mean, error = _mean_ratios(adapter, case.rng, 6 * STEPS, r, q)[name]
            gone = mean * np.sign(np.log(true))
            told = (
                f"{name} should become {true:.2g} times the model's, and becomes {np.exp(mean):.3g}"
            )
            assert gone > _FIVE_SIGMA * error, (
                f"{told}: it moves away from the truth, or not at all"
            )
            assert gone < 2.0 * abs(np.log(true)), f"{told}: it passes the truth by far"


@law("adapter", name="what was not measured teaches nothing")
def nothing_measured_teaches_nothing(adapter: Any, case: Case) -> None:
    """A step whose measurement is NaN throughout leaves R and Q as they were; one component that is
    NaN leaves its variance as it was.
    """
    for batch in ((), (3,)):
        gaps, z = _simulated(case.rng, STEPS, batch, r=9.0)
        carried, _ = _run(adapter, _prior(batch), gaps, z)
        before = _tuned(adapter, carried)
        nothing = np.full((2, *batch), np.nan)
        after, *_ = advance(PLAIN, adapter, carried, MOTION, POSITION, 0, nothing, 1.0)
        for name, a, b in zip("RQ", _tuned(adapter, after), before, strict=True):
            agree(a, b, 1e-12, f"a step in which nothing was measured changes {name}")
        for place in (0, 1):
            part = z[-1].copy()
            part[place] = np.nan
            after, *_ = advance(PLAIN, adapter, carried, MOTION, POSITION, 0, part, 1.0)
            told = f"component {place} was not measured, and yet its variance changes"
            agree(_tuned(adapter, after)[0][place, place], before[0][place, place], 1e-12, told)


@law("adapter", name="models are not changed", examples=2)
def models_are_not_changed(adapter: Any, case: Case) -> None:
    """The models that were given answer as before; so do memories that were adapted from."""
    x = _prior((3,)).mean
    own = np.array(POSITION.R(x)), np.array(MOTION.Q(x, 1.0))
    gaps, z = _simulated(case.rng, STEPS, (3,), r=9.0, q=9.0)
    carried, _ = _run(adapter, _prior((3,)), gaps, z)
    first = _tuned(adapter, carried)
    for _ in range(2):
        again, *_ = advance(PLAIN, adapter, carried, MOTION, POSITION, 0, z[-1] + 50.0, 1.0)
        second = _tuned(adapter, again)
        for name, a, b in zip("RQ", _tuned(adapter, carried), first, strict=True):
            assert np.array_equal(a, b), f"adapting changes the memory that it was given ({name})"
        first_again, *_ = advance(PLAIN, adapter, carried, MOTION, POSITION, 0, z[-1] + 50.0, 1.0)
        for a, b in zip(_tuned(adapter, first_again), second, strict=True):
            assert np.array_equal(a, b), "the same step learnt twice from the same memory differs"
    for before, now in zip(own, (POSITION.R(x), MOTION.Q(x, 1.0)), strict=True):
        assert np.array_equal(before, now), "a model that was given is changed"


@law("adapter", name="a diverged lane harms no neighbour", examples=2)
def diverged_lane(adapter: Any, case: Case) -> None:
    """A lane that has become NaN leaves the noise of the other lanes exactly as it is without it."""
    gaps, z = _simulated(case.rng, STEPS, (3,), r=9.0)
    well, _ = _run(adapter, _prior((3,)), gaps, z)
    ill = _prior((3,))
    ill.mean[:, 1], ill.cov[:, :, 1] = np.nan, np.nan
    gone, _ = _run(adapter, ill, gaps, z)
    for name, a, b in zip("RQ", _tuned(adapter, well), _tuned(adapter, gone), strict=True):
        same = np.array_equal(a[..., [0, 2]], b[..., [0, 2]])
        assert same, f"a lane of NaN changes the {name} of its neighbours"


@law("adapter", name="serves a sensor of one component", examples=1)
def serves_one_component(adapter: Any, case: Case) -> None:
    """A sensor of one component is served as well as one of two."""
    gaps, z = _simulated(case.rng, STEPS, (3,), r=9.0)
    carried, _ = _run(adapter, _prior((3,)), gaps, z[:, :1], ABSCISSA)
    assert all(np.isfinite(noise).all() for noise in _tuned(adapter, carried, sensor=ABSCISSA))


@contextmanager
def _compiling(mode: str) -> Iterator[None]:
    before = os.environ.get("TRACKER_COMPILE")
    os.environ["TRACKER_COMPILE"] = mode
    try:
        yield
    finally:
        del os.environ["TRACKER_COMPILE"]
        if before is not None:
            os.environ["TRACKER_COMPILE"] = before


def _estimator(adapter: Any) -> Estimator:
    return Estimator(filter=PLAIN, motion=MOTION, sensors=(POSITION,), adapter=adapter)


def _not_compiled(adapter: Any) -> str:
    with _compiling("on"):
        return compiled.reason(_estimator(adapter))


@law("adapter", name="compiled agrees with arrays", examples=2, unless=_not_compiled)
def compiled_agrees_with_arrays(adapter: Any, case: Case) -> None:
    """A record filtered by the compiled step gives the same, to 1e-9, as filtered on arrays."""
    gaps, z = _simulated(case.rng, STEPS, (5,), r=9.0)
    z[case.rng.uniform(size=z.shape) < 0.2] = np.nan
    found = []
    for mode in ("off", "on"):
        with _compiling(mode):
            record = Record(np.cumsum(gaps), z)
            found.append(run(_estimator(adapter), record, _prior((5,)), start=0.0))
    arrays, fused = found
    told = "compiled, a record gives another {} than on arrays"
    sigma = np.sqrt(np.einsum("tii...->ti...", arrays.predicted.cov))
    size = np.abs(arrays.predicted.mean) + sigma
    agree(fused.filtered.mean, arrays.filtered.mean, 1e-9, told.format("mean"), size)
    agree(fused.innovation.S, arrays.innovation.S, 1e-9, told.format("innovation covariance"))
