"""Tuning finds known numbers, answers the same for the same seed, and says what it should not be trusted for."""

from __future__ import annotations

import attrs
import numpy as np
import pytest

import tracker as tk
from tracker import tuning
from tracker.compile import objects
from tracker.compile import run as compiled_run
from tracker.errors import CapabilityError, ConfigError, DomainError
from tracker.metrics.consistency import chi_square_point, mean_interval
from tracker.tuning import HELD_OUT, TRAINING, Score, Tuned
from tracker_adaptive.fuzzy_measurement_noise import FuzzyMeasurementNoise
from tracker_optimise import NSGA2, ParticleSwarm

compiled = pytest.mark.skipif(not objects.available(), reason="llvmlite is not installed")

BOTH = {"motion.density": (1e-3, 10.0, "log"), "sensor.sigma": (0.3, 30.0, "log")}


@pytest.fixture(scope="module")
def line():
    """A vehicle on a line: density 0.1, sigma 3; and a filter that is told otherwise."""
    scene = tk.scenario("line", axes=1, steps=100)
    wrong = tk.estimator(
        "kf",
        motion=scene.motion.with_parameters(density=2.0),
        sensor=scene.sensor.with_parameters(sigma=8.0),
    )
    return scene, wrong


@pytest.fixture(scope="module")
def found(line):
    scene, wrong = line
    return tk.tune(wrong, scene, BOTH, "likelihood", evaluations=1500, runs=20, seed=4)


# ---------------------------------------------------------------------------- what it finds
def test_likelihood_finds_the_numbers_that_simulated(line, found):
    # Wilks: twice what the likelihood gains over the true numbers is chi-square with 2 degrees of
    # freedom; its point of 1 - 1e-6 is passed by chance once in a million seeds.
    scene, _ = line
    true = tk.estimator("kf", motion=scene.motion, sensor=scene.sensor)
    simulation = scene.simulate(4, 20, condition=TRAINING)
    history = tk.filter(true, simulation.record, simulation.prior, start=simulation.start)
    gained = found.training["tuned"].totals["loglik"].sum() - history.innovation.loglik.sum()
    assert -1e-3 < 2.0 * gained < chi_square_point(1.0 - 1e-6, 2)
    # In numbers: 2,000 rows, standard errors near 7 % and 2 %; five of them, 1 in a million.
    assert abs(np.log(found.values["motion.density"] / 0.1)) < 0.35
    assert abs(np.log(found.values["sensor.sigma"] / 3.0)) < 0.1
    assert found.estimator.motion.parameters["density"] == found.values["motion.density"]
    assert not found.warnings()


def test_the_likelihood_is_the_closed_form(line):
    """A linear Gaussian system's measurements are one Gaussian vector."""
    scene, _ = line
    steps, density, sigma = 12, 0.4, 2.0
    scene = attrs.evolve(scene, t=scene.t[:steps])
    est = tk.estimator(
        "kf",
        motion=scene.motion.with_parameters(density=density),
        sensor=scene.sensor.with_parameters(sigma=sigma),
    )
    simulation = scene.simulate(0, 1)
    record = tk.Record(simulation.record.t, simulation.record.z[..., 0])
    prior = tk.Gaussian([0.0, 1.0], np.diag([4.0, 2.0]))
    result = tk.tune(
        est, record, {"motion.density": (density, 1.0)}, "likelihood", prior=prior, start=0.0,
        evaluations=1, held_out=0,
    )  # fmt: skip
    F, Q = np.array([[1.0, 1.0], [0.0, 1.0]]), density * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    mean, covs, m = [], [], prior.mean
    P = np.asarray(prior.cov)
    for _ in range(steps):
        m, P = F @ m, F @ P @ F.T + Q
        mean.append(m[0])
        covs.append(P)
    joint = np.zeros((steps, steps))
    for i in range(steps):
        ahead = covs[i]
        for j in range(i, steps):
            joint[i, j] = joint[j, i] = ahead[0, 0]
            ahead = F @ ahead
    joint += sigma**2 * np.eye(steps)
    miss = record.z[:, 0] - np.array(mean)
    _, log = np.linalg.slogdet(2.0 * np.pi * joint)
    wanted = -0.5 * (miss @ np.linalg.solve(joint, miss) + log)
    given = result.training["given"]
    assert float(given.totals["loglik"].sum()) == pytest.approx(wanted, rel=1e-9)
    assert given.cost("likelihood") == pytest.approx(-wanted / steps, rel=1e-9)


@pytest.mark.parametrize("objective", ["rmse", "nees", "innovation", "dom"])
def test_every_objective_gets_better_on_runs_it_has_not_seen(line, objective):
    scene, wrong = line
    result = tk.tune(wrong, scene, BOTH, objective, evaluations=400, runs=20, held_out=40, seed=2)
    for scores in (result.training, result.held_out):
        assert scores["tuned"].cost(objective) < scores["given"].cost(objective)
    assert result.cost == pytest.approx(result.best[-1].min(), rel=1e-9)
    assert result.summary().count("\n") >= 8


def test_numbers_of_an_adapter_are_tuned(line):
    scene, _ = line
    scene = attrs.evolve(scene, truth_sensor=scene.sensor.with_parameters(sigma=12.0))
    est = tk.estimator(
        "ekf1", motion=scene.motion, sensor=scene.sensor, adapter=FuzzyMeasurementNoise()
    )
    bounds = {"adapter.scale": (0.01, 5.0, "log"), "adapter.dom_ZE_width": (0.2, 5.0)}
    result = tk.tune(est, scene, bounds, "rmse", evaluations=200, runs=20, held_out=50, seed=1)
    gain, error = result.held_out["tuned"].gain(result.held_out["given"], "rmse")
    assert gain > 3.0 * error, "a larger step finds an R that is 16 times larger sooner"
    assert result.estimator.adapter.parameters["scale"] == result.values["adapter.scale"]


@pytest.mark.parametrize("name", ["genetic", "imperialist", "differential_evolution", "cma_es"])
def test_any_optimiser_of_one_objective_will_do(line, name):
    if name == "cma_es":
        pytest.importorskip("cmaes")
    scene, wrong = line
    result = tk.tune(
        wrong, scene, BOTH, "likelihood", name, evaluations=400, runs=5, held_out=5, restarts=2
    )
    assert result.cost < result.training["given"].cost("likelihood")
    assert result.held_out["tuned"].cost("likelihood") < result.held_out["given"].cost("likelihood")


def test_restarts_that_end_early_leave_the_others_as_they_are(line):
    scene, wrong = line
    options = {"evaluations": 600, "runs": 4, "held_out": 4, "patience": 2, "tolerance": 1e-3}
    three = tk.tune(wrong, scene, BOTH, "rmse", restarts=3, **options)
    last = tk.tune(wrong, scene, BOTH, "rmse", restarts=[2], **options)
    np.testing.assert_array_equal(last.settings[:, 0], three.settings[:, 2])


def test_tied_numbers_get_one_value():
    scene = tk.scenario("two_stations", steps=30)
    est = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor)
    pair = ("sensor.sigma_1", "sensor.sigma_2")
    result = tk.tune(est, scene, {pair: (0.01, 0.1)}, evaluations=60, runs=4, held_out=4)
    parameters = result.estimator.sensors[0].parameters
    assert parameters["sigma_1"] == parameters["sigma_2"] == result.values["sensor.sigma_2"]
    unequal = attrs.evolve(est, sensors=(scene.sensor.with_parameters(sigma_1=0.5),))
    with pytest.raises(DomainError, match="equal ones, to begin with"):
        tk.tune(unequal, scene, {pair: (0.01, 0.1)}, evaluations=60)


# --------------------------------------------------------------------------- the same answer
def equal(one, other):
    np.testing.assert_array_equal(one.settings, other.settings)
    np.testing.assert_array_equal(one.best, other.best)
    for name, value in one.held_out["tuned"].totals.items():
        np.testing.assert_array_equal(value, other.held_out["tuned"].totals[name])
    assert one.values == other.values


@pytest.mark.parametrize("mode", ["off", pytest.param("on", marks=compiled)])
def test_the_same_seed_gives_the_same_answer_for_any_workers(line, mode, monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", mode)
    monkeypatch.setattr("tracker.trials.TILE_BYTES", 60_000)
    monkeypatch.setattr("tracker.estimation.LANE_BYTES", 4_000)
    scene, wrong = line
    budget = {"evaluations": 120, "runs": 6, "held_out": 6, "restarts": 2}
    one = tk.tune(wrong, scene, BOTH, "nees", seed=5, **budget)
    equal(one, tk.tune(wrong, scene, BOTH, "nees", seed=5, workers=2, **budget))
    assert one.values != tk.tune(wrong, scene, BOTH, "nees", seed=6, **budget).values


@compiled
def test_arrays_and_compiled_tune_alike(line, monkeypatch):
    scene, wrong = line
    results = []
    for mode in ("off", "require"):
        monkeypatch.setenv("TRACKER_COMPILE", mode)
        results.append(
            tk.tune(wrong, scene, BOTH, "rmse", evaluations=150, runs=5, held_out=5, seed=1)
        )
    np.testing.assert_allclose(*(list(r.values.values()) for r in results), rtol=1e-6)
    np.testing.assert_allclose(*(r.best for r in results), rtol=1e-9)


@compiled
def test_a_second_tuning_compiles_nothing(line, monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    scene, wrong = line
    budget = {"evaluations": 100, "runs": 4, "held_out": 4}
    tk.tune(wrong, scene, BOTH, "rmse", seed=1, **budget)
    before = compiled_run.kernel.cache_info().misses
    other = {"motion.density": (1e-2, 5.0), "sensor.sigma": (1.0, 20.0)}
    tk.tune(wrong, scene, other, "rmse", seed=2, restarts=3, redraw=True, **budget)
    assert compiled_run.kernel.cache_info().misses == before


def test_training_held_out_and_campaigns_never_share_a_run(line):
    scene, _ = line
    drawn = [
        scene.simulate(4, 3, condition=c).record.z for c in (0, TRAINING, HELD_OUT, HELD_OUT + 2)
    ]
    flat = np.concatenate([z.reshape(-1) for z in drawn])
    assert len(np.unique(flat)) == flat.size


def test_runs_drawn_again_for_every_generation_are_the_same_for_the_same_seed(line):
    scene, wrong = line
    budget = {"evaluations": 150, "runs": 5, "held_out": 20, "seed": 3, "redraw": True}
    one = tk.tune(wrong, scene, BOTH, "nees", **budget)
    equal(one, tk.tune(wrong, scene, BOTH, "nees", **budget))
    kept = tk.tune(wrong, scene, BOTH, "nees", **(budget | {"redraw": False}))
    np.testing.assert_array_equal(one.best[0], kept.best[0])  # the first generation is the same
    assert one.values != kept.values


def test_the_given_numbers_are_the_least_that_is_found(line):
    scene, _ = line
    right = tk.estimator("kf", motion=scene.motion, sensor=scene.sensor)
    result = tk.tune(right, scene, BOTH, "likelihood", evaluations=3, runs=5, held_out=5)
    assert result.cost <= result.training["given"].cost("likelihood")


# ---------------------------------------------------------------------------------- records
def test_a_record_is_tuned_on_its_first_rows_and_told_on_the_rest(line):
    scene, wrong = line
    simulation = scene.simulate(1, 8)
    record, prior, start = simulation.record, simulation.prior, simulation.start
    given = {"prior": prior, "start": start, "evaluations": 200, "seed": 1}
    result = tk.tune(wrong, record, BOTH, "likelihood", held_out=30, **given)
    history = tk.filter(result.estimator, record, prior, start=start)
    per_row = history.innovation.loglik
    for scores, rows in ((result.training, slice(70)), (result.held_out, slice(70, None))):
        wanted = per_row[rows].sum(axis=0)
        np.testing.assert_allclose(scores["tuned"].totals["loglik"][0], wanted, rtol=1e-8)
    assert not result.training["tuned"].offers("rmse")
    told = tk.tune(wrong, record, BOTH, "rmse", truth=simulation.truth, **given)
    assert told.held_out["tuned"].offers("nees")
    assert told.held_out["tuned"].steps == 25
    assert "25 rows held out" in told.summary()


def test_records_of_any_batch_are_tuned_alike(line):
    scene, wrong = line
    simulation = scene.simulate(1, 6)
    results = []
    for shape in ((6,), (2, 3)):
        z = simulation.record.z.reshape(100, 1, *shape)
        prior = tk.Gaussian(
            simulation.prior.mean.reshape(2, *shape), simulation.prior.cov.reshape(2, 2, *shape)
        )
        record = tk.Record(simulation.record.t, z)
        results.append(
            tk.tune(wrong, record, BOTH, "innovation", prior=prior, start=0.0, evaluations=100)
        )
    equal(*results)


# ---------------------------------------------------------------------------------- in words
def test_what_is_learnt_by_heart_is_called_overfitted():
    # Seventeen numbers of a fuzzy system on one short run.
    scene = tk.scenario("line", axes=1, steps=40)
    adapter = FuzzyMeasurementNoise(window=3)
    est = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor, adapter=adapter)
    bounds = {
        f"adapter.{name}": (0.1, 10.0) if "width" in name or name == "scale" else (-10.0, 10.0)
        for name in adapter.parameters
        if name != "floor"
    }
    result = tk.tune(est, scene, bounds, "rmse", evaluations=2000, runs=1, held_out=100, seed=1)
    words = " ".join(result.warnings())
    assert "overfitted: on the runs held out the tuned numbers are worse" in words
    assert "Warning: overfitted" in result.summary()


def test_warnings_name_bounds_inconsistency_and_nothing_held_out(line):
    scene, wrong = line
    result = tk.tune(
        wrong, scene, {"sensor.sigma": (5.0, 9.0)}, "likelihood", evaluations=100, held_out=0
    )
    words = "\n".join(result.warnings())
    assert "sensor.sigma ended at its lower bound" in words
    assert "underconfident: its mean NEES" in words
    assert "nothing was held out" in words
    assert result.held_out == {}


def test_better_consistency_that_is_less_accurate_is_told():
    totals = {
        "squared_error": np.full((1, 9), 100.0) + np.arange(9.0),
        "nees": np.full((1, 9), 400.0),
    }
    worse = {"squared_error": 4.0 * totals["squared_error"], "nees": np.full((1, 9), 200.0)}
    scores = {"given": Score(totals, 100, 2), "tuned": Score(worse, 100, 2)}
    result = tuning.Tuning(
        problem="p", objective="nees", optimiser="O", seed=0,
        numbers=(Tuned("motion.density", 0.1, 1.0, False, 0.2, 0.5),),
        training=scores, held_out=scores, evaluated=np.array([1]), best=np.ones((1, 1)),
        mean=np.ones((1, 1)), settings=np.ones((1, 1)), costs=np.ones(1),
    )  # fmt: skip
    assert any("is not more accurate here" in words for words in result.warnings())


def test_intervals_of_means_are_students(found):
    score = found.held_out["tuned"]
    rmse = np.sqrt(score.totals["squared_error"][0] / score.steps)
    ours, textbook = score.interval("rmse"), mean_interval(rmse)
    np.testing.assert_allclose(
        [ours.value, ours.low, ours.high], [textbook.value, textbook.low, textbook.high], rtol=1e-12
    )
    lone = Score({k: v[:, :1] for k, v in score.totals.items()}, score.steps, score.n)
    assert np.isnan(lone.interval("rmse").low)


def test_lost_runs_are_left_out_of_intervals_and_cost_everything(found):
    score = found.held_out["tuned"]
    hurt = {k: v.copy() for k, v in score.totals.items()}
    hurt["nis"][0, 3] = np.nan
    hurt["loglik"][0, 3] = np.nan
    hurt = Score(hurt, score.steps, score.n)
    assert hurt.lost.sum() == 1
    assert np.isnan(hurt.cost("likelihood"))
    assert np.isfinite(hurt.interval("likelihood").low)


def test_a_candidate_that_loses_a_run_has_the_worst_cost(line):
    scene, wrong = line
    wide = {"motion.density": (1e-3, 1.7e308, "log")}
    result = tk.tune(wrong, scene, wide, evaluations=100, runs=3, held_out=3, seed=1)
    assert np.isfinite(result.cost)
    assert result.values["motion.density"] < 1e100
    with pytest.raises(DomainError, match="no finite cost in 20 evaluations"):
        tk.tune(wrong, scene, {"motion.density": (1.5e308, 1.7e308)}, evaluations=20, runs=3)


def test_a_result_is_kept_in_a_file(found, line, tmp_path):
    again = tk.load_tuning(found.save(tmp_path / "found.npz"))
    assert again.summary() == found.summary()
    assert again.values == found.values
    np.testing.assert_array_equal(again.mean, found.mean)
    assert again.estimator is None
    tuned = again.applied_to(line[1])
    assert tuned.sensors[0].parameters == found.estimator.sensors[0].parameters
    campaign = tk.monte_carlo(tuned, line[0], runs=2).save(tmp_path / "campaign.npz")
    with pytest.raises(ConfigError, match="a tuning"):
        tk.load_tuning(campaign)


# ------------------------------------------------------------------------------- going on
@pytest.mark.parametrize("redraw", [False, True])
def test_a_search_that_is_resumed_equals_one_that_is_not(line, redraw, tmp_path):
    """Cut off within a generation and between two, kept in a file, and gone on with."""
    scene, wrong = line
    swarm = ParticleSwarm(population=8, generations=5)
    options = {"runs": 3, "held_out": 4, "seed": 6, "restarts": 2, "redraw": redraw}
    whole = tk.tune(wrong, scene, BOTH, "rmse", swarm, evaluations=40, **options)
    part = tk.tune(wrong, scene, BOTH, "rmse", swarm, evaluations=11, **options)
    assert part.best.shape[0] == 2
    for budget in (13, 24, 40):
        part = tk.load_tuning(part.save(tmp_path / "part.npz"))
        part = tk.tune(wrong, scene, resume=part, evaluations=budget)
    equal(whole, part)
    for field in ("evaluated", "best", "mean", "settings", "costs"):
        np.testing.assert_array_equal(getattr(whole, field), getattr(part, field), err_msg=field)
    assert part.summary() == whole.summary()


def test_what_is_resumed_brings_its_own_and_wants_what_it_was_given(line, found):
    scene, wrong = line
    for estimator, problem, more, words in (
        (wrong, scene, {"parameters": BOTH}, "leave it out"),
        (wrong, scene, {"seed": 0}, "leave it out"),
        (found.estimator, scene, {}, "not the tuned one"),
        (wrong, attrs.evolve(scene, t=scene.t[:50]), {}, "50 steps"),
        (wrong, scene, {"resume": attrs.evolve(found, search=None)}, "without its search"),
    ):
        with pytest.raises((CapabilityError, DomainError), match=words):
            tk.tune(estimator, problem, **({"resume": found, "evaluations": 1600} | more))


# ------------------------------------------------------------------------- several objectives
@pytest.fixture(scope="module")
def front(line):
    """Of a sensor twice as noisy as told, one density is most accurate, another most honest."""
    scene, _ = line
    scene = attrs.evolve(scene, truth_sensor=scene.sensor.with_parameters(sigma=6.0))
    est = tk.estimator("kf", motion=scene.motion, sensor=scene.sensor)
    bounds = {"motion.density": (1e-3, 10.0, "log")}
    options = {"evaluations": 200, "runs": 10, "held_out": 30, "seed": 1, "restarts": 2}
    nsga = NSGA2(population=20)
    return scene, est, tk.tune(est, scene, bounds, ("rmse", "nees"), nsga, **options)


def test_several_objectives_give_a_front(front):
    scene, est, result = front
    costs = result.costs
    assert costs.shape == (2, len(result.front))
    assert len(result.front) > 5
    # By one number from good to bad: who is better in one objective is worse in the other.
    assert (np.diff(costs[0]) > 0.0).all()
    assert (np.diff(costs[1]) < 0.0).all()
    for k, one in enumerate(result.front):
        mine = [one.training["tuned"].cost(name) for name in ("rmse", "nees")]
        np.testing.assert_array_equal(mine, costs[:, k])
        assert list(one.values.values()) == result.settings[:, k].tolist()
        assert one.estimator.motion.parameters["density"] == one.values["motion.density"]
    for row, name in enumerate(("rmse", "nees")):
        alone = tk.tune(
            est, scene, {"motion.density": (1e-3, 10.0, "log")}, name,
            evaluations=200, runs=10, held_out=0, seed=1,
        )  # fmt: skip
        assert costs[row].min() == pytest.approx(alone.cost, rel=1e-3, abs=1e-3), name
    assert any(one.values == result.values for one in result.front)
    assert all(row.min() < result.training["tuned"].cost(name) < row.max()
               for row, name in zip(costs, ("rmse", "nees"), strict=True))  # fmt: skip


def test_a_front_is_told_kept_in_a_file_and_gone_on_with(front, tmp_path):
    scene, est, result = front
    told = result.summary()
    assert "tuned for 'rmse' and 'nees' by NSGA2, 2 restarts of 200" in told
    assert f"[{len(result.front) - 1}]" in told
    assert told.count("* ") == 2
    again = tk.load_tuning(result.save(tmp_path / "front.npz"))
    assert again.summary() == told
    assert again.front[3].summary() == result.front[3].summary()
    longer = tk.tune(est, scene, resume=again, evaluations=240)
    options = {"evaluations": 240, "runs": 10, "held_out": 30, "seed": 1, "restarts": 2}
    bounds = {"motion.density": (1e-3, 10.0, "log")}
    whole = tk.tune(est, scene, bounds, ("rmse", "nees"), NSGA2(population=20), **options)
    np.testing.assert_array_equal(longer.settings, whole.settings)
    np.testing.assert_array_equal(longer.best, whole.best)


def test_by_name_an_optimiser_of_several_learns_how_many(line):
    scene, wrong = line
    aims = ("rmse", "nees", "innovation")
    result = tk.tune(wrong, scene, BOTH, aims, evaluations=100, runs=3, held_out=0)
    assert result.optimiser == "NSGA2"
    assert result.best.shape == (1, 3, 1)
    alone = tk.tune(wrong, scene, BOTH, ("rmse",), evaluations=20, runs=3, held_out=0)
    assert alone.objective == "rmse"
    assert not alone.front


# ---------------------------------------------------------------------------------- refusals
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"objective": "accuracy"}, "'rmse', 'nees'"),
        ({"parameters": {}}, "nothing to tune"),
        ({"parameters": {"sensor.sigmas": (1.0, 2.0)}}, "write 'sensor.sigma'"),
        ({"parameters": {"sensor.sigma": (2.0, 1.0)}}, "bounds of sensor.sigma"),
        ({"parameters": {"sensor.sigma": (0.0, 1.0, "log")}}, "positive for 'log'"),
        ({"parameters": {"sensor.sigma": 3.0}}, "bounds of sensor.sigma"),
        ({"runs": 0}, "at least one run"),
        ({"evaluations": 0}, "evaluations"),
        ({"optimiser": "nsga2"}, "expected one of a single cost"),
        ({"objective": ("rmse", "nees"), "optimiser": "genetic"}, "expected one of 2 costs"),
        ({"objective": ("rmse", "rmse")}, "'rmse', 'nees'"),
        ({"objective": ()}, "'rmse', 'nees'"),
        ({"problem": "line"}, "a Scenario, or a Record"),
    ],
)
def test_what_makes_no_sense_is_refused_with_what_would(line, change, words):
    scene, wrong = line
    given = {"problem": scene, "parameters": BOTH, "objective": "rmse", "evaluations": 10} | change
    with pytest.raises((CapabilityError, DomainError), match=words):
        tk.tune(wrong, **given)


def test_records_are_refused_without_prior_truth_or_rows(line):
    scene, wrong = line
    simulation = scene.simulate(1, 2)
    record, prior = simulation.record, simulation.prior
    for objective, more, words in (
        ("likelihood", {}, "no prior"),
        ("rmse", {"prior": prior}, "no truth"),
        ("likelihood", {"prior": prior, "held_out": 100}, "fewer rows than there are"),
        ("likelihood", {"prior": prior, "redraw": True}, "a scenario to draw from"),
    ):
        with pytest.raises((CapabilityError, DomainError), match=words):
            tk.tune(wrong, record, BOTH, objective, evaluations=10, **more)
