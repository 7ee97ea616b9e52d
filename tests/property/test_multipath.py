"""Delays of reflected paths against images drawn by hand, the thesis' equations, and their inverse."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.errors import DomainError, ShapeError
from tracker_sensors.multipath_delays import multipath_delays, range_and_height
from tracker_sensors.sound_speed import mackenzie, unesco

REFERENCE = json.loads(
    (Path(__file__).parents[1] / "reference/data/underwater/reference.json").read_text(
        encoding="utf-8"
    )
)
PATHS = ("surface", "bottom", "surface bottom", "bottom surface")


def delays(x, y, z, *, paths=("surface", "bottom"), depth=100.0, height=155.0):
    sensor = multipath_delays(1e-3, depth=depth, height=height, paths=paths)
    return sensor.at(sx=0.0, sy=0.0, sz=0.0).h(np.array([x, y, z, 0.0, 0.0, 0.0]))


@pytest.mark.parametrize("row", REFERENCE["multipath_image"]["rows"])
def test_travel_times_are_those_of_images(row):
    sensor = multipath_delays(
        1e-3,
        depth=row["z_receiver"],
        height=row["depth"] - row["z_receiver"],
        paths=PATHS,
        speed=row["c"],
    ).at(sx=0.0, sy=0.0, sz=-row["z_receiver"])
    found = sensor.h(np.array([row["range_m"], 0.0, -row["z_source"], 0.0, 0.0, 0.0]))
    expected = [row[f"tau_{path.replace(' ', '_')}"] - row["tau_direct"] for path in PATHS]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


@given(
    st.floats(1.0, 5000.0),
    st.floats(-3.0, 3.0),
    st.floats(-154.0, 99.0),
)
def test_single_reflections_are_the_equations_of_the_thesis(level, azimuth, dz):
    """Paper 4, eq. 4-1 and 4-2 as printed, to the digits that their difference leaves."""
    x, y = level * np.cos(azimuth), level * np.sin(azimuth)
    slant = np.sqrt(level**2 + dz**2)
    up, down, c = 100.0, 155.0, 1500.0
    surface = (np.sqrt(slant**2 + 4 * up**2 - 4 * dz * up) - slant) / c
    bottom = (np.sqrt(slant**2 + 4 * down**2 + 4 * dz * down) - slant) / c
    np.testing.assert_allclose(delays(x, y, dz), [surface, bottom], rtol=0, atol=1e-14 * slant)


@given(
    st.floats(1.0, 5000.0),
    st.floats(-154.0, 99.0),
)
def test_the_inverse_gives_back_what_was_put_in(level, dz):
    surface, bottom = delays(level, 0.0, dz)
    slant, above = range_and_height(surface, bottom, depth=100.0, height=155.0)
    expected = np.hypot(level, dz)
    np.testing.assert_allclose([slant, above], [expected, dz], rtol=1e-6, atol=1e-6 * expected)


def test_the_printed_jacobian_of_the_bottom_path_is_wrong():
    """Eq. 4-25 and 4-30 print a minus before the terms in HO2; the derivative has a plus."""
    sensor = multipath_delays(1e-3, depth=100.0, height=155.0).at(sx=0.0, sy=0.0, sz=0.0)
    x = np.array([300.0, -120.0, -60.0, 0.0, 0.0, 0.0])
    dz, down, c = x[2], 155.0, 1500.0
    slant = np.linalg.norm(x[:3])

    def row(sign):
        length = np.sqrt(slant**2 + 4 * down**2 + sign * 4 * down * dz)
        return [
            *(x[:2] / c * (1 / length - 1 / slant)),
            ((dz + sign * 2 * down) / length - dz / slant) / c,
        ]

    found = sensor.jacobian(x)[1, :3]
    np.testing.assert_allclose(found, row(+1.0), rtol=1e-10)
    assert np.abs(found - row(-1.0)).max() > 0.5 * np.abs(found).max()


def test_several_bounces_arrive_later_and_later():
    paths = ("surface", "surface bottom", "surface bottom surface", "surface bottom surface bottom")
    found = delays(800.0, 0.0, -20.0, paths=paths)
    assert (np.diff(found) > 0).all()


@pytest.mark.parametrize(
    ("error", "arguments"),
    [
        (DomainError, {"paths": ("surface", "surface")}),
        (DomainError, {"paths": ()}),
        (DomainError, {"paths": ("surface surface",)}),
        (DomainError, {"paths": ("sky",)}),
        (DomainError, {"depth": -1.0}),
        (ShapeError, {"sigma": (1.0, 2.0, 3.0)}),
    ],
)
def test_what_cannot_be_is_refused(error, arguments):
    with pytest.raises(error):
        multipath_delays(**{"sigma": 1e-3, "depth": 10.0, "height": 10.0} | arguments)


def test_sound_speeds_are_those_of_other_programs():
    for row in REFERENCE["sound_speed"]["mackenzie"]:
        found = mackenzie(row["T_degC"], row["S_ppt"], row["depth_m"])
        assert found == pytest.approx(row["formula"], abs=1e-9)
    for row in REFERENCE["sound_speed"]["unesco"]:
        t = row.get("T_degC", row.get("T_degC_ITS90"))
        assert unesco(t, row["S_psu"], row["p_dbar"]) == pytest.approx(
            row["unesco_chen_millero"], abs=1e-6
        )
