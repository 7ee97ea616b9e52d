"""Motions that switch, the filter of all their modes, and its smoother: laws, edges and truth."""

import itertools

import numpy as np
import pytest
from scipy.linalg import expm

import tracker as tk
from tracker.errors import CapabilityError, DomainError, ShapeError
from tracker.models import ComponentMotion
from tracker_kalman import InteractingMultipleModels, ModeSmoother
from tracker_motion import (
    acceleration_input,
    constant_acceleration,
    constant_velocity,
    coordinated_turn,
    switching,
)
from tracker_sensors import azimuth, position, stack

CALM, WILD = constant_velocity(0.01), constant_velocity(10.0)
CHAIN = [[0.9, 0.1], [0.3, 0.7]]
PRIOR = tk.Gaussian(np.zeros(4), np.diag([4.0, 4.0, 1.0, 1.0]))
STEPS = 25


def record(batch=(), seed=1, missing=0.1):
    """Times, some equal, and positions of anything, some missing."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.choice([0.0, 0.5, 1.0], STEPS))
    z = np.cumsum(rng.standard_normal((STEPS, 2, *batch)), axis=0)
    z[rng.uniform(size=z.shape) < missing] = np.nan
    return tk.Record(t, z)


def run(motion, rule="imm", sensor=None, smoother=None, prior=PRIOR, measured=None):
    sensor = position(1.0) if sensor is None else sensor
    built = tk.estimator(rule, motion=motion, sensor=sensor, smoother=smoother)
    done = tk.filter if smoother is None else tk.smooth
    return done(built, record() if measured is None else measured, prior, start=0.0)


def same(a, b, tolerance=1e-9):
    for name in ("predicted", "filtered"):
        x, y = getattr(a, name), getattr(b, name)
        np.testing.assert_allclose(x.mean, y.mean, rtol=0, atol=tolerance)
        np.testing.assert_allclose(x.cov, y.cov, rtol=0, atol=tolerance)
    for name in ("nis", "loglik", "count"):
        x, y = (getattr(h.innovation, name) for h in (a, b))
        np.testing.assert_allclose(x, y, rtol=1e-9, atol=tolerance)


# ------------------------------------------------------------------------------------- motion
def test_the_state_of_a_switching_motion_is_the_union_of_its_modes():
    motion = switching([coordinated_turn(0.1, 0.01), constant_acceleration(1.0)], CHAIN)
    assert motion.space.names == ("x", "y", "vx", "vy", "omega", "ax", "ay")
    assert motion.places == ((0, 1, 2, 3, 4), (0, 1, 2, 3, 5, 6))


def test_rates_give_the_matrix_exponential_at_any_step():
    rates = np.array([[0.0, 0.3, 0.1], [0.02, 0.0, 0.5], [1e-6, 2.0, 0.0]])
    motion = switching([CALM, WILD, CALM], rates=rates)
    generator = rates - np.diag(rates.sum(axis=1))
    for dt in (0.0, 1e-9, 0.1, 10.0, 1e4):
        np.testing.assert_allclose(motion.transition(dt), expm(generator * dt), rtol=0, atol=1e-11)
    half, whole = np.array(motion.transition(0.35)), np.array(motion.transition(0.7))
    np.testing.assert_allclose(half @ half, whole, rtol=0, atol=1e-14)


def test_nothing_switches_in_no_time():
    assert switching([CALM, WILD], CHAIN).transition(0.0) == [[1.0, 0.0], [0.0, 1.0]]


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"modes": []}, ShapeError, "at least one motion"),
        ({"transition": None}, CapabilityError, "neither"),
        ({"rates": CHAIN}, CapabilityError, "both"),
        ({"transition": [[1.0]]}, ShapeError, "(2, 2)"),
        ({"transition": [[0.9, 0.2], [0.5, 0.5]]}, DomainError, "sum to one"),
        ({"transition": None, "rates": [[0.0, -1.0], [1.0, 0.0]]}, DomainError, "not negative"),
        ({"initial": [0.5, 0.6]}, DomainError, "sum to one"),
    ],
)
def test_a_wrong_chain_is_refused_in_words(change, error, words):
    given = {"modes": [CALM, WILD], "transition": CHAIN} | change
    with pytest.raises(error) as told:
        switching(**given)
    assert words in str(told.value)


# ------------------------------------------------------------------------------------- filter
@pytest.mark.parametrize("batch", [(), (7,), (3, 5)])
@pytest.mark.parametrize("rule", ["kf", "ekf1", "ukf"])
def test_equal_modes_are_one_filter(batch, rule):
    equal = switching([CALM, CALM, CALM], [[0.8, 0.1, 0.1], [0.0, 0.5, 0.5], [0.2, 0.3, 0.5]])
    measured = record(batch)
    want = run(CALM, rule, measured=measured)
    same(run(equal, InteractingMultipleModels(rule), measured=measured), want)
    same(run(CALM, InteractingMultipleModels(rule), measured=measured), want)
    same(run(switching([CALM]), InteractingMultipleModels(rule), measured=measured), want)


def test_the_order_of_the_modes_does_not_matter():
    rng = np.random.default_rng(3)
    modes = [CALM, WILD, constant_acceleration(0.5)]
    chain, initial = rng.dirichlet(np.ones(3), 3), rng.dirichlet(np.ones(3))
    prior = tk.Gaussian(np.zeros(6), np.eye(6))
    want = run(switching(modes, chain, initial=initial), prior=prior)
    for order in itertools.permutations(range(3)):
        if modes[order[0]].space.size != 4:
            continue  # the components would come in another order
        turned = [modes[i] for i in order], chain[np.ix_(order, order)]
        same(run(switching(*turned, initial=initial[list(order)]), prior=prior), want)


def test_every_lane_may_have_its_own_parameters():
    q, stay = np.array([0.01, 0.1, 1.0]), np.array([0.95, 0.8, 0.6])
    per_lane = switching([CALM, WILD], CHAIN).with_parameters(density_1=q, switch_1_2=1.0 - stay)
    together = run(per_lane, measured=record((3,)))
    for lane in range(3):
        own = switching(
            [constant_velocity(q[lane]), WILD], [[stay[lane], 1.0 - stay[lane]], CHAIN[1]]
        )
        alone = run(own, measured=tk.Record(record((3,)).t, record((3,)).z[..., lane]))
        for name in ("mean", "cov"):
            ours = getattr(together.filtered, name)[..., lane]
            np.testing.assert_allclose(ours, getattr(alone.filtered, name), rtol=0, atol=1e-9)


def test_components_that_a_mode_lacks_are_zero_as_in_a_larger_motion_that_keeps_them_zero():
    def advance(x, y, vx, vy, ax, ay, *, dt):
        return x + dt * vx, y + dt * vy, vx, vy, 0.0 * ax, 0.0 * ay

    small = constant_velocity(0.01)

    def noise(*, dt):
        q = small.Q(np.zeros(4), float(dt)) if isinstance(dt, float) else None
        if q is None:
            a, b, c = 0.01 * dt**3 / 3.0, 0.01 * dt**2 / 2.0, 0.01 * dt
            q = ((a, 0.0, b, 0.0), (0.0, a, 0.0, b), (b, 0.0, c, 0.0), (0.0, b, 0.0, c))
        rows = [[0.0] * 6 for _ in range(6)]
        for i in range(4):
            for j in range(4):
                rows[i][j] = q[i][j]
        return tuple(map(tuple, rows))

    larger = ComponentMotion(
        name="no acceleration", advance=advance, noise=noise, space=constant_acceleration(1.0).space
    )
    prior = tk.Gaussian(np.zeros(6), np.diag([4.0, 4.0, 1.0, 1.0, 0.0, 0.0]))
    other = constant_acceleration(1.0)
    want = run(switching([larger, other], CHAIN), prior=prior)
    same(run(switching([small, other], CHAIN), prior=prior), want, 1e-8)


def test_without_measurements_modes_follow_their_chain():
    motion = switching([CALM, WILD], CHAIN, initial=[0.2, 0.8])
    built = tk.estimator("imm", motion=motion, sensor=position(1.0))
    state = built.begin(PRIOR)
    chances = np.array([0.2, 0.8])
    for _ in range(4):
        state, told = built.step(state, [np.nan, np.nan], 1.0)
        chances = chances @ CHAIN
        np.testing.assert_allclose(state.probabilities, chances, rtol=1e-13)
        assert (told.nis, told.loglik, told.count) == (0.0, 0.0, 0.0)
        assert told.ok


def test_the_likelihood_of_a_record_is_that_of_all_modes():
    # With modes that never switch, the record's likelihood is a mixture of each mode's own.
    motion = switching([CALM, WILD], np.eye(2), initial=[0.3, 0.7])
    own = [run(mode, "kf").innovation.loglik.sum() for mode in (CALM, WILD)]
    want = np.logaddexp(np.log(0.3) + own[0], np.log(0.7) + own[1])
    np.testing.assert_allclose(run(motion).innovation.loglik.sum(), want, rtol=1e-12)


def test_no_likelihood_underflows_and_an_unlikely_mode_comes_back():
    motion = switching([CALM, WILD], np.eye(2))
    far = np.zeros((40, 2))
    far[:20] += 1e5 * (-1.0) ** np.arange(20)[:, None]  # tens of thousands of nats against calm
    history = run(motion, measured=tk.Record(np.arange(1.0, 41.0), far))
    assert history.innovation.ok.all()
    assert np.isfinite(history.innovation.loglik).all()
    calm = np.concatenate([far[:20], np.zeros((2000, 2))])
    later = run(motion, measured=tk.Record(np.arange(1.0, 2021.0), calm))
    alone = run(CALM, "kf", measured=tk.Record(np.arange(1.0, 2021.0), calm))
    np.testing.assert_allclose(later.filtered.cov[-1], alone.filtered.cov[-1], rtol=1e-6)


def test_a_mode_that_is_lost_starts_again_and_a_lane_is_lost_with_all_of_them():
    def advance(x, y, vx, vy, *, dt, gone):
        return x + dt * vx + gone, y + dt * vy, vx, vy

    fragile = ComponentMotion(
        name="fragile", advance=advance, noise=CALM.noise, space=CALM.space,
        parameters={"gone": 0.0, "density": 0.01},
    )  # fmt: skip
    huge = np.array([0.0, 1e200, 0.0])
    motion = switching([fragile, WILD], CHAIN)
    one_lost = run(motion.with_parameters(gone_1=huge), measured=record((3,), missing=0.0))
    assert one_lost.innovation.ok.all()
    assert np.isfinite(one_lost.filtered.mean).all()
    both = switching([fragile, fragile], CHAIN).with_parameters(gone_1=huge, gone_2=huge)
    all_lost = run(both, measured=record((3,), missing=0.0))
    assert all_lost.innovation.ok.all(axis=0).tolist() == [True, False, True]
    well = run(switching([fragile, fragile], CHAIN), measured=record((3,), missing=0.0))
    for lane in (0, 2):
        assert np.array_equal(all_lost.filtered.mean[..., lane], well.filtered.mean[..., lane])


def test_a_single_run_that_lost_all_its_modes_says_so():
    built = tk.estimator("imm", motion=switching([CALM, WILD], CHAIN), sensor=position(1.0))
    lost = tk.Gaussian.trusted(np.full(4, np.nan), np.eye(4))
    with np.errstate(invalid="ignore"):
        state, told = built.step(built.begin(lost), [0.0, 0.0], 1.0)
    assert not told.ok
    assert np.isnan(state.moments().mean).all()
    assert np.isnan(told.loglik)


def test_a_mode_of_probability_zero_stays_so():
    motion = switching([CALM, WILD], np.eye(2), initial=[1.0, 0.0])
    same(run(motion), run(CALM, "kf"))


def test_filters_may_differ_between_modes_but_there_must_be_enough():
    motion = switching([CALM, WILD], CHAIN)
    same(run(motion, InteractingMultipleModels(["ekf1", "ukf"])), run(motion), 1e-8)
    with pytest.raises(CapabilityError, match="3 filters for 2 modes"):
        run(motion, InteractingMultipleModels(["ekf1"] * 3))
    with pytest.raises(DomainError, match="common"):
        InteractingMultipleModels(missing="somehow")


def test_a_mixture_of_other_modes_is_refused():
    two = tk.estimator("imm", motion=switching([CALM, WILD], CHAIN), sensor=position(1.0))
    three = switching([CALM, WILD, WILD], np.full((3, 3), 1.0 / 3.0))
    state, _ = two.step(two.begin(PRIOR), [0.0, 0.0], 1.0)
    several = tk.estimator("imm", motion=three, sensor=position(1.0))
    for built, had, wanted in ((several, "2 modes", "3 modes"), (
        tk.estimator("imm", motion=CALM, sensor=position(1.0)), "2 modes", "1 mode of 4"
    )):  # fmt: skip
        with pytest.raises(CapabilityError, match=f"got a mixture of {had}.*expected {wanted}"):
            built.step(state, [0.0, 0.0], 1.0)
        after, _ = built.step(built.begin(state.moments()), [0.0, 0.0], 1.0)  # as it says
        assert np.isfinite(after.moments().mean).all()
    turning = switching([CALM, coordinated_turn(0.1, 0.01)], CHAIN)
    wider = tk.estimator("imm", motion=turning, sensor=position(1.0))
    with pytest.raises(CapabilityError, match="expected 2 modes of 4, 5 components"):
        wider.filter.predict(state, turning, 1.0)


def test_it_is_compiled_over_modes_of_different_size(interpretation):
    motion = switching([CALM, coordinated_turn(0.01, 0.1)], CHAIN)
    sensor = stack([azimuth(0.1).at(sx=9.0, sy=0.0), azimuth(0.1).at(sx=0.0, sy=9.0)])
    for missing in ("zero", "prior", "common"):
        rule = InteractingMultipleModels(missing=missing)
        built = tk.estimator(rule, motion=motion, sensor=sensor)
        if interpretation == "compiled":
            assert "one compiled step" in built.explain()
        rng = np.random.default_rng(2)
        measured = tk.Record(np.arange(1.0, 11.0), rng.uniform(-3.0, 3.0, (10, 2, 9)))
        prior = tk.Gaussian(np.zeros(5), np.eye(5))
        several = tk.filter(built, measured, prior, start=0.0)
        alone = tk.filter(built, tk.Record(measured.t, measured.z[..., 4]), prior, start=0.0)
        np.testing.assert_allclose(several.filtered.mean[..., 4], alone.filtered.mean, atol=1e-9)
        np.testing.assert_allclose(several.filtered.cov[..., 4], alone.filtered.cov, atol=1e-9)


def test_modes_with_other_numbers_share_a_compiled_step():
    from tracker.compile.fuse import structure

    one, two = (
        switching([constant_velocity(q), WILD], c) for q, c in ((0.1, CHAIN), (2.0, np.eye(2)))
    )
    assert structure(one) == structure(two)
    assert hash(structure(one)) == hash(structure(two))
    assert structure(one) != structure(switching([WILD, WILD, WILD], np.eye(3)))


# ----------------------------------------------------------------------------------- smoother
@pytest.mark.parametrize("batch", [(), (7,), (3, 5)])
def test_one_mode_is_smoothed_as_by_rts(batch):
    measured = record(batch)
    want = run(CALM, "kf", smoother="rts", measured=measured).smoothed
    equal = switching([CALM, CALM], CHAIN)
    for motion in (CALM, equal):
        found = run(motion, smoother="imm_smoother", measured=measured).smoothed
        np.testing.assert_allclose(found.mean, want.mean, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.cov, want.cov, rtol=0, atol=1e-9)


@pytest.mark.parametrize("finer", [1e4, 1e6, 1e7])
def test_a_future_that_knows_far_more_than_the_filter_leaves_covariances_right(finer):
    """Three steps without a measurement, then such as are ``finer`` than what the filter believed."""
    rng, t = np.random.default_rng(1), np.arange(1.0, 9.0)
    prior = tk.Gaussian(np.zeros(4), np.diag([1e6, 1e6, 1e2, 1e2]))
    z = 1e3 / finer * rng.standard_normal((8, 2))
    z[:3] = np.nan
    measured, sensor = tk.Record(t, z), position(1e3 / finer)
    slow, slower = constant_velocity(1e-9), constant_velocity(1e-12)
    rule = InteractingMultipleModels("square_root")
    want = run(slower, "square_root", sensor, "square_root_rts", prior, measured).smoothed
    for motion in (slower, switching([slower, slower], CHAIN)):
        found = run(motion, rule, sensor, ModeSmoother(), prior, measured).smoothed
        apart = np.einsum("kii->ki", found.cov) / np.einsum("kii->ki", want.cov)
        assert np.abs(apart - 1.0).max() < 1e-2
        scale = np.sqrt(np.einsum("kii->ki", want.cov))
        assert np.abs((found.mean - want.mean) / scale).max() < 1e-2
    found = run(switching([slow, slower], CHAIN), rule, sensor, ModeSmoother(), prior, measured)
    cov = found.smoothed.cov
    scale = np.sqrt(np.einsum("kii->ki", cov))
    assert np.linalg.eigvalsh(cov / scale[:, :, None] / scale[:, None]).min() > 0.0


def test_a_smoothed_density_wider_than_the_predicted_one_says_less_not_more():
    """The quotient of two Gaussians of which neither is wider throughout: no variance is overstated."""
    from tracker_kalman.imm_smoother import _Future

    rng = np.random.default_rng(2)
    for _ in range(200):
        half, other = rng.standard_normal((2, 4, 4))
        P, S = half @ half.T, other @ other.T
        zero = np.zeros(4)
        future = _Future.of(
            tk.Gaussian.trusted(zero, P), tk.Gaussian.trusted(zero, S), (False,) * 4
        )
        white = np.linalg.solve(future.L, np.linalg.solve(future.L, S).T)
        ratios, directions = np.linalg.eigh(white)
        told = np.einsum("ji,jk->ik", directions, future.K)
        known = np.sqrt((told**2).sum(axis=1))
        assert np.isfinite(known).all()
        exact = np.sqrt(np.maximum(1.0 / ratios - 1.0, 0.0))
        assert known.max() <= 2.0 * (
            1.0 / np.sqrt(ratios.min())
        )  # n-fold at most, of what it may be
        if ratios.max() < 1.0:
            np.testing.assert_allclose(known, exact, rtol=1e-6)


def test_a_smoother_of_modes_needs_their_beliefs():
    motion = switching([CALM, WILD], CHAIN)
    with pytest.raises(CapabilityError, match="imm_smoother"):
        ModeSmoother().smooth(run(motion), motion)


def test_a_lane_that_diverged_harms_no_neighbour_backwards():
    motion = switching([CALM, WILD], CHAIN)
    measured = record((3,), missing=0.0)
    prior = np.zeros((4, 3)), np.repeat(np.eye(4)[..., None], 3, axis=2)
    well = run(motion, smoother="imm_smoother", measured=measured, prior=tk.Gaussian(*prior))
    prior[0][:, 1] = np.nan
    ill = run(motion, smoother="imm_smoother", measured=measured, prior=tk.Gaussian(*prior))
    assert np.isnan(ill.smoothed.mean[..., 1]).all()
    for lane in (0, 2):
        assert np.array_equal(ill.smoothed.mean[..., lane], well.smoothed.mean[..., lane])


class Exact:
    """All sequences of modes, each with its own Kalman filter and smoother, weighted by likelihood."""

    def __init__(self, motion, prior, t, z):
        chain, first = np.array(motion.transition(1.0)), np.array(motion.initial)
        steps, count = len(t), len(motion.modes)
        sequences = np.array(list(itertools.product(range(count), repeat=steps)))
        weights, means, covs = [], [], []
        for sequence in sequences:
            weight = np.log((first @ chain)[sequence[0]])
            weight += np.log(chain[sequence[:-1], sequence[1:]]).sum()
            loglik, mean, cov = self.one(motion, sequence, prior, t, z)
            weights.append(weight + loglik)
            means.append(mean)
            covs.append(cov)
        share = np.exp(weights - np.logaddexp.reduce(weights))
        means = np.array(means)
        self.mean = np.einsum("s,ski->ki", share, means)
        apart = means - self.mean
        self.cov = np.einsum("s,skij->kij", share, np.array(covs))
        self.cov += np.einsum("s,ski,skj->kij", share, apart, apart)
        chosen = sequences[..., None] == np.arange(count)
        self.probabilities = np.einsum("s,skm->km", share, chosen)

    @staticmethod
    def one(motion, sequence, prior, t, z):
        x, P, H, loglik, past, before = prior.mean, prior.cov, np.eye(2, 4), 0.0, [], 0.0
        for k, mode in enumerate(sequence):
            F = motion.modes[mode].jacobian(x, t[k] - before)
            ahead, C = F @ x, F @ P @ F.T + motion.modes[mode].Q(x, t[k] - before)
            S, v = H @ C @ H.T + np.eye(2), z[k] - H @ ahead
            K = np.linalg.solve(S, H @ C).T
            loglik -= 0.5 * (v @ np.linalg.solve(S, v) + np.linalg.slogdet(2.0 * np.pi * S)[1])
            x, P, before = ahead + K @ v, C - K @ S @ K.T, t[k]
            past.append((F, ahead, C, x, P))
        mean, cov = [x], [P]
        for k in range(len(sequence) - 2, -1, -1):
            F, ahead, C, _, _ = past[k + 1]
            _, _, _, x, P = past[k]
            G = np.linalg.solve(C, F @ P).T
            mean.append(x + G @ (mean[-1] - ahead))
            cov.append(P + G @ (cov[-1] - C) @ G.T)
        return loglik, np.array(mean[::-1]), np.array(cov[::-1])


def test_the_smoother_is_close_to_the_sum_over_all_sequences_of_modes():
    """And five times closer than the filter: 12 records of 8 steps drawn from the model, fixed seed."""
    motion, t = switching([CALM, WILD], CHAIN, initial=[0.8, 0.2]), np.arange(1.0, 9.0)
    rng, gaps = np.random.default_rng(0), []
    for _ in range(12):
        x, mode, z = PRIOR.sample(rng=rng), rng.choice(2, p=motion.initial), []
        for _ in t:
            mode = rng.choice(2, p=motion.transition(1.0)[mode])
            Q = motion.modes[mode].Q(x, 1.0)
            x = motion.modes[mode].f(x, 1.0) + np.linalg.cholesky(Q) @ rng.standard_normal(4)
            z.append(x[:2] + rng.standard_normal(2))
        measured = tk.Record(t, np.array(z))
        want = Exact(motion, PRIOR, t, measured.z)
        history, modes = ModeSmoother().modes(
            run(motion, smoother="imm_smoother", measured=measured), motion
        )
        before = np.array([b.probabilities for b in history.beliefs.filtered])
        after = np.array([b.probabilities for b in modes])
        gaps.append(
            [
                np.abs(history.filtered.mean - want.mean)[:, :2].mean(),
                np.abs(history.smoothed.mean - want.mean)[:, :2].mean(),
                np.abs(before - want.probabilities).mean(),
                np.abs(after - want.probabilities).mean(),
            ]
        )
    filtered, smoothed, guessed, known = np.mean(gaps, axis=0)
    assert smoothed < 0.2 * filtered, (smoothed, filtered)
    assert known < 0.4 * guessed, (known, guessed)


# ------------------------------------------------------------------- beside everything else
def test_filters_that_keep_square_roots_are_mixed_too():
    motion, measured = switching([CALM, WILD], CHAIN), record((3,))
    rooted = run(motion, InteractingMultipleModels("ukf_square_root"), measured=measured)
    same(rooted, run(motion, InteractingMultipleModels("ukf"), measured=measured), 1e-8)


def test_modes_may_take_inputs_and_several_sensors_measure(interpretation, monkeypatch):
    pushed = acceleration_input(sigma=0.05)
    motion = switching([pushed, WILD], CHAIN)
    assert motion.input_space == pushed.input_space
    rng = np.random.default_rng(5)
    sensors = [position(1.0), azimuth(0.05).at(sx=20.0, sy=0.0)]
    z = rng.standard_normal((12, 2, 9))
    which = np.arange(12) % 2
    z[which == 1, 1] = np.nan
    measured = tk.Record(
        np.arange(1.0, 13.0), z, u=rng.standard_normal((12, 2)), sensor=which
    )  # fmt: skip
    built = tk.estimator("imm", motion=motion, sensor=sensors)
    if interpretation == "compiled":
        assert "one compiled step" in built.explain()
    here = tk.filter(built, measured, PRIOR, start=0.0)
    monkeypatch.setenv("TRACKER_COMPILE", "off")
    same(here, tk.filter(built, measured, PRIOR, start=0.0))
    single = tk.estimator("ekf1", motion=pushed, sensor=sensors)
    only = tk.estimator("imm", motion=switching([pushed, pushed], CHAIN), sensor=sensors)
    same(tk.filter(only, measured, PRIOR), tk.filter(single, measured, PRIOR))


def test_a_lane_of_a_smoothed_record_is_that_lane_smoothed_alone():
    motion = switching([CALM, coordinated_turn(0.01, 0.1)], rates=[[0.0, 0.1], [0.2, 0.0]])
    prior = tk.Gaussian(np.zeros(5), np.eye(5))
    rule, measured = InteractingMultipleModels(missing="prior"), record((4,))
    together = run(motion, rule, smoother=ModeSmoother(), prior=prior, measured=measured)
    alone = tk.Record(measured.t, measured.z[..., 2])
    single = run(motion, rule, smoother=ModeSmoother(), prior=prior, measured=alone)
    for name in ("mean", "cov"):
        ours = getattr(together.smoothed, name)[..., 2]
        np.testing.assert_allclose(ours, getattr(single.smoothed, name), rtol=0, atol=1e-8)


def test_it_runs_on_line_as_on_a_record():
    motion = switching([CALM, WILD], CHAIN)
    built = tk.estimator("imm", motion=motion, sensor=position(1.0))
    want, state, before = run(motion), PRIOR, 0.0
    for k, now in enumerate(want.t):
        state, told = built.step(state, record().z[k], now - before)
        before = now
        np.testing.assert_allclose(state.moments().mean, want.filtered.mean[k], atol=1e-10)
        np.testing.assert_allclose(told.loglik, want.innovation.loglik[k], atol=1e-9)


def test_a_campaign_of_modes_is_consistent_where_the_truth_is_one_of_them():
    """NEES of 1,000 runs in which the truth follows the first mode: at most 30 % above its 4."""
    scene = tk.scenario("line", steps=30, axes=2)
    motion = switching([scene.motion, constant_velocity(2.0)], [[0.98, 0.02], [0.1, 0.9]])
    modes = tk.estimator("imm", motion=motion, sensor=scene.sensor)
    single = tk.estimator("kf", motion=scene.motion, sensor=scene.sensor)
    campaign = tk.monte_carlo({"imm": modes, "kf": single}, scene, runs=1000, seed=3)
    imm, kf = (campaign.scores[name]["filter"] for name in ("imm", "kf"))
    assert 0.7 * 4 < imm.mean_nees < 1.3 * 4
    assert imm.rmse.value < 1.1 * kf.rmse.value


def test_a_heading_is_mixed_across_the_cut():
    from tracker.models import ComponentSensor
    from tracker.models import wrap as wrapped

    space = tk.Space.of("heading [rad] circular", "rate [rad/s]")

    def turning(by):
        return ComponentMotion(
            name="turning", space=space, parameters={"by": by},
            advance=lambda heading, rate, *, dt, by: (wrapped(heading + dt * (rate + by)), rate),
            noise=lambda *, dt: ((1e-3 * dt, 0.0), (0.0, 1e-6 * dt)),
        )  # fmt: skip

    compass = ComponentSensor(
        name="compass", measure=lambda heading: (heading,), noise=lambda: ((1e-2,),),
        space=tk.Space.of("heading [rad] circular"), state=space,
    )  # fmt: skip
    motion = switching([turning(0.05), turning(-0.05)], CHAIN)
    rng, t = np.random.default_rng(4), np.arange(1.0, 41.0)
    truth = np.pi + 0.3 * np.sin(t / 3.0)
    z = wrapped(truth + 0.1 * rng.standard_normal(40))[:, None]
    prior = tk.Gaussian(np.array([-3.1, 0.0]), np.diag([0.1, 1e-3]))
    for smoother in (None, "imm_smoother"):
        history = run(
            motion, sensor=compass, prior=prior, measured=tk.Record(t, z), smoother=smoother
        )
        error = wrapped(history.estimate.mean[:, 0] - truth)
        assert np.abs(error).max() < 0.4
        assert history.estimate.cov[:, 0, 0].max() < 0.1


@pytest.mark.parametrize("batch", [(), (3,)])
def test_a_mode_that_nothing_leads_to_is_no_reason_to_smooth_nothing(batch):
    modes = [constant_velocity(0.01), constant_velocity(1.0)]
    motion = switching(modes, np.eye(2), initial=[1.0, 0.0])
    prior, measured = tk.Gaussian(np.zeros(4), np.eye(4)), record(batch)
    found = run(motion, smoother="imm_smoother", prior=prior, measured=measured).smoothed
    alone = run(modes[0], "ekf1", smoother="rts", prior=prior, measured=measured).smoothed
    np.testing.assert_allclose(found.mean, alone.mean, atol=1e-9)
    np.testing.assert_allclose(found.cov, alone.cov, atol=1e-9)
