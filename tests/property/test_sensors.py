"""Laws of every sensor: independent formulas in SymPy, batches, singular places, stacks."""

import pickle
from functools import cache

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from tracker.errors import CapabilityError, DomainError, ShapeError
from tracker.models import ComponentSensor
from tracker.types import PLANAR, SPATIAL, Space
from tracker_motion import constant_acceleration, coordinated_turn
from tracker_sensors import (
    azimuth,
    azimuth_elevation,
    azimuth_height,
    conical_angle,
    doppler_frequency,
    position,
    position_velocity,
    range_azimuth,
    range_only,
    range_rate,
    relative_position,
    stack,
    time_difference,
)

BATCHES = ((), (3,), (2, 0), (2, 3))


def names(text):
    return sp.symbols(text, real=True)


X, Y, Z, VX, VY, VZ = names("x y z vx vy vz")
SX, SY, SZ, SVX, SVY, SVZ, HEADING = names("sx sy sz svx svy svz heading")
SX1, SY1, SX2, SY2, SX3, SY3 = names("sx_1 sy_1 sx_2 sy_2 sx_3 sy_3")
DX, DY, DZ = X - SX, Y - SY, Z - SZ
RHO = sp.sqrt(DX**2 + DY**2)
RANGE = sp.sqrt(DX**2 + DY**2 + DZ**2)
MATH, NORTH = sp.atan2(DY, DX), sp.atan2(DX, DY)
ELEVATION = sp.atan(DZ / RHO)
RATE = (DX * (VX - SVX) + DY * (VY - SVY)) / RHO
RATE_3 = (DX * (VX - SVX) + DY * (VY - SVY) + DZ * (VZ - SVZ)) / RANGE
ALONG = DX * sp.cos(HEADING) + DY * sp.sin(HEADING)


def distance(*station):
    return sp.sqrt(sum((a - b) ** 2 for a, b in zip((X, Y, Z), station, strict=False)))


TONE = 300 * (1500 + (DX * SVX + DY * SVY) / RHO) / (1500 + (DX * VX + DY * VY) / RHO)
TONE_3 = (
    300
    * (1500 + (DX * SVX + DY * SVY + DZ * SVZ) / RANGE)
    / (1500 + (DX * VX + DY * VY + DZ * VZ) / RANGE)
)

# Each sensor beside what it should measure, written again from its definition.
SENSORS = {
    "azimuth": (azimuth(0.1), [MATH]),
    "azimuth from north": (azimuth(0.1, convention="north"), [NORTH]),
    "azimuth, elevation": (azimuth_elevation(0.1, 0.2), [MATH, ELEVATION]),
    "azimuth from north, elevation": (
        azimuth_elevation(0.1, 0.2, convention="north"),
        [NORTH, ELEVATION],
    ),
    "azimuth, height": (azimuth_height(0.1, 2.0), [MATH, DZ]),
    "azimuth from north, height": (azimuth_height(0.1, 2.0, convention="north"), [NORTH, DZ]),
    "position": (position(2.0), [X, Y]),
    "position 3-D": (position((2.0, 3.0, 4.0), axes=3), [X, Y, Z]),
    "position, velocity": (position_velocity(2.0, 0.1), [X, Y, VX, VY]),
    "position, velocity 3-D": (position_velocity(2.0, 0.1, axes=3), [X, Y, Z, VX, VY, VZ]),
    "relative position": (relative_position(2.0), [DX, DY]),
    "relative position 3-D": (relative_position(2.0, axes=3), [DX, DY, DZ]),
    "range": (range_only(2.0), [RHO]),
    "range 3-D": (range_only(2.0, axes=3), [RANGE]),
    "range, azimuth": (range_azimuth(2.0, 0.1), [RHO, MATH]),
    "range, azimuth from north": (range_azimuth(2.0, 0.1, convention="north"), [RHO, NORTH]),
    "range rate": (range_rate(0.1), [RATE]),
    "range rate 3-D": (range_rate(0.1, axes=3), [RATE_3]),
    "Doppler": (doppler_frequency(0.1, 300.0), [TONE]),
    "Doppler 3-D": (doppler_frequency(0.1, 300.0, axes=3), [TONE_3]),
    "conical angle": (conical_angle(0.1), [sp.acos(ALONG / RHO)]),
    "conical angle 3-D": (conical_angle(0.1, axes=3), [sp.acos(ALONG / RANGE)]),
    "conical cosine": (conical_angle(0.1, form="cosine"), [ALONG / RHO]),
    "conical cosine 3-D": (conical_angle(0.1, form="cosine", axes=3), [ALONG / RANGE]),
    "time difference": (
        time_difference(1e-3, receivers=3),
        [
            (distance(SX2, SY2) - distance(SX1, SY1)) / 1500,
            (distance(SX3, SY3) - distance(SX1, SY1)) / 1500,
        ],
    ),
    "time difference 3-D": (
        time_difference(1e-3, receivers=[[0, 1, 2], [5, -3, 4]], axes=3),
        [(distance(5, -3, 4) - distance(0, 1, 2)) / 1500],
    ),
}
every_sensor = pytest.mark.parametrize("name", list(SENSORS))


@cache
def oracle(name):
    """Value, Jacobian and Hessian from SymPy, as functions of state and pose."""
    sensor, expressions = SENSORS[name]
    state = [names(n) for n in sensor.state.names]
    pose = [names(n) for n in sensor.pose_space.names]
    jacobian = [[sp.diff(e, s) for s in state] for e in expressions]
    hessian = [[[sp.diff(e, s) for s in state] for e in row] for row in jacobian]
    return [
        sp.lambdify([*state, *pose], v, "numpy", cse=True) for v in (expressions, jacobian, hessian)
    ]


def draw(sensor, seed, batch=(), scale=100.0):
    rng = np.random.default_rng(seed)
    x = scale * rng.standard_normal((len(sensor.state), *batch))
    velocity = list(sensor.state.velocity)
    x[velocity] *= 0.05
    pose = scale * rng.standard_normal(len(sensor.pose_space))
    for i, name in enumerate(sensor.pose_space.names):
        if name.startswith("sv"):
            pose[i] *= 0.05
        if name == "heading":
            pose[i] = rng.uniform(-3.0, 3.0)
    return x, pose


def assert_close(ours, theirs, message):
    theirs = np.asarray(theirs, dtype=float)
    scale = max(np.abs(theirs).max(initial=0.0), 1e-300)
    np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-8 * scale, err_msg=message)


@every_sensor
@settings(deadline=None)  # the first example derives the formulas
@given(seed=st.integers(0, 2**32 - 1), scale=st.sampled_from([1.0, 100.0, 1e5]))
def test_measurement_jacobian_and_hessian_equal_symbolic_ones(name, seed, scale):
    sensor, _ = SENSORS[name]
    x, pose = draw(sensor, seed, scale=scale)
    value, jacobian, hessian = oracle(name)
    at = [*x, *pose]
    assert_close(sensor.h(x, pose), value(*at), "h is not what the sensor's definition says")
    assert_close(sensor.jacobian(x, pose), jacobian(*at), "the Jacobian is not the derivative of h")
    assert_close(sensor.hessian(x, pose), hessian(*at), "the Hessian is not the second derivative")


@every_sensor
@pytest.mark.parametrize("batch", BATCHES)
def test_a_batch_is_its_lanes(name, batch):
    sensor, _ = SENSORS[name]
    x, pose = draw(sensor, 7, batch)
    m, n = len(sensor.space), len(sensor.state)
    h, J, H, R = (
        sensor.h(x, pose),
        sensor.jacobian(x, pose),
        sensor.hessian(x, pose),
        sensor.R(x, pose),
    )
    assert h.shape == (m, *batch)
    assert J.shape == (m, n, *batch)
    assert H.shape == (m, n, n, *batch)
    assert np.broadcast_shapes(R.shape, (m, m, *batch)) == (m, m, *batch)
    for lane in np.ndindex(*batch):
        one = x[(slice(None), *lane)]
        every = slice(None)
        np.testing.assert_allclose(h[(every, *lane)], sensor.h(one, pose), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(
            J[(every, every, *lane)], sensor.jacobian(one, pose), rtol=1e-12, atol=1e-15
        )


@every_sensor
def test_noise_is_symmetric_and_positive_definite(name):
    sensor, _ = SENSORS[name]
    x, pose = draw(sensor, 3)
    R = sensor.R(x, pose)
    np.testing.assert_array_equal(R, R.T)
    assert np.linalg.eigvalsh(R)[0] > 0


@every_sensor
def test_sensors_pickle_and_can_be_traced(name):
    sensor, _ = SENSORS[name]
    x, pose = draw(sensor, 5)
    again = pickle.loads(pickle.dumps(sensor))
    np.testing.assert_array_equal(again.h(x, pose), sensor.h(x, pose))
    assert not again.why_opaque


@every_sensor
def test_components_are_found_by_name_in_any_state_that_has_them(name):
    sensor, _ = SENSORS[name]
    x, pose = draw(sensor, 11)
    shuffled = Space(tuple(reversed(sensor.state.axes))) + Space.of("omega [rad/s]")
    moved = sensor.over(shuffled)
    np.testing.assert_array_equal(moved.h([*x[::-1], 0.1], pose), sensor.h(x, pose))
    np.testing.assert_array_equal(
        moved.jacobian(np.array([*x[::-1], 0.1]), pose)[:, :-1], sensor.jacobian(x, pose)[:, ::-1]
    )


@pytest.mark.parametrize("name", [n for n, (s, _) in SENSORS.items() if "sx" in s.pose_space.names])
def test_at_zero_range_only_that_lane_fails_and_r_stays_right(name):
    sensor, _ = SENSORS[name]
    x, pose = draw(sensor, 13, (3,))
    for place, axis in enumerate("xyz"):
        if f"s{axis}" in sensor.pose_space.names:
            x[place, 1] = pose[sensor.pose_space.index(f"s{axis}")]
    others = [0, 2]
    np.testing.assert_array_equal(sensor.h(x, pose)[:, others], sensor.h(x[:, others], pose))
    np.testing.assert_array_equal(
        sensor.jacobian(x, pose)[..., others], sensor.jacobian(x[:, others], pose)
    )
    assert np.isfinite(sensor.jacobian(x, pose)[..., others]).all()
    np.testing.assert_array_equal(sensor.R(x[:, 1], pose), sensor.R(x[:, 0], pose))
    sensor.hessian(x[:, 1], pose)  # no exception for a single state either


# ------------------------------------------------------------------------------ angles
@given(seed=st.integers(0, 2**32 - 1))
def test_north_and_math_azimuths_add_up_to_a_right_angle(seed):
    x, pose = draw(azimuth(0.1), seed)
    total = azimuth(0.1).h(x, pose) + azimuth(0.1, convention="north").h(x, pose)
    np.testing.assert_allclose(np.cos(total - np.pi / 2), 1.0)


def test_an_azimuth_that_crosses_the_cut_has_a_small_residual():
    sensor = azimuth(0.1).at(sx=0.0, sy=0.0)
    above, below = sensor.h([-10.0, 0.1, 0, 0]), sensor.h([-10.0, -0.1, 0, 0])
    assert above - below > 6.0
    np.testing.assert_allclose(sensor.residual(above, below), -0.02, rtol=1e-3)


def test_the_derivative_through_the_residual_is_right_at_the_cut():
    sensor = azimuth(0.1).at(sx=0.0, sy=0.0)
    x, step = np.array([-10.0, 0.0, 0.0, 0.0]), np.array([0.0, 1e-4, 0.0, 0.0])
    slope = sensor.residual(sensor.h(x + step), sensor.h(x - step)) / 2e-4
    np.testing.assert_allclose(slope, sensor.jacobian(x)[:, 1], rtol=1e-6)


@given(seed=st.integers(0, 2**32 - 1))
def test_turning_target_and_sensor_together_turns_the_azimuth(seed):
    rng = np.random.default_rng(seed)
    target, station, angle = rng.normal(size=2), rng.normal(size=2), rng.uniform(-3, 3)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    sensor = azimuth(0.1)
    before = sensor.h([*target, 0.0, 0.0], station)
    after = sensor.h([*(turn @ target), 0.0, 0.0], turn @ station)
    np.testing.assert_allclose(sensor.residual(after, before + angle), 0.0, atol=1e-9)


@given(seed=st.integers(0, 2**32 - 1))
def test_the_conical_angle_is_the_arccosine_of_a_dot_product_and_cannot_tell_left_from_right(seed):
    rng = np.random.default_rng(seed)
    line, heading = rng.normal(size=3), rng.uniform(-np.pi, np.pi)
    axis = np.array([np.cos(heading), np.sin(heading), 0.0])
    expected = np.arccos(line @ axis / np.linalg.norm(line))
    sensor = conical_angle(0.1, axes=3).at(sx=0.0, sy=0.0, sz=0.0, heading=heading)
    np.testing.assert_allclose(sensor.h([*line, 0, 0, 0]), expected, atol=1e-7)
    mirrored = 2 * (line @ axis) * axis - line
    np.testing.assert_allclose(sensor.h([*mirrored, 0, 0, 0]), expected, atol=1e-7)


# ----------------------------------------------------------------------- Doppler, delays
@given(seed=st.integers(0, 2**32 - 1))
def test_range_rate_is_the_time_derivative_of_range(seed):
    x, pose = draw(range_rate(0.1), seed)
    dt = 1e-3
    ranges = [
        range_only(1.0).h([*(x[:2] + sign * dt * x[2:]), 0, 0], pose[:2] + sign * dt * pose[2:])
        for sign in (1, -1)
    ]
    np.testing.assert_allclose(
        range_rate(0.1).h(x, pose), (ranges[0] - ranges[1]) / (2 * dt), rtol=1e-5, atol=1e-6
    )


def test_at_low_speed_the_tone_shifts_by_range_rate_over_speed_of_propagation():
    x, pose = np.array([300.0, 400.0, 2.0, -1.0]), np.array([0.0, 0.0, 1.0, 0.5])
    rate = range_rate(0.1).h(x, pose)
    tone = doppler_frequency(0.1, 1e9, speed=299792458.0).h(x, pose)
    np.testing.assert_allclose(tone - 1e9, -1e9 * rate / 299792458.0, rtol=1e-6)


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 5), axes=st.sampled_from([2, 3]))
def test_delays_equal_brute_force_over_receivers(seed, count, axes):
    rng = np.random.default_rng(seed)
    places, target = rng.normal(size=(count, axes)) * 1e3, rng.normal(size=axes) * 1e4
    arrivals = np.array([np.linalg.norm(target - place) / 343.0 for place in places])
    x = [*target, *np.zeros(axes)]
    fixed = time_difference(1e-3, receivers=places, speed=343.0, axes=axes)
    posed = time_difference(1e-3, receivers=count, speed=343.0, axes=axes)
    np.testing.assert_allclose(fixed.h(x), arrivals[1:] - arrivals[0], rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(posed.h(x, places.ravel()), fixed.h(x))
    assert len(fixed.pose_space) == 0


def test_delays_share_the_error_of_the_first_arrival():
    rng = np.random.default_rng(1)
    arrivals = 1e-3 * rng.standard_normal((3, 200_000))
    sample = np.cov(arrivals[1:] - arrivals[0])
    correlated = time_difference(1e-3, receivers=3).R(np.zeros(4), np.zeros(6))
    np.testing.assert_allclose(sample, correlated, rtol=0.02)
    alone = time_difference(1e-3, receivers=3, errors="delays").R(np.zeros(4), np.zeros(6))
    np.testing.assert_allclose(alone, 1e-6 * np.eye(2))


# -------------------------------------------------------------------------------- stack
class Opaque:
    """A sensor of nobody's making: depth from a table, with a hand-written derivative."""

    space, pose_space, state = Space.of("depth [m]"), Space.of("level [m]"), PLANAR

    def h(self, x, pose=None):
        return np.interp(x[:1], [-1e3, 1e3], [0.0, 200.0]) - pose[0]

    def jacobian(self, x, pose=None):
        return np.broadcast_to(
            np.reshape([0.1, 0, 0, 0], (1, 4) + (1,) * (x.ndim - 1)), (1, 4, *x.shape[1:])
        )

    def R(self, x, pose=None):
        return np.full((1, 1), 4.0)

    def residual(self, z, zhat):
        return z - zhat


PARTS = (
    azimuth(0.1),
    range_rate(0.2),
    azimuth(0.3, convention="north").at(sx=1.0, sy=2.0),
    position((1.0, 2.0)),
)


@pytest.mark.parametrize("opaque", [False, True])
@pytest.mark.parametrize("batch", BATCHES)
def test_a_stack_equals_its_parts(batch, opaque):
    parts = (*PARTS, Opaque()) if opaque else PARTS
    both = stack(parts)
    assert isinstance(both, ComponentSensor) is not opaque
    rng = np.random.default_rng(2)
    x = 100 * rng.standard_normal((4, *batch))
    pose = rng.standard_normal(len(both.pose_space))
    row = at = 0
    h, J, R = both.h(x, pose), both.jacobian(x, pose), both.R(x, pose)
    R = np.broadcast_to(R, (*R.shape[:2], *batch))
    for part in parts:
        m, p = len(part.space), len(part.pose_space)
        here = pose[at : at + p]
        np.testing.assert_allclose(h[row : row + m], part.h(x, here), rtol=1e-14)
        np.testing.assert_allclose(J[row : row + m], part.jacobian(x, here), rtol=1e-14)
        own = np.asarray(part.R(x, here))
        own = own.reshape(*own.shape, *(1,) * (len(batch) + 2 - own.ndim))
        np.testing.assert_array_equal(
            R[row : row + m, row : row + m], np.broadcast_to(own, (m, m, *batch))
        )
        assert not R[row : row + m, :row].any()
        row, at = row + m, at + p
    assert (row, at) == (len(both.space), len(both.pose_space))
    np.testing.assert_array_equal(both.residual(h, h), np.zeros_like(h))
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(both)).h(x, pose), h)


def test_a_stack_is_traced_jointly_and_names_tell_its_parts_apart():
    both = stack([azimuth(0.1), azimuth(0.2)])
    assert both.space.names == ("azimuth_1", "azimuth_2")
    assert both.pose_space.names == ("sx_1", "sy_1", "sx_2", "sy_2")
    assert dict(both.parameters) == {"sigma_1": 0.1, "sigma_2": 0.2}
    assert not both.why_opaque
    wide = both.with_parameters(sigma_2=np.array([0.5, 0.6]))
    np.testing.assert_allclose(wide.R(np.zeros((4, 2)), np.zeros(4))[1, 1], [0.25, 0.36])


def test_residuals_of_a_stack_wrap_only_where_angles_are():
    both = stack([azimuth(0.1), position(1.0)])
    residual = both.residual(np.array([3.0, 3.0, 3.0]), np.array([-3.0, -3.0, -3.0]))
    np.testing.assert_allclose(residual, [6 - 2 * np.pi, 6.0, 6.0])


def test_a_stack_moves_planar_sensors_into_space():
    both = stack([azimuth(0.1), azimuth_elevation(0.1, 0.1)])
    assert both.state == SPATIAL


def test_stacks_nest():
    inner = stack([azimuth(0.1), position(1.0)])
    outer = stack([inner, range_only(2.0)])
    assert outer.space.names == ("azimuth_1_1", "x_2_1", "y_2_1", "range_2")
    x, pose = np.array([3.0, 4.0, 0.0, 0.0]), np.array([1.0, 1.0, 0.0, 0.0])
    np.testing.assert_allclose(outer.h(x, pose), [np.arctan2(3, 2), 3, 4, 5])


def test_a_hand_written_derivative_is_kept_in_a_stack():
    def swapped(x, y, *, sx, sy):
        return ((x - sx, y - sy),)

    import attrs

    wrong = attrs.evolve(azimuth(0.1), derivative=swapped)
    both = stack([wrong, azimuth(0.1)])
    x, pose = np.array([3.0, 4.0, 0.0, 0.0]), np.zeros(4)
    np.testing.assert_array_equal(both.jacobian(x, pose)[0, :2], [3.0, 4.0])
    np.testing.assert_allclose(both.jacobian(x, pose)[1, :2], [-4 / 25, 3 / 25])


# ------------------------------------------------------------------ parameters and errors
def test_parameters_may_differ_between_lanes():
    sensor = azimuth(np.array([0.1, 0.2, 0.3])).at(sx=0.0, sy=0.0)
    np.testing.assert_allclose(sensor.R(np.ones((4, 3)))[0, 0], [0.01, 0.04, 0.09])
    assert sensor.lanes(slice(1, 2)).R(np.ones((4, 1)))[0, 0] == pytest.approx(0.04)


def test_poses_may_differ_between_lanes():
    pose = np.array([[0.0, 1.0], [0.0, 0.0]])
    x = np.zeros((4, 2))
    x[1] = 1.0
    np.testing.assert_allclose(azimuth(0.1).h(x, pose)[0], [np.pi / 2, 3 * np.pi / 4])


def test_a_sensor_that_cannot_be_traced_still_measures():
    def measure(x, y, *, sx, sy):
        return (np.arctan2(y - sy, x - sx),)

    def noise(*, sigma):
        return ((sigma**2,),)

    sensor = ComponentSensor(
        name="foreign",
        measure=measure,
        noise=noise,
        space=Space.of("azimuth [rad] circular"),
        pose_space=Space.of("sx [m]", "sy [m]"),
        parameters={"sigma": 0.1},
    )
    x, pose = np.ones((4, 3)), np.zeros(2)
    np.testing.assert_allclose(sensor.h(x, pose), np.pi / 4)
    assert "tracker.models" in sensor.why_opaque
    with pytest.raises(CapabilityError, match=r"derivative=|tracker\.models"):
        sensor.jacobian(x, pose)
    both = stack([sensor, azimuth(0.1)])
    np.testing.assert_allclose(both.h(x, np.zeros(4)), np.pi / 4)
    assert both.why_opaque


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: azimuth(-0.1), DomainError, ("sigma", "-0.1", "positive", "rad")),
        (lambda: azimuth(float("nan")), DomainError, ("sigma", "nan")),
        (lambda: azimuth(0.1, convention="south"), DomainError, ("convention", "south", "math", "north")),
        (lambda: position(1.0, axes=4), DomainError, ("axes", "4", "2, 3")),
        (lambda: position((1.0, 2.0, 3.0)), ShapeError, ("sigma", "3 values", "per axis (2)")),
        (lambda: time_difference(1e-3, receivers=1), ShapeError, ("receivers", "at least 2")),
        (lambda: time_difference(1e-3, receivers=[[0.0, 1.0, 2.0]]), ShapeError, ("receivers", "(1, 3)", "(count, 2)")),
        (lambda: azimuth(0.1).h(np.zeros(4)), ShapeError, ("pose", "nothing", "sx", ".at(")),
        (lambda: azimuth(0.1).h(np.zeros(4), np.zeros(3)), ShapeError, ("pose", "(3,)", "(2, *batch)")),
        (lambda: azimuth(0.1).h(np.zeros(3), np.zeros(2)), ShapeError, ("'x'", "(3,)", "(4, *batch)")),
        (lambda: azimuth(0.1).over(Space.of("x [m]", "vx [m/s]")), CapabilityError, ("azimuth", "y")),
        (lambda: stack([]), ShapeError, ("at least one sensor",)),
        (lambda: stack([azimuth(0.1)], names=["a", "b"]), ShapeError, ("['a', 'b']", "one distinct name")),
        (lambda: stack([Opaque(), range_only(1.0, axes=3)]), CapabilityError, ("state space", "over(state)")),
        (lambda: stack([Opaque(), azimuth(0.1)]).h(np.zeros(4), np.zeros(9)), ShapeError, ("pose", "(9,)", "level_1")),
        (lambda: stack([Opaque(), azimuth(0.1)]).hessian(np.zeros(4), np.zeros(3)), CapabilityError, ("Hessian", "1")),
    ],
)  # fmt: skip
def test_errors_name_the_argument_what_it_was_and_the_way_out(call, error, words):
    with pytest.raises(error) as raised:
        call()
    missing = [word for word in words if word not in str(raised.value)]
    assert not missing, f"the message should say {missing}: {raised.value}"


def test_azimuth_works_on_any_motion_with_x_and_y():
    for motion in (coordinated_turn(0.1, 1e-6), constant_acceleration(0.1, axes=3)):
        sensor = azimuth(0.1).over(motion.space).at(sx=0.0, sy=0.0)
        x = np.zeros(len(motion.space))
        x[list(motion.space.indices("x", "y"))] = 1.0
        np.testing.assert_allclose(sensor.h(x), np.pi / 4)
