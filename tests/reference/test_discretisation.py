"""Three ways to the noise of a step agree, with each other and with an independent program."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.errors import DomainError, ShapeError, TraceError
from tracker.models.graph import Graph
from tracker_motion import constant_acceleration, constant_velocity, linear
from tracker_motion.discretisation import integral, is_nilpotent, matrix_fraction, transition

DATA = Path(__file__).parent / "data"


def table(name):
    return np.loadtxt(DATA / name, delimiter=",", skiprows=1)


def relative(ours, theirs):
    """Largest difference, each entry measured by the standard deviations that it couples."""
    sigma = np.sqrt(np.einsum("ii...->i...", theirs))
    scale = sigma[:, None] * sigma[None]
    return np.abs((ours - theirs) / np.where(scale == 0, 1.0, scale)).max(initial=0.0)


@pytest.mark.parametrize("axes", [1, 2, 3])
@given(dt=st.floats(1e-4, 1e3), seed=st.integers(0, 2**32 - 1))
def test_the_three_discretisations_of_constant_velocity_agree(axes, dt, seed):
    density = tuple(np.random.default_rng(seed).uniform(0.01, 10.0, axes))
    x = np.zeros(2 * axes)
    closed, *others = (
        constant_velocity(density, axes=axes, discretisation=way).Q(x, dt)
        for way in ("closed form", "integral", "matrix fraction")
    )
    for other in others:
        assert relative(other, closed) < 1e-12
        np.testing.assert_array_equal(other == 0, closed == 0)


@pytest.mark.parametrize("batch", [(), (3,), (2, 0), (2, 3)])
def test_they_agree_on_lanes_with_their_own_steps_and_densities(batch):
    rng = np.random.default_rng(0)
    dt, density = rng.uniform(0.1, 5.0, batch), rng.uniform(0.1, 5.0, batch)
    x = np.zeros((4, *batch))
    closed, *others = (
        constant_velocity(density, discretisation=way).Q(x, dt)
        for way in ("closed form", "integral", "matrix fraction")
    )
    for other in others:
        assert other.shape == closed.shape == (4, 4, *batch)
        assert relative(other, closed) < 1e-12


@given(dt=st.floats(1e-3, 100.0))
def test_constant_acceleration_equals_its_general_discretisation(dt):
    F = np.eye(3, k=1)
    closed = constant_acceleration(0.2, axes=1).Q(np.zeros(3), dt)
    for method in (integral, matrix_fraction):
        assert relative(method(F, [[0], [0], [1]], [[0.2]], dt), closed) < 1e-12


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 5), dt=st.floats(1e-3, 2.0))
def test_integral_and_matrix_fraction_agree_for_any_linear_model(seed, n, dt):
    rng = np.random.default_rng(seed)
    F, L = rng.standard_normal((n, n)), rng.standard_normal((n, 2))
    root = rng.standard_normal((2, 2))
    Qc = root @ root.T
    np.testing.assert_allclose(
        integral(F, L, Qc, dt),
        matrix_fraction(F, L, Qc, dt),
        rtol=1e-10,
        atol=1e-12 * np.abs(integral(F, L, Qc, dt)).max(),
    )


def test_a_damped_velocity_has_the_variance_of_an_ornstein_uhlenbeck_process():
    rate, density, dt = 0.5, 0.3, np.array([0.1, 1.0, 20.0])
    expected = density / (2 * rate) * (1 - np.exp(-2 * rate * dt))
    for method in (integral, matrix_fraction):
        np.testing.assert_allclose(method([[-rate]], [[1]], [[density]], dt)[0, 0], expected)


def test_discretisation_runs_on_graph_nodes_where_the_exponential_is_a_polynomial():
    dt = Graph().input("dt")
    chain = np.eye(2, k=1)
    for method in (integral, matrix_fraction):
        assert method(chain, [[0], [1]], [[1]], dt).shape == (2, 2)
    with pytest.raises(TraceError):
        transition([[0.0, 1.0], [-1.0, 0.0]], dt)


def test_nilpotent_matrices_are_known():
    assert is_nilpotent(np.eye(4, k=1))
    assert is_nilpotent(np.eye(4, k=-1))
    assert not is_nilpotent([[-0.5]])


def test_errors_say_what_does_not_fit():
    with pytest.raises(ShapeError, match=r"'L'.*got shape"):
        integral(np.eye(2), [[1]], [[1]], 0.1)
    with pytest.raises(ShapeError, match=r"'F'.*\(2, 3\)"):
        transition(np.ones((2, 3)), 0.1)
    with pytest.raises(DomainError, match="matrix_fraction"):
        integral([[-1e9]], [[1]], [[1]], 1.0)


# ------------------------------------------------------------------- an independent program
def test_constant_acceleration_equals_the_toolbox():
    motion = constant_acceleration(0.2)
    x = np.zeros(6)
    np.testing.assert_allclose(motion.jacobian(x, 0.5), table("kfcwpa/A.csv"), atol=1e-15)
    np.testing.assert_allclose(motion.Q(x, 0.5), table("kfcwpa/Q.csv"), rtol=1e-13, atol=1e-18)


@pytest.mark.parametrize("way", ["closed form", "integral", "matrix fraction"])
def test_constant_velocity_equals_the_toolbox(way):
    motion = constant_velocity(0.1, discretisation=way)
    x = np.zeros(4)
    np.testing.assert_allclose(motion.jacobian(x, 0.01), table("bot_reference/A.csv"), atol=1e-15)
    np.testing.assert_allclose(
        motion.Q(x, 0.01), table("bot_reference/Q.csv"), rtol=1e-13, atol=1e-20
    )


def test_constant_velocity_equals_a_linear_motion_of_its_matrices():
    F, L = np.kron(np.eye(2, k=1), np.eye(2)), np.kron([[0.0], [1.0]], np.eye(2))
    general, ours = (
        linear(constant_velocity(0.1).space, F, L=L, Qc=0.1 * np.eye(2)),
        constant_velocity(0.1),
    )
    x = np.random.default_rng(1).standard_normal((4, 3))
    np.testing.assert_allclose(general.f(x, 0.7), ours.f(x, 0.7), rtol=1e-13)
    np.testing.assert_allclose(general.Q(x, 0.7), ours.Q(x, 0.7), rtol=1e-13, atol=1e-18)
