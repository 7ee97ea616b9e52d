"""A start from echo delays at several receivers: exact without noise, as sure as it says with little."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tracker as tk
from tracker.errors import CapabilityError, ShapeError
from tracker.metrics.consistency import chi_square_band, nees
from tracker.types import Gaussian
from tracker_papers.underwater_multipath import PRESETS, hydrophones
from tracker_sensors import azimuth, multipath_delays, stack
from tracker_sensors.start_from_delays import start_from_delays

CHANNEL = PRESETS["M1"]
SENSOR = hydrophones(CHANNEL, (4e-8, 4e-8))
"""Both hydrophones of chapter 4; a fifth of a millisecond."""

ASIDE = np.array([0.0, -5.0, -98.0, 1.0, 2.0, 3.0])


def guess(place, spread=1e4):
    return Gaussian(np.array([*place, 0.5, -0.5, 0.1]), np.diag([spread] * 3 + [4.0, 9.0, 1.0]))


@given(
    st.floats(-400.0, 400.0), st.floats(80.0, 900.0), st.sampled_from([1.0, -1.0]),
    st.floats(-220.0, 240.0),
)  # fmt: skip
def test_delays_without_noise_tell_the_place_on_the_side_that_is_meant(along, aside, side, above):
    """Wherever the target is beside the line between the hydrophones; a guess 70 m off tells the side."""
    first, second = (np.array(p) for p in CHANNEL.places)
    one = (second - first)[:2] / np.linalg.norm(second - first)
    flat = first[:2] + along * one + side * aside * np.array([-one[1], one[0]])
    x = np.array([*flat, first[2] + above, 0.0, 0.0, 0.0])
    found = start_from_delays(SENSOR, SENSOR.h(x), guess(x[:3] + 40.0))
    np.testing.assert_allclose(found.mean[:3], x[:3], atol=1e-5)


def test_what_delays_do_not_tell_is_as_it_was():
    rest = guess(ASIDE[:3])
    found = start_from_delays(SENSOR, SENSOR.h(ASIDE), rest)
    np.testing.assert_array_equal(found.mean[3:], rest.mean[3:])
    np.testing.assert_array_equal(found.cov[3:, 3:], rest.cov[3:, 3:])
    assert not found.cov[:3, 3:].any()


@pytest.mark.statistical
@pytest.mark.parametrize("sensor", [SENSOR, SENSOR.with_parameters(sigma_bottom_1=2e-3)])
def test_a_start_is_as_sure_as_it_says(sensor):
    """4000 draws; their mean NEES leaves its band once in 10,000 times."""
    rng, lanes = np.random.default_rng(5), 4000
    x = np.repeat(ASIDE[:, None], lanes, axis=1)
    x[:3] += rng.normal(0.0, 30.0, (3, lanes))
    sigma = np.sqrt(np.diagonal(np.squeeze(sensor.R(x[:, :1]))))
    z = sensor.h(x) + sigma[:, None] * rng.standard_normal((4, lanes))
    found = start_from_delays(sensor, z, guess(ASIDE[:3]))
    off = (x - found.mean)[None, :3]
    band = chi_square_band(3 * lanes, 1.0 - 1e-4, per=lanes)
    mean = float(nees(off, found.cov[None, :3, :3]).mean())
    assert band.low < mean < band.high, (mean, band)
    # every direction by itself: a standard error of 2.2 %, seven of them
    spread = np.mean(off[0] ** 2, axis=-1) / np.mean(np.diagonal(found.cov[:3, :3]), axis=0)
    assert np.abs(spread - 1.0).max() < 0.16, spread


def test_every_delay_counts_for_what_it_is_worth():
    """The covariance is the Cramér-Rao bound of a place: better with a third hydrophone, and with bounces."""
    alone = start_from_delays(SENSOR, SENSOR.h(ASIDE), guess(ASIDE[:3])).cov[:3, :3]
    make = {"depth": 285.0, "height": 270.0}
    third = stack([
        *(multipath_delays(2e-4, **make).at(sx=x, sy=y, sz=z) for x, y, z in CHANNEL.places),
        multipath_delays(2e-4, **make).at(sx=300.0, sy=200.0, sz=-160.0),
    ])  # fmt: skip
    bounces = stack([
        multipath_delays(2e-4, **make, paths=("surface", "bottom", "surface bottom")).at(sx=x, sy=y, sz=z)
        for x, y, z in CHANNEL.places
    ])  # fmt: skip
    with_azimuth = stack([*(
        multipath_delays(2e-4, **make).at(sx=x, sy=y, sz=z) for x, y, z in CHANNEL.places
    ), azimuth(1e-3).at(sx=-200.0, sy=-600.0)])  # fmt: skip
    for more in (third, bounces, with_azimuth):
        found = start_from_delays(more, more.h(ASIDE), guess(ASIDE[:3]))
        np.testing.assert_allclose(found.mean[:3], ASIDE[:3], atol=1e-5)
        gain = np.linalg.eigvalsh(alone - found.cov[:3, :3])
        assert gain.min() > -1e-9
        assert gain.max() > 0.0


def test_hydrophones_that_move_are_where_their_pose_is():
    make = {"depth": 285.0, "height": 270.0}
    moving = stack([multipath_delays(2e-4, **make) for _ in range(2)])
    pose = np.array([*CHANNEL.places[0], *CHANNEL.places[1]])
    here = start_from_delays(moving, moving.h(ASIDE, pose), guess(ASIDE[:3]), pose)
    there = start_from_delays(SENSOR, SENSOR.h(ASIDE), guess(ASIDE[:3]))
    np.testing.assert_allclose(here.mean, there.mean, rtol=1e-12)
    np.testing.assert_allclose(here.cov, there.cov, rtol=1e-9)


def test_lanes_are_worked_by_themselves_and_impossible_ones_are_nan():
    x = np.repeat(ASIDE[:, None], 4, axis=1)
    z = np.array(SENSOR.h(x))
    z[1, 1] = np.nan
    z[:2, 2] = 1e-4  # kilometres away, says one; the other hears it near
    found = start_from_delays(SENSOR, z, guess(ASIDE[:3]))
    np.testing.assert_array_equal(np.isfinite(found.mean).all(axis=0), [True, False, False, True])
    alone = start_from_delays(SENSOR, z[:, 0], guess(ASIDE[:3]))
    np.testing.assert_allclose(found.mean[:, 0], alone.mean, rtol=1e-12)
    np.testing.assert_allclose(found.cov[..., 3], alone.cov, rtol=1e-9)
    assert start_from_delays(SENSOR, z[:, :0], guess(ASIDE[:3])).mean.shape == (6, 0)
    two = start_from_delays(SENSOR, z[:, [0, 3]][:, None], guess(ASIDE[:3]))
    assert two.cov.shape == (6, 6, 1, 2)


def test_what_tells_no_place_is_refused_in_words():
    rest = guess(ASIDE[:3])
    one = multipath_delays(1e-3, depth=285.0, height=270.0).at(sx=0.0, sy=0.0, sz=-160.0)
    for sensor in (one, stack([one, azimuth(0.1).at(sx=0.0, sy=0.0)])):
        with pytest.raises(CapabilityError, match="range_and_height"):
            start_from_delays(sensor, sensor.h(ASIDE), rest)
    below = one.with_parameters(sz=-200.0)
    with pytest.raises(CapabilityError, match="above each other"):
        start_from_delays(stack([one, below]), stack([one, below]).h(ASIDE), rest)
    with pytest.raises(ShapeError, match="delay_surface_1"):
        start_from_delays(SENSOR, np.zeros(3), rest)


@pytest.mark.statistical
def test_a_filter_begun_by_delays_is_consistent_at_once():
    """NEES over 200 runs at each of the first steps: beyond its band once in 10,000 times for all ten."""
    scene = tk.scenario("underwater_multipath", told=True, steps=10)
    quiet = scene.sensor.with_parameters(
        **{name: 2e-4 for name in scene.sensor.parameters if name.startswith("sigma")}
    )
    x0 = np.array(scene.start)
    rng = np.random.default_rng(11)
    x = np.repeat(x0[:, None], 200, axis=1)
    x[3:] += 0.5 * rng.standard_normal((3, 200))
    rest = Gaussian(np.array([*x0[:3] + 100.0, *x0[3:]]), np.diag([1e6] * 3 + [0.25] * 3))
    z = quiet.h(x) + 2e-4 * rng.standard_normal((4, 200))
    begun = start_from_delays(quiet, z, rest)
    rows, truth = [], []
    for _ in range(10):
        x = scene.motion.f(x, 1.0) + 1e-2 * rng.standard_normal(x.shape)
        rows.append(quiet.h(x) + 2e-4 * rng.standard_normal((4, 200)))
        truth.append(x)
    one = tk.estimator("ekf1", motion=scene.motion, sensor=quiet)
    record = tk.Record(np.arange(1.0, 11.0), np.array(rows))
    history = tk.filter(one, record, begun, start=0.0)
    found = nees(np.array(truth) - history.filtered.mean, history.filtered.cov).mean(axis=-1)
    band = chi_square_band(6 * 200, 1.0 - 1e-5, per=200)
    assert ((found > band.low) & (found < band.high)).all(), (found, band)
