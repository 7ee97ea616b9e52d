"""Noise told as a ratio, samples held, polar places, and the paths of observers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.errors import DomainError, ShapeError
from tracker_sensors.observer_paths import Straight, Together, Weaving
from tracker_sensors.polar import from_polar, to_polar
from tracker_sensors.range_azimuth import range_azimuth
from tracker_sensors.signals import noise_sigma, signal_to_noise, zero_order_hold

offsets = st.floats(-1e4, 1e4)


# -------------------------------------------------------------------------------- signals
@given(scale=st.floats(1e-6, 1e6), decibels=st.floats(-60.0, 60.0))
def test_a_ratio_and_a_sigma_say_the_same(scale, decibels):
    signal = scale * np.random.default_rng(0).normal(size=(50, 3))
    sigma = noise_sigma(signal, decibels)
    np.testing.assert_allclose(signal_to_noise(signal, sigma), decibels, atol=1e-9)


def test_twenty_decibels_are_a_tenth_of_the_root_mean_square():
    assert float(noise_sigma([1.0, -1.0, 1.0], 20.0)) == pytest.approx(0.1)
    with pytest.raises(ShapeError):
        noise_sigma([], 20.0)
    with pytest.raises(DomainError):
        signal_to_noise([1.0], 0.0)


def test_a_sample_is_held_until_the_next_one_and_nothing_is_known_before_the_first():
    t, values = np.array([0.0, 1.0, 1.0, 3.0]), np.array([[1.0], [2.0], [3.0], [4.0]])
    held = zero_order_hold(t, values, np.array([-1.0, 0.0, 0.5, 1.0, 2.9, 3.0, 99.0]))
    np.testing.assert_array_equal(held[:, 0], [np.nan, 1.0, 1.0, 3.0, 3.0, 4.0, 4.0])
    np.testing.assert_array_equal(zero_order_hold(t[1:], values[1:], t[1:])[-1], values[-1])
    with pytest.raises(DomainError):
        zero_order_hold([1.0, 0.0], [1.0, 2.0], [0.5])
    with pytest.raises(ShapeError):
        zero_order_hold([0.0], [1.0, 2.0], [0.5])


# ---------------------------------------------------------------------------------- polar
@given(offsets, offsets, offsets, st.sampled_from(["math", "north"]))
def test_there_and_back(dx, dy, dz, convention):
    back = from_polar(*to_polar(dx, dy, dz, convention=convention), convention=convention)
    np.testing.assert_allclose(back, [dx, dy, dz], atol=1e-8)


@pytest.mark.parametrize("convention", ["math", "north"])
def test_polar_places_are_what_the_radar_measures(convention):
    x = np.array([30.0, -50.0, 0.0, 0.0])
    sensor = range_azimuth(1.0, 0.1, convention=convention).at(sx=0.0, sy=0.0)
    distance, azimuth, elevation = to_polar(30.0, -50.0, convention=convention)
    np.testing.assert_allclose(sensor.h(x), [distance, azimuth], rtol=1e-14)
    assert float(elevation) == 0.0


def test_another_convention_is_refused():
    with pytest.raises(DomainError, match="convention"):
        to_polar(1.0, 1.0, convention="south")


# ---------------------------------------------------------------------------------- paths
@pytest.mark.parametrize(
    "path",
    [
        Straight((1.0, 2.0, 3.0)),
        Straight((1.0, 2.0, 3.0), (0.5, 0.0, -1.0)),
        Weaving((1.0, 2.0, 3.0), (12.0, 0.0, -1.0), (0.0, 8.0, 0.0), period=100.0),
        Together((Straight((0.0, 0.0)), Weaving((1.0,), (1.0,), (2.0,), period=7.0))),
    ],
)
@pytest.mark.parametrize("shape", [(), (4,), (2, 0)])
def test_a_path_answers_for_times_of_any_shape(path, shape):
    t = np.arange(float(np.prod(shape, dtype=int))).reshape(shape)
    pose = path.pose(t)
    assert pose.shape == (3, *shape)
    for place in np.ndindex(shape):
        np.testing.assert_array_equal(pose[(slice(None), *place)], path.pose(t[place]))


def test_one_who_stands_still_stays():
    np.testing.assert_array_equal(Straight((4.0, 5.0)).pose(1e6), [4.0, 5.0])


@given(t=st.floats(0.0, 1e4), sway=st.floats(-50.0, 50.0), period=st.floats(1.0, 500.0))
def test_weaving_has_the_velocity_that_it_says(t, sway, period):
    path = Weaving((0.0, 0.0), (1.0, -2.0), (0.0, sway), period=period)
    h = 1e-3 * period
    slope = (path.pose(t + h) - path.pose(t - h)) / (2.0 * h)
    expected = [1.0, -2.0 + sway * np.sin(2.0 * np.pi * t / period)]
    np.testing.assert_allclose(slope, expected, atol=1e-5 * (1.0 + abs(sway)))
    away = path.pose(t) - Straight((0.0, 0.0), (1.0, -2.0)).pose(t)
    assert abs(away[1]) <= abs(sway) * period / np.pi + 1e-9


def test_paths_that_make_no_sense_are_refused():
    with pytest.raises(ShapeError):
        Straight((1.0, 2.0), (1.0,))
    with pytest.raises(ShapeError):
        Straight((np.nan,))
    with pytest.raises(DomainError):
        Weaving((0.0,), (0.0,), (1.0,), period=0.0)
