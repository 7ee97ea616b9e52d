"""Scenarios, keyed randomness, Monte Carlo campaigns: reproducible, groupable, honest in words."""

import pickle

import attrs
import numpy as np
import pytest
from scipy import stats

import tracker as tk
from tracker.errors import CapabilityError, ConfigError, DomainError, ShapeError, UnknownComponent
from tracker.metrics.bounds import scenario_bound
from tracker.metrics.consistency import chi_square_band, mean_interval, nees
from tracker.simulation import stream
from tracker_motion.constant_velocity import constant_velocity
from tracker_sensors.azimuth import azimuth
from tracker_sensors.observer_paths import Straight
from tracker_sensors.range_only import range_only
from tracker_sensors.stack import stack


@pytest.fixture(scope="module")
def scene():
    return tk.scenario("two_stations", steps=30)


@pytest.fixture(scope="module")
def est(scene):
    return tk.estimator(motion=scene.motion, sensor=scene.sensor, smoother="rts")


# -------------------------------------------------------------------------------- simulation
def test_one_run_can_be_remade_alone(scene):
    many, alone = scene.simulate(7, 50), scene.simulate(7, [31])
    np.testing.assert_array_equal(alone.truth[..., 0], many.truth[..., 31])
    np.testing.assert_array_equal(alone.record.z[..., 0], many.record.z[..., 31])
    np.testing.assert_array_equal(alone.prior.mean[:, 0], many.prior.mean[:, 31])


def test_runs_conditions_and_seeds_are_different_worlds(scene):
    base = scene.simulate(7, 2)
    for other in (
        scene.simulate(8, 2),
        scene.simulate(7, 2, condition=1),
        scene.simulate(7, [5, 6]),
    ):
        assert not (other.record.z == base.record.z).any()


def test_components_of_randomness_do_not_share_a_stream():
    draws = {name: stream(1, 0, name).standard_normal() for name in ("initial", "process", "prior")}
    assert len(set(draws.values())) == 3


def test_the_estimator_never_changes_what_is_simulated(scene):
    # missing measurements leave truth and the other measurements as they were
    gaps = tk.scenario("two_stations", steps=30, detection_probability=0.7)
    full, holes = scene.simulate(3, 40), gaps.simulate(3, 40)
    seen = ~np.isnan(holes.record.z)
    np.testing.assert_array_equal(holes.record.z[seen], full.record.z[seen])
    # 2,400 trials: a share outside 0.7 +- 0.05 has probability below 1e-7
    assert abs(seen.mean() - 0.7) < 0.05


def test_truth_from_prior_has_the_moments_of_the_prior():
    scene = tk.scenario("line", steps=1)
    scene = attrs.evolve(scene, t=np.array([1e-9]))
    x = scene.simulate(1, 4000).truth[0]
    # z-scores of two means, false alarm 1e-6 each
    z = x.mean(axis=1) / np.sqrt(np.diag(scene.prior.cov) / 4000)
    assert (np.abs(z) < 4.9).all()
    ratio = x.var(axis=1) / np.diag(scene.prior.cov)
    low, high = stats.chi2.ppf([5e-7, 1 - 5e-7], 3999) / 3999
    assert ((low < ratio) & (ratio < high)).all()


def test_prior_around_truth_keeps_the_truth_and_draws_the_belief():
    scene = tk.scenario("moving_observer", initial="prior around truth")
    simulation = scene.simulate(1, 100)
    start = simulation.truth[0, :2] - 10.0 * simulation.truth[0, 2:]
    np.testing.assert_allclose(start.T, np.tile([6000.0, 5000.0], (100, 1)))
    # five standard errors of a standard deviation: false alarm below 1e-6
    np.testing.assert_allclose(simulation.truth[0, 2:].std(axis=1), 5.0, rtol=5.0 / np.sqrt(200))
    assert simulation.prior.mean[0].std() > 1000


def test_simulated_angles_are_wrapped(scene):
    z = tk.scenario("two_stations", steps=200, sigma=1.0).simulate(1, 20).record.z
    assert (z > -np.pi).all()
    assert (z <= np.pi).all()


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"initial": "somehow"}, DomainError, "truth from prior"),
        ({"initial": "fixed", "start": None}, DomainError, "true initial state"),
        ({"prior_time": 99.0}, DomainError, "not after"),
        ({"start": np.zeros(3)}, ShapeError, "'start'"),
        ({"path": np.zeros((2, 4))}, ShapeError, "one row per measurement time"),
        ({"detection_probability": 1.5}, DomainError, "probability"),
        ({"prior": tk.Gaussian([0.0], [[1.0]])}, ShapeError, "prior"),
        ({"truth_sensor": azimuth(0.1).at(sx=0.0, sy=0.0)}, ShapeError, "truth_sensor"),
    ],
)
def test_a_wrong_scenario_says_what_to_do(scene, change, error, words):
    with pytest.raises(error, match=words):
        attrs.evolve(scene, **change)


def test_a_fixed_path_is_followed_exactly(scene):
    path = np.outer(np.arange(30.0), [1.0, 2.0, 0.0, 0.0])
    truth = attrs.evolve(scene, path=path).simulate(1, 3).truth
    np.testing.assert_array_equal(truth[..., 1], path)


def test_what_is_measured_has_the_noise_of_the_true_sensor_and_the_estimator_is_not_told(scene):
    places = ({"sx": 1.0, "sy": 1.0}, {"sx": 4.0, "sy": 1.1})
    told = stack([azimuth(0.01).at(**place) for place in places])
    true = stack([azimuth(sigma).at(**p) for sigma, p in zip((0.2, 0.05), places, strict=True)])
    made = attrs.evolve(scene, sensor=told, truth_sensor=true)
    runs = made.simulate(3, 200)
    off = told.residual(np.asarray(runs.record.z)[0], told.h(runs.truth[0]))
    # 200 normals each: five standard errors of a standard deviation, false alarm below 1e-6
    np.testing.assert_allclose(off.std(axis=1), [0.2, 0.05], rtol=5.0 / np.sqrt(400))
    assert made.true_sensor is made.truth_sensor
    assert scene.true_sensor is scene.sensor
    np.testing.assert_array_equal(made.sensor.R(runs.truth[0])[..., 0], 1e-4 * np.eye(2))


def test_the_bound_of_a_scenario_is_that_of_the_noise_there_is(scene):
    coarse = attrs.evolve(scene, sensor=scene.sensor.with_parameters(sigma_1=9.0, sigma_2=9.0))
    same_truth = attrs.evolve(coarse, truth_sensor=scene.sensor)
    np.testing.assert_array_equal(
        scenario_bound(same_truth, runs=4).cov, scenario_bound(scene, runs=4).cov
    )


def test_a_pose_may_be_a_path_of_an_observer():
    path = Straight((1.0, 2.0), (0.5, 0.0))
    scene = tk.scenario("moving_observer")
    moved = attrs.evolve(scene, pose=path)
    np.testing.assert_array_equal(moved.pose, path.pose(scene.t).T)
    np.testing.assert_array_equal(moved.simulate(1).record.pose, moved.pose)
    with pytest.raises(ShapeError, match="pose"):
        attrs.evolve(scene, pose=Straight((1.0, 2.0, 3.0)))


# --------------------------------------------------------------------------------- campaigns
def same(a, b):
    for stage in ("filter", "smoother"):
        for group in ("per_run", "per_step"):
            left = getattr(a.scores["estimator"][stage], group)
            right = getattr(b.scores["estimator"][stage], group)
            for name in left:
                np.testing.assert_array_equal(left[name], right[name], err_msg=f"{stage} {name}")


def test_chunks_and_workers_change_no_bit(est, scene):
    base = tk.monte_carlo(est, scene, runs=100, seed=5)
    same(base, tk.monte_carlo(est, scene, runs=100, seed=5, chunk=32))
    same(base, tk.monte_carlo(est, scene, runs=100, seed=5, chunk=33, workers=2))


def test_more_runs_repeat_the_first_ones(est, scene):
    few, many = (tk.monte_carlo(est, scene, runs=n, seed=5) for n in (33, 65))
    for name, value in few.scores["estimator"]["filter"].per_run.items():
        np.testing.assert_array_equal(value, many.scores["estimator"]["filter"].per_run[name][:33])


def test_a_single_run_has_the_bits_that_it_has_in_company(est, scene):
    one, many = (tk.monte_carlo(est, scene, runs=n, seed=5) for n in (1, 40))
    for name, value in one.scores["estimator"]["smoother"].per_run.items():
        np.testing.assert_array_equal(value, many.scores["estimator"]["smoother"].per_run[name][:1])


def test_reductions_equal_the_scores_of_the_histories(est, scene):
    campaign = tk.monte_carlo(est, scene, runs=20, seed=5)
    simulation = scene.simulate(5, 20)
    history = tk.smooth(est, simulation.record, simulation.prior, start=simulation.start)
    errors = history.smoothed.mean - simulation.truth
    squared = (errors[:, :2] ** 2).sum(axis=1)
    scores = campaign.scores["estimator"]["smoother"]
    np.testing.assert_allclose(scores.per_run["rmse"], np.sqrt(squared.mean(axis=0)))
    np.testing.assert_allclose(scores.per_step["squared_error"], squared.mean(axis=1))
    P = np.moveaxis(history.smoothed.cov, (1, 2), (-2, -1))
    e = np.moveaxis(errors, 1, -1)
    direct = np.einsum("tri,tri->tr", e, np.linalg.solve(P, e[..., None])[..., 0])
    np.testing.assert_allclose(scores.per_step["nees"], direct.mean(axis=1), rtol=1e-7)


def test_estimators_in_one_campaign_see_the_same_measurements(scene, est):
    other = tk.estimator("ekf1_joseph", motion=scene.motion, sensor=scene.sensor)
    campaign = tk.monte_carlo({"a": est, "b": other}, scene, runs=30, seed=2)
    a, b = (campaign.scores[k]["filter"].per_run["rmse"] for k in "ab")
    np.testing.assert_allclose(a, b, rtol=1e-6)
    assert set(campaign.scores["a"]) == {"filter", "smoother"}
    assert set(campaign.scores["b"]) == {"filter"}


def test_a_campaign_survives_a_file(tmp_path, est, scene):
    campaign = tk.monte_carlo(est, scene, runs=10, seed=2)
    loaded = tk.load_campaign(campaign.save(tmp_path / "campaign.npz"))
    same(campaign, loaded)
    assert loaded.summary() == campaign.summary()
    (tmp_path / "other.npz").write_bytes(b"nothing")
    with pytest.raises(ConfigError):
        tk.load_campaign(tmp_path / "other.npz")


def test_the_summary_warns_in_words_of_an_overconfident_filter():
    scene = tk.scenario("moving_observer")
    est = tk.estimator(motion=scene.motion, sensor=scene.sensor)
    text = tk.monte_carlo(est, scene, runs=64, seed=1).summary()
    assert "overconfident" in text
    assert "diverged in" in text


def test_the_summary_of_a_consistent_filter_warns_of_nothing():
    scene = tk.scenario("line", steps=40)
    est = tk.estimator("kf", motion=scene.motion, sensor=scene.sensor, smoother="rts")
    campaign = tk.monte_carlo(est, scene, runs=200, seed=1)
    assert "Warning" not in campaign.summary()
    assert "NIS" not in campaign.summary("rmse")
    with pytest.raises(UnknownComponent, match="rmse, nees"):
        campaign.summary("speed")


@pytest.mark.parametrize("argument", ["runs", "workers", "chunk"])
def test_counts_below_one_are_refused(est, scene, argument):
    with pytest.raises(DomainError, match=argument):
        tk.monte_carlo(est, scene, **{argument: -1})


def test_an_estimator_of_other_measurements_or_states_is_refused(scene):
    line = tk.scenario("line", steps=3)
    position = line.sensor
    planar = tk.scenario("moving_observer")
    for motion, sensor, where, words in (
        (line.motion, stack([position, position]), line, "2 components"),
        (planar.motion, range_only(1.0), planar, r"range \[m\]"),
        (planar.motion, azimuth(0.1), line, "x, y, vx, vy"),
    ):
        with pytest.raises(CapabilityError, match=words):
            tk.monte_carlo(tk.estimator(motion=motion, sensor=sensor), where, runs=2)
    needs_a_pose = tk.estimator(motion=scene.motion, sensor=stack([azimuth(0.1), azimuth(0.1)]))
    with pytest.raises(ShapeError, match="pose"):
        tk.monte_carlo(needs_a_pose, scene, runs=2)


def test_a_scenario_without_steps_has_nothing_to_score(est, scene):
    with pytest.raises(DomainError, match="no measurement times"):
        tk.monte_carlo(est, attrs.evolve(scene, t=[], path=None), runs=2)


def test_a_campaign_in_which_every_run_diverged_is_not_called_underconfident():
    at = np.array([3.0, 4.0, 0.0, 0.0])
    sensor = range_only(1.0).at(sx=0.0, sy=0.0)
    blind = tk.Scenario(  # no direction at the place of the sensor: derivatives are NaN
        name="blind", motion=constant_velocity(0.1), sensor=sensor, t=[0.0, 1.0],
        prior=tk.Gaussian(np.zeros(4), np.zeros((4, 4))), initial="fixed", start=at,
    )  # fmt: skip
    est = tk.estimator(motion=blind.motion, sensor=sensor)
    campaign = tk.monte_carlo(est, blind, runs=3)
    assert [w for w in campaign.warnings() if "confident" in w] == []
    assert "3 of 3" in campaign.summary()


def test_a_smoother_has_no_innovations(est, scene):
    scores = tk.monte_carlo(est, scene, runs=3).scores["estimator"]["smoother"]
    for name in ("nis", "count", "loglik"):
        assert np.isnan(scores.per_run[name]).all(), name


def test_runs_may_be_counted_by_a_numpy_integer(scene):
    assert scene.simulate(1, np.int64(3)).runs == (0, 1, 2)


def test_estimators_and_scenarios_travel_to_other_processes(est, scene):
    again, back = pickle.loads(pickle.dumps((est, scene)))
    same(tk.monte_carlo(est, scene, runs=5), tk.monte_carlo(again, back, runs=5))


# ------------------------------------------------------------------------------- consistency
def test_bands_hold_what_they_promise():
    band = chi_square_band(3 * 50, 0.9, per=50)
    rng = np.random.default_rng(1)
    means = rng.chisquare(3, size=(4000, 50)).mean(axis=1)
    share = ((band.low <= means) & (means <= band.high)).mean()
    assert abs(share - 0.9) < 0.025  # 5.3 standard errors: false alarm about 1e-7


@pytest.mark.parametrize(
    ("mean", "verdict"),
    [(3.0, "consistent"), (30.0, "overconfident"), (0.1, "underconfident"), (np.nan, "undefined")],
)
def test_a_band_gives_its_verdict_in_a_word(mean, verdict):
    assert chi_square_band(300, per=100).verdict(mean) == verdict


def test_confidence_intervals_cover_and_leave_nan_out():
    rng = np.random.default_rng(2)
    hits = 0
    for _ in range(2000):
        interval = mean_interval(np.append(rng.standard_normal(8) + 5, np.nan))
        hits += interval.low <= 5 <= interval.high
    assert abs(hits / 2000 - 0.95) < 0.03  # 6 standard errors
    assert np.isnan(mean_interval([np.nan]).value)


def test_nees_of_a_singular_direction_counts_nothing():
    cov = np.zeros((1, 2, 2, 1))
    cov[0, 0, 0] = 4.0
    assert nees(np.array([[[2.0], [0.0]]]), cov)[0, 0] == pytest.approx(1.0)


def test_a_report_is_one_page_that_loads_nothing(tmp_path, est, scene):
    campaign = tk.monte_carlo(est, scene, runs=20, seed=2)
    page = campaign.report(tmp_path / "deep" / "report.html").read_text()
    assert "default-src 'none'" in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "constant_velocity" in page  # cited
    assert campaign.plot().axes[0].get_ylabel() == "position RMSE [m]"


def test_an_estimator_cites_the_components_it_was_given_by_name_or_as_objects(est):
    lines = est.cite().split("\n")
    assert [line.split(":")[0] for line in lines] == [
        "motion constant_velocity",
        "sensor stack",
        "sensor azimuth",
        "filter ekf1",
        "smoother rts",
        "paper 0",
        "paper 2",
        "paper 3",
        "paper 4",
    ]
    assert "paper 0, eq. 24" in lines[4]


def test_a_scenario_by_its_name_alone_is_refused_in_words():
    scene = tk.scenario("two_stations", steps=2)
    estimator = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor)
    with pytest.raises(CapabilityError, match="a Scenario"):
        tk.monte_carlo(estimator, "two_stations")


def test_ratios_tell_a_difference_that_is_no_chance_and_draw_it():
    # Twenty runs of the same filter told wrongly: its median is 1.2 times as large or more, and the same
    # runs leave no doubt of it; an estimator over itself is exactly 1.
    scene = tk.scenario("line", axes=1)
    built = {
        "right": tk.estimator("kf", motion=scene.motion, sensor=scene.sensor),
        "wrong": tk.estimator(
            "kf", motion=scene.motion, sensor=scene.sensor.with_parameters(sigma=90.0)
        ),
        "again": tk.estimator("kf", motion=scene.motion, sensor=scene.sensor),
    }
    campaign = tk.monte_carlo(built, scene, runs=20, seed=3)
    found = campaign.ratios("right")
    assert found["again"] == found["right"] == attrs.evolve(found["right"], value=1.0)
    assert found["wrong"].low > 1.0
    middle = [np.median(campaign.scores[name]["filter"].per_run["rmse"]) for name in built]
    assert found["wrong"].value == pytest.approx(middle[1] / middle[0])
    drawn = campaign.plot_ratios("right").axes[0]
    assert [label.get_text() for label in drawn.get_yticklabels()] == ["wrong", "again"]
    far = campaign.plot_ratios("right", limits=(0.4, 0.9), colours={"wrong": "red"}).axes[0]
    assert far.texts[0].get_color() == "red"
    assert far.texts[0].get_text().startswith(f"{found['wrong'].value:.0f}")
    for given in (("nobody",), ("right", "beauty"), ("right", "rmse", "smoother")):
        with pytest.raises(UnknownComponent, match="there are"):
            campaign.ratios(*given)


def test_an_estimator_that_most_runs_lose_is_called_lost():
    """The second-order filter on growth is wrong by 1e80: half the runs are below the median of that."""
    scene = tk.scenario("growth")
    named = {n: tk.estimator(n, motion=scene.motion, sensor=scene.sensor) for n in ("ekf2", "ukf")}
    campaign = tk.monte_carlo(named, scene, runs=60, seed=0)
    ekf2, ukf = (campaign.scores[name]["filter"] for name in named)
    assert ekf2.percentile("rmse", 10)[0] > 1e20
    assert ekf2.diverged.sum() > 55
    assert ekf2.lost
    assert not ukf.lost
    of_ekf2 = [words for words in campaign.warnings() if words.startswith("ekf2")]
    assert of_ekf2[0].startswith(f"ekf2 (filter) is lost: {ekf2.diverged.sum()} of 60")
    assert len(of_ekf2) == 1, "nothing else is said of it"


def test_how_far_a_run_comes_is_measured_from_its_prior(tmp_path):
    scene = tk.scenario("two_stations", steps=40)
    estimator = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor, smoother="rts")
    campaign = tk.monte_carlo({"ekf1": estimator}, scene, runs=40, seed=3)
    runs = scene.simulate(3, 40)
    mean = runs.prior.mean.reshape(4, -1)
    away = np.hypot(runs.truth[:, 0] - mean[0], runs.truth[:, 1] - mean[1]).max(axis=0)
    for stage in ("filter", "smoother"):
        reach = campaign.scores["ekf1"][stage].per_run["reach"]
        assert (reach >= away - 1e-12).all()
        assert (reach <= np.maximum(away, 10.0)).all()
    campaign.save(tmp_path / "campaign.npz")
    again = tk.load_campaign(tmp_path / "campaign.npz").scores["ekf1"]["filter"]
    np.testing.assert_array_equal(again.diverged, campaign.scores["ekf1"]["filter"].diverged)
    older = attrs.evolve(again, per_run={k: v for k, v in again.per_run.items() if k != "reach"})
    assert older.diverged.shape == (40,)
