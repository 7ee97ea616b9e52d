"""Laws of geodesy: every conversion is undone by its inverse, on the whole Earth."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.geodesy import (
    LocalTangentPlane,
    angle_from_bearing,
    bearing_from_angle,
    course_from_velocity,
    ecef_from_geodetic,
    geodetic_from_ecef,
    velocity_from_course,
)
from tracker.types import ArrayLike

latitudes = st.floats(-np.pi / 2, np.pi / 2)
longitudes = st.floats(-np.pi, np.pi)
heights = st.floats(-10_000.0, 1e7)
angles = st.floats(-1e3, 1e3)


def turns_apart(one: ArrayLike, other: ArrayLike) -> Any:
    return abs(np.exp(1j * np.asarray(one)) - np.exp(1j * np.asarray(other)))


@given(latitudes, longitudes, heights)
def test_a_position_survives_geodetic_coordinates(
    latitude: float, longitude: float, height: float
) -> None:
    position = ecef_from_geodetic(latitude, longitude, height)
    back = geodetic_from_ecef(position)
    np.testing.assert_allclose(ecef_from_geodetic(*back), position, rtol=0, atol=2e-8)
    assert abs(back[0] - latitude) < 1e-14
    assert abs(back[2] - height) < 1e-8


@given(latitudes, longitudes, latitudes, longitudes, heights)
def test_a_position_survives_the_local_tangent_plane(
    lat0: float, lon0: float, latitude: float, longitude: float, height: float
) -> None:
    plane = LocalTangentPlane(lat0, lon0)
    enu = plane.from_geodetic(latitude, longitude, height)
    back = plane.from_geodetic(*plane.to_geodetic(enu))
    np.testing.assert_allclose(back, enu, rtol=0, atol=5e-8)


@given(latitudes, longitudes, heights, heights)
def test_up_is_the_direction_in_which_height_grows(
    latitude: float, longitude: float, low: float, high: float
) -> None:
    plane = LocalTangentPlane(latitude, longitude, low)
    enu = plane.from_geodetic(latitude, longitude, high)
    np.testing.assert_allclose(enu, [0.0, 0.0, high - low], rtol=0, atol=2e-8)


@pytest.mark.parametrize("batch", [(), (3,), (2, 0)])
def test_a_batch_equals_its_elements_and_is_not_modified(batch: tuple[int, ...]) -> None:
    rng = np.random.default_rng(3)
    arguments = rng.uniform(-1.0, 1.0, (3, *batch))
    arguments.flags.writeable = False
    plane = LocalTangentPlane(0.3, -2.0, 50.0)
    enu = plane.from_geodetic(*arguments)
    back = plane.to_geodetic(enu)
    assert enu.shape == back.shape == (3, *batch)
    for index in np.ndindex(batch):
        one = plane.from_geodetic(*arguments[(slice(None), *index)])
        np.testing.assert_allclose(enu[(slice(None), *index)], one, rtol=1e-12)


@given(angles)
def test_bearings_and_angles_undo_each_other(bearing: float) -> None:
    angle = angle_from_bearing(bearing)
    assert -np.pi < angle <= np.pi
    assert 0.0 <= bearing_from_angle(angle) < 2 * np.pi
    assert turns_apart(bearing_from_angle(angle), bearing) < 1e-12
    assert turns_apart(angle_from_bearing(bearing_from_angle(bearing)), bearing) < 1e-12


@given(angles, st.floats(1e-3, 1e3))
def test_course_and_speed_survive_velocity(course: float, speed: float) -> None:
    back_course, back_speed = course_from_velocity(velocity_from_course(course, speed))
    assert 0.0 <= back_course < 2 * np.pi
    assert turns_apart(back_course, course) < 1e-12
    assert abs(back_speed - speed) < 1e-12 * speed


@pytest.mark.parametrize("tiny", [-1e-20, 0.0, 1e-20])
def test_bearings_just_west_of_north_stay_below_a_full_turn(tiny: float) -> None:
    assert course_from_velocity([tiny, 1.0])[0] < 1e-15
    assert angle_from_bearing(np.pi / 2 + tiny) <= np.pi
