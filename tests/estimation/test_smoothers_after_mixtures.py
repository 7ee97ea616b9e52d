"""Smoothers after filters that believe more than a Gaussian: said in words, refused, or made use of."""

import attrs
import numpy as np
import pytest

import tracker as tk
from tracker import estimation
from tracker.errors import CapabilityError
from tracker.recursion import joined, lanes_of
from tracker_kalman import FixedPoint, ModeSmoother
from tracker_motion import constant_velocity, switching
from tracker_sensors import position

CALM, WILD = constant_velocity(0.01), constant_velocity(10.0)
MODES = switching([CALM, WILD], [[0.9, 0.1], [0.3, 0.7]])
PRIOR = tk.Gaussian(np.zeros(4), np.diag([4.0, 4.0, 1.0, 1.0]))
OF_MOMENTS = ["rts", "sigma_point_rts", "two_filter", "square_root_rts", "fixed_lag"]
MIXTURES = {
    "imm": ("a mixture of 2 modes", "use smoother 'imm_smoother'"),
    "gaussian_sum": ("a sum of 4 Gaussians", "compare it with the filter"),
    "range_parameterised": ("a sum of 4 Gaussians", "compare it with the filter"),
}
PARTICLES = ["bootstrap", "auxiliary", "regularised"]


def record(batch=(), steps=12, seed=1):
    rng = np.random.default_rng(seed)
    z = np.cumsum(rng.standard_normal((steps, 2, *batch)), axis=0)
    return tk.Record(np.arange(1.0, steps + 1.0), z)


def built(rule, smoother, motion=MODES, **options):
    if rule in MIXTURES and rule != "imm":
        options = {"components": 4, **options}
    made = tk.filters.make(rule, **options)
    return tk.estimator(made, motion=motion, sensor=position(1.0), smoother=smoother)


# --------------------------------------------------------------------------- said in words
@pytest.mark.parametrize("smoother", OF_MOMENTS)
@pytest.mark.parametrize("rule", MIXTURES)
def test_a_smoother_of_moments_after_a_mixture_says_what_it_does_not_see(rule, smoother):
    est = built(rule, smoother)
    believed, way = MIXTURES[rule]
    words = (
        f"smoother {type(est.smoother).__name__} sees only mean and covariance of what filter "
        f"{type(est.filter).__name__} believes, {believed}, and takes it for one Gaussian: {way}"
    )
    assert words in est.explain()
    history = tk.smooth(est, record((3,)), PRIOR)
    assert sum(words in w for w in history.warnings()) == 1
    assert words in history.summary()
    assert not any("sees only" in w for w in tk.filter(est, record(), PRIOR).warnings())


def test_a_campaign_says_so_too(tmp_path):
    from tracker.montecarlo import load_campaign

    scene = tk.scenario("line", steps=10, axes=2)
    motion = switching([scene.motion, WILD], [[0.9, 0.1], [0.3, 0.7]])
    estimators = {
        name: tk.estimator("imm", motion=motion, sensor=scene.sensor, smoother=smoother)
        for name, smoother in (("blind", "rts"), ("seeing", "imm_smoother"), ("filter", None))
    }
    campaign = tk.monte_carlo(estimators, scene, runs=32, seed=1)
    words = (
        "blind (smoother): smoother RauchTungStriebel sees only mean and covariance of what filter "
        "InteractingMultipleModels believes, a mixture of 2 modes, and takes it for one Gaussian: use "
        "smoother 'imm_smoother'."
    )
    again = load_campaign(campaign.save(tmp_path / "campaign.npz"))
    for one in (campaign, again):
        assert [w for w in one.warnings() if "sees only" in w] == [words]
        assert words in one.summary("rmse")


def test_an_explanation_tells_how_a_smoother_goes_back(interpretation):
    with_rts = built("imm", "rts").explain()
    if interpretation == "arrays":
        assert "smoother RauchTungStriebel: goes back on arrays: TRACKER_COMPILE=off" in with_rts
        return
    assert "smoother RauchTungStriebel: goes back in compiled steps" in with_rts
    assert (
        "smoother ModeSmoother: goes back in compiled steps"
        in built("imm", "imm_smoother").explain()
    )
    several = switching([CALM] * 5, np.full((5, 5), 0.2))
    told = built("imm", "imm_smoother", several).explain()
    assert "cannot be traced: 5 modes of 4 components are too many to unroll" in told


def test_smoothing_by_hand_says_so_too():
    history = tk.filter(built("imm", None), record(), PRIOR)
    assert "sees only" not in history.summary()
    by_hand = tk.smoothers.make("rts").smooth(history, MODES)
    assert "a smoother of moments sees only mean and covariance" in by_hand.summary()


@pytest.mark.parametrize(
    ("rule", "smoother", "motion", "options"),
    [
        ("imm", "imm_smoother", MODES, {}),
        ("imm", "rts", CALM, {}),
        ("gaussian_sum", "rts", CALM, {"components": 1}),
        ("ekf1", "rts", CALM, {}),
        ("ukf_square_root", "rts", CALM, {}),
        ("information", "two_filter", CALM, {}),
    ],
)
def test_where_moments_are_all_or_beliefs_are_seen_nothing_is_said(rule, smoother, motion, options):
    est = built(rule, smoother, motion, **options)
    assert "sees only" not in est.explain()
    assert "sees only" not in tk.smooth(est, record(), PRIOR).summary()


# -------------------------------------------------------------------------------- refused
@pytest.mark.parametrize("smoother", OF_MOMENTS)
@pytest.mark.parametrize("rule", PARTICLES)
def test_particles_are_not_smoothed_by_their_moments(rule, smoother):
    with pytest.raises(
        CapabilityError, match=r"got particles.*pass smoother='backward_simulation'"
    ):
        built(rule, smoother, CALM)


def test_particles_that_nothing_here_smooths_are_told_so():
    marginalised = tk.filters.make("marginalised", linear=("vx", "vy"))
    with pytest.raises(CapabilityError, match="leave the smoother out"):
        tk.estimator(marginalised, motion=CALM, sensor=position(1.0), smoother="rts")


def test_particles_are_smoothed_by_the_smoother_that_is_named():
    est = built("bootstrap", "backward_simulation", CALM, particles=50)
    history = tk.smooth(est, record(), PRIOR, rng=np.random.default_rng(1))
    assert np.isfinite(history.smoothed.mean).all()
    assert "sees only" not in history.summary()


def test_the_smoothers_that_a_filter_names_exist_and_see_beliefs():
    named = set()
    for component in tk.default_registry().search(kind="filter"):
        named |= set(getattr(component.load(), "smoothers", ()))
    assert named == {"imm_smoother", "backward_simulation"}
    for name in named:
        assert "beliefs" in tk.smoothers.make(name).needs


# ------------------------------------------------------------------- smoothed modes, offered
def probabilities(beliefs):
    return np.stack([belief.probabilities for belief in beliefs])


@pytest.mark.parametrize("batch", [(), (1,), (5,), (2, 3)], ids=str)
def test_smoothed_probabilities_of_the_modes_are_in_the_history(batch):
    measured = record(batch)
    history = tk.smooth(built("imm", "imm_smoother"), measured, PRIOR)
    found = probabilities(history.beliefs.smoothed)
    assert found.shape == (12, 2, *batch)
    np.testing.assert_allclose(found.sum(axis=1), 1.0, rtol=0, atol=1e-12)
    filtered = probabilities(history.beliefs.filtered)
    assert np.array_equal(found[-1], filtered[-1])
    assert np.abs(found[:-1] - filtered[:-1]).max() > 0.01  # the future tells something
    moments = [belief.moments() for belief in history.beliefs.smoothed]
    means = np.stack([m.mean for m in moments])
    np.testing.assert_allclose(means, history.smoothed.mean, rtol=1e-12, atol=1e-12)
    covs = np.stack([m.cov for m in moments])
    np.testing.assert_allclose(covs, history.smoothed.cov, rtol=1e-12, atol=1e-12)
    again, modes = ModeSmoother().modes(history, MODES)
    np.testing.assert_array_equal(probabilities(modes), probabilities(again.beliefs.smoothed))


def test_a_manoeuvre_is_seen_from_both_sides():
    t = np.arange(1.0, 41.0)
    path = np.stack([5.0 * t, np.where(t > 20, 8.0 * (t - 20.0), 0.0)], axis=1)
    z = path + np.random.default_rng(3).standard_normal(path.shape)
    history = tk.smooth(
        built("imm", "imm_smoother"), tk.Record(t, z), tk.Gaussian([0, 0, 5, 0], np.eye(4))
    )
    restless = probabilities(history.beliefs.smoothed)[:, 1]
    assert restless[19:22].max() > 0.9  # the turn itself, which the filter notices a step later
    assert restless[5:15].max() < 0.5
    assert restless[30:].max() < 0.5


def test_tiles_of_lanes_and_threads_change_no_bit_of_smoothed_beliefs(monkeypatch):
    est, measured = built("imm", "imm_smoother"), record((9,))
    whole = tk.smooth(est, measured, PRIOR)
    monkeypatch.setattr(estimation, "LANE_BYTES", 8 * 16 * 2)  # tiles of two lanes or three
    assert len(estimation.tiles((9,), 4)) == 4
    for workers in (1, 2):
        parted = tk.smooth(est, measured, PRIOR, workers=workers)
        np.testing.assert_array_equal(
            probabilities(parted.beliefs.smoothed), probabilities(whole.beliefs.smoothed)
        )
        np.testing.assert_array_equal(parted.smoothed.mean, whole.smoothed.mean)


@attrs.frozen(eq=False)
class Kept:
    own: np.ndarray
    shared: np.ndarray
    more: tuple
    name: str


def test_beliefs_that_were_parted_are_joined_again():
    values = np.arange(14.0).reshape(2, 7)
    whole = Kept(values, np.ones((2, 1)), (values + 1.0, None), "a")
    again = joined([lanes_of(whole, cut) for cut in (slice(0, 2), slice(2, 5), slice(5, 7))])
    np.testing.assert_array_equal(again.own, whole.own)
    assert again.shared.shape == (2, 1)
    np.testing.assert_array_equal(again.more[0], whole.more[0])
    assert (again.more[1], again.name) == (None, "a")


@pytest.mark.parametrize("rule", ["marginalised", "ekf1"])
def test_backward_simulation_is_refused_where_there_are_no_particles_to_go_back_through(rule):
    with pytest.raises(CapabilityError, match=r"got beliefs that are no particles.*'bootstrap'"):
        tk.estimator(rule, motion=CALM, sensor=position(1.0), smoother="backward_simulation")


# ---------------------------------------------------------------- smoothers within smoothers
@pytest.mark.parametrize("name", ["rts", "sigma_point_rts", "square_root_rts", "two_filter"])
def test_a_fixed_lag_smoother_knows_those_inside_by_their_names(name):
    by_name = tk.smoothers.make("fixed_lag", lag=3, smoother=name)
    assert by_name == tk.smoothers.make("fixed_lag", lag=3, smoother=tk.smoothers.make(name))
    tk.smooth(built("kf", by_name, CALM), record(), PRIOR)


@pytest.mark.parametrize("batch", [(), (3,)])
@pytest.mark.parametrize("lag", [1, 2, 3, 5, 20])
@pytest.mark.parametrize("name", ["sigma_point_rts", "square_root_rts", "two_filter"])
def test_whatever_is_inside_a_lag_gives_the_same_estimates(name, lag, batch, monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", "off")
    found = [
        tk.smooth(
            built("kf", tk.smoothers.make("fixed_lag", lag=lag, smoother=inside), CALM),
            record(batch),
            PRIOR,
        ).smoothed
        for inside in ("rts", name)
    ]
    np.testing.assert_allclose(found[1].mean, found[0].mean, atol=1e-9)
    np.testing.assert_allclose(found[1].cov, found[0].cov, atol=1e-9)


@pytest.mark.parametrize("inside", [ModeSmoother(), "imm_smoother", "backward_simulation"])
def test_a_fixed_lag_smoother_refuses_one_that_takes_no_steps_from_moments(inside):
    with pytest.raises(CapabilityError, match="expected a smoother that goes back step by step"):
        tk.smoothers.make("fixed_lag", lag=5, smoother=inside)


def test_a_fixed_point_refuses_a_smoother_without_gains_and_knows_one_by_its_name():
    history = tk.filter(built("kf", None, CALM), record((3,)), PRIOR)
    for name in ("square_root_rts", "two_filter"):
        for rule in (name, tk.smoothers.make(name)):
            with pytest.raises(CapabilityError, match=r"which has no method 'gain'.*pass 'rts'"):
                FixedPoint.along(history, CALM, 0, rule)
    found = FixedPoint.along(history, CALM, 0, "rts")
    assert np.array_equal(found.mean, FixedPoint.along(history, CALM, 0).mean)
