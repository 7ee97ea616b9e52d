"""Laws of filters, on small linear problems of the kit's own, beside a filter as textbooks print it."""

from __future__ import annotations

import inspect
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import attrs
import numpy as np

from tracker.compile import run as compiled
from tracker.estimation import Estimator
from tracker.estimation import filter as run
from tracker.models.graph import Graph, evaluate
from tracker.protocols import WorksRecords
from tracker.testing import textbook
from tracker.testing.calls import Call, Given, calls_of
from tracker.testing.law import Case, agree, law, not_negative, symmetric
from tracker.testing.strategies import covariances
from tracker.testing.textbook import ABSCISSA, BEARING, COMPASS, MOTION, ORDINATE, POSITION
from tracker.types import Array, Gaussian, Record

_REACH = np.array([100.0, 100.0, 10.0, 10.0])
FALSE_ALARM = 1e-6


def _belief(case: Case, batch: tuple[int, ...] = (), decades: float = 8.0) -> Gaussian:
    mean = _REACH.reshape(4, *(1,) * len(batch)) * case.rng.standard_normal((4, *batch))
    return Gaussian.trusted(mean, case.draw(covariances(4, batch, _REACH, decades)))


def _measurement(case: Case, batch: tuple[int, ...] = ()) -> Array:
    return 100.0 * case.rng.standard_normal((2, *batch))


def _sensors(rule: Any) -> list[Any]:
    """The sensors of the kit that a filter can use."""
    return [POSITION] if "linear" in rule.needs else [POSITION, BEARING]


def begun(rule: Any, prior: Gaussian) -> Any:
    """The belief that a filter makes of a Gaussian; a lane draws the same in any company."""
    if not hasattr(rule, "begin"):
        return prior
    known = {"motion": MOTION} if "motion" in inspect.signature(rule.begin).parameters else {}
    if not getattr(rule, "random", False):
        return rule.begin(prior, **known)
    streams = [
        np.random.default_rng(np.ascontiguousarray(lane).view(np.uint64).tolist())
        for lane in prior.mean.reshape(len(prior.mean), -1).T
    ]
    return rule.begin(prior, rng=streams if prior.batch else streams[0], **known)


def _draws(rule: Any) -> str:
    few = "it draws random numbers: true of infinitely many draws, not of these"
    return few if getattr(rule, "random", False) else ""


def _moments(belief: Any) -> tuple[Array, Array]:
    gaussian = belief.moments()
    return gaussian.mean, gaussian.cov


def _predict(rule: Any, mean: Any, cov: Any, dt: Any) -> tuple[Any, ...]:
    return _moments(rule.predict(begun(rule, Gaussian.trusted(mean, cov)), MOTION, dt))


def _project(rule: Any, mean: Any, cov: Any) -> tuple[Any, ...]:
    seen = rule.project(begun(rule, Gaussian.trusted(mean, cov)), POSITION)
    return seen.z, seen.S, seen.cross


def _update(rule: Any, mean: Any, cov: Any, z: Any, sensor: Any = POSITION) -> tuple[Any, ...]:
    after, told = rule.update(begun(rule, Gaussian.trusted(mean, cov)), sensor, z)
    return (*_moments(after), told.residual, told.S, told.nis, told.loglik, told.count, told.ok)


@calls_of("filter")
def filter_calls(_rule: Any, case: Case, batch: tuple[int, ...]) -> list[Call]:
    """How a filter is called, once with a component that was not measured."""
    state = _belief(case, batch)
    z = _measurement(case, batch)
    missing = np.where(case.rng.uniform(size=z.shape) < 0.5, np.nan, z)
    belief = (Given("mean", state.mean, 1), Given("cov", state.cov, 2))
    leads = (1, 2, 1, 2, 0, 0, 0, 0)
    return [
        Call("predict", _predict, (*belief, Given("dt", case.dt(), None)), (1, 2), batch),
        Call("project", _project, belief, (1, 2, 2), batch),
        Call("update", _update, (*belief, Given("z", z, 1)), leads, batch),
        Call("update", _update, (*belief, Given("z", missing, 1)), leads, batch),
    ]


@law("filter", name="equals the textbook filter", examples=12, unless=_draws)
def equals_the_textbook(rule: Any, case: Case) -> None:
    """On linear problems with Gaussian noise it is the Kalman filter, to 1e-9, for any batch shape."""
    for batch in ((), (7,), (3, 5)):
        state, dt, z = _belief(case, batch), case.dt(zero=True), _measurement(case, batch)
        belief = begun(rule, state)
        ahead = rule.predict(belief, MOTION, dt)
        after, told = rule.update(belief, POSITION, z)
        for lane in np.ndindex(*batch):
            x, P = state.mean[(..., *lane)], state.cov[(..., *lane)]
            scale = np.sqrt(np.diagonal(P)) + np.sqrt(np.diagonal(textbook.predict(x, P, dt)[1]))
            _moments_agree("predict", ahead, lane, textbook.predict(x, P, dt), scale, x)
            mean, cov, nis, loglik = textbook.update(x, P, z[(..., *lane)])
            _moments_agree("update", after, lane, (mean, cov), np.sqrt(np.diagonal(P)), x)
            for name, value in (("nis", nis), ("loglik", loglik), ("count", 2.0)):
                found = np.asarray(getattr(told, name))[lane]
                differs = f"update: {name} differs from the textbook"
                agree(found, value, 1e-9, differs, scale=1.0 + abs(nis))
            assert np.asarray(told.ok)[lane], "update: ok is False although every number is finite"


def _moments_agree(what: str, belief: Any, lane: Any, want: Any, sigma: Array, x: Array) -> None:
    mean, cov = _moments(belief)
    told = f"{what}: the {{}} differs from that of the Kalman filter"
    size = np.abs(want[0]) + np.abs(x) + sigma
    agree(mean[(..., *lane)], want[0], 1e-9, told.format("mean"), scale=size)
    agree(cov[(..., *lane)], want[1], 1e-9, told.format("covariance"), scale=np.outer(sigma, sigma))


@law("filter", name="covariance is a covariance", examples=16)
def covariance_is_a_covariance(rule: Any, case: Case) -> None:
    """Covariances stay exactly symmetric and positive semi-definite, conditioning 1e-8 to 1e8."""
    for batch in ((), (3,)):
        state = _belief(case, batch)
        largest, belief = np.abs(state.cov).max(), begun(rule, state)
        for what, after in (
            ("predict", rule.predict(belief, MOTION, case.dt(zero=True))),
            *((f"update with {s.name}", rule.update(belief, s, _measurement(case, batch)[: len(s.space)])[0])
              for s in _sensors(rule)),
        ):  # fmt: skip
            cov = _moments(after)[1]
            symmetric(cov, f"{what}: the covariance is not exactly symmetric")
            told = f"{what}: the covariance is not positive semi-definite"
            not_negative(cov, told, largest if what != "predict" else None)


@law("filter", name="an update never raises the covariance", unless=_draws)
def never_raises(rule: Any, case: Case) -> None:
    """A measurement takes uncertainty away: the covariance before minus that after is not negative."""
    for sensor in _sensors(rule):
        state = _belief(case, (3,))
        z = _measurement(case, (3,))[: len(sensor.space)]
        after, _ = rule.update(begun(rule, state), sensor, z)
        told = f"an update with {sensor.name} raises the covariance: P - K S K', not P + K S K'"
        not_negative(state.cov - _moments(after)[1], told, np.abs(state.cov).max())


@law("filter", name="a missing component equals a sensor without it")
def missing_component(rule: Any, case: Case) -> None:
    """A component that is NaN is treated exactly as if the sensor did not have it."""
    for batch in ((), (3,)):
        state, z = _belief(case, batch), _measurement(case, batch)
        for place, smaller in ((1, ABSCISSA), (0, ORDINATE)):
            holed = z.copy()
            holed[place] = np.nan
            found = _update(rule, state.mean, state.cov, holed)
            want = _update(rule, state.mean, state.cov, z[1 - place : 2 - place], smaller)
            names = ("mean", "covariance", "", "", "nis", "loglik", "count", "ok")
            for name, a, b in zip(names, found, want, strict=True):
                told = f"with component {place} missing, {name} differs from a sensor without it"
                if name:
                    agree(a, b, 1e-9, told)


@law("filter", name="a missing measurement changes nothing")
def missing_measurement(rule: Any, case: Case) -> None:
    """A measurement that is NaN throughout leaves the state as it was, and is no evidence."""
    for batch in ((), (3,)):
        state = _belief(case, batch)
        mean, cov, _, _, nis, loglik, count, ok = _update(
            rule, state.mean, state.cov, np.full((2, *batch), np.nan)
        )
        before, spread = _moments(begun(rule, state))
        agree(mean, before, 1e-14, "a missing measurement changes the mean")
        agree(cov, spread, 1e-14, "a missing measurement changes the covariance")
        for name, value in (("nis", nis), ("loglik", loglik), ("count", count)):
            agree(value, np.zeros(batch), 0.0, f"a missing measurement has a {name}")
        assert np.all(ok), "a missing measurement is not ok"


@law("filter", name="a diverged lane harms no neighbour")
def diverged_lane(rule: Any, case: Case) -> None:
    """A lane that has become NaN is flagged not ok, and the other lanes do not change at all."""
    state, z, dt = _belief(case, (3,)), _measurement(case, (3,)), case.dt()
    mean, cov = state.mean.copy(), state.cov.copy()
    mean[:, 1], cov[:, :, 1] = np.nan, np.nan
    well, ill = _update(rule, state.mean, state.cov, z), _update(rule, mean, cov, z)
    ahead, gone = _predict(rule, state.mean, state.cov, dt), _predict(rule, mean, cov, dt)
    for a, b in zip((*well, *ahead), (*ill, *gone), strict=True):
        same = np.array_equal(np.asarray(a)[..., [0, 2]], np.asarray(b)[..., [0, 2]])
        assert same, "a lane of NaN changes what its neighbours get"
    assert np.asarray(ill[-1]).tolist() == [True, False, True], (
        f"ok is {np.asarray(ill[-1]).tolist()} where only the middle lane is NaN"
    )


@law("filter", name="subtracts through the residual", unless=_draws)
def subtracts_through_the_residual(rule: Any, case: Case) -> None:
    """A heading measured across the cut moves the estimate a little, and a whole turn not at all."""
    gap = case.rng.uniform(1e-3, 0.1)
    state = Gaussian.trusted(np.array([np.pi - gap, 0.01]), np.diag([0.04, 0.01]))
    moved, _ = rule.update(begun(rule, state), COMPASS, np.array([-np.pi + gap]))
    step = 2.0 * gap * 0.04 / (0.04 + 0.01)
    told = "a measurement across the cut is not a near one: subtract by sensor.residual"
    change = _moments(moved)[0][0] - state.mean[0]
    agree(np.sin(change - step), 0.0, 1e-9, told, scale=1.0)
    agree(np.cos(change - step), 1.0, 1e-9, told, scale=1.0)


@law("filter", name="one measurement at a time", unless=_draws)
def one_at_a_time(rule: Any, case: Case) -> None:
    """Independent components give the same taken one after the other, in either order, as at once."""
    state, z = _belief(case, (3,), decades=4.0), _measurement(case, (3,))
    together = _moments(rule.update(begun(rule, state), POSITION, z)[0])
    for order in ((0, 1), (1, 0)):
        belief = begun(rule, state)
        for place in order:
            sensor = (ABSCISSA, ORDINATE)[place]
            belief = rule.update(belief, sensor, z[place : place + 1])[0]
        told = "independent components, one after the other, differ from all at once in the"
        for name, a, b in zip(("mean", "covariance"), _moments(belief), together, strict=True):
            agree(a, b, 1e-8, f"{told} {name}")


@law("filter", name="iterating a linear update changes nothing",
     unless=lambda f: "" if hasattr(f, "iterations") and attrs.has(type(f)) else "it has no iterations")  # fmt: skip
def iterating(rule: Any, case: Case) -> None:
    """On a linear sensor more iterations give the same answer: a measurement counts once."""
    state, z = begun(rule, _belief(case, (3,))), _measurement(case, (3,))
    want = _moments(rule.update(state, POSITION, z)[0])
    for iterations in (1, 2, 5):
        more = attrs.evolve(rule, iterations=iterations)
        for a, b in zip(_moments(more.update(state, POSITION, z)[0]), want, strict=True):
            agree(a, b, 1e-9, f"{iterations} iterations change a linear update: z counts twice")


@law("filter", name="a projection is reused")
def projection_is_reused(rule: Any, case: Case) -> None:
    """An update that is handed its projection gives the same as one that computes it."""
    for batch in ((), (3,)):
        for sensor in _sensors(rule):
            state = begun(rule, _belief(case, batch))
            z = _measurement(case, batch)[: len(sensor.space)]
            seen = rule.project(state, sensor)
            given, alone = rule.update(state, sensor, z, None, seen), rule.update(state, sensor, z)
            for a, b in zip(_moments(given[0]), _moments(alone[0]), strict=True):
                agree(a, b, 1e-12, f"update with {sensor.name} differs when handed its projection")


@law("filter", name="zero step")
def zero_step(rule: Any, case: Case) -> None:
    """A prediction over no time changes nothing."""
    state = begun(rule, _belief(case, (3,)))
    mean, cov = _moments(rule.predict(state, MOTION, 0.0))
    before, spread = _moments(state)
    agree(mean, before, 1e-9, "a prediction over zero seconds changes the mean")
    agree(cov, spread, 1e-9, "a prediction over zero seconds changes the covariance")


def _untraceable(rule: Any) -> str:
    why = getattr(rule, "why_opaque", "")
    if not why and "opaque" in getattr(rule, "tags", ()):
        why = "it is tagged opaque"
    return f"it cannot be traced: {why}" if why else ""


@law("filter", name="interpretations agree", unless=_untraceable)
def interpretations_agree(rule: Any, case: Case) -> None:
    """A step gives the same, to 1e-9, on lanes, on one run, and on graph nodes.

    A filter that cannot be traced says why in an attribute ``why_opaque``.
    """
    state, dt = _belief(case, decades=4.0), case.dt()
    lanes = Gaussian.trusted(state.mean[:, None], state.cov[..., None])
    told = "{}: {} differ from one run"
    one = _predict(rule, state.mean, state.cov, dt)
    for a, b in zip(_predict(rule, lanes.mean, lanes.cov, dt), one, strict=True):
        agree(a[..., 0], b, 1e-9, told.format("predict", "lanes"))
    traced = Traced()
    belief = traced.gaussian(state)
    ahead = _predict(rule, belief.mean, belief.cov, traced.vector("dt", [dt])[0])
    for a, b in zip(ahead, one, strict=True):
        agree(traced.worth(a), b, 1e-9, told.format("predict", "graph nodes"))
    for sensor in _sensors(rule):
        z = np.array(_measurement(case)[: len(sensor.space)])
        if len(z) > 1:
            z[0] = case.rng.choice([z[0], np.nan])
        single = _update(rule, state.mean, state.cov, z, sensor)
        several = _update(rule, lanes.mean, lanes.cov, z[:, None], sensor)
        nodes = _update(rule, belief.mean, belief.cov, traced.vector("z", z), sensor)
        for k in (0, 1, 4, 5, 6):
            what = f"update with {sensor.name}"
            size = None if k < 2 else 1.0 + np.abs(single[4])
            agree(several[k][..., 0], single[k], 1e-9, told.format(what, "lanes"), size)
            agree(traced.worth(nodes[k]), single[k], 1e-9, told.format(what, "graph nodes"), size)


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


def _not_compiled(rule: Any) -> str:
    with _compiling("on"):
        if isinstance(rule, WorksRecords):
            return rule.why_not_whole(MOTION, _sensors(rule)[-1:])
        if getattr(rule, "random", False):
            return "it draws random numbers"
        return compiled.reason(_estimator(rule, _sensors(rule)[-1]))


def _estimator(rule: Any, sensor: Any) -> Estimator:
    return Estimator(filter=rule, motion=MOTION, sensors=(sensor,))


@law("filter", name="compiled agrees with arrays", examples=2, unless=_not_compiled)
def compiled_agrees_with_arrays(rule: Any, case: Case) -> None:
    """A record filtered by the compiled step gives the same, to 1e-9, as filtered on arrays.

    So does one that a filter with machine code of its own works as a whole, of the same draws: to 1e-5,
    as a root of the covariance of few particles has but half of its digits.

    Times are uneven, some equal; some measurements are missing; means and covariances are compared
    relative to what was predicted or found.
    """
    random = getattr(rule, "random", False)
    close = 1e-5 if random else 1e-9
    for sensor in _sensors(rule):
        batch, steps = (5,), 6
        prior = _belief(case, batch, decades=3.0)
        gaps = case.rng.uniform(0.1, 2.0, steps) * case.rng.choice([0.0, 1.0, 1.0], steps)
        z = 100.0 * case.rng.standard_normal((steps, len(sensor.space), *batch))
        if any(sensor.space.circular):
            z = case.rng.uniform(-np.pi, np.pi, z.shape)
        z[case.rng.uniform(size=z.shape) < 0.2] = np.nan
        found = []
        for mode in ("off", "on"):
            with _compiling(mode):
                record = Record(np.cumsum(gaps), z)
                rng = [np.random.default_rng(lane) for lane in range(*batch)]
                estimator = _estimator(rule, sensor)
                found.append(run(estimator, record, prior, start=0.0, rng=rng if random else None))
        arrays, fused = found
        told = f"compiled, a record of {sensor.name} gives another {{}} than on arrays"
        spreads = (arrays.predicted.cov, arrays.filtered.cov)  # particles may know less than before
        sigma = np.sqrt(np.maximum(*(np.einsum("tii...->ti...", P) for P in spreads)))
        size = np.abs(arrays.predicted.mean) + sigma
        if random:  # what is common to a cloud takes digits from what is not
            sigma = sigma + 1e-6 * size
        agree(fused.filtered.mean, arrays.filtered.mean, close, told.format("mean"), size)
        agree(fused.filtered.cov, arrays.filtered.cov, close, told.format("covariance"),
              sigma[:, :, None] * sigma[:, None])  # fmt: skip
        for score in ("nis", "loglik"):
            a, b = getattr(fused.innovation, score), getattr(arrays.innovation, score)
            agree(a, b, close, told.format(score), 1.0 + np.abs(arrays.innovation.nis))


class Traced:
    """Inputs of a graph with their values: how a step is run on components."""

    def __init__(self) -> None:
        self.graph, self.values = Graph(), dict[str, float]()

    def vector(self, name: str, values: Any) -> Any:
        """A vector of inputs."""
        out = np.empty(len(values), dtype=object)
        for i, value in enumerate(values):
            self.values[f"{name}{i}"] = float(value)
            out[i] = self.graph.input(f"{name}{i}")
        return out

    def gaussian(self, state: Gaussian, name: str = "") -> Gaussian:
        """A Gaussian of inputs; both triangles of its covariance hold the same nodes."""
        n = len(state.mean)
        cov = np.empty((n, n), dtype=object)
        for i in range(n):
            cov[i, i:] = cov[i:, i] = self.vector(f"{name}P{i}_", state.cov[i, i:])
        return Gaussian.trusted(self.vector(f"{name}x", state.mean), cov)

    def worth(self, entries: Any) -> Array:
        """What an array of nodes is worth."""
        array = np.asarray(entries, dtype=object)
        worth = evaluate(list(array.ravel()), self.values)
        return np.array(worth, dtype=np.float64).reshape(array.shape)


def _campaign(rule: Any) -> tuple[Array, Array]:
    """NEES of the last step, and NIS of all steps, in matched runs with a fixed seed."""
    runs, steps, dt = 400, 12, 1.5
    rng = np.random.default_rng(20130625)
    start = Gaussian(np.zeros((4, runs)), np.diag(_REACH))
    truth = start.sample(rng=rng)
    root, nis = np.linalg.cholesky(textbook.Q(dt)), []
    state = begun(rule, start)
    for _ in range(steps):
        truth = textbook.F(dt) @ truth + root @ rng.standard_normal((4, runs))
        noise = np.sqrt(textbook.R) @ rng.standard_normal((2, runs))
        state, told = rule.update(
            rule.predict(state, MOTION, dt), POSITION, textbook.H @ truth + noise
        )
        nis.append(np.asarray(told.nis))
    mean, cov = _moments(state)
    error = (truth - mean).T[..., None]
    nees = (error * np.linalg.solve(np.moveaxis(cov, -1, 0), error)).sum(axis=(1, 2))
    return nees, np.stack(nis)


def _in_band(name: str, values: Array, degrees: int) -> None:
    from scipy.special import chdtri

    total, freedom = float(values.sum()), degrees * values.size
    low, high = chdtri(freedom, 1 - FALSE_ALARM / 2), chdtri(freedom, FALSE_ALARM / 2)
    assert low <= total <= high, (
        f"the mean {name} is {total / values.size:.4g} where {degrees} is right: outside "
        f"[{low / values.size:.4g}, {high / values.size:.4g}], which chance alone leaves with "
        f"probability {FALSE_ALARM:g}: the filter is "
        + ("overconfident" if total > high else "too cautious")
    )


@law("filter", name="NEES in its band", examples=1, unless=_draws)
def nees_in_its_band(rule: Any, _case: Case) -> None:
    """On matched models the squared errors are what the covariance says (false alarm 1e-6)."""
    _in_band("NEES", _campaign(rule)[0], 4)


@law("filter", name="NIS in its band", examples=1, unless=_draws)
def nis_in_its_band(rule: Any, _case: Case) -> None:
    """On matched models the innovations are what their covariance says (false alarm 1e-6)."""
    _in_band("NIS", _campaign(rule)[1], 2)
