"""Values: what they refuse, what they keep, and that nothing handed in is changed."""

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tracker as tk
from tracker.errors import DomainError, ShapeError


@given(st.integers(1, 6), st.integers(0, 2**32 - 1), st.sampled_from([(), (3,), (2, 0), (2, 3)]))
def test_samples_of_a_gaussian_have_its_moments_and_shape(n, seed, batch):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((n, n, *batch))
    cov = np.einsum("ik...,jk...->ij...", root, root)
    state = tk.Gaussian(rng.standard_normal((n, *batch)), cov)
    assert state.sample(rng=rng).shape == (n, *batch)
    assert state.sample(5, rng=rng).shape == (n, 5, *batch)
    assert (state.cov == state.cov.swapaxes(0, 1)).all()


def test_samples_have_the_right_covariance():
    cov = np.array([[2.0, -0.6], [-0.6, 0.5]])
    draws = tk.Gaussian([1.0, 2.0], cov).sample(40_000, rng=np.random.default_rng(1))
    # entries of the sample covariance have standard errors below 0.015: 5 of them
    np.testing.assert_allclose(np.cov(draws), cov, atol=0.075)
    np.testing.assert_allclose(draws.mean(axis=1), [1.0, 2.0], atol=0.04)


@pytest.mark.parametrize(
    ("mean", "cov", "error", "words"),
    [
        (1.0, [[1.0]], ShapeError, "a vector"),
        ([0.0, 0.0], [[1.0]], ShapeError, r"\(2, 2\)"),
        ([0.0, np.nan], np.eye(2), DomainError, "finite"),
        ([0.0, 0.0], [[1.0, np.inf], [np.inf, 1.0]], DomainError, "finite"),
        ([0.0, 0.0], [[1.0, 0.5], [0.0, 1.0]], DomainError, "symmetric"),
        ([0.0, 0.0], [[1.0, 2.0], [2.0, 1.0]], DomainError, "positive semi-definite"),
        (["a"], [[1.0]], DomainError, "real numbers"),
        (np.zeros((2, 3)), np.eye(3), ShapeError, "batch axes last"),
    ],
)
def test_a_wrong_gaussian_says_what_came_and_what_to_do(mean, cov, error, words):
    with pytest.raises(error, match=words):
        tk.Gaussian(mean, cov)


def test_what_is_handed_in_is_neither_kept_nor_changed():
    mean, cov = np.zeros(2), np.eye(2)
    state = tk.Gaussian(mean, cov)
    mean[0] = cov[0, 0] = 9.0
    assert state.mean[0] == 0.0
    assert state.cov[0, 0] == 1.0
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        state.mean = mean


def test_an_array_of_parameters_is_the_models_own():
    from tracker_motion.constant_velocity import constant_velocity

    density = np.array([0.1, 0.2])
    motion = constant_velocity(density=density)
    density[0] = 99.0
    assert motion.parameters["density"].tolist() == [0.1, 0.2]


def test_a_diverged_lane_is_allowed_in_a_batch_and_a_singular_covariance_everywhere():
    mean = np.array([[0.0, np.nan], [0.0, 0.0]])
    assert tk.Gaussian(mean, np.zeros((2, 2))).batch == (2,)


def test_one_covariance_serves_a_batch():
    assert tk.Gaussian(np.zeros((2, 3)), np.eye(2)).cov.shape == (2, 2, 3)


@pytest.mark.parametrize("text", ["x m", "", "1x [m]", "x [m", "x [m] round"])
def test_a_space_explains_how_components_are_written(text):
    with pytest.raises(DomainError, match=r"write for example 'x \[m\]'"):
        tk.Space.of(text)


def test_a_space_finds_components_by_name_only():
    space = tk.Space.of("x [m]", "vx [m/s]", "heading [rad] circular")
    assert space.indices("heading", "x") == (2, 0)
    assert space.position == (0,)
    assert space.velocity == (1,)
    with pytest.raises(DomainError, match="one of x, vx, heading"):
        space.index("y")
    with pytest.raises(DomainError, match="more than once"):
        tk.Space.of("x [m]", "x [m]")
    assert tk.Space.of(*str(space).split(", ")) == space


def test_a_scan_without_detections_is_a_value_like_any_other():
    scan = tk.Scan(1.0, np.zeros((2, 0)), sensor="radar")
    assert scan.detections == 0
    with pytest.raises(ShapeError, match="one flag per detection slot"):
        tk.Scan(1.0, np.zeros((2, 3)), mask=[True])
    with pytest.raises(DomainError, match="inf"):
        tk.Scan(1.0, [[np.inf]])


def test_values_show_themselves_in_notebooks():
    state = tk.Gaussian([1.0], [[4.0]])
    assert "<table>" in state._repr_html_()
    assert "batch (3,)" in tk.Gaussian(np.zeros((1, 3)), [[1.0]])._repr_html_()


def test_what_is_masked_was_not_measured():
    z = np.ma.masked_array([[1.0, 2.0]], mask=[[False, True]])
    np.testing.assert_array_equal(tk.Record([0.0], z).z, [[1.0, np.nan]])


@pytest.mark.parametrize(
    ("t", "z", "words"),
    [
        (np.array(["2020-01-01"], "datetime64[s]"), [[1.0]], "pass seconds"),
        ([0.0], [["1"]], r"float\(\)"),
        ([0.0], [[1j]], "real and imaginary"),
        ([0.0, np.nan], [[1.0], [2.0]], "row 1"),
        ([0.0, 1.0, 0.5], [[1.0], [2.0], [3.0]], "row 2"),
    ],
)
def test_what_is_no_number_is_refused_with_the_way_to_make_it_one(t, z, words):
    with pytest.raises(DomainError, match=words):
        tk.Record(t, z)


def test_long_values_print_short():
    record = tk.scenario("two_stations").simulate(1, 3).record
    assert repr(record) == (
        "Record(t=<500 numbers>, z=<500x2x3 numbers>, u=None, pose=None, sensor=None)"
    )


def test_a_planar_range_is_not_moved_to_states_with_a_height():
    from tracker.errors import CapabilityError
    from tracker_sensors.range_only import range_only

    with pytest.raises(CapabilityError, match="axes=3"):
        range_only(1.0).over(tk.SPATIAL)
    assert range_only(1.0, state=tk.SPATIAL).h([3.0, 4.0, 12.0, 0, 0, 0], [0.0, 0.0])[0] == 5.0
