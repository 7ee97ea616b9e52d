"""The noise of the sea against the curves it stands for, and bearings against the Cramér-Rao bound itself."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.errors import DomainError
from tracker_sensors.ambient_noise import (
    KNUDSEN_LEVELS,
    band_level,
    knudsen_level,
    shipping_level,
    thermal_level,
    turbulence_level,
    wenz_level,
    wind_level,
)
from tracker_sensors.passive_sonar import bearing_sigma, passive_sonar, signal_excess

frequencies = st.floats(1.0, 5e5)


@pytest.mark.parametrize(
    ("low", "high", "loudest"),
    [
        (1.0, 5.0, "turbulence"),
        (20.0, 80.0, "shipping"),
        (500.0, 5e4, "wind"),
        (3e5, 1e6, "thermal"),
    ],
)
def test_each_source_is_the_loudest_in_its_band(low, high, loudest):
    f = np.geomspace(low, high, 20)
    by = {
        "turbulence": turbulence_level(f),
        "shipping": shipping_level(f, 0.5),
        "wind": wind_level(f, 5.0),
        "thermal": thermal_level(f),
    }
    for name, level in by.items():
        assert name == loudest or (level < by[loudest]).all(), name


@given(f=frequencies, wind=st.floats(0.0, 20.0), more=st.floats(0.0, 10.0))
def test_wind_and_ships_only_add_noise(f, wind, more):
    quiet = wenz_level(f, wind=wind, shipping=0.2)
    assert wenz_level(f, wind=wind + more, shipping=0.2) >= quiet
    assert wenz_level(f, wind=wind, shipping=0.9) >= quiet
    assert quiet >= max(turbulence_level(f), thermal_level(f), wind_level(f, wind))


@pytest.mark.parametrize(("sea_state", "wind"), [(0.0, 0.0), (1.0, 1.7), (3.0, 6.0), (6.0, 13.0)])
def test_both_descriptions_of_wind_agree_within_the_scatter_of_the_sea(sea_state, wind):
    """Two fits to one pile of measurements, which scatter by 5 to 10 dB themselves."""
    f = np.geomspace(1e3, 2e4, 30)
    assert np.abs(wind_level(f, wind) - knudsen_level(f, sea_state)).max() < 6.5


def test_knudsen_falls_five_decibels_an_octave_and_knows_its_table():
    assert float(knudsen_level(2e3, 3.0) - knudsen_level(4e3, 3.0)) == pytest.approx(5.0, abs=0.2)
    for state, level in KNUDSEN_LEVELS.items():
        assert float(knudsen_level(1e3, state)) == level
        assert float(knudsen_level(300.0, state)) == level


@given(low=st.floats(10.0, 1e4), factor=st.floats(1.01, 30.0), slope=st.floats(-3.0, 3.0))
def test_the_level_of_a_band_is_the_integral_of_a_power_law(low, factor, slope):
    high = low * factor
    found = band_level(lambda f: 50.0 + 10.0 * slope * np.log10(f / low), low, high)
    p = slope + 1.0
    whole = low * (np.log(factor) if abs(p) < 1e-9 else (factor**p - 1.0) / p)
    assert found == pytest.approx(50.0 + 10.0 * np.log10(whole), abs=1e-5)


def test_bands_beside_each_other_add_their_powers():
    def level(f):
        return wenz_level(f, wind=8.0)

    parts = sum(10.0 ** (band_level(level, a, b) / 10.0) for a, b in ((50.0, 300.0), (300.0, 2e3)))
    assert band_level(level, 50.0, 2e3) == pytest.approx(10.0 * np.log10(parts), abs=2e-3)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: wenz_level(0.0),
        lambda: wenz_level(100.0, wind=-1.0),
        lambda: wenz_level(100.0, shipping=1.1),
        lambda: knudsen_level(100.0, 7.0),
        lambda: band_level(wenz_level, 100.0, 100.0),
    ],
)
def test_what_the_curves_do_not_cover_is_refused(wrong):
    with pytest.raises(DomainError):
        wrong()


# ------------------------------------------------------------------------------- bearings
@pytest.mark.parametrize("elements", [3, 8, 17])
@pytest.mark.parametrize("ratio", [-15.0, 0.0, 20.0])
@pytest.mark.parametrize("direction", [0.0, 0.4, 2.0])
def test_the_bearing_is_as_good_as_the_fisher_information_of_the_snapshots(
    elements, ratio, direction
):
    """Slepian-Bangs: information of K zero-mean complex Gaussian snapshots, powers unknown too."""
    radius, snapshots = 1.3, 40
    around = 2.0 * np.pi * np.arange(elements) / elements

    def covariance(parameters):
        theta, signal, noise = parameters
        a = np.exp(2j * np.pi * radius * np.cos(theta - around))
        return signal * np.outer(a, a.conj()) + noise * np.eye(elements)

    at = np.array([direction, 10.0 ** (ratio / 10.0), 1.0])
    inverse = np.linalg.solve(covariance(at), np.eye(elements))
    turned = []
    for i in range(3):
        h = 1e-5 * max(abs(at[i]), 1e-2)
        step = h * np.eye(3)[i]
        turned.append(inverse @ (covariance(at + step) - covariance(at - step)) / (2.0 * h))
    information = snapshots * np.array([[np.trace(a @ b).real for b in turned] for a in turned])
    bound = np.sqrt(np.linalg.solve(information, np.eye(3)[0])[0])
    found = bearing_sigma(ratio, elements=elements, radius=radius, snapshots=snapshots)
    assert float(found) == pytest.approx(bound, rel=1e-5)


@given(r=st.floats(50.0, 2e4), level=st.floats(120.0, 160.0))
def test_the_sensor_puts_sonar_equation_and_bound_together(r, level):
    sensor = passive_sonar(level, 85.0, absorption=0.07, floor=1e-9).at(sx=3.0, sy=-4.0)
    got = float(sensor.R(np.array([3.0 + 0.6 * r, -4.0 + 0.8 * r, 0.0, 0.0]))[0, 0])
    excess = signal_excess(r, source_level=level, noise_level=85.0, absorption=0.07)
    bound = float(bearing_sigma(excess, elements=16, radius=2.0, snapshots=100)) ** 2
    nothing = np.pi**2 / 3.0
    assert got == pytest.approx(bound * nothing / (bound + nothing), rel=2e-3)


def test_noise_of_a_bearing_grows_with_distance_and_stays_finite():
    sensor = passive_sonar(140.0, 85.0).at(sx=0.0, sy=0.0)
    r = np.geomspace(1e-3, 1e6, 60)
    variance = sensor.R(np.stack([r, 0 * r, 0 * r, 0 * r]))[0, 0]
    assert (np.diff(variance) >= 0.0).all()
    assert variance[-1] <= np.pi**2 / 3.0 + 1e-6
