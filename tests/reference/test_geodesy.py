"""Geodesy against pyproj, and against what ships reported of themselves."""

import csv
import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tracker.errors import DomainError, ShapeError
from tracker.geodesy import (
    KNOT,
    LocalTangentPlane,
    ecef_from_geodetic,
    geodetic_from_ecef,
    velocity_from_course,
)
from tracker.types import Array

pyproj = pytest.importorskip("pyproj", reason="pyproj is the oracle; install the test extra")

REPORTS = Path(__file__).parent / "data" / "ais" / "solent_20160112.csv.gz"
LATITUDES = np.radians([-90.0, -89.999999, -45.0, -1e-9, 0.0, 1e-9, 12.5, 45.0, 89.999999, 90.0])
LONGITUDES = np.radians([-180.0, -179.999999, -90.0, 0.0, 1e-9, 33.0, 179.999999, 180.0])
HEIGHTS = np.array([-10_000.0, 0.0, 100.0, 35_000.0, 1e6, 1e7])


def grid() -> Array:
    return np.stack(np.meshgrid(LATITUDES, LONGITUDES, HEIGHTS, indexing="ij"))


def transformer(text: str, **options: float) -> Any:
    return pyproj.Transformer.from_pipeline(text.format(**options))


def test_earth_centred_positions_equal_pyproj() -> None:
    latitude, longitude, height = grid()
    oracle = transformer("+proj=cart +ellps=WGS84")
    expected = np.stack(oracle.transform(longitude, latitude, height, radians=True))
    ours = ecef_from_geodetic(latitude, longitude, height)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-8)


def test_geodetic_coordinates_equal_pyproj() -> None:
    oracle = transformer("+proj=cart +ellps=WGS84")
    position = ecef_from_geodetic(*grid())
    longitude, latitude, height = oracle.transform(*position, radians=True, direction="INVERSE")
    ours = geodetic_from_ecef(position)
    off_axis = np.hypot(position[0], position[1]) > 1e-3
    np.testing.assert_allclose(ours[1][off_axis], longitude[off_axis], rtol=0, atol=1e-15)
    # pyproj takes one step of Bowring's iteration, so it loses digits with height; how exact ours
    # is, the forward oracle above and the round trip in tests/property say together.
    for heights, angle, length in ((HEIGHTS < 1e5, 1e-11, 2e-5), (HEIGHTS > 1e5, 1e-8, 0.2)):
        chosen = np.s_[..., heights]
        np.testing.assert_allclose(ours[0][chosen], latitude[chosen], rtol=0, atol=angle)
        np.testing.assert_allclose(ours[2][chosen], height[chosen], rtol=0, atol=length)


@pytest.mark.parametrize(
    "origin", [(50.8, -1.1, 0.0), (-33.0, 179.999, 250.0), (90.0, 0.0, 0.0), (0.0, -180.0, -10.0)]
)
def test_the_local_tangent_plane_equals_pyproj(origin: tuple[float, float, float]) -> None:
    lat0, lon0, h0 = origin
    oracle = transformer(
        "+proj=pipeline +step +proj=cart +ellps=WGS84 "
        "+step +proj=topocentric +ellps=WGS84 +lat_0={lat0} +lon_0={lon0} +h_0={h0}",
        lat0=lat0,
        lon0=lon0,
        h0=h0,
    )
    latitude, longitude, height = grid()
    expected = np.stack(oracle.transform(longitude, latitude, height, radians=True))
    plane = LocalTangentPlane(np.radians(lat0), np.radians(lon0), h0)
    ours = plane.from_geodetic(latitude, longitude, height)
    np.testing.assert_allclose(ours, expected, rtol=0, atol=2e-8)


def test_ships_move_as_their_reported_course_and_speed_say() -> None:
    with gzip.open(REPORTS, "rt", encoding="utf-8", newline="") as stream:
        rows = [[float(cell) for cell in row] for row in list(csv.reader(stream))[1:]]
    t, vessel, latitude, longitude, course, knots = np.array(rows).T
    plane = LocalTangentPlane(*np.radians([latitude.mean(), longitude.mean()]))
    position = plane.from_geodetic(np.radians(latitude), np.radians(longitude))[:2]
    velocity = velocity_from_course(np.radians(course), knots * KNOT)
    for ship in np.unique(vessel):
        own = (vessel == ship).nonzero()[0]
        before, after = own[:-1], own[1:]
        gap = t[after] - t[before]
        under_way = (gap > 5.0) & (gap < 15.0) & (knots[before] > 5.0)
        before, after, gap = before[under_way], after[under_way], gap[under_way]
        mean_velocity = (velocity[:, before] + velocity[:, after]) / 2
        moved = position[:, after] - position[:, before]
        error = np.hypot(*(moved - mean_velocity * gap)) / np.hypot(*moved)
        assert len(gap) > 20
        assert np.median(error) < 0.1, f"vessel {ship:.0f}: axes, course or knots are mixed up"


def test_degrees_taken_for_radians_are_refused_with_the_remedy() -> None:
    with pytest.raises(DomainError, match=r"'latitude': got 50\.8.*np\.radians\(latitude\)"):
        ecef_from_geodetic(50.8, -1.1)
    with pytest.raises(DomainError, match=r"'longitude': got 151\.2.*np\.radians\(longitude\)"):
        ecef_from_geodetic(0.3, 151.2)
    with pytest.raises(DomainError, match="'height': got inf"):
        ecef_from_geodetic(0.0, 0.0, np.inf)


def test_a_position_at_the_centre_of_the_earth_is_refused() -> None:
    with pytest.raises(DomainError, match="Earth-centred and in metres"):
        geodetic_from_ecef([1.0, 2.0, 3.0])


def test_shapes_that_do_not_fit_are_named() -> None:
    with pytest.raises(ShapeError, match=r"latitude, longitude, height: got shapes \(2,\), \(3,\)"):
        ecef_from_geodetic(np.zeros(2), np.zeros(3))
    with pytest.raises(ShapeError, match=r"'enu': got shape \(2,\); expected \(3, \*batch\)"):
        LocalTangentPlane(0.0, 0.0).to_geodetic([1.0, 2.0])


def test_a_tangent_plane_needs_a_known_place() -> None:
    with pytest.raises(DomainError, match="give a known place"):
        LocalTangentPlane(np.nan, 0.0)


@pytest.mark.parametrize("spoilt", [0, 1, 2])
def test_an_unknown_component_spoils_its_own_element_only(spoilt: int) -> None:
    arguments = np.zeros((3, 2))
    arguments[spoilt, 0] = np.nan
    for answer in (
        ecef_from_geodetic(*arguments),
        LocalTangentPlane(0.1, 0.2).from_geodetic(*arguments),
        geodetic_from_ecef(arguments + np.array([[7e6], [0.0], [0.0]])),
        LocalTangentPlane(0.1, 0.2).to_geodetic(arguments),
    ):
        assert np.isnan(answer[:, 0]).all()
        assert np.isfinite(answer[:, 1]).all()
