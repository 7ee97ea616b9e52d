"""One compiled step on line: the same numbers as records and arrays, and results that are values."""

import copy
import pickle
import threading

import attrs
import numpy as np
import pytest

import tracker as tk
from tracker.compile import objects
from tracker.errors import CapabilityError, ConfigError, DomainError, ShapeError
from tracker_motion.acceleration_input import acceleration_input
from tracker_motion.constant_velocity import constant_velocity
from tracker_motion.coordinated_turn import coordinated_turn
from tracker_sensors.azimuth import azimuth
from tracker_sensors.position import position
from tracker_sensors.stack import stack

pytestmark = pytest.mark.skipif(not objects.available(), reason="llvmlite is not installed")

MOTION = constant_velocity(density=0.1)
BEARINGS = stack([azimuth(0.02).at(sx=-1.0, sy=-2.0), azimuth(0.02).at(sx=1.0, sy=1.0)])
PRIOR = tk.Gaussian([0.0, 0.0, 1.0, 0.0], np.diag([0.1, 0.1, 1.0, 1.0]))
SHAPES = [(), (1,), (7,), (2, 3), (1024,)]
FIELDS = [field.name for field in attrs.fields(tk.Innovation)]


@pytest.fixture(autouse=True)
def compiled(monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", "on")


def built(**changes):
    return tk.estimator(**{"motion": MOTION, "sensor": BEARINGS} | changes)


def prior(batch, of=PRIOR):
    lead = (1,) * len(batch)
    mean = np.broadcast_to(of.mean.reshape(-1, *lead), (of.n, *batch))
    return tk.Gaussian(mean, of.cov)


def measured(steps, batch, m=2, missing=0.2, seed=3):
    rng = np.random.default_rng(seed)
    z = rng.uniform(0.5, 1.5, (steps, m, *batch))
    z[rng.random(z.shape) < missing] = np.nan
    return z


def is_compiled(state):
    return type(state) is not tk.Gaussian


def equal(state, innovation, history, k, m=None):
    np.testing.assert_array_equal(state.mean, history.filtered.mean[k])
    np.testing.assert_array_equal(state.cov, history.filtered.cov[k])
    for name in FIELDS:
        whole = getattr(history.innovation, name)[k]
        cut = {"residual": np.s_[:m], "S": np.s_[:m, :m]}.get(name, ...)
        np.testing.assert_array_equal(getattr(innovation, name), whole[cut])


# ------------------------------------------------------------------------------------ the numbers
@pytest.mark.parametrize("batch", SHAPES)
def test_steps_have_the_bits_of_the_record_filtered_at_once(batch):
    est, z = built(), measured(12, batch)
    t = np.cumsum(np.random.default_rng(1).uniform(0.0, 0.2, 12))
    history = tk.filter(est, tk.Record(t, z), PRIOR, start=0.0)
    state, before = prior(batch), 0.0
    for k in range(12):
        state, innovation = est.step(state, z[k], t[k] - before)
        before = t[k]
        assert is_compiled(state), "this step should have been compiled"
        equal(state, innovation, history, k)


def arguments(batch, steps=6):
    """Whatever else a step takes, alone and per lane: estimator, prior, keywords of each step."""
    rng = np.random.default_rng(11)
    lanes = np.ones(batch)
    drifting = azimuth(0.02)
    turn = coordinated_turn(density=0.1, turn_density=0.01)
    five = tk.Gaussian([0.1, -0.2, 1.0, 0.3, 0.05], 0.1 * np.eye(5))
    pushed = acceleration_input(sigma=0.1)
    per_lane = constant_velocity(density=rng.uniform(0.05, 0.2, batch)) if batch else MOTION
    cases = {
        "dt": (built(), PRIOR, 2, lambda k: {"dt": 0.1 * k * lanes}),
        "whole dt": (built(), PRIOR, 2, lambda k: {"dt": k}),
        "parameters": (built(motion=per_lane), PRIOR, 2, lambda _: {}),
        "pose": (built(sensor=drifting), PRIOR, 1, lambda k: {"pose": [-3.0 + k, -5.0]}),
        "poses": (
            built(sensor=drifting),
            PRIOR,
            1,
            lambda k: {"pose": np.multiply.outer([-3.0 + k, -5.0], lanes)},
        ),
        "u": (built(motion=pushed), PRIOR, 2, lambda k: {"u": np.array([0.1 * k, 1.0])}),
        "us": (built(motion=pushed), PRIOR, 2, lambda _: {"u": np.full((2, *batch), 0.3)}),
        "turn": (built(motion=turn), five, 2, lambda _: {}),
        "t": (built(), PRIOR, 2, lambda k: {"t": float(k)}),
    }
    return {name: (*case[:3], [case[3](k) for k in range(steps)]) for name, case in cases.items()}


@pytest.mark.parametrize("batch", [(), (1,), (9,), (2, 3), (70,)])
@pytest.mark.parametrize("case", list(arguments(())))
def test_compiled_steps_agree_with_arrays(case, batch, monkeypatch):
    est, start, m, keywords = arguments(batch)[case]
    z = measured(len(keywords), batch, m)
    ours = theirs = prior(batch, start)
    for k, keyword in enumerate(keywords):
        keyword = {"dt": 0.1} | keyword  # noqa: PLW2901 - what this step is given
        monkeypatch.setenv("TRACKER_COMPILE", "require")
        ours, surprise = est.step(ours, z[k], **keyword)
        assert is_compiled(ours)
        monkeypatch.setenv("TRACKER_COMPILE", "off")
        theirs, expected = est.step(theirs, z[k], **keyword)
        assert not is_compiled(theirs)
        np.testing.assert_allclose(ours.mean, theirs.mean, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(ours.cov, theirs.cov, rtol=1e-9, atol=1e-9)
        for name in FIELDS:
            a, b = getattr(surprise, name), getattr(expected, name)
            assert (
                np.shape(a)
                == np.shape(b)
                == {"residual": (m, *batch), "S": (m, m, *batch)}.get(name, batch)
            )
            assert batch or name in {"residual", "S"} or isinstance(a, (float, bool))
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("batch", [(), (9,), (1024,)])
def test_sensors_of_different_size_take_turns(batch):
    est = built(sensor=[position(1.0), azimuth(0.02)])
    which = [0, 1, 1, 0, 1]
    z = measured(5, batch, missing=0.0)
    z[np.array(which) == 1, 1] = np.nan
    pose = np.random.default_rng(2).uniform(2.0, 3.0, (5, 2, *batch))
    record = tk.Record(np.arange(1.0, 6.0), z, pose=pose, sensor=which)
    history = tk.filter(est, record, PRIOR, start=0.0)
    state = prior(batch)
    for k, i in enumerate(which):
        m = (2, 1)[i]
        where = {"pose": pose[k]} if i else {}
        state, innovation = est.step(state, z[k, :m], 1.0, sensor=i, **where)
        assert is_compiled(state)
        assert np.shape(innovation.residual) == (m, *batch)
        np.testing.assert_allclose(state.mean, history.filtered.mean[k], rtol=1e-12, atol=1e-12)


def test_angles_pass_through_the_cut_without_a_jump():
    sensor = azimuth(0.01).at(sx=0.0, sy=0.0)
    x = np.stack([np.full(40, -100.0), 19.0 - np.arange(40), np.zeros(40), -np.ones(40)])
    z = sensor.h(x).T
    assert np.ptp(z) > 6.0  # it does cross
    est = built(sensor=sensor)
    state = tk.Gaussian([-100.0, 20.0, 0.0, -1.0], np.diag([1.0, 1.0, 0.01, 0.01]))
    for k in range(40):
        state, innovation = est.step(state, z[k], 1.0)
        assert innovation.nis < 1e-6
    np.testing.assert_allclose(state.mean, x[:, -1], atol=1e-6)


def test_a_lane_that_diverges_stays_nan_and_harms_no_neighbour():
    est, z = built(), measured(3, (9,), missing=0.0)
    whole, start = prior((9,)), prior((9,)).mean.copy()
    start[0, 4] = np.nan
    broken = tk.Gaussian(start, PRIOR.cov)
    for k in range(3):
        whole, _ = est.step(whole, z[k], 0.1)
        broken, innovation = est.step(broken, z[k], 0.1)
        assert innovation.ok.tolist() == [lane != 4 for lane in range(9)]
    keep = [0, 1, 2, 3, 5, 6, 7, 8]
    np.testing.assert_array_equal(broken.mean[:, keep], whole.mean[:, keep])
    assert np.isnan(broken.mean[0, 4])


# ------------------------------------------------------------------------------ results are values
@pytest.mark.parametrize("batch", SHAPES)
def test_a_result_is_a_gaussian_in_every_way(batch):
    state, innovation = built().step(prior(batch), measured(1, batch)[0], 0.1)
    assert isinstance(state, tk.Gaussian)
    assert isinstance(innovation, tk.Innovation)
    assert (state.n, state.batch, state.mean.shape) == (4, batch, (4, *batch))
    assert state.cov.shape == (4, 4, *batch)
    assert state.moments() is state
    assert state.sigma.shape == (4, *batch)
    assert repr(state) == repr(tk.Gaussian.trusted(state.mean, state.cov))
    assert repr(innovation).startswith("Innovation(residual=")
    assert state.sample(rng=np.random.default_rng(0)).shape == (4, *batch)
    np.testing.assert_array_equal(state.cov, state.cov.swapaxes(0, 1))
    if batch:
        np.testing.assert_array_equal(state[..., :1].mean, state.mean[..., :1])
    with pytest.raises(AttributeError):
        state.mean = 0.0
    with pytest.raises(AttributeError, match="absent"):
        _ = state.absent
    with pytest.raises(AttributeError, match="absent"):
        _ = innovation.absent
    changed = attrs.evolve(state, mean=state.mean + 1.0)
    np.testing.assert_array_equal(changed.mean, state.mean + 1.0)


@pytest.mark.parametrize("batch", [(), (7,), (1024,)])
def test_results_are_pickled_and_copied_as_plain_values(batch):
    est = built()
    state, innovation = est.step(prior(batch), z := measured(1, batch)[0], 0.1)
    for again in (pickle.loads(pickle.dumps(state)), copy.copy(state), copy.deepcopy(state)):
        assert type(again) is tk.Gaussian
        np.testing.assert_array_equal(again.mean, state.mean)
        np.testing.assert_array_equal(again.cov, state.cov)
        np.testing.assert_array_equal(
            est.step(again, z, 0.1)[0].mean, est.step(state, z, 0.1)[0].mean
        )
    again = pickle.loads(pickle.dumps(innovation))
    assert type(again) is tk.Innovation
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(again, name), getattr(innovation, name))


@pytest.mark.parametrize("batch", SHAPES)
def test_no_later_step_changes_an_earlier_result(batch):
    est, z = built(), measured(30, batch)
    states = [prior(batch)]
    surprises = []
    for k in range(30):
        state, innovation = est.step(states[-1], z[k], 0.1)
        states.append(state)
        surprises.append(innovation)
    again = states[0]
    for k in range(30):
        again, innovation = est.step(again, z[k], 0.1)
        now = again.mean.copy(), np.copy(innovation.nis)  # read at once; the others only now
        np.testing.assert_array_equal(states[k + 1].mean, now[0])
        np.testing.assert_array_equal(surprises[k].nis, now[1])


@pytest.mark.parametrize("batch", [(), (7,), (1024,)])
def test_what_a_user_writes_into_a_state_counts_and_into_an_argument_does_not(batch):
    est, z = built(), measured(1, batch, missing=0.0)[0]
    start = prior(batch)
    state, _ = est.step(start, z, 0.1)
    kept = state.mean.copy()
    start.mean[:] = 99.0
    np.testing.assert_array_equal(state.mean, kept)
    same = tk.Gaussian(state.mean, state.cov)
    same.mean[0] += 0.01
    state.mean[0] += 0.01
    np.testing.assert_array_equal(est.step(state, z, 0.1)[0].mean, est.step(same, z, 0.1)[0].mean)


def test_states_travel_between_estimators_and_interpretations(monkeypatch):
    one, two = built(), built(sensor=position(1.0), filter="kf")
    z = np.array([0.4, 0.2])
    state, _ = one.step(PRIOR, z, 0.1)
    crossed, _ = two.step(state, z, 0.1)
    plain, _ = two.step(tk.Gaussian(state.mean, state.cov), z, 0.1)
    np.testing.assert_array_equal(crossed.mean, plain.mean)
    monkeypatch.setenv("TRACKER_COMPILE", "off")
    arrays, _ = two.step(state, z, 0.1)
    np.testing.assert_allclose(arrays.mean, crossed.mean, atol=1e-12)


# ------------------------------------------------------------------- the estimator stays a value
def test_an_estimator_that_has_stepped_is_pickled_copied_and_shown_like_a_new_one():
    est = built()
    words = repr(est)
    state, _ = est.step(PRIOR, [0.4, 0.3], 0.1)
    assert repr(est) == words
    for again in (pickle.loads(pickle.dumps(est)), copy.deepcopy(est), attrs.evolve(est)):
        np.testing.assert_array_equal(again.step(PRIOR, [0.4, 0.3], 0.1)[0].mean, state.mean)
    sharper = attrs.evolve(est, motion=constant_velocity(density=5.0))
    assert (sharper.step(PRIOR, [0.4, 0.3], 0.1)[0].mean != state.mean).any()


@pytest.mark.parametrize("batch", [(), (1024,)])
def test_two_threads_may_step_the_same_estimator(batch):
    est, steps = built(), 300 if not batch else 60
    z = [measured(steps, batch, seed=seed) for seed in range(4)]

    def stepped(i, rule):
        state = prior(batch)
        for k in range(steps):
            state, _ = rule.step(state, z[i][k], 0.01)
        return state.mean

    expected = [stepped(i, built()) for i in range(4)]
    got = {}
    threads = [
        threading.Thread(target=lambda i=i: got.__setitem__(i, stepped(i, est))) for i in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for i in range(4):
        np.testing.assert_array_equal(got[i], expected[i])


def test_batches_of_ever_new_sizes_do_not_pile_up():
    est = built()
    for lanes in range(1, 140):
        est.step(prior((lanes,)), np.ones((2, lanes)), 0.1)
    assert len(est._compiled._known) <= 64


# ------------------------------------------------------------------------ mistakes, and what is not
@pytest.mark.parametrize("state", [PRIOR, None], ids=["given", "stepped"])
@pytest.mark.parametrize(
    ("z", "dt", "more", "error", "words"),
    [
        ([0.1], 0.1, {}, ShapeError, "one row per component"),
        ([np.inf, 0.1], 0.1, {}, DomainError, "NaN"),
        (np.array([0.1, -np.inf]), 0.1, {}, DomainError, "NaN"),
        ([0.1, 0.1], -1.0, {}, DomainError, "not negative"),
        ([0.1, 0.1], -1, {}, DomainError, "not negative"),
        ([0.1, 0.1], np.float64(-1), {}, DomainError, "not negative"),
        (np.zeros((2, 3)), 0.1, {}, ShapeError, "one measurement per lane"),
        ([0.1, 0.1], 0.1, {"sensor": 1}, DomainError, "argument 'sensor'"),
    ],
)
def test_a_wrong_argument_is_refused_in_the_same_words(z, dt, more, error, words, state):
    est = built()
    if state is None:
        state, _ = est.step(PRIOR, [0.4, 0.3], 0.1)
    with pytest.raises(error, match=words):
        est.step(state, z, dt, **more)


@pytest.mark.parametrize(
    ("z", "dt"), [(np.full((2, 7), np.inf), 0.1), (np.zeros((2, 7)), np.linspace(-1, 1, 7))]
)
def test_a_wrong_number_in_one_lane_is_refused(z, dt):
    est = built()
    est.step(prior((7,)), np.zeros((2, 7)), np.ones(7))
    with pytest.raises(DomainError):
        est.step(prior((7,)), z, dt)


def test_other_number_types_are_taken():
    est = built()
    expected = est.step(PRIOR, np.array([1.0, 0.0]), 1.0)[0]
    for z, dt in (
        ([1, 0], 1),
        (np.array([1, 0]), np.float64(1)),
        (np.float32([1, 0]), np.array(1)),
    ):
        state = est.step(PRIOR, z, dt)[0]
        assert is_compiled(state)
        np.testing.assert_array_equal(state.mean, expected.mean)


def test_arrays_that_are_not_contiguous_are_taken():
    est, z = built(), measured(1, (9,), missing=0.0)[0]
    expected = est.step(prior((9,)), z, 0.1)[0]
    turned = tk.Gaussian.trusted(
        np.asfortranarray(prior((9,)).mean), np.asfortranarray(prior((9,)).cov)
    )
    np.testing.assert_array_equal(
        est.step(turned, np.repeat(z, 2, 1)[:, ::2], 0.1)[0].mean, expected.mean
    )


@attrs.frozen
class Rooted(tk.Gaussian):
    """A state that says more than its moments."""


def test_a_filter_with_a_state_of_its_own_keeps_it():
    kalman = built().filter

    class Own:
        needs = ("jacobian",)
        predict, project = kalman.predict, kalman.project

        def update(self, *arguments):
            state, innovation = kalman.update(*arguments)
            return Rooted.trusted(state.mean, state.cov), innovation

    est = built(filter=Own())
    state, _ = est.step(PRIOR, [0.4, 0.3], 0.1)
    assert type(state) is Rooted
    assert type(est.step(state, [0.4, 0.3], 0.1)[0]) is Rooted


def test_the_environment_decides_at_every_step(monkeypatch):
    est = built()
    for choice, yes in (("on", True), ("off", False), ("require", True), ("off", False)):
        monkeypatch.setenv("TRACKER_COMPILE", choice)
        assert is_compiled(est.step(PRIOR, [0.4, 0.3], 0.1)[0]) is yes
    monkeypatch.delenv("TRACKER_COMPILE")
    assert is_compiled(est.step(PRIOR, [0.4, 0.3], 0.1)[0])
    monkeypatch.setenv("TRACKER_COMPILE", "sometimes")
    with pytest.raises(ConfigError, match="sometimes"):
        est.step(PRIOR, [0.4, 0.3], 0.1)


def test_what_cannot_be_compiled_steps_on_arrays_or_is_refused_where_compiling_is_required(
    monkeypatch,
):
    class Plain:
        tags, needs = ("opaque",), ("jacobian",)
        predict, project, update = (
            getattr(built().filter, name) for name in ("predict", "project", "update")
        )

    est = built(filter=Plain())
    for _ in range(2):
        assert not is_compiled(est.step(PRIOR, [0.4, 0.3], 0.1)[0])
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    for _ in range(2):
        with pytest.raises(CapabilityError, match="TRACKER_COMPILE=require"):
            est.step(PRIOR, [0.4, 0.3], 0.1)
