"""A record as one call of machine code is its steps, one after the other, bit for bit."""

from typing import Any

import attrs
import numpy as np
import pytest
from clouds import linear

import tracker as tk
from tracker.compile import objects
from tracker.models import ComponentMotion, ComponentSensor, diagonal, maximum, sqrt
from tracker_motion import constant_velocity
from tracker_particle import (
    AuxiliaryFilter,
    BootstrapFilter,
    MarginalisedFilter,
    RegularisedFilter,
    kernels,
    machine,
    records,
)
from tracker_particle.belief import Particles
from tracker_particle.propagation import resampled, root
from tracker_particle.resampling import SYSTEMATIC
from tracker_sensors import azimuth, position, range_azimuth

pytestmark = pytest.mark.skipif(not objects.available(), reason="llvmlite is not installed")

RULES = {
    "bootstrap": BootstrapFilter(particles=200),
    "of odd number": BootstrapFilter(particles=61, threshold=0.9),
    "multinomial": BootstrapFilter(particles=96, resampling="multinomial", threshold=1.0),
    "regularised": RegularisedFilter(particles=120),
    "auxiliary": AuxiliaryFilter(particles=125),
    "marginalised": MarginalisedFilter(particles=104),
    "marginalised, all but one": MarginalisedFilter(particles=99, linear=("y", "vx", "vy")),
    "marginalised, multinomial": MarginalisedFilter(particles=104, resampling="multinomial"),
    "kalman": MarginalisedFilter(particles=7, linear=("x", "y", "vx", "vy")),
}
every = pytest.mark.parametrize("name", list(RULES))


@attrs.frozen
class Watched:
    """A filter that tells how often its own methods were asked, and may forget that it works records."""

    rule: Any
    stepwise: bool = False
    asked: list[str] = attrs.field(factory=list)

    needs = ()
    random = True

    def begin(self, prior: Any, *, rng: Any = None, motion: Any = None) -> Any:
        return self.rule.begin(prior, rng=rng, motion=motion)

    def predict(self, *arguments: Any) -> Any:
        self.asked.append("predict")
        return self.rule.predict(*arguments)

    def update(self, *arguments: Any) -> Any:
        return self.rule.update(*arguments)

    def why_not_whole(self, *arguments: Any) -> str:
        return "it was told so" if self.stepwise else self.rule.why_not_whole(*arguments)

    def whole(self, *arguments: Any) -> bool:
        self.asked.append("whole")
        done = self.rule.whole(*arguments)
        assert done
        return bool(done)


def numbers(history: tk.History) -> dict[str, Any]:
    out = {
        f"{stage} {name}": getattr(getattr(history, stage), name)
        for stage in ("predicted", "filtered")
        for name in ("mean", "cov")
    }
    return out | attrs.asdict(history.innovation, recurse=False)


def both_ways(
    rule: Any, models: Any, record: tk.Record, prior: tk.Gaussian, start: float | None = 0.0
) -> tuple[Watched, tk.History, tk.History]:
    """The record as a whole and step by step: the same, bit for bit."""
    whole, steps = Watched(rule), Watched(rule, stepwise=True)
    histories = [
        tk.filter(
            tk.estimator(watched, **models),
            record,
            prior,
            start=start,
            rng=np.random.default_rng(3),
        )
        for watched in (whole, steps)
    ]
    assert whole.asked[0] == "whole"
    assert steps.asked.count("whole") == 0
    same(rule, *(numbers(history) for history in histories))
    return whole, *histories


def same(rule: Any, ours: dict[str, Any], theirs: dict[str, Any]) -> None:
    """Bit for bit, or as far as rounding goes where single steps run on arrays."""
    rounded = isinstance(rule, AuxiliaryFilter | MarginalisedFilter)
    for name, values in ours.items():
        other = theirs[name]
        if not rounded or values.dtype.kind != "f":
            assert np.array_equal(values, other, equal_nan=values.dtype.kind == "f"), name
            continue
        assert np.array_equal(np.isnan(values), np.isnan(other)), name
        size = np.nanmax(np.abs(other)) if other.size else 0.0
        assert np.nanmax(np.abs(values - other), initial=0.0) <= 1e-10 * size, name


@every
def test_a_record_is_its_steps(name: str) -> None:
    models, record, prior = linear(steps=40)
    watched, _, _ = both_ways(RULES[name], models, record, prior)
    assert watched.asked == ["whole"], "no step was unusual"


@every
def test_calls_of_few_steps_change_no_bit(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    models, record, prior = linear(steps=20)
    estimator, histories = tk.estimator(RULES[name], **models), []
    for most in (records.AT_ONCE, 600, 1):
        monkeypatch.setattr(records, "AT_ONCE", most)
        rng = np.random.default_rng(3)
        histories.append(numbers(tk.filter(estimator, record, prior, start=0.0, rng=rng)))
    for some in histories[1:]:
        for key, values in some.items():
            assert np.array_equal(values, histories[0][key], equal_nan=values.dtype.kind == "f"), (
                key
            )


@every
def test_a_record_of_lanes_is_their_steps(name: str) -> None:
    rule = RULES[name]
    models, record, prior = linear(steps=12, batch=(2, 3))
    whole = tk.filter(
        tk.estimator(rule, **models), record, prior, start=0.0, rng=np.random.default_rng(3)
    )
    generators = np.random.default_rng(3).spawn(6)
    for i, at in enumerate(np.ndindex(2, 3)):
        row = tk.Record(record.t, record.z[(slice(None), slice(None), *at)])
        steps = tk.filter(
            tk.estimator(Watched(rule, stepwise=True), **models), row, prior, start=0.0,
            rng=generators[i],
        )  # fmt: skip
        same(rule, {k: v[(..., *at)] for k, v in numbers(whole).items()}, numbers(steps))


@pytest.mark.parametrize(
    "rule", [BootstrapFilter(particles=104), AuxiliaryFilter(particles=101), MarginalisedFilter()]
)
def test_several_sensors_with_poses_take_turns_and_the_clock_is_each_lanes_own(rule: Any) -> None:
    rng = np.random.default_rng(4)
    motion = constant_velocity(density=0.5)
    sensors = [position(sigma=2.0), azimuth(0.05), range_azimuth(2.0, 0.05)]
    steps = 24
    t = np.cumsum(rng.uniform(0.2, 0.8, (steps, 2)), axis=0)
    z = np.full((steps, 2, 2), np.nan)
    which = np.arange(steps) % 3
    pose = rng.standard_normal((steps, 2, 2)) - 100.0
    for k, i in enumerate(which):
        z[k, 0] = (0.0, 0.8, 141.0)[i] + 0.02 * rng.standard_normal(2)
        if i != 1:
            z[k, 1] = (0.0, 0.0, 0.8)[i] + 0.02 * rng.standard_normal(2)
    prior = tk.Gaussian(np.zeros(4), np.diag([25.0, 25.0, 0.1, 0.1]))
    models = {"motion": motion, "sensor": sensors}
    record = tk.Record(t, z, pose=pose, sensor=which)
    whole = tk.filter(
        tk.estimator(rule, **models), record, prior, start=0.0, rng=np.random.default_rng(3)
    )
    for lane, own in enumerate(np.random.default_rng(3).spawn(2)):
        row = tk.Record(t[:, lane], z[..., lane], pose=pose[..., lane], sensor=which)
        alone = tk.filter(
            tk.estimator(Watched(rule, stepwise=True), **models), row, prior, start=0.0, rng=own
        )
        same(rule, {k: v[..., lane] for k, v in numbers(whole).items()}, numbers(alone))
    assert np.isfinite(whole.filtered.mean).all()


def test_inputs_and_a_first_row_at_the_time_of_the_prior() -> None:
    space = tk.Space.of("x [m]", "v [m/s]")
    motion = ComponentMotion(
        name="pushed", advance=lambda x, v, *, dt, a: (x + dt * v, v + dt * a),
        noise=lambda *, dt: ((0.0, 0.0), (0.0, 0.04 * dt)), space=space,
        input_space=tk.Space.of("a [m/s^2]"),
    )  # fmt: skip
    sensor = ComponentSensor(
        name="x", measure=lambda x: (x,), noise=lambda: ((0.25,),), space=tk.Space.of("z"), state=space,
    )  # fmt: skip
    u = np.sin(np.arange(20.0))[:, None]
    record = tk.Record(0.5 * np.arange(20.0), 0.1 * np.arange(20.0)[:, None], u=u)
    prior = tk.Gaussian(np.zeros(2), np.eye(2))
    for rule in (
        BootstrapFilter(particles=80),
        AuxiliaryFilter(particles=80),
        MarginalisedFilter(particles=80, linear=("x",)),
    ):
        both_ways(rule, {"motion": motion, "sensor": sensor}, record, prior, start=None)


def test_a_step_that_passes_leave_to_the_arrays_is_one_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A measurement that no particle can explain, and rows on which the record goes on."""
    models, record, prior = linear(steps=30)
    z = record.z.copy()
    z[6], z[15], z[16] = 5e3, -5e3, 5e3
    done: list[int] = []
    own = records._Loop._step

    def counted(self: Any, state: Any, k: int, at: Any) -> Any:
        done.append(k)
        return own(self, state, k, at)

    monkeypatch.setattr(records._Loop, "_step", counted)
    for rule in (
        BootstrapFilter(particles=104),
        RegularisedFilter(particles=104),
        AuxiliaryFilter(particles=104),
        MarginalisedFilter(particles=104),
    ):
        done.clear()
        sharp = {**models, "sensor": position(sigma=0.5)}
        _, history, _ = both_ways(rule, sharp, tk.Record(record.t, z), prior)
        assert {6, 15, 16} <= set(done), rule
        assert len(done) < 12
        assert np.isfinite(history.filtered.mean).all()


def test_a_source_of_noise_that_is_not_there_yet_is_left_to_the_arrays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """They drop its column, and draw for the others alone."""
    space = tk.Space.of("x [m]", "y [m]", "v [m/s]")
    motion = ComponentMotion(
        name="half still", advance=lambda x, y, v, *, dt: (x, y + dt * v, v), space=space,
        noise=lambda *, dt: diagonal(0.0, 0.1 * dt, 0.1 * dt),
    )  # fmt: skip
    prior = tk.Gaussian(np.zeros(3), np.diag([0.0, 1.0, 1.0]))
    z = np.random.default_rng(1).standard_normal((9, 2))
    done: list[int] = []
    own = records._Loop._step

    def counted(self: Any, state: Any, k: int, at: Any) -> Any:
        done.append(k)
        return own(self, state, k, at)

    monkeypatch.setattr(records._Loop, "_step", counted)
    models = {"motion": motion, "sensor": position(sigma=1.0).over(space)}
    both_ways(MarginalisedFilter(("v",), 40), models, tk.Record(np.arange(1.0, 10.0), z), prior)
    assert done == list(range(9))


@pytest.mark.parametrize(
    "rule", [BootstrapFilter(particles=104), AuxiliaryFilter(), MarginalisedFilter()]
)
def test_a_lane_that_has_diverged_harms_no_neighbour(rule: Any) -> None:
    models, record, prior = linear(steps=10, batch=(3,))
    blind = ComponentSensor(
        name="blind", measure=lambda x, y: (x + y,), noise=lambda: ((1.0,),),
        space=tk.Space.of("z"), state=models["motion"].space,
    )  # fmt: skip
    mean = np.zeros((4, 3))
    mean[0, 1] = np.nan
    lanes = tk.Gaussian.trusted(mean, np.repeat(prior.cov[..., None], 3, axis=2))
    history = tk.filter(
        tk.estimator(rule, motion=models["motion"], sensor=blind),
        tk.Record(record.t, record.z[:, :1]), lanes, start=0.0, rng=np.random.default_rng(1),
    )  # fmt: skip
    assert np.isnan(history.filtered.mean[..., 1]).any(axis=1).all()
    assert not history.innovation.ok[:, 1].any()
    assert np.isfinite(history.filtered.mean[..., [0, 2]]).all()


def test_what_cannot_be_worked_whole_says_why() -> None:
    models, _, _ = linear()
    rule = BootstrapFilter(particles=64)
    assert tk.estimator(rule, **models).explain().startswith("runs compiled, whole records")
    several = {**models, "motion": constant_velocity(density=np.array([0.1, 0.2]))}
    assert "differs from lane to lane" in tk.estimator(rule, **several).explain()
    noisy = ComponentSensor(
        name="faint", measure=lambda x: (x,), noise=lambda x: ((1.0 + x * x,),),
        space=tk.Space.of("z"),
    )  # fmt: skip
    told = tk.estimator(rule, **{**models, "sensor": noisy}).explain()
    assert "runs step by step: sensor 'faint'" in told
    assert "differs from particle to particle" in told
    restless = ComponentMotion(
        name="restless", advance=lambda x, y, vx, vy, *, dt: (x + dt * vx, y + dt * vy, vx, vy),
        noise=lambda vx, *, dt: np.diag([0.0, 0.0, dt * (1.0 + vx * vx), dt]).tolist(),
        space=models["motion"].space,
    )  # fmt: skip
    told = tk.estimator(MarginalisedFilter(), motion=restless, sensor=models["sensor"]).explain()
    assert "differs from particle to particle" in told
    told = tk.estimator(AuxiliaryFilter(resampling="residual"), **models).explain()
    assert "runs step by step: parents are chosen by the residual scheme" in told
    doppler = ComponentSensor(
        name="doppler", measure=lambda x, y, vx, vy: ((x * vx + y * vy) / sqrt(x * x + y * y),),
        noise=lambda: ((1.0,),), space=tk.Space.of("z [m/s]"), state=models["motion"].space,
    )  # fmt: skip
    told = tk.estimator(MarginalisedFilter(), **{**models, "sensor": doppler}).explain()
    assert "runs step by step: sensor 'doppler'" in told
    assert "its Jacobian by the linear components" in told


def test_columns_of_noise_that_come_and_go_are_left_to_the_steps() -> None:
    """Which columns there are decides about the draws, and a whole record has one number of them."""
    steady = constant_velocity(density=0.5)
    found = records.roots(steady, np.array([0.0, 0.5, 0.2, 0.5]))
    assert not isinstance(found, str)
    columns, (entries, place) = found
    assert columns == 4
    for k, dt in enumerate((0.0, 0.5, 0.2, 0.5)):
        own = root(steady.Q(np.zeros((4, 1)), dt))[:, :, 0]
        whole = entries[place[k]].reshape(4, columns)
        assert np.array_equal(whole[:, : own.shape[1]], own)
        assert (whole[:, own.shape[1] :] == 0.0).all()
    late = ComponentMotion(
        name="late", advance=lambda x, y, vx, vy, *, dt: (x + dt * vx, y + dt * vy, vx, vy),
        noise=lambda *, dt: diagonal(dt, dt, maximum(dt - 0.7, 0.0), dt), space=steady.space,
    )  # fmt: skip
    assert "come and go" in records.roots(late, np.array([1.0, 0.5]))
    models, record, prior = linear(steps=20)
    rule = BootstrapFilter(particles=104)
    histories = [
        tk.filter(
            tk.estimator(each, **{**models, "motion": late}), record, prior, start=0.0,
            rng=np.random.default_rng(3),
        )
        for each in (rule, Watched(rule, stepwise=True))
    ]  # fmt: skip
    assert np.array_equal(histories[0].filtered.mean, histories[1].filtered.mean)


@pytest.mark.parametrize("count", [1, 2, 104])
def test_every_particle_may_have_noise_of_its_own(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = tk.scenario("turning_target", steps=30)
    simulation = scenario.simulate(1, 1)
    record = tk.Record(simulation.record.t, simulation.record.z[..., 0])
    models = {"motion": scenario.motion, "sensor": scenario.sensor}
    prior, start = simulation.prior[0], simulation.start
    rules = (BootstrapFilter(particles=count), RegularisedFilter(particles=count))
    for rule in rules[:1] if count < 3 else rules:
        if count > 1:  # a single particle's is that of all, and loses columns
            both_ways(rule, models, record, prior, start)
        histories = []
        for mode in ("on", "off"):
            monkeypatch.setenv("TRACKER_COMPILE", mode)
            histories.append(
                tk.filter(
                    tk.estimator(rule, **models), record, prior, start=start,
                    rng=np.random.default_rng(3),
                )
            )  # fmt: skip
        monkeypatch.setenv("TRACKER_COMPILE", "on")
        ours, theirs = (history.filtered.mean for history in histories)
        assert np.abs(ours - theirs).max() < 1e-7 * np.abs(theirs).max()
    told = tk.estimator(AuxiliaryFilter(particles=count), **models).explain()
    assert "the noise of motion 'coordinated_turn' differs from particle to particle" in told


@pytest.mark.parametrize("count", [1, 5, 8, 64, 1001])
def test_chosen_ancestors_are_those_of_the_arrays(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(count)
    for trial in range(20):
        weights = rng.exponential(size=count) ** (trial % 4)
        weights[rng.uniform(size=count) < 0.3] = 0.0
        weights[rng.integers(count)] = 1.0
        with np.errstate(divide="ignore"):
            log_weights = np.log(weights / weights.sum())
        key = rng.integers(0, 2**64, size=2, dtype=np.uint64)
        state = Particles(np.arange(2.0 * count).reshape(2, count), log_weights, key, 7)
        made = kernels.choose(state)
        assert made is not None
        with monkeypatch.context() as without:
            without.setattr(kernels, "choose", lambda _: None)
            theirs = resampled(state, SYSTEMATIC, 1.1)
        assert np.array_equal(made.points, theirs.points)
        assert np.array_equal(made.log_weights, theirs.log_weights)


def test_the_most_that_a_uniform_may_be_is_that_of_the_arrays() -> None:
    assert float.fromhex("0x1.fffffff768fa1p-1") == 1.0 - 1e-9
    assert machine._MOST == "0x3FEFFFFFFF768FA1"
