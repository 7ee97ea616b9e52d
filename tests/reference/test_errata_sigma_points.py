"""The unscented filter of paper 0 step by step (eq. 12-23): the corrected equations, and the printed ones.

Written out in NumPy from the paper, beside our own filter.
"""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

import tracker as tk
from tracker.testing import textbook
from tracker_kalman.sigma_point import unscented_symmetric
from tracker_sensors import azimuth, stack

seeds = st.integers(0, 2**32 - 1)
STATIONS = {"sx_1": 1.0, "sy_1": 1.0, "sx_2": 4.0, "sy_2": 1.1}  # paper 0, eq. (34)
SENSOR = stack([azimuth(np.deg2rad(2.0))] * 2).at(**STATIONS)
DT = 0.5


def spread(mean, cov):
    """Eq. (12), (13): 2n points of equal weight, columns of a root of n P."""
    root = np.linalg.cholesky(len(mean) * cov)
    return mean[:, None] + np.concatenate([root, -root], axis=1)


def moments(points, noise):
    """Eq. (16), (17) and (20), (21): mean and covariance of points of equal weight."""
    mean = points.mean(axis=1)
    d = points - mean[:, None]
    return mean, d @ d.T / points.shape[1] + noise


def predicted(mean, cov):
    """Eq. (14)-(17) through the kit's linear motion."""
    return moments(textbook.F(DT) @ spread(mean, cov), textbook.Q(DT))


def updated(mean, cov, points, h, R, z, sign=-1.0):
    """Eq. (19)-(23), from the points of eq. (18); the printed eq. (23) has the sign +1."""
    seen = h(points)
    zhat, S = moments(seen, R)  # eq. (20), (21)
    cross = (points - mean[:, None]) @ (seen - zhat[:, None]).T / points.shape[1]  # eq. (22)
    K = np.linalg.solve(S, cross.T).T
    return mean + K @ (z - zhat), cov + sign * K @ S @ K.T  # eq. (23)


def drawn(seed):
    rng = np.random.default_rng(seed)
    root = np.tril(rng.uniform(-1.0, 1.0, (4, 4))) + 2.0 * np.eye(4)
    return rng.standard_normal(4), root @ root.T, rng.standard_normal(2)


def linear(points):
    return textbook.H @ points


@given(seed=seeds)
def test_the_corrected_steps_are_the_kalman_filter_where_all_is_linear(seed):
    mean, cov, z = drawn(seed)
    x, P = predicted(mean, cov)
    want_x, want_P = textbook.predict(mean, cov, DT)
    np.testing.assert_allclose(x, want_x, atol=1e-10)
    np.testing.assert_allclose(P, want_P, atol=1e-10)
    found = updated(x, P, spread(x, P), linear, textbook.R, z)
    for a, b in zip(found, textbook.update(x, P, z)[:2], strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


@given(seed=seeds)
def test_the_corrected_steps_are_our_symmetric_unscented_filter(seed):
    rng = np.random.default_rng(seed)
    mean = np.array([2.5, 3.0, 0.3, 0.1]) + 0.1 * rng.standard_normal(4)
    cov = np.diag([0.05, 0.05, 0.1, 0.1])
    z = SENSOR.h(mean) + 0.03 * rng.standard_normal(2)
    want = updated(mean, cov, spread(mean, cov), SENSOR.h, SENSOR.R(mean), z)
    found, _ = unscented_symmetric().update(tk.Gaussian(mean, cov), SENSOR, z)
    np.testing.assert_allclose(found.mean, want[0], atol=1e-11)
    np.testing.assert_allclose(found.cov, want[1], atol=1e-11)


@given(seed=seeds)
def test_eq_16_is_the_mean_before_the_measurement(seed):
    """Printed as the estimate itself: read so, a measurement would have no part in it."""
    mean, cov, z = drawn(seed)
    x, P = predicted(mean, cov)
    after = textbook.update(x, P, z)[0]
    np.testing.assert_allclose(x, textbook.F(DT) @ mean, atol=1e-10)
    assert not np.allclose(x, after, atol=1e-9)


@given(seed=seeds)
def test_eq_18_with_the_covariance_after_an_update_is_not_the_kalman_filter(seed):
    """P+ of the step itself does not exist yet; that of the step before is too small by the motion."""
    mean, cov, z = drawn(seed)
    x, P = predicted(mean, cov)
    found = updated(x, P, spread(x, cov), linear, textbook.R, z)[1]
    assert not np.allclose(found, textbook.update(x, P, z)[1], rtol=1e-3, atol=1e-3)


@given(seed=seeds)
def test_eq_21_is_the_covariance_of_the_innovation(seed):
    """Printed as P-; it has the size of a measurement, and is what eq. (23) multiplies."""
    mean, cov, _ = drawn(seed)
    _, S = moments(linear(spread(mean, cov)), textbook.R)
    np.testing.assert_allclose(S, textbook.H @ cov @ textbook.H.T + textbook.R, atol=1e-10)
    assert S.shape == (2, 2) != cov.shape


@given(seed=seeds)
def test_eq_23_as_printed_lets_a_measurement_raise_the_covariance(seed):
    mean, cov, z = drawn(seed)
    printed = updated(mean, cov, spread(mean, cov), linear, textbook.R, z, sign=1.0)[1]
    corrected = updated(mean, cov, spread(mean, cov), linear, textbook.R, z)[1]
    right = textbook.update(mean, cov, z)[1]
    np.testing.assert_allclose(corrected, right, atol=1e-9)
    assert np.linalg.eigvalsh(cov - corrected)[0] > -1e-9, "what was learnt is taken away"
    assert np.linalg.eigvalsh(printed - cov)[-1] > 0.1, "printed, it is added"
    assert np.trace(printed) > np.trace(cov) > np.trace(right)


def test_eq_23_as_printed_is_inconsistent_on_the_stations_of_the_paper():
    """Mean NEES of 4 is right: the printed sign makes it far smaller. Chance: below 1e-6."""
    rng = np.random.default_rng(12)
    cov = np.diag([0.01, 0.01, 0.1, 0.1])
    nees = {-1.0: [], 1.0: []}
    for _ in range(200):
        mean = np.array([2.5, 3.0, 0.3, 0.1])
        truth = mean + np.sqrt(np.diag(cov)) * rng.standard_normal(4)
        z = SENSOR.h(truth) + np.deg2rad(2.0) * rng.standard_normal(2)
        for sign, found in nees.items():
            x, P = updated(mean, cov, spread(mean, cov), SENSOR.h, SENSOR.R(mean), z, sign)
            found.append((truth - x) @ np.linalg.solve(P, truth - x))
    # The mean of 200 chi-squares of 4 degrees has a standard deviation of 0.2: 5 of them are 1e-6.
    assert abs(np.mean(nees[-1.0]) - 4.0) < 1.0
    assert np.mean(nees[1.0]) < 3.0
