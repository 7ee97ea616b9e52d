"""Filters that find their noise: limits in which they are their inner filter, equations, and purposes."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
import thesis

import tracker as tk
from tracker.errors import CapabilityError, DomainError, ShapeError
from tracker.testing.textbook import MOTION, POSITION
from tracker.types import Gaussian, Record
from tracker_adaptive import SmoothVariableStructure, StrongTracking, VariationalBayes
from tracker_motion.constant_velocity import constant_velocity
from tracker_sensors.position import position

Q, R0, TRUE = (0.02, 0.02, 0.02), (8.0, 1.0), (0.8, 9.0)


# ------------------------------------------------------------------------ variational Bayes
def textbook_vb(z, R, forgetting, worth, turns):
    """Särkkä and Nummenmaa (2009), algorithm 1, of one run, written in absolute variances."""
    x, P = np.zeros(3), 0.01 * np.eye(3)
    a, b = np.full(2, worth / 2), worth / 2 * np.array(R, float)
    H = thesis.H
    for row in z:
        x, P = thesis.F @ x, thesis.F @ P @ thesis.F.T + np.diag(Q)
        a, b0 = forgetting * a, forgetting * b
        a = a + 0.5
        # The first turn of ours begins with the predicted rate over the updated shape, as printed.
        b, m, C = b0, x, P
        for _ in range(turns):
            S = H @ P @ H.T + np.diag(b / a)
            K = np.linalg.solve(S, H @ P).T
            m, C = x + K @ (row - H @ x), P - K @ S @ K.T
            b = b0 + 0.5 * (row - H @ m) ** 2 + 0.5 * np.diag(H @ C @ H.T)
        S = H @ P @ H.T + np.diag(b / a)
        K = np.linalg.solve(S, H @ P).T
        x, P = x + K @ (row - H @ x), P - K @ S @ K.T
    return x, P, b / a


def test_variational_bayes_is_the_published_algorithm():
    # Ours conditions once more with the last noise; so does the loop above.
    _, z = thesis.simulated(Q, TRUE, 1, seed=1, steps=60)
    rule = VariationalBayes(inner="kf", forgetting=0.97, worth=8.0, iterations=4)
    est = tk.estimator(rule, motion=thesis.motion(Q), sensor=thesis.sensor(R0))
    state = est.begin(thesis.PRIOR)
    for row in z[..., 0]:
        state, _ = est.step(state, row, 1.0)
    x, P, R = textbook_vb(z[..., 0], R0, 0.97, 8.0, 4)
    np.testing.assert_allclose(state.state.mean, x, rtol=1e-9)
    np.testing.assert_allclose(state.state.cov, P, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(state.rate / state.shape * R0, R, rtol=1e-9)


@pytest.mark.statistical
def test_variational_bayes_finds_the_noise():
    # Over 100 runs of 500 steps the standard error of the mean log ratio is below 0.03.
    _, z = thesis.simulated(Q, TRUE, 100, seed=2)
    for factor in (1e-2, 1.0, 1e2):
        given = factor * np.array(TRUE)
        history = thesis.filtered(z, Q, given, filter=VariationalBayes(inner="kf"))
        S, P = history.innovation.S[-1], history.predicted.cov[-1]
        R = np.einsum("iib->ib", S) - np.einsum("iib->ib", P[:2, :2])
        assert (np.abs(np.log(R / np.array(TRUE)[:, None]).mean(axis=1)) < 0.2).all(), factor


def test_what_is_not_measured_teaches_no_noise():
    est = tk.estimator(VariationalBayes(), motion=MOTION, sensor=POSITION)
    state = est.begin(Gaussian(np.zeros(4), np.diag([9.0, 9.0, 1.0, 1.0])))
    state, _ = est.step(state, np.array([40.0, -30.0]), 1.0)
    for z in ([np.nan, np.nan], [np.nan, 7.0]):
        after, _ = est.filter.update(state, POSITION, np.array(z))
        assert after.rate[0] == state.rate[0]
        assert after.shape[0] == state.shape[0]
    again = est.filter.predict(state, MOTION, 0.0)
    np.testing.assert_array_equal(again.shape, state.shape)  # no time, nothing is forgotten
    for _ in range(5000):
        state = est.filter.predict(state, MOTION, 1e-3)
    np.testing.assert_allclose(state.shape, 1.0)  # vague, not gone
    np.testing.assert_allclose(state.rate / state.shape, again.rate / again.shape)


def test_a_sensor_without_room_is_refused():
    rule = VariationalBayes()
    state = rule.begin(Gaussian(np.zeros(4), np.eye(4)), sensors=[position(1.0)])
    assert len(state.shape) == 2
    wide = rule.begin(Gaussian(np.zeros(4), np.eye(4)))
    assert len(wide.shape) == 6
    small = attrs.evolve(wide, shape=wide.shape[:1], rate=wide.rate[:1])
    with pytest.raises(ShapeError, match="room for 1"):
        rule.project(small, position(1.0))


# ----------------------------------------------------------------------------------- limits
@pytest.mark.parametrize("inner", ["ekf1", "ukf"])
@pytest.mark.parametrize(
    ("rule", "limit"),
    [(VariationalBayes, {"worth": 1e12, "forgetting": 1.0}), (StrongTracking, {"softening": 1e30})],
)
def test_in_the_limit_it_is_its_inner_filter(rule, limit, inner):
    rng = np.random.default_rng(0)
    z = 30.0 * rng.standard_normal((20, 2, 3))
    z[rng.random(z.shape) < 0.2] = np.nan
    record = Record(np.cumsum(rng.uniform(0.0, 2.0, 20)), z)
    prior = Gaussian(np.zeros(4), np.diag([100.0, 100.0, 1.0, 1.0]))
    est = tk.estimator(inner, motion=MOTION, sensor=POSITION)
    want = tk.filter(est, record, prior)
    found = tk.filter(attrs.evolve(est, filter=rule(inner=inner, **limit)), record, prior)
    np.testing.assert_allclose(found.filtered.mean, want.filtered.mean, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found.innovation.nis, want.innovation.nis, rtol=1e-6, atol=1e-9)


# -------------------------------------------------------------------------- strong tracking
def test_the_fading_factor_is_the_published_one():
    rule = StrongTracking(inner="kf", softening=1.5, remember=0.9, most=1e6, beyond=1e12)
    state = rule.begin(Gaussian(np.zeros(4), np.diag([4.0, 9.0, 1.0, 1.0])))
    F, H, R = MOTION.jacobian(np.zeros(4), 1.0), np.eye(2, 4), POSITION.R(np.zeros(4))
    V = None
    for z in (np.array([30.0, -5.0]), np.array([60.0, 20.0])):
        P = state.state.cov
        ahead = rule.predict(state, MOTION, 1.0)
        v = z - H @ ahead.state.mean
        squares = np.mean(v**2 / np.diag(R))
        V = squares if V is None else (0.9 * V + squares) / 1.9
        Q_, carried = MOTION.Q(np.zeros(4), 1.0), F @ P @ F.T
        N = V - np.mean(np.diag(H @ Q_ @ H.T) / np.diag(R)) - 1.5
        M = np.mean(np.diag(H @ carried @ H.T) / np.diag(R))
        inflated = max(1.0, N / M) * carried + Q_
        state, told = rule.update(ahead, POSITION, z)
        np.testing.assert_allclose(told.S, H @ inflated @ H.T + R, rtol=1e-9)
        assert N / M > 1.0


@pytest.mark.parametrize("beyond", [0.5, 4.0, np.array([1.0, 50.0])])
def test_no_variance_is_inflated_beyond_what_the_prior_alone_would_predict(beyond):
    rule = StrongTracking(inner="kf", most=1e9, beyond=beyond)
    cov = np.diag([4.0, 9.0, 1.0, 1.0])
    state, blind = rule.begin(Gaussian(np.zeros((4, 2)), cov)), cov
    F, bounds = MOTION.jacobian(np.zeros(4), 1.0), np.broadcast_to(beyond, 2)
    for z in ([30.0, -5.0], [3e3, 20.0], [-5e3, 4e4], [1e6, 1e6]):
        ahead = rule.predict(state, MOTION, 1.0)
        blind = F @ blind @ F.T + MOTION.Q(np.zeros(4), 1.0)
        state, told = rule.update(ahead, POSITION, np.array(z)[:, None].repeat(2, axis=1))
        known = np.einsum("iib->ib", told.S - POSITION.R(np.zeros((4, 2))))
        predicted = np.einsum("iib->ib", ahead.state.cov)
        most = np.maximum(bounds * np.diag(blind)[:2, None], predicted[:2])
        assert (known < most * (1.0 + 1e-9)).all()
        room = (1.1 * predicted < bounds * np.diag(blind)[:, None]).all(axis=0)
        assert (known > 1.001 * predicted[:2])[:, room].all()  # else it would be no bound


@pytest.mark.parametrize("inner", ["ekf1", "ukf"])
@pytest.mark.parametrize("name", ["two_stations", "underwater_angles", "underwater_multipath"])
def test_where_noise_passes_for_a_manoeuvre_it_stays_near_or_says_so(name, inner):
    # Two of them tell their filters a noise that is many times too small. One seed.
    scene = tk.scenario(name)
    made = scene.simulate(seed=1, runs=200)
    place = list(scene.motion.space.position)

    def run(filter_):
        est = tk.estimator(filter_, motion=scene.motion, sensor=scene.sensor)
        history = tk.filter(est, made.record, made.prior, start=made.start)
        gap = (history.filtered.mean - made.truth)[:, place]
        sigma = np.einsum("kiib->kib", history.filtered.cov)[:, place]
        return history, np.sqrt((gap**2).sum(axis=1)), np.sqrt(sigma.sum(axis=1))

    history, error, sigma = run(StrongTracking(inner=inner))
    assert history.innovation.ok.all()
    assert error.max() < 10.0 * run(inner)[1].max(), "it has followed its noise away"
    if (error[-1] > 5.0 * sigma[-1]).mean() > 0.01:
        assert any("overconfident" in words for words in history.warnings())


def test_compiled_and_on_arrays_it_differs_by_rounding_that_only_the_printed_form_amplifies(
    monkeypatch,
):
    """The printed recursion is chaotic where noise is larger than R: arrays against arrays, of a
    record that differs by rounding, come apart as far as arrays and compiled steps do.
    """
    scene = tk.scenario("underwater_angles", steps=60)
    made = scene.simulate(seed=1, runs=16)
    jitter = np.random.default_rng(0).choice([-1.0, 1.0], made.record.z.shape)
    moved = Record(made.record.t, made.record.z * (1.0 + 2e-16 * jitter), pose=made.record.pose)

    def apart(rule):
        est = tk.estimator(rule, motion=scene.motion, sensor=scene.sensor)
        runs = []
        for mode, record in (("off", made.record), ("on", made.record), ("off", moved)):
            monkeypatch.setenv("TRACKER_COMPILE", mode)
            runs.append(tk.filter(est, record, made.prior, start=made.start).filtered)
        sigma = np.sqrt(np.einsum("kiib->kib", runs[0].cov))
        return [np.abs((other.mean - runs[0].mean) / sigma).max() for other in runs[1:]]

    compiled, jittered = apart(StrongTracking(beyond=1e300))
    assert jittered > 1e-6, "the case that this test is for did not occur"
    assert compiled < 1e3 * jittered
    assert max(apart(StrongTracking())) < 1e-9


@pytest.mark.statistical
@pytest.mark.parametrize("inner", ["ekf1", "ukf"])
def test_it_follows_a_target_that_manoeuvres(inner):
    # A sharp turn the motion does not know: the errors are several times larger without; one seed.
    rng = np.random.default_rng(3)
    steps, lanes = 80, 50
    speed = np.where(np.arange(steps)[:, None] < 40, [10.0, 0.0], [-5.0, 8.0])
    path = np.cumsum(speed, axis=0)
    z = path[..., None] + 3.0 * rng.standard_normal((steps, 2, lanes))
    est = tk.estimator(inner, motion=constant_velocity(density=1e-3), sensor=position(3.0))
    record = Record(np.arange(1.0, steps + 1), z)
    prior = Gaussian(np.array([0.0, 0.0, 10.0, 0.0]), np.eye(4))

    def error(filter_):
        history = tk.filter(attrs.evolve(est, filter=filter_), record, prior, start=0.0)
        gap = history.filtered.mean[40:, :2] - path[40:, :, None]
        return np.sqrt((gap**2).sum(axis=1).mean())

    assert error(StrongTracking(inner=inner)) < 0.5 * error(est.filter)


# ---------------------------------------------------------------------- variable structure
def test_the_residual_shrinks_as_the_convergence_says():
    # With everything measured, H+ = 1 / H: beyond the boundary, what is left is gamma times the last.
    rule = SmoothVariableStructure(inner="kf", boundary=1e-6, convergence=0.3, share=1e-12)
    state = rule.begin(Gaussian(np.zeros(4), np.eye(4)))
    z = np.array([7.0, -4.0])
    left = []
    for _ in range(4):
        state, told = rule.update(state, POSITION, z)
        left.append(np.abs(z - state.state.mean[:2]))
        assert told.ok
    np.testing.assert_allclose(left[0], 0.0, atol=1e-9)
    state = attrs.evolve(state, left=np.ones(6))
    moved = attrs.evolve(state, state=Gaussian(np.zeros(4), np.eye(4)))
    after, _ = rule.update(moved, POSITION, z)
    np.testing.assert_allclose(after.state.mean[:2], z + 0.3 * np.sign(z), rtol=1e-6)
    np.testing.assert_allclose(after.left[:2], 0.3, rtol=1e-6)


def test_its_covariance_is_josephs():
    rng = np.random.default_rng(2)
    A = rng.standard_normal((4, 4))
    P, H, R = A @ A.T, np.eye(2, 4), POSITION.R(np.zeros(4))
    rule = SmoothVariableStructure(inner="kf", boundary=2.0, convergence=0.2, share=0.3)
    state = rule.begin(Gaussian(np.zeros(4), P))
    z = np.array([5.0, -30.0])
    after, _ = rule.update(state, POSITION, z)
    part = np.abs(z) / np.maximum(np.abs(z), 2.0 * np.sqrt(np.diag(R)))
    K = np.linalg.solve(H @ P @ H.T + 0.3 * R, H @ P).T * part
    L = np.eye(4) - K @ H
    np.testing.assert_allclose(after.state.cov, L @ P @ L.T + K @ R @ K.T, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(after.state.mean, K @ z, rtol=1e-9)


@pytest.mark.parametrize("inner", ["ekf1", "ukf"])
def test_its_covariance_is_a_sum_of_squares_however_far_it_was_driven(inner):
    # Noise 3.4 times as large as told and a near-inverse of H: covariances of 1e20 and more.
    scene = tk.scenario("underwater_angles", steps=200)
    made = scene.simulate(seed=1, runs=50)
    rule = SmoothVariableStructure(inner=inner, share=0.01)
    est = tk.estimator(rule, motion=scene.motion, sensor=scene.sensor)
    history = tk.filter(est, made.record, made.prior, start=made.start)
    cov, ok = np.moveaxis(history.filtered.cov, (1, 2), (-2, -1)), history.innovation.ok
    assert cov[ok].max() > 1e12, "the case that this test is for did not occur"
    scale = np.sqrt(np.einsum("kii->ki", cov[ok]))
    assert np.linalg.eigvalsh(cov[ok] / (scale[:, :, None] * scale[:, None])).min() > -1e-13


def test_noise_that_rounding_has_swallowed_is_not_ok():
    rule = SmoothVariableStructure(inner="kf")
    for variance, sound in ((1e12, True), (1e18, False)):
        state = rule.begin(Gaussian(np.zeros(4), np.diag([variance, 1.0, 1.0, 1.0])))
        sharp = position(np.sqrt(1e-2))
        after, told = rule.update(state, sharp, np.array([1.0, 1.0]))
        assert bool(told.ok) is sound
        assert np.isnan(told.loglik) == (not sound)
        assert after.state.cov.diagonal().min() >= 0.0


@pytest.mark.statistical
def test_it_tracks_by_angles_where_the_noise_is_as_told_and_loses_nearer_to_the_inverse():
    """Shares of lost runs, of 200: none against nearly all, and none against a sixth."""
    from tracker_papers.underwater_angles import underwater_angles

    for scene, some in ((underwater_angles(told=True), 0.8), (tk.scenario("two_stations"), 0.05)):
        made = scene.simulate(seed=1, runs=200)
        place = list(scene.motion.space.position)
        lost = []
        for share in (0.3, 0.01):
            rule = SmoothVariableStructure(share=share)
            est = tk.estimator(rule, motion=scene.motion, sensor=scene.sensor)
            history = tk.filter(est, made.record, made.prior, start=made.start)
            gap = (history.filtered.mean[-1] - made.truth[-1])[place]
            sigma = np.einsum("iib->ib", history.filtered.cov[-1])[place]
            far = (gap**2).sum(axis=0) > 36.0 * sigma.sum(axis=0)
            lost.append(far | ~history.innovation.ok.all(axis=0))
        assert lost[0].mean() < 0.01
        assert lost[1].mean() > some


def test_it_says_so_where_noise_larger_than_told_drives_it_away():
    scene = tk.scenario("underwater_angles")
    made = scene.simulate(seed=1, runs=50)
    est = tk.estimator("smooth_variable_structure", motion=scene.motion, sensor=scene.sensor)
    told = tk.filter(est, made.record, made.prior, start=made.start).warnings()
    assert any("overconfident" in words for words in told)


def test_who_replaces_an_update_refuses_a_filter_that_has_its_own():
    for rule in (SmoothVariableStructure, VariationalBayes):
        with pytest.raises(CapabilityError, match="whose update is its own"):
            rule(inner="huber")


def test_numbers_that_cannot_be_are_refused():
    for rule, wrong in (
        (VariationalBayes, {"forgetting": 0.0}),
        (VariationalBayes, {"iterations": 0}),
        (StrongTracking, {"softening": 0.5}),
        (SmoothVariableStructure, {"convergence": 1.0}),
        (SmoothVariableStructure, {"boundary": np.nan}),
    ):
        with pytest.raises(DomainError):
            rule(**wrong)
