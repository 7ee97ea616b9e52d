"""What a run and a campaign say of themselves: whiteness, observability, and warnings in words."""

import attrs
import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

import tracker as tk
from tracker.errors import CapabilityError, DomainError, ShapeError
from tracker.metrics.bounds import posterior_bound, scenario_bound
from tracker.metrics.consistency import whiteness
from tracker.metrics.noise import measurement_noise
from tracker.metrics.observability import (
    noise_free_path,
    observability,
    observability_matrix,
    scenario_observability,
)
from tracker.testing.textbook import ABSCISSA
from tracker_motion import constant_velocity, coordinated_turn
from tracker_sensors import azimuth, position, range_azimuth, stack

WALK = constant_velocity(0.5)
FIX = position(3.0)


def walking(steps=200, probability=1.0, density=0.5):
    return tk.Scenario(
        name="walking",
        motion=constant_velocity(density),
        sensor=FIX,
        prior=tk.Gaussian(np.zeros(4), np.diag([100.0, 100.0, 10.0, 10.0])),
        t=np.arange(1.0, steps + 1.0),
        detection_probability=probability,
    )


def run_of(scene, motion=None, runs=300, seed=5, rule="kf"):
    made = scene.simulate(seed, runs)
    est = tk.estimator(rule, motion=motion or scene.motion, sensor=scene.sensor)
    return tk.filter(est, made.record, made.prior, start=made.start)


# ------------------------------------------------------------------------ noise that was used
def test_the_noise_of_a_run_is_the_sensor_s_own_where_nobody_adapts_it():
    whole = run_of(walking(20), runs=3)
    np.testing.assert_allclose(
        whole.measurement_noise(), np.eye(2)[..., None] * np.full((20, 1, 1, 3), 9.0)
    )
    for name in ("underwater_multipath", "underwater_angles"):
        scene = tk.scenario(name, steps=30)
        history = run_of(scene, runs=2, rule="ekf1")
        pose = None if scene.pose is None else scene.pose[0]
        R = scene.sensor.R(scene.prior.mean, pose)
        np.testing.assert_allclose(
            history.measurement_noise(),
            np.broadcast_to(R[..., None], (30, 4, 4, 2)),
            rtol=1e-6,
            atol=1e-12,
        )
        np.testing.assert_array_equal(
            measurement_noise(history, 10), history.measurement_noise()[10:]
        )


def test_the_noise_of_an_adapted_run_is_what_the_adapter_made_of_it():
    scene = tk.scenario("flying_object")
    made = scene.simulate(1, 20)
    est = tk.estimator("kf", motion=scene.motion, sensor=scene.sensor, adapter="sage_husa")
    R = tk.filter(est, made.record, made.prior, start=made.start).measurement_noise()
    np.testing.assert_allclose(R[0, [0, 1], [0, 1]], np.repeat([[8.0], [1.0]], 20, axis=1))
    # true are 0.8 and 9; 20 runs with a memory of some 50 squares: a standard error of 5 %
    np.testing.assert_allclose(R[-1, [0, 1], [0, 1]].mean(axis=1), (0.8, 9.0), rtol=0.25)


def test_a_history_that_does_not_know_its_record_cannot_tell_the_noise():
    with pytest.raises(CapabilityError, match="by itself"):
        attrs.evolve(run_of(walking(5), runs=2), run=None).measurement_noise()


# -------------------------------------------------------------------------------- whiteness
@pytest.mark.statistical
@pytest.mark.parametrize("probability", [1.0, 0.7])
@pytest.mark.parametrize("steps", [50, 200])
def test_innovations_of_a_matched_filter_are_white(steps, probability):
    # 2,000 p-values that should be uniform: their mean has standard deviation 1 / sqrt(12 * 2000).
    found = whiteness(run_of(walking(steps, probability), runs=2000).innovation)
    assert (found.degrees == 20).all()
    share = 4.9 / np.sqrt(12 * 2000)  # false alarm 1e-6
    assert abs(found.probability.mean() - 0.5) < share
    # Each is below 1 % in 1 % of runs, a little more in short ones: 2 % would be 4.5 deviations.
    assert (found.probability < 0.01).mean() < 0.02


def test_noise_that_is_too_small_or_too_large_colours_the_innovations():
    timid = whiteness(run_of(walking(), constant_velocity(0.05), runs=50).innovation)
    bold = whiteness(run_of(walking(), constant_velocity(10.0), runs=50).innovation)
    assert (timid.probability < 1e-3).mean() > 0.9
    assert (bold.probability < 1e-3).mean() > 0.9
    assert timid.together.correlations[0] > 0.2
    assert bold.together.correlations[0] < -0.2


def test_whiteness_of_a_lane_does_not_depend_on_the_others():
    history = run_of(walking(60, 0.8), runs=6)
    whole = whiteness(history.innovation)
    fields = {k: v[..., 3] for k, v in attrs.asdict(history.innovation, recurse=False).items()}
    alone = whiteness(tk.Innovation(**fields))
    assert alone.statistic == pytest.approx(whole.statistic[3], rel=1e-12)
    assert alone.probability == pytest.approx(whole.probability[3], rel=1e-9)


# ----------------------------------------------------------------------------- observability
def test_the_matrix_is_that_of_the_textbook():
    F = np.eye(4) + np.eye(4, k=2) * 2.0
    H = np.eye(2, 4)
    expected = np.vstack([H @ np.linalg.matrix_power(F, k) for k in range(4)])
    found = observability_matrix(WALK, FIX, np.zeros(4), 2.0)
    np.testing.assert_array_equal(found, expected)
    assert observability_matrix(WALK, FIX, np.zeros((4, 3, 2)), 2.0).shape == (8, 4, 3, 2)
    velocity = tk.sensors.make("position_velocity", sigma=1.0, sigma_velocity=1.0)
    assert observability_matrix(WALK, velocity, np.zeros(4), 1.0, steps=1).shape == (4, 4)


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), batch=st.sampled_from([(), (3,), (2, 2)]))
def test_information_is_that_of_the_least_squares_problem(seed, batch):
    # The Hessian of half the squared, weighted residuals, by differences of the first state.
    rng = np.random.default_rng(seed)
    motion = coordinated_turn(0.1, 0.01)
    sensor = stack([azimuth(0.02).at(sx=0.0, sy=0.0), range_azimuth(2.0, 0.05)]).over(motion.space)
    t = np.cumsum(rng.uniform(0.1, 1.0, 8))
    pose = rng.normal(0.0, 20.0, (8, 2))
    first = np.array([50.0, 60.0, 3.0, -2.0, 0.1]).reshape(5, *(1,) * len(batch))
    first = first + rng.normal(0.0, 1.0, (5, *batch))
    seen = rng.uniform(size=(8, 3, *batch)) < 0.8

    def path(x):
        out = [x]
        for k in range(1, 8):
            out.append(motion.f(out[-1], t[k] - t[k - 1]))
        return np.stack(out)

    states = path(first)
    found = observability(motion, sensor, t, states, np.eye(5), pose=pose, measured=seen)
    for lane in list(np.ndindex(*batch))[:2]:
        rows = []
        for j in range(5):
            step = np.zeros(5)
            step[j] = 1e-5
            up, down = path(first[(..., *lane)] + step), path(first[(..., *lane)] - step)
            part = [
                sensor.residual(sensor.h(up[k], pose[k]), sensor.h(down[k], pose[k])) / 2e-5
                for k in range(8)
            ]
            rows.append(np.stack(part))
        J = np.stack(rows, axis=-1) / np.array([0.02, 2.0, 0.05])[:, None]
        J = J * seen[(..., *lane)][..., None]
        expected = np.einsum("kmi,kmj->ij", J, J)
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        assert (np.abs(found.information[(..., *lane)] - expected) < 1e-6 * scale + 1e-12).all()


def test_the_gramian_weighs_all_measurements_alike():
    t, states = np.arange(4.0), np.zeros((4, 4))
    matrix = observability_matrix(WALK, FIX, np.zeros(4), 1.0)
    found = observability(WALK, FIX, t, states, np.eye(4), weighted=False)
    np.testing.assert_allclose(found.information, matrix.T @ matrix, rtol=1e-12)
    assert found.rank == 4
    ratios = np.linalg.eigvalsh(matrix.T @ matrix)
    assert found.condition == pytest.approx(ratios[-1] / ratios[0], rel=1e-9)


def test_a_noise_free_path_leads_to_where_it_must():
    motion = coordinated_turn(0.1, 0.01)
    t = np.linspace(0.0, 5.0, 11)
    start = np.array([[1.0, 2.0, 3.0, 4.0, 0.2], [5.0, 0.0, -1.0, 2.0, -0.3]]).T
    states = [start]
    for k in range(10):
        states.append(motion.f(states[-1], t[k + 1] - t[k]))
    true = np.stack(states)
    guess = true + 0.1 * np.random.default_rng(0).normal(size=true.shape)
    guess[-1] = true[-1]
    np.testing.assert_allclose(noise_free_path(motion, t, guess), true, rtol=1e-9, atol=1e-9)


def test_one_bearing_from_a_straight_observer_does_not_show_the_range():
    straight = scenario_observability(tk.scenario("moving_observer", path="straight"))
    weaving = scenario_observability(tk.scenario("moving_observer", path="manoeuvring"))
    assert (straight.rank == 3).all()
    assert straight.along_sight[0].all()
    assert (weaving.rank == 4).all()
    assert (weaving.ratios[0] > 10.0).all()
    # The direction is the one that theory names: position and velocity relative to the observer.
    scene = tk.scenario("moving_observer", path="straight")
    x = scene.simulate(0, 8).truth[0] - np.array([0.0, 50.0, 0.0, 5.0])[:, None]
    change = straight.directions[:, 0]
    unit = np.sqrt((x[:2] ** 2).sum(axis=0)), np.sqrt((change[:2] ** 2).sum(axis=0))
    np.testing.assert_allclose(np.abs(x / unit[0]), np.abs(change / unit[1]), rtol=0, atol=1e-5)


def test_along_estimates_there_seems_to_be_information_where_there_is_none():
    scene = tk.scenario("moving_observer", path="straight")
    history = run_of(scene, runs=8, rule="ekf1")
    arguments = (scene.motion, scene.sensor, scene.t)
    scale = history.predicted.cov[0]
    along = observability(*arguments, history.filtered.mean, scale, pose=scene.pose)
    path = noise_free_path(scene.motion, scene.t, history.filtered.mean)
    honest = observability(*arguments, path, scale, pose=scene.pose)
    assert (along.ratios[0] > 0.1).all()
    assert (np.abs(honest.ratios[0]) < 1e-6).all()


def test_a_component_that_nothing_measures_is_named():
    t, states = np.arange(5.0), np.zeros((5, 4))
    sensor = ABSCISSA
    found = observability(WALK, sensor, t, states, np.diag([4.0, 9.0, 1.0, 1.0]))
    words = found.words()
    assert found.rank == 2
    assert len(words) == 2
    assert "direction of the state is unobservable" in words[0]
    assert {w.split("(")[1].split()[0] for w in words} == {"y", "vy"}


def test_what_the_prior_knows_exactly_needs_no_measurement():
    t, states = np.arange(5.0), np.zeros((5, 4))
    sensor = ABSCISSA
    found = observability(WALK, sensor, t, states, np.diag([4.0, 0.0, 1.0, 0.0]))
    assert found.words() == ()
    assert found.rank == 4
    assert np.isinf(found.ratios[-2:]).all()


def test_a_lane_that_is_not_finite_says_nothing_and_harms_none():
    states = np.zeros((5, 4, 2))
    states[3, 0, 1] = np.nan
    sensor = range_azimuth(1.0, 0.1).at(sx=5.0, sy=5.0)
    found = observability(WALK, sensor, np.arange(5.0), states, np.eye(4))
    assert np.isfinite(found.ratios[:, 0]).all()
    assert np.isnan(found.ratios[:, 1]).all()
    assert found.words((1,)) == ()


# ---------------------------------------------------------------------------- runs in words
def test_a_matched_run_is_warned_of_nothing():
    history = run_of(walking(), runs=20)
    assert history.warnings() == []
    told = history.summary()
    assert "consistent" in told
    assert "rank 4 of 4" in told


@pytest.mark.parametrize("batch", ["one run", "lanes"])
def test_every_summary_of_a_straight_observer_says_that_the_range_is_unobservable(batch):
    scene = tk.scenario("moving_observer", path="straight")
    made = scene.simulate(3, 20)
    est = tk.estimator("ekf1", motion=scene.motion, sensor=scene.sensor, smoother="rts")
    record, prior = made.record, made.prior
    if batch == "one run":
        record = tk.Record(record.t, record.z[..., 4], pose=record.pose)
        prior = prior[4]
    for run in (tk.filter, tk.smooth):
        history = run(est, record, prior, start=made.start)
        assert "the range is unobservable" in history.summary()
    one = tk.Record(made.record.t, made.record.z[..., :1], pose=made.record.pose)
    assert "range is unobservable" in tk.smooth(est, one, made.prior[..., :1], start=0.0).summary()


@pytest.mark.parametrize("rule", ["ukf", "ckf", "range_parameterised", "gaussian_sum", "bootstrap"])
def test_whatever_the_filter_the_range_is_unobservable(rule):
    scene = tk.scenario("moving_observer", path="straight")
    made = scene.simulate(3, 4)
    est = tk.estimator(rule, motion=scene.motion, sensor=scene.sensor)
    random = {"rng": np.random.default_rng(1)} if rule == "bootstrap" else {}
    history = tk.filter(est, made.record, made.prior, start=made.start, **random)
    assert "the range is unobservable" in history.summary()


def test_a_campaign_says_that_the_range_is_unobservable_and_says_so_again_when_loaded(tmp_path):
    scene = tk.scenario("moving_observer", path="straight")
    built = {
        name: tk.estimator(name, motion=scene.motion, sensor=scene.sensor)
        for name in ("ekf1", "ukf")
    }
    campaign = tk.monte_carlo(built, scene, runs=32, seed=1)
    told = campaign.summary()
    assert told.count("the range is unobservable") == 1
    assert "overconfident" in told
    assert "the range is unobservable" in campaign.summary("rmse")
    again = tk.load_campaign(campaign.save(tmp_path / "campaign.npz"))
    assert again.unobservable == campaign.unobservable
    assert again.summary() == told
    other = tk.scenario("moving_observer", path="manoeuvring")
    assert not tk.monte_carlo(built["ekf1"], other, runs=32, seed=1).unobservable


def test_timid_and_bold_filters_are_called_what_they_are():
    timid = run_of(walking(), constant_velocity(0.05), runs=50).warnings()
    bold = run_of(walking(), constant_velocity(10.0), runs=50).warnings()
    assert timid[0].startswith("overconfident: mean NIS is")
    assert "motion is more restless" in timid[1]
    assert bold[0].startswith("underconfident: mean NIS is")
    assert "follows noise" in bold[1]


def test_a_run_that_diverged_says_so():
    record = tk.Record(np.arange(6.0), np.zeros((6, 2, 3)))
    est = tk.estimator("kf", motion=WALK, sensor=FIX)
    prior = tk.Gaussian(np.zeros((4, 3)), np.eye(4))
    prior.mean[:, 1] = np.nan
    told = tk.filter(est, record, prior).warnings()
    assert told[0].startswith("1 of 3 lanes diverged")


@pytest.mark.parametrize("batch", [(), (3,), (3, 2)], ids=str)
@pytest.mark.parametrize(
    "rule", ["kf", "ekf1", "ukf", "strong_tracking", "smooth_variable_structure"]
)
def test_a_run_that_lost_its_digits_is_told_so_and_what_to_do(rule, batch):
    z = np.random.default_rng(2).normal(0.0, 1.0, (6, 2, *batch))
    vague = np.zeros(batch)
    if batch:
        vague[1] = 1.0
    cov = np.einsum("ij,...->ij...", np.eye(4), np.where(vague, 1e20, 1.0) if batch else 1e20)
    prior = tk.Gaussian(np.zeros((4, *batch)), cov)
    est = tk.estimator(rule, motion=WALK, sensor=position(0.01))
    told = tk.filter(est, tk.Record(np.arange(6.0), z), prior).warnings()
    what = {(): "the run", (3,): "1 of 3 lanes", (3, 2): "2 of 6 lanes"}[batch]
    assert told[0].startswith(f"{what} lost all digits: an update, first at step 0,")
    assert "ekf1_joseph" in told[0]
    assert not any("diverged" in words for words in told)


def test_both_ways_of_getting_lost_are_told_apart():
    record = tk.Record(np.arange(6.0), np.random.default_rng(2).normal(0.0, 1.0, (6, 2, 3)))
    prior = tk.Gaussian(np.zeros((4, 3)), np.eye(4))
    prior.mean[:, 1] = np.nan
    prior = tk.Gaussian.trusted(prior.mean, prior.cov * np.array([1.0, 1.0, 1e20]))
    est = tk.estimator("kf", motion=WALK, sensor=position(0.01))
    told = tk.filter(est, record, prior).warnings()
    assert told[0].startswith("1 of 3 lanes lost all digits")
    assert told[1].startswith("1 of 3 lanes diverged")


def test_a_history_made_by_hand_is_summed_up_as_far_as_it_goes():
    history = attrs.evolve(run_of(walking(30), runs=2), run=None)
    assert "unknown: no record" in history.summary()


@pytest.mark.parametrize("batch", [(), (3,), (0,), (2, 0)], ids=str)
@pytest.mark.parametrize("steps", [0, 1, 2, 3])
def test_however_little_there_is_a_summary_and_no_warning_of_numpy_s(steps, batch):
    # A warning that leaks is an error under this suite's settings.
    z = np.random.default_rng(1).normal(0.0, 3.0, (steps, 2, *batch))
    est = tk.estimator("kf", motion=WALK, sensor=FIX)
    prior = tk.Gaussian(np.zeros(4), np.diag([9.0, 9.0, 1.0, 1.0]))
    history = tk.filter(est, tk.Record(np.arange(float(steps)), z), prior)
    told = history.summary()
    assert "nan if white" not in told
    assert "correlation +nan" not in told
    if not z.size:
        assert history.warnings() == []
        assert "observability  unknown: nothing was filtered" in told
    assert ("correlation" in told) == (z.size > 0 and steps > 1)


@pytest.mark.parametrize("batch", [(), (3,)])
def test_a_summary_tells_the_condition_number_of_what_the_record_says(batch):
    rng = np.random.default_rng(2)
    record = tk.Record(np.arange(5.0), rng.normal(size=(5, 2, *batch)))
    prior = tk.Gaussian(np.zeros(4), np.diag([9.0, 9.0, 1.0, 1.0]))
    history = tk.filter(tk.estimator("kf", motion=WALK, sensor=FIX), record, prior)
    found = observability(
        WALK, FIX, record.t, np.zeros((5, 4)), prior.cov, measured=np.ones((5, 2), bool)
    )
    assert found.condition == pytest.approx(np.linalg.cond(found.information * np.outer(*2 * [
        np.sqrt(np.diag(prior.cov))])))  # fmt: skip
    assert f"rank 4 of 4, condition number {found.condition:.2g}; " in history.summary()


def test_a_correlation_is_that_of_the_lanes_that_have_one():
    told = run_of(walking(2), runs=40).innovation
    found = whiteness(told)
    assert np.isnan(found.correlations[1:]).all()
    assert found.together.correlations[0] == pytest.approx(found.correlations[0].mean())
    assert np.isnan(found.together.correlations[1:]).all()


def test_directions_that_are_not_seen_are_counted_and_said_in_english():
    record = tk.Record([0.0], np.zeros((1, 2)))
    prior = tk.Gaussian(np.zeros(4), np.diag([9.0, 9.0, 1.0, 1.0]))
    history = tk.filter(tk.estimator("kf", motion=WALK, sensor=FIX), record, prior)
    told = history.summary()
    assert (
        "rank 2 of 4, condition number above 1e12; of 2 directions the record says next to nothing"
        in told
    )
    blind = [words for words in history.warnings() if "unobservable" in words]
    assert len(blind) == 2
    for words, axis in zip(blind, ("vx", "vy"), strict=True):
        assert (
            f"a target with another state ({axis} +1 m/s at the first measurement) would have given "
            "all but the same measurements" in words
        )


# ---------------------------------------------------- questions along a path that make no sense
TIMES, PATH, UNIT = np.arange(5.0), np.zeros((5, 4)) + np.array([300.0, 400.0, 1.0, 0.0]), np.eye(4)
SHARP = position(0.01)


def asked_of_bound(sensors=FIX, t=TIMES, states=PATH, cov=UNIT, **more):
    return posterior_bound(WALK, sensors, t, states[..., None], cov, **more).position


def asked_of_record(sensors=FIX, t=TIMES, states=PATH, cov=UNIT, **more):
    return observability(WALK, sensors, t, states, cov, **more).ratios


BOTH = pytest.mark.parametrize("asked", [asked_of_bound, asked_of_record])
WRONG = {
    "which of several sensors is not said": (
        {"sensors": [FIX, SHARP]}, DomainError, r"'sensor': got nothing; expected which of the 2"),
    "a sensor that is not there": (
        {"sensors": [FIX, SHARP], "sensor": [0, 1, 0, 0, 7]}, DomainError, r"sensor 7.*0 to 1"),
    "a sensor counted from the end": (
        {"sensors": [FIX, SHARP], "sensor": [0, 1, 0, 0, -1]}, DomainError, r"sensor -1"),
    "too few places of sensors": (
        {"sensors": [FIX, SHARP], "sensor": [0, 1]}, ShapeError, r"integers of shape \(5,\)"),
    "the name of a sensor": ({"sensors": "position"}, CapabilityError, r"tracker\.sensors\.make"),
    "no sensor": ({"sensors": []}, CapabilityError, r"'sensors': got none"),
    "times that run backwards": ({"t": TIMES[::-1]}, DomainError, r"never decrease"),
    "a time that is not known": ({"t": TIMES * np.nan}, DomainError, r"finite seconds"),
    "too few times": ({"t": TIMES[:3]}, ShapeError, r"'t': got shape \(3,\)"),
    "states of another space": ({"states": PATH[:, :3]}, ShapeError, r"vy \[m/s\]"),
    "a negative covariance": ({"cov": -UNIT}, DomainError, r"smallest eigenvalue of -1"),
    "variances instead of a covariance": ({"cov": np.ones(4)}, ShapeError, r"np\.diag"),
    "an asymmetric covariance": ({"cov": np.arange(16.0).reshape(4, 4)}, DomainError, "asymmetry"),
    "a Gaussian": ({"cov": tk.Gaussian(np.zeros(4), UNIT)}, DomainError, r"\.cov"),
    "the class of Gaussians": ({"cov": tk.Gaussian}, DomainError, r"\.cov"),
    "too few poses": (
        {"sensors": azimuth(0.1), "pose": np.zeros((3, 2))}, ShapeError, r"'pose'.*\(5, 2, \.\.\.\)"),
    "one pose without time": (
        {"sensors": azimuth(0.1), "pose": np.zeros(2)}, ShapeError, r"'pose'.*\(5, 2, \.\.\.\)"),
    "too few flags": ({"measured": np.ones((2, 2), bool)}, ShapeError, r"'measured'"),
    "too few inputs": ({"u": np.zeros((2, 2))}, ShapeError, r"'u'"),
}  # fmt: skip


@BOTH
@pytest.mark.parametrize("wrong", WRONG)
def test_what_makes_no_sense_along_a_path_is_refused(asked, wrong):
    arguments, error, words = WRONG[wrong]
    with pytest.raises(error, match=words):
        asked(**arguments)


@BOTH
def test_the_order_of_sensors_does_not_matter_where_it_is_said_which_measured(asked):
    which = np.array([0, 1, 0, 0, 1])
    one, other = asked([FIX, SHARP], sensor=which), asked([SHARP, FIX], sensor=1 - which)
    np.testing.assert_array_equal(one, other)
    assert not np.array_equal(one, asked([FIX, SHARP], sensor=0 * which))


@BOTH
def test_a_sensor_is_bound_to_the_state_of_the_motion(asked):
    turn = coordinated_turn(0.1, 0.01)
    states = np.concatenate([PATH, np.full((5, 1), 0.1)], axis=1)
    kwargs = {"t": TIMES, "truth": states[..., None], "prior": np.eye(5)}
    if asked is asked_of_record:
        kwargs = {"t": TIMES, "states": states, "scale": np.eye(5)}
    ask = posterior_bound if asked is asked_of_bound else observability
    loose, bound = ask(turn, FIX, **kwargs), ask(turn, FIX.over(turn.space), **kwargs)
    for field in ("cov",) if ask is posterior_bound else ("information", "ratios"):
        np.testing.assert_array_equal(getattr(loose, field), getattr(bound, field))


@pytest.mark.parametrize("start", [2.0, np.nan, np.inf, -np.inf, [0.0, 0.0]], ids=str)
def test_a_bound_begins_no_later_than_its_path(start):
    with pytest.raises(DomainError, match=r"'start'.*not after the first one at 0\.0 s"):
        asked_of_bound(start=start)


@pytest.mark.parametrize("ask", [scenario_bound, scenario_observability])
def test_a_scenario_is_no_name_and_has_runs(ask):
    with pytest.raises(CapabilityError, match=r"'scenario': got 'two_stations'.*tracker\.scenario"):
        ask("two_stations")
    for runs in (0, -1, 2.5, True):
        with pytest.raises(DomainError, match=r"'runs'.*whole number of runs"):
            ask(tk.scenario("two_stations", steps=5), runs=runs)
