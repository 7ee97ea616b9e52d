"""Settings on lanes score what single filters score, compiled or not, in any company."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np
import pytest

import tracker as tk
from tracker import estimation, trials
from tracker.adaptation import with_noise
from tracker.compile import objects
from tracker.compile import run as compiled_run
from tracker.errors import CapabilityError, DomainError, ShapeError
from tracker.models import isnan, maximum, where
from tracker.trials import TOTALS, Trials, numbers, place, retuned
from tracker.types import PARAMETER, SYMMETRIC
from tracker_adaptive.fuzzy_measurement_noise import FuzzyMeasurementNoise
from tracker_adaptive.mismatch import degree_of_mismatch
from tracker_motion.constant_velocity import constant_velocity
from tracker_sensors.azimuth import azimuth

compiled = pytest.mark.skipif(not objects.available(), reason="llvmlite is not installed")


# ------------------------------------------------------------------------------ a small adapter
@attrs.frozen(eq=False)
class Kept:
    """What `Forgetful` remembers."""

    R: Any = attrs.field(metadata=SYMMETRIC)


@attrs.frozen(eq=False)
class Forgetful:
    """Covariance matching with a forgetting factor (Mehra 1972), of one measured component.

    It begins with the sensor's own noise, refuses to forget everything, and gives up above 0.999.
    """

    keep: Any = attrs.field(default=0.95, metadata=PARAMETER)

    tunes = ("R",)

    @property
    def parameters(self):
        return {"keep": self.keep}

    def with_parameters(self, keep):
        if isinstance(keep, np.ndarray) and (keep > 0.999).any():
            raise DomainError("parameter 'keep': got more than 0.999")
        return Forgetful(keep)

    def begin(self, motion, sensor, prior, pose):
        return Kept(sensor.R(prior.mean, pose))

    def tuned(self, memory, motion, sensor):
        return motion, with_noise(sensor, memory.R)

    def adapt(self, memory, step, motion, sensor):
        v, S, old = step.innovation.residual, step.innovation.S, memory.R
        found = v * v - S[0] + old[0]
        new = maximum(self.keep * old[0] + (1.0 - self.keep) * found, 1e-6)
        return Kept(where(isnan(v), old[0], new)[None])


@pytest.fixture
def problem():
    """One vehicle on a line; 5 runs."""
    scene = attrs.evolve(tk.scenario("line", axes=1, steps=60), detection_probability=0.9)
    return scene, scene.simulate(seed=1, runs=5)


def made(est, names, simulation, wanted=TOTALS, **options):
    places = [[place(est, name)] for name in names]
    start, truth = simulation.start, simulation.truth
    return Trials(est, places, simulation.record, simulation.prior, start, truth, wanted, **options)


def both(est, names, simulation, values, monkeypatch, wanted=TOTALS):
    monkeypatch.setenv("TRACKER_COMPILE", "off")
    arrays = made(est, names, simulation, wanted)(values)
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    return arrays, made(est, names, simulation, wanted)(values)


# ------------------------------------------------------------------------------------ numbers
@compiled
@pytest.mark.parametrize("adapter", [None, Forgetful(), FuzzyMeasurementNoise(window=7)])
def test_arrays_and_compiled_lanes_score_the_same(problem, adapter, monkeypatch):
    scene, simulation = problem
    est = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor, adapter=adapter)
    names = ["motion.density", "sensor.sigma"]
    values = np.array([[0.01, 0.1, 1.0], [1.0, 3.0, 9.0]])
    arrays, fast = both(est, names, simulation, values, monkeypatch)
    assert list(arrays) == list(fast) == list(TOTALS)
    for name in TOTALS:
        assert arrays[name].shape == (1, 3, 5)
        np.testing.assert_allclose(fast[name], arrays[name], rtol=1e-9)


def test_a_setting_scores_what_its_own_estimator_scores_in_a_campaign(problem):
    scene, _ = problem
    est = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor)
    values = np.array([[0.05, 0.4], [2.0, 4.0]])
    names = ["motion.density", "sensor.sigma"]
    found = made(est, names, scene.simulate(seed=8, runs=40))(values)
    for i in range(2):
        alone = retuned(est, [[place(est, name)] for name in names], values[:, i].tolist())
        scores = tk.monte_carlo(alone, scene, runs=40, seed=8).scores["estimator"]["filter"]
        steps = len(scene.t)
        for name, wanted in {
            "squared_error": scores.per_run["rmse"] ** 2 * steps,
            "nees": scores.per_run["nees"] * steps,
            "nis": scores.per_run["nis"],
            "count": scores.per_run["count"],
            "loglik": scores.per_run["loglik"],
        }.items():
            np.testing.assert_allclose(found[name][0, i], wanted, rtol=1e-9)


def test_the_squared_mismatch_is_that_of_the_thesis(problem):
    scene, simulation = problem
    est = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor)
    found = made(est, ["sensor.sigma"], simulation, ["mismatch"])(np.array([[2.0, 3.0]]))
    for i, sigma in enumerate((2.0, 3.0)):
        alone = retuned(est, [[place(est, "sensor.sigma")]], [sigma])
        history = tk.filter(alone, simulation.record, simulation.prior, start=simulation.start)
        cost = degree_of_mismatch(history.innovation).cost()
        ours = 1000.0 * np.sqrt(found["mismatch"][:, i] / len(scene.t)).sum(axis=0)
        np.testing.assert_allclose(ours, cost, rtol=1e-9)


@pytest.mark.parametrize("mode", ["off", pytest.param("require", marks=compiled)])
def test_no_bit_depends_on_company_tiles_or_workers(problem, mode, monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", mode)
    scene, simulation = problem
    est = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor, adapter=Forgetful())
    names = ["motion.density", "sensor.sigma", "adapter.keep"]
    rng = np.random.default_rng(0)
    values = np.exp(rng.uniform(-2, 1, (3, 13))) * np.array([[0.1], [3.0], [0.3]])
    whole = made(est, names, simulation, together=13)(values)
    monkeypatch.setattr(trials, "TILE_BYTES", 20_000)
    monkeypatch.setattr(estimation, "LANE_BYTES", 400)
    cut = made(est, names, simulation, together=13, workers=2)
    assert cut.size < 13
    alone = made(est, names, simulation)
    for name in TOTALS:
        np.testing.assert_array_equal(cut(values)[name], whole[name])
        np.testing.assert_array_equal(alone(values[:, 4:5])[name], whole[name][:, 4:5])


@compiled
def test_a_lone_run_has_the_bits_it_has_in_company(problem, monkeypatch):
    scene, _ = problem
    est = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor)
    monkeypatch.setenv("TRACKER_COMPILE", "off")
    one, five = (scene.simulate(seed=1, runs=n) for n in (1, 5))
    few = made(est, ["sensor.sigma"], one)(np.array([[2.0]]))
    many = made(est, ["sensor.sigma"], five)(np.array([[2.0, 3.0]]))
    for name in TOTALS:
        np.testing.assert_array_equal(few[name][:, 0, 0], many[name][:, 0, 0])


# ------------------------------------------------------------------- what depends on numbers
@compiled
def test_what_an_adapter_begins_with_may_depend_on_a_number(problem, monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    scene, simulation = problem
    est = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor, adapter=Forgetful())
    tried = made(est, ["sensor.sigma"], simulation)
    first = tried(np.array([[1.0]]))["loglik"]
    other = tried(np.array([[9.0]]))["loglik"]
    assert not np.array_equal(first, other)
    np.testing.assert_array_equal(tried(np.array([[1.0]]))["loglik"], first)


@compiled
def test_windows_begin_empty_at_every_call(problem, monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    scene, simulation = problem
    adapter = FuzzyMeasurementNoise(window=7)
    est = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor, adapter=adapter)
    tried = made(est, ["adapter.scale"], simulation)
    first, again = (tried(np.array([[0.2]])) for _ in range(2))
    for name in TOTALS:
        np.testing.assert_array_equal(first[name], again[name])


@compiled
def test_other_values_never_compile_again(problem, monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    scene, simulation = problem
    est = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor, adapter=Forgetful())
    names = ["motion.density", "adapter.keep"]
    made(est, names, simulation, together=4)(np.full((2, 4), 0.5))
    before = compiled_run.kernel.cache_info().misses
    for value in (0.1, 0.2, 0.3):
        again = retuned(est, [[place(est, name)] for name in names], [value, value])
        made(again, names, simulation, together=4)(np.full((2, 4), value))
    assert compiled_run.kernel.cache_info().misses == before, "a value was baked into a kernel"


def test_filters_that_draw_show_every_setting_the_same_numbers(problem):
    scene, simulation = problem
    est = tk.estimator("bootstrap", motion=scene.motion, sensor=scene.sensor)

    def draws(run):
        return np.random.default_rng([7, run])

    tried = made(est, ["sensor.sigma"], simulation, ["loglik"], draws=draws, together=3)
    found = tried(np.array([[3.0, 2.0, 3.0]]))["loglik"]
    np.testing.assert_array_equal(found[:, 0], found[:, 2])
    assert not np.array_equal(found[:, 0], found[:, 1])


# ------------------------------------------------------------------------------------ records
@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
@pytest.mark.parametrize("mode", ["off", pytest.param("require", marks=compiled)])
def test_every_lane_of_a_record_is_a_run(batch, mode, monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", mode)
    rng = np.random.default_rng(2)
    steps = 30
    t = np.cumsum(rng.uniform(0.1, 0.3, (steps, *batch)), axis=0)
    pose = rng.normal(0.0, 5.0, (steps, 2, *batch))
    z = rng.uniform(-0.5, 0.5, (steps, 1, *batch))
    est = tk.estimator("ekf1", motion=constant_velocity(density=0.1), sensor=azimuth(0.05))
    record = tk.Record(t, z, pose=pose)
    prior = tk.Gaussian([50.0, 0.0, 0.0, 0.0], np.diag([25.0, 25.0, 1.0, 1.0]))
    tried = Trials(est, [[place(est, "sensor.sigma")]], record, prior, None, None, ["loglik"])
    found = tried(np.array([[0.05, 0.1]]))["loglik"]
    history = tk.filter(est, record, prior)
    np.testing.assert_allclose(
        found[0, 0], history.innovation.loglik.sum(axis=0).reshape(-1), rtol=1e-9
    )


def test_several_sensors_are_named_by_their_places():
    sensors = [azimuth(0.03).at(sx=0.0, sy=0.0), azimuth(0.05).at(sx=4.0, sy=1.0)]
    est = tk.estimator("ekf1", motion=constant_velocity(density=0.1), sensor=sensors)
    assert {"sensor0.sigma", "sensor1.sigma", "motion.density"} <= {*numbers(est)}
    rng = np.random.default_rng(2)
    which = rng.integers(0, 2, 20)
    record = tk.Record(np.arange(20.0), rng.normal(0, 0.1, (20, 1, 3)), sensor=which)
    prior = tk.Gaussian([9.0, 0.0, 0.0, 0.0], np.eye(4))
    places = [[place(est, "sensor1.sigma")]]
    found = Trials(est, places, record, prior, None, None, ["loglik"])(np.array([[0.05]]))
    history = tk.filter(est, record, prior)
    wanted = history.innovation.loglik.sum(axis=0)
    np.testing.assert_allclose(found["loglik"][0, 0], wanted, rtol=1e-9)
    with pytest.raises(CapabilityError, match="got 2 sensors"):
        Trials(est, places, record, prior, None, None, ["mismatch"])


# ------------------------------------------------------------------------------------ refusals
@pytest.mark.parametrize("mode", ["off", pytest.param("require", marks=compiled)])
def test_a_setting_that_a_part_refuses_is_nan_and_harms_no_other(problem, mode, monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", mode)
    scene, simulation = problem
    est = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor, adapter=Forgetful())
    tried = made(est, ["adapter.keep"], simulation, ["loglik"], together=3)
    found = tried(np.array([[2.0, 0.5, 0.9995]]))["loglik"]
    assert np.isnan(found[:, [0, 2]]).all()
    np.testing.assert_array_equal(found[:, 1], tried(np.array([[0.5]]))["loglik"][:, 0])
    assert np.isnan(tried(np.array([[2.0]]))["loglik"]).all()


def test_a_name_that_is_not_there_is_answered_by_those_that_are(problem):
    scene, _ = problem
    est = tk.estimator("kf", motion=scene.motion, sensor=scene.sensor)
    with pytest.raises(DomainError, match=r"motion.density, sensor.sigma.*write 'motion.density'"):
        place(est, "motion.densty")
    assert place(est, "sensor.sigma") == place(est, "sensor0.sigma") == ("sensor0", "sigma")
    lanes = tk.estimator(
        "kf", motion=scene.motion, sensor=scene.sensor.with_parameters(sigma=np.ones(3))
    )
    with pytest.raises(DomainError, match="one number, to begin with"):
        place(lanes, "sensor.sigma")


def test_errors_need_a_truth_that_fits(problem):
    scene, simulation = problem
    est = tk.estimator("kf", motion=scene.motion, sensor=scene.sensor)
    places = [[place(est, "sensor.sigma")]]
    given = (est, places, simulation.record, simulation.prior, simulation.start)
    with pytest.raises(CapabilityError, match="no truth"):
        Trials(*given, None, ["nees"])
    with pytest.raises(ShapeError, match="'truth'"):
        Trials(*given, simulation.truth[:5], ["nees"])
    with pytest.raises(DomainError, match="no rows"):
        Trials(
            est, places, tk.Record([], np.empty((0, 1))), simulation.prior[0], None, None, ["nis"]
        )
