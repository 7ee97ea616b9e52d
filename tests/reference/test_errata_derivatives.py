"""Derivatives as the papers should have printed them, and proof that the printed ones are wrong."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker_sensors import azimuth, azimuth_elevation, azimuth_height, stack

STATIONS = {"sx_1": 1.0, "sy_1": 1.0, "sx_2": 4.0, "sy_2": 1.1}  # paper 0, eq. (34)
seeds = st.integers(0, 2**32 - 1)


def two_stations():
    return stack([azimuth(np.deg2rad(2.0))] * 2).at(**STATIONS)


def near(seed):
    """A target at a distance of 1 to 3 from the first station, in any direction."""
    rng = np.random.default_rng(seed)
    angle, r = rng.uniform(-np.pi, np.pi), rng.uniform(1.0, 3.0)
    return np.array([1.0 + r * np.cos(angle), 1.0 + r * np.sin(angle), 0.3, 0.1])


def offsets(x):
    return x[0] - 1.0, x[1] - 1.0


def numerical(function, x, step=1e-5):
    columns = []
    for i in range(len(x)):
        e = np.zeros(len(x))
        e[i] = step
        columns.append((function(x + e) - function(x - e)) / (2 * step))
    return np.stack(columns, axis=-1)


@given(seed=seeds)
def test_paper_0_jacobian_has_the_form_of_eq_31(seed):
    x = near(seed)
    dx, dy = offsets(x)
    r2 = dx**2 + dy**2
    np.testing.assert_allclose(two_stations().jacobian(x)[0], [-dy / r2, dx / r2, 0, 0], atol=1e-14)


@given(seed=seeds)
def test_paper_0_hessian_has_the_corrected_form(seed):
    x = near(seed)
    dx, dy = offsets(x)
    r4 = (dx**2 + dy**2) ** 2
    corrected = np.zeros((4, 4))
    corrected[:2, :2] = np.array([[2 * dx * dy, dy**2 - dx**2], [dy**2 - dx**2, -2 * dx * dy]]) / r4
    np.testing.assert_allclose(two_stations().hessian(x)[0], corrected, atol=1e-13)


@given(seed=seeds)
def test_paper_0_eq_32_as_printed_is_not_the_derivative(seed):
    x = near(seed)
    dx, dy = offsets(x)
    r2 = dx**2 + dy**2
    printed = np.array([dx / r2, -dy / r2, 0, 0])
    true = numerical(lambda s: two_stations().h(s)[:1], x)[0]
    wrong = np.linalg.norm(printed - true) * np.sqrt(r2)
    # The two differ by |dx + dy| sqrt(2) / r, which vanishes only where dx = -dy.
    assert wrong == pytest.approx(np.sqrt(2) * abs(dx + dy) / np.sqrt(r2), abs=1e-6)


@given(seed=seeds)
def test_paper_0_eq_33_as_printed_is_not_the_second_derivative_except_in_its_mixed_term(seed):
    x = near(seed)
    dx, dy = offsets(x)
    r4 = (dx**2 + dy**2) ** 2
    true = numerical(lambda s: two_stations().jacobian(s)[0], x)
    printed = {(0, 0): -2 * dx / r4, (1, 1): -2 * dy / r4, (0, 1): (dy**2 - dx**2) / r4}
    np.testing.assert_allclose(printed[0, 1], true[0, 1], atol=1e-7)
    # xx is right only where dx = 0 or dy = -1 [a length], yy only where dy = 0 or dx = 1.
    np.testing.assert_allclose(printed[0, 0] - true[0, 0], -2 * dx * (1 + dy) / r4, atol=1e-7)
    np.testing.assert_allclose(printed[1, 1] - true[1, 1], 2 * dy * (dx - 1) / r4, atol=1e-7)


def test_paper_0_eq_33_as_printed_changes_with_the_unit_of_length():
    """A second derivative of an angle by lengths must shrink a millionfold from km to m."""

    def printed(dx, dy):
        return -2 * dx / (dx**2 + dy**2) ** 2

    def corrected(dx, dy):
        return 2 * dx * dy / (dx**2 + dy**2) ** 2

    assert corrected(3.0, 4.0) / corrected(3e3, 4e3) == pytest.approx(1e6)
    assert printed(3.0, 4.0) / printed(3e3, 4e3) == pytest.approx(1e9)


@given(seed=seeds)
def test_paper_0_eq_30_needs_a_two_argument_arctangent(seed):
    x = near(seed)
    dx, dy = offsets(x)
    sensor = two_stations()
    printed = np.arctan(dy / dx)
    error = sensor.residual(np.array([printed, 0.0]), sensor.h(x) * [1.0, 0.0])[0]
    assert abs(error) == pytest.approx(np.pi if dx < 0 else 0.0, abs=1e-9)


@given(seed=seeds)
def test_paper_2_gradient_of_the_azimuth_from_north(seed):
    x = near(seed)
    dx, dy = offsets(x)
    r2 = dx**2 + dy**2
    gradient = azimuth(0.1, convention="north").jacobian(x, [1.0, 1.0])[0]
    np.testing.assert_allclose(gradient, [dy / r2, -dx / r2, 0, 0], atol=1e-14)


@given(seed=seeds)
def test_paper_3_and_4_rows_of_azimuth_elevation_and_height(seed):
    x, y, z, *v = np.random.default_rng(seed).normal(size=6) * 100
    rho, R2 = np.hypot(x, y), x**2 + y**2 + z**2
    state, pose = np.array([x, y, z, *v]), np.zeros(3)
    rows = azimuth_elevation(0.1, 0.1).jacobian(state, pose)
    np.testing.assert_allclose(
        rows[0], [-y / rho**2, x / rho**2, 0, 0, 0, 0], rtol=1e-9, atol=1e-15
    )
    elevation = [-x * z / (rho * R2), -y * z / (rho * R2), rho / R2, 0, 0, 0]
    np.testing.assert_allclose(rows[1], elevation, rtol=1e-9, atol=1e-15)
    height = azimuth_height(0.1, 2.0).jacobian(state, pose)[1]
    np.testing.assert_array_equal(height, [0, 0, 1, 0, 0, 0])


@given(seed=seeds)
def test_paper_3_eq_5_and_eq_12_count_azimuth_differently(seed):
    state, pose = np.random.default_rng(seed).normal(size=6), np.zeros(3)
    along_12 = azimuth_elevation(0.1, 0.1).h(state, pose)
    along_5 = azimuth_elevation(0.1, 0.1, convention="north").h(state, pose)
    phi, gamma = along_5
    r = np.linalg.norm(state[:3])
    # eq. (5): the vector that this direction stands for
    vector = r * np.array([np.cos(gamma) * np.sin(phi), np.cos(gamma) * np.cos(phi), np.sin(gamma)])
    np.testing.assert_allclose(vector, state[:3], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.cos(along_12[0] + phi - np.pi / 2), 1.0)
