"""Each erratum of paper 0: what is printed is wrong, what replaces it is right, by independent means.

The names of these tests stand in ``plugins/tracker_papers/paper0/paper.toml`` beside the errata.
"""

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm

import tracker as tk
from tracker.errors import ShapeError
from tracker.metrics.errors import rmse, squared_position_error
from tracker.types import Gaussian
from tracker_papers.gulf_to_oman import STATIONS, gulf_to_oman
from tracker_papers.paper0.methods import WRONG_HESSIAN, estimators, with_printed_hessian
from tracker_sensors import position

SCENE = gulf_to_oman()
H = np.array([[1.0, 0.2, 0.0, 0.0], [0.0, 1.0, 0.3, 0.0]])
R = np.diag([0.3, 0.2])


def offsets(x):
    """Of a state to the first station: dx, dy, r squared."""
    dx, dy = x[0] - STATIONS[0][0], x[1] - STATIONS[0][1]
    return dx, dy, dx**2 + dy**2


def covariance(n, seed):
    root = np.random.default_rng(seed).normal(size=(n, n))
    return root @ root.T / n + 0.1 * np.eye(n)


def numerical(function, x, step=1e-5):
    columns = []
    for i in range(len(x)):
        e = np.zeros(len(x))
        e[i] = step
        columns.append((function(x + e) - function(x - e)) / (2 * step))
    return np.stack(columns, axis=-1)


def points(mean, cov):
    """The 2n sigma points of eq. 12, written out."""
    root = np.linalg.cholesky(len(mean) * cov)
    return np.concatenate([mean + root.T, mean - root.T])  # one per row


NEAR = [np.array([1.0 + r * np.cos(a), 1.0 + r * np.sin(a), 0.3, 0.1])
        for r, a in ((0.7, 0.4), (1.3, 2.0), (2.0, -2.5), (0.5, -0.8))]  # fmt: skip


# ------------------------------------------------------------------------------------ models
@pytest.mark.statistical
def test_eq_1_the_noise_of_measurement_k_has_the_index_k():
    """Noise that changes from step to step is consistent only with the R of its own step.

    NIS per component of 2,000 measurements of two components: it is chi-square with 4,000 degrees,
    whose 99.99 % band is 1 +- 0.087 per degree. With the R of the step before it is several times 1.
    """
    sensors = [position(sigma, axes=2) for sigma in (1.0, 5.0)]
    still = tk.motions.make("constant_velocity", density=1e-12)
    made = tk.estimator("kf", motion=still, sensor=sensors)
    rng, t, which = np.random.default_rng(1), np.arange(2000.0), np.arange(2000) % 2
    prior = Gaussian(np.zeros(4), 1e-12 * np.eye(4))
    z = rng.normal(size=(2000, 2)) * np.where(which, 5.0, 1.0)[:, None]

    def score(index):
        record = tk.Record(t, z, sensor=index)
        return np.mean(tk.filter(made, record, prior).innovation.nis) / 2.0

    assert abs(score(which) - 1.0) < 0.087
    assert score(1 - which) > 3.0, "the R of the step before is that of the other sensor"


def test_eq_3_4_26_28_and_29_agree():
    """Integral, matrix fraction and closed form of Q are one, with L zero in the rows of position."""
    dt, q = 0.37, 0.1
    F, L = np.kron([[0, 1], [0, 0]], np.eye(2)), np.kron([[0], [1]], np.eye(2))
    assert not L[:2].any()
    noise = L @ (q * np.eye(2)) @ L.T
    integral, _ = quad_vec(lambda s: expm(F * (dt - s)) @ noise @ expm(F * (dt - s)).T, 0.0, dt)
    fraction = expm(np.block([[F, noise], [np.zeros((4, 4)), -F.T]]) * dt)[:, 4:]
    fraction = fraction[:4] @ np.linalg.solve(fraction[4:], np.eye(4))
    closed = q * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(2))
    np.testing.assert_allclose(integral, closed, atol=1e-14)
    np.testing.assert_allclose(fraction, closed, atol=1e-14)
    np.testing.assert_allclose(np.squeeze(SCENE.motion.Q(np.zeros(4), dt)), closed, atol=1e-15)
    np.testing.assert_allclose(
        np.squeeze(SCENE.motion.jacobian(np.zeros(4), dt)), expm(F * dt), atol=1e-15
    )


@pytest.mark.parametrize("x", NEAR)
def test_eq_30_needs_a_two_argument_arctangent(x):
    dx, dy, _ = offsets(x)
    bearing = SCENE.sensor.h(x)[0]
    turned = np.array([np.cos(bearing), np.sin(bearing)]) * np.hypot(dx, dy)
    np.testing.assert_allclose(turned, [dx, dy], atol=1e-14)
    printed = np.arctan(dy / dx)
    wrong = abs(np.angle(np.exp(1j * (printed - bearing))))
    assert wrong == pytest.approx(np.pi if dx < 0 else 0.0, abs=1e-9)


def test_eq_30_needs_wrapped_residuals():
    """Across the cut two bearings that are 2 degrees apart differ by 358 without wrapping."""
    z, zhat = np.deg2rad([179.0, 10.0]), np.deg2rad([-179.0, 10.0])
    np.testing.assert_allclose(SCENE.sensor.residual(z, zhat), np.deg2rad([-2.0, 0.0]), atol=1e-15)
    track, (sx, sy) = np.asarray(SCENE.path), STATIONS[1]
    bearing = np.arctan2(track[:, 1] - sy, track[:, 0] - sx)
    assert np.sum(np.abs(np.diff(bearing)) > np.pi) == 2, (
        "the ship crosses the cut of station 2 twice"
    )


@pytest.mark.parametrize("x", NEAR)
def test_eq_32_has_its_columns_swapped_and_signs_moved(x):
    dx, dy, r2 = offsets(x)
    true = numerical(lambda s: SCENE.sensor.h(s)[:1], x)[0]
    np.testing.assert_allclose(true, [-dy / r2, dx / r2, 0, 0], atol=1e-8)  # eq. 31
    np.testing.assert_allclose(SCENE.sensor.jacobian(x)[0], true, atol=1e-8)
    printed = np.array([dx / r2, -dy / r2, 0, 0])
    # they differ by |dx + dy| sqrt(2) / r2, which vanishes only where dx = -dy
    off = np.linalg.norm(printed - true)
    assert off == pytest.approx(np.sqrt(2) * abs(dx + dy) / r2, abs=1e-7)
    assert off > 0.05


@pytest.mark.parametrize("x", NEAR)
def test_eq_33_is_not_the_second_derivative(x):
    dx, dy, r2 = offsets(x)
    true = numerical(lambda s: SCENE.sensor.jacobian(s)[0], x)
    corrected = np.zeros((4, 4))
    corrected[:2, :2] = [[2 * dx * dy, dy**2 - dx**2], [dy**2 - dx**2, -2 * dx * dy]]
    np.testing.assert_allclose(corrected / r2**2, true, atol=1e-6)
    np.testing.assert_allclose(SCENE.sensor.hessian(x)[0], true, atol=1e-6)
    (sensor,) = (one.sensors[0] for one in with_printed_hessian(SCENE).values())
    printed = sensor.hessian(x)[0]
    np.testing.assert_allclose(printed[0, 1], true[0, 1], atol=1e-6)  # the mixed term is right
    # xx is right only where dx = 0 or dy = -1 [a length], yy only where dy = 0 or dx = 1
    off = printed[0, 0] - true[0, 0], printed[1, 1] - true[1, 1]
    by_hand = [-2 * dx * (1 + dy) / r2**2, 2 * dy * (dx - 1) / r2**2]
    np.testing.assert_allclose(off, by_hand, atol=1e-6)
    assert np.abs(off).max() > 0.2


def test_eq_33_changes_with_the_unit_of_length():
    """A second derivative of an angle by lengths shrinks a millionfold from km to m."""

    def printed(dx, dy):
        return -2 * dx / (dx**2 + dy**2) ** 2

    def corrected(dx, dy):
        return 2 * dx * dy / (dx**2 + dy**2) ** 2

    assert corrected(3.0, 4.0) / corrected(3e3, 4e3) == pytest.approx(1e6)
    assert printed(3.0, 4.0) / printed(3e3, 4e3) == pytest.approx(1e9)


@pytest.mark.statistical
@pytest.mark.parametrize("preset", ["A", "B"])
def test_eq_33_as_printed_makes_the_filter_worse(preset):
    """Run by run on the same numbers: worse in more than half of 100 runs, and in the median.

    If it did no harm, a run would be worse with probability 1/2, and 70 or more of 100 with
    probability 4e-5. (A: four times the error; B, with its small steps: 5 per cent.)
    """
    scene = gulf_to_oman(preset)
    made = {**estimators(scene, ("ekf2",)), **with_printed_hessian(scene)}
    campaign = tk.monte_carlo(made, scene, runs=100, seed=3)
    right = campaign.scores["ekf2"]["filter"].per_run["rmse"]
    wrong = campaign.scores[WRONG_HESSIAN]["filter"].per_run["rmse"]
    assert np.sum(wrong > right) >= 70
    assert np.median(wrong) > (2.0 if preset == "A" else 1.02) * np.median(right)


def test_the_initial_state_needs_four_numbers():
    with pytest.raises(ShapeError, match="vy"):
        tk.Scenario(
            name="as printed",
            motion=SCENE.motion,
            sensor=SCENE.sensor,
            prior=Gaussian([0.5, 0.5, 0.3], np.eye(3)),
            t=SCENE.t,
        )


# ----------------------------------------------------------------------------------- filters
def test_eq_6_and_7_both_forms_of_the_covariance_are_one():
    for seed in range(5):
        P = covariance(4, seed)
        S = H @ P @ H.T + R
        K = np.linalg.solve(S, H @ P).T
        np.testing.assert_allclose((np.eye(4) - K @ H) @ P, P - K @ S @ K.T, atol=1e-14)


def test_eq_8_and_11_a_hessian_belongs_to_the_component_of_its_superscript():
    """With h_i the expansion is right to third order in the step; h_j does not even exist for j > m."""
    x, step = NEAR[1], np.array([0.3, -0.2, 0.1, 0.4])
    sensor = SCENE.sensor
    second = sensor.hessian(x)
    assert second.shape == (2, 4, 4), "j runs over 4 states, the components are only 2"

    def left_over(size, hessians):
        e = size * step
        expanded = sensor.h(x) + sensor.jacobian(x) @ e
        expanded = expanded + 0.5 * np.einsum("ijk,j,k->i", hessians, e, e)
        return np.abs(sensor.residual(sensor.h(x + e), expanded))

    ratio = left_over(0.02, second) / left_over(0.01, second)
    np.testing.assert_allclose(ratio, 8.0, rtol=0.1)
    other = left_over(0.02, second[::-1]) / left_over(0.01, second[::-1])
    np.testing.assert_allclose(
        other, 4.0, rtol=0.2
    )  # the Hessian of another component: second order


@pytest.mark.statistical
def test_eq_10_lacks_the_second_order_part_of_the_innovation_covariance():
    """The covariance of (e' H_i e) / 2 is tr(H_i P H_j P) / 2, by 200,000 draws, and not zero.

    Each entry of the sample covariance has a standard error of at most sqrt(3 kurtosis) of its size
    over sqrt(200,000), below 2 % of the geometric mean of the two variances; 5 standard errors are
    allowed: a false alarm in less than 1 of 100,000 repetitions.
    """
    rng = np.random.default_rng(0)
    P, second = covariance(4, 3), SCENE.sensor.hessian(NEAR[1])
    e = rng.multivariate_normal(np.zeros(4), P, size=200_000)
    sampled = np.cov(0.5 * np.einsum("ijk,rj,rk->ir", second, e, e))
    formula = 0.5 * np.einsum("iab,bc,jcd,da->ij", second, P, second, P)
    scale = np.sqrt(np.outer(np.diag(formula), np.diag(formula)))
    assert np.abs(sampled - formula).max() < 0.1 * scale.max()
    assert formula[0, 0] > 0.01, "there is something to be missed"
    # and our filter has it, unless the printed form is asked for
    state, x = Gaussian(NEAR[1], P), NEAR[1]
    jacobian = SCENE.sensor.jacobian(x)
    first = jacobian @ P @ jacobian.T + np.squeeze(SCENE.sensor.R(x))
    whole = tk.filters.make("ekf2").project(state, SCENE.sensor)
    printed = tk.filters.make("ekf2", second_order_innovation=False).project(state, SCENE.sensor)
    np.testing.assert_allclose(whole.S, first + formula, atol=1e-12)
    np.testing.assert_allclose(printed.S, first, atol=1e-12)


def _linear_step():
    """One step of a linear problem by the Kalman filter: predicted and updated moments."""
    F = np.squeeze(SCENE.motion.jacobian(np.zeros(4), 0.5))
    Q = np.squeeze(SCENE.motion.Q(np.zeros(4), 0.5))
    x, P = np.array([1.0, -0.5, 0.4, 0.2]), covariance(4, 7)
    ahead, before = F @ x, F @ P @ F.T + Q
    S = H @ before @ H.T + R
    K = np.linalg.solve(S, H @ before).T
    after = ahead + K @ (np.array([2.0, 0.5]) - H @ ahead)
    return F, Q, x, P, ahead, before, S, K, after


def test_eq_16_the_mean_of_the_propagated_points_is_the_predicted_mean():
    F, _, x, P, ahead, *_, after = _linear_step()
    mean = (points(x, P) @ F.T).mean(axis=0)
    np.testing.assert_allclose(mean, ahead, atol=1e-14)
    assert np.abs(mean - after).max() > 0.1, "and not the updated one"


def test_eq_18_points_are_redrawn_from_the_predicted_covariance():
    """From the predicted covariance the measured points have the covariance that Kalman's filter has."""
    *_, ahead, before, S, K, _ = _linear_step()
    updated = before - K @ S @ K.T

    def measured(cov):
        y = points(ahead, cov) @ H.T
        return (y - y.mean(axis=0)).T @ (y - y.mean(axis=0)) / len(y) + R

    np.testing.assert_allclose(measured(before), S, atol=1e-14)
    assert np.abs(measured(updated) - S).max() > 0.1


def test_eq_21_is_the_covariance_of_the_innovation():
    """It is made of measurements, m by m, and is what K of eq. 22 divides by."""
    *_, ahead, before, S, K, _ = _linear_step()
    x = points(ahead, before)
    y = x @ H.T
    P_Y = (y - y.mean(axis=0)).T @ (y - y.mean(axis=0)) / len(y) + R
    P_XY = (x - ahead).T @ (y - y.mean(axis=0)) / len(y)
    assert P_Y.shape == (2, 2) != before.shape
    np.testing.assert_allclose(P_Y, S, atol=1e-14)
    np.testing.assert_allclose(np.linalg.solve(P_Y, P_XY.T).T, K, atol=1e-14)


def test_eq_23_has_a_minus_sign():
    """A measurement cannot raise the covariance, and the linear case has the minus."""
    *_, before, S, K, _ = _linear_step()
    exact = np.linalg.inv(np.linalg.inv(before) + H.T @ np.linalg.inv(R) @ H)  # noqa: TID251
    np.testing.assert_allclose(before - K @ S @ K.T, exact, atol=1e-13)
    printed = before + K @ S @ K.T
    assert np.linalg.eigvalsh(printed - before).min() > -1e-12
    assert np.trace(printed) > np.trace(before) > np.trace(exact)
    state = Gaussian(NEAR[0], 0.01 * np.eye(4))
    z = SCENE.sensor.h(NEAR[0]) + 0.01
    ours, _ = tk.filters.make("ukf_symmetric").update(state, SCENE.sensor, z)
    assert np.linalg.eigvalsh(state.cov - ours.cov).min() > -1e-12


def test_eq_24_equals_the_batch_solution():
    """On a linear problem the recursion gives the posterior of the whole record, solved at once."""
    motion, sensor = SCENE.motion, position(0.5, axes=2)
    prior = Gaussian([1.0, 2.0, 0.5, -0.5], covariance(4, 11))
    t = np.array([0.3, 0.4, 1.0, 1.7, 2.5])
    z = np.random.default_rng(5).normal(size=(5, 2)) + 1.5
    made = tk.estimator("kf", motion=motion, sensor=sensor, smoother="rts")
    ours = tk.smooth(made, tk.Record(t, z), prior, start=0.0).smoothed
    # all states in one vector: x_0 and the process noises map onto them linearly
    steps = np.diff(np.concatenate(([0.0], t)))
    n, T = 4, len(t)
    mean, joint = np.empty(n * T), np.zeros((n * T, n * T))
    spread = [prior.cov, *(np.squeeze(motion.Q(np.zeros(n), dt)) for dt in steps)]
    maps = np.zeros((T, T + 1, n, n))
    past, transitions = np.eye(n), []
    for k, dt in enumerate(steps):
        F = np.squeeze(motion.jacobian(np.zeros(n), dt))
        transitions.append(F)
        past = F @ past
        mean[n * k : n * (k + 1)] = past @ prior.mean
        maps[k, 0] = past
        for j in range(k):
            maps[k, j + 1] = F @ maps[k - 1, j + 1]
        maps[k, k + 1] = np.eye(n)
    for a in range(T):
        for b in range(T):
            joint[n * a : n * (a + 1), n * b : n * (b + 1)] = sum(
                maps[a, j] @ spread[j] @ maps[b, j].T for j in range(T + 1)
            )
    observe = np.kron(np.eye(T), np.eye(2, 4))
    S = observe @ joint @ observe.T + 0.25 * np.eye(2 * T)
    gain = np.linalg.solve(S, observe @ joint).T
    mean = mean + gain @ (z.ravel() - observe @ mean)
    joint -= gain @ S @ gain.T
    np.testing.assert_allclose(ours.mean.reshape(-1), mean, atol=1e-12)
    for k in range(T):
        block = slice(n * k, n * (k + 1))
        np.testing.assert_allclose(ours.cov[k], joint[block, block], atol=1e-12)


# ----------------------------------------------------------------------------------- metrics
def test_eq_37_needs_a_bracket():
    """Without it the second square is neither averaged nor bounded by the errors themselves."""
    errors = np.array([[3.0, 4.0, 9.0, 9.0]] * 10)[:, :, None]  # every error is 5 long
    bracketed = rmse(squared_position_error(errors, SCENE.motion.space), axis=0)
    assert bracketed == pytest.approx(5.0)
    dx, dy = errors[:, 0, 0], errors[:, 1, 0]
    printed = np.sqrt(np.sum(dx**2 / len(dx) + dy**2))  # 1/N reaches the first square only
    assert printed == pytest.approx(13.0)
