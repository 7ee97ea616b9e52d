"""Laws of every motion: independent formulas in SymPy, composition of steps, batches."""

import pickle
from functools import cache

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from tracker.errors import CapabilityError, DomainError, ShapeError
from tracker.models import ComponentMotion
from tracker.types import Space
from tracker_motion import (
    acceleration_input,
    constant_acceleration,
    constant_velocity,
    coordinated_turn,
    linear,
)

BATCHES = ((), (3,), (2, 0), (2, 3))
T = sp.Symbol("dt", positive=True)
OSCILLATOR = [[0.0, 1.0], [-0.3, -0.2]]
LINE = Space.of("x [m]", "vx [m/s]")


def names(text):
    return sp.symbols(text, real=True)


def chain(order, axes):
    """Transition of a chain of integrators on several axes: eq. (28) of paper 0 and its like."""
    F = sp.kronecker_product(sp.Matrix(order, order, lambda i, j: int(j == i + 1)), sp.eye(axes))
    return (F * T).exp()


def turned():
    x, y, vx, vy, w = names("x y vx vy omega")
    s, c = sp.sin(w * T), sp.cos(w * T)
    return [
        x + (vx * s - vy * (1 - c)) / w,
        y + (vx * (1 - c) + vy * s) / w,
        vx * c - vy * s,
        vx * s + vy * c,
        w,
    ]


def carried(A, motion):
    return list(A * sp.Matrix([names(n) for n in motion.space.names]))


CV = {axes: constant_velocity(0.3, axes=axes) for axes in (1, 2, 3)}
CA = {axes: constant_acceleration(0.2, axes=axes) for axes in (1, 2, 3)}
DRIVEN = {axes: acceleration_input(0.05, axes=axes) for axes in (1, 2, 3)}
TURN = coordinated_turn(0.1, 1e-3)
DAMPED = linear(LINE, OSCILLATOR, L=[[0], [1]], Qc=[[0.4]])
NILPOTENT = linear(LINE, [[0, 1], [0, 0]], L=[[0], [1]], Qc=[[0.4]])

# Motions beside their transition, written again from its definition.
MOTIONS = {
    **{f"constant velocity {a}": (m, carried(chain(2, a), m)) for a, m in CV.items()},
    **{f"constant acceleration {a}": (m, carried(chain(3, a), m)) for a, m in CA.items()},
    **{f"acceleration input {a}": (m, carried(chain(2, a), m)) for a, m in DRIVEN.items()},
    "coordinated turn": (TURN, turned()),
    "linear, polynomial": (NILPOTENT, carried(chain(2, 1), NILPOTENT)),
}
COMPOSING = {
    **{name: m for name, (m, _) in MOTIONS.items() if "input" not in name},
    "unequal densities": constant_velocity((0.1, 0.4)),
    "integral": constant_velocity(0.3, discretisation="integral"),
    "matrix fraction": constant_velocity((0.1, 0.4, 0.0), axes=3, discretisation="matrix fraction"),
    "linear, damped": DAMPED,
}
EVERY = {**COMPOSING, **{name: m for name, (m, _) in MOTIONS.items() if "input" in name}}
every_motion = pytest.mark.parametrize("name", list(EVERY))


@cache
def oracle(name):
    motion, out = MOTIONS[name]
    state = [names(n) for n in motion.space.names]
    first = [[sp.diff(e, s) for s in state] for e in out]
    second = [[[sp.diff(e, s) for s in state] for e in row] for row in first]
    return [sp.lambdify([*state, T], v, "numpy", cse=True) for v in (out, first, second)]


def draw(motion, seed, batch=(), rate=0.4):
    rng = np.random.default_rng(seed)
    x = 100 * rng.standard_normal((len(motion.space), *batch))
    if "omega" in motion.space.names:
        x[-1] = rate * rng.choice([-1.0, 1.0], batch) * rng.uniform(0.1, 1.0, batch)
    return x


def assert_close(ours, theirs, message="", tolerance=1e-9):
    scale = max(np.abs(np.asarray(theirs)).max(initial=0.0), 1e-300)
    np.testing.assert_allclose(
        ours, theirs, rtol=tolerance, atol=tolerance * scale, err_msg=message
    )


@pytest.mark.parametrize("name", list(MOTIONS))
@settings(deadline=None)  # the first example derives the formulas
@given(seed=st.integers(0, 2**32 - 1), dt=st.floats(0.01, 20.0))
def test_transition_jacobian_and_hessian_equal_symbolic_ones(name, seed, dt):
    motion, _ = MOTIONS[name]
    x = draw(motion, seed)
    value, first, second = (part(*x, dt) for part in oracle(name))
    n = len(x)
    assert_close(motion.f(x, dt), value, "f is not what the model's definition says")
    assert_close(motion.jacobian(x, dt), first, "the Jacobian is not the derivative of f", 1e-8)
    hessian = np.broadcast_to(np.asarray(second, dtype=float), (n, n, n))
    assert_close(motion.hessian(x, dt), hessian, "the Hessian is not the second derivative", 1e-7)


@pytest.mark.parametrize("name", list(COMPOSING))
@given(seed=st.integers(0, 2**32 - 1), dt=st.floats(0.0, 4.0), share=st.floats(0.0, 1.0))
def test_two_steps_equal_one_in_f_and_q(name, seed, dt, share):
    motion = COMPOSING[name]
    x = draw(motion, seed)
    first, second = share * dt, dt - share * dt
    middle = motion.f(x, first)
    assert_close(motion.f(middle, second), motion.f(x, dt), "f does not compose")
    F = motion.jacobian(middle, second)
    together = F @ motion.Q(x, first) @ F.T + motion.Q(middle, second)
    assert_close(together, motion.Q(x, dt), "Q does not compose", 1e-8)


def test_the_noise_of_an_acceleration_input_belongs_to_the_step():
    motion = DRIVEN[2]
    x = np.array([1.0, 2.0, 3.0, 4.0])
    F, half, whole = motion.jacobian(x, 0.5), motion.Q(x, 0.5), motion.Q(x, 1.0)
    assert_close(
        motion.f(motion.f(x, 0.5, u=[1.0, 2.0]), 0.5, u=[1.0, 2.0]), motion.f(x, 1.0, u=[1.0, 2.0])
    )
    assert (F @ half @ F.T + half)[2, 2] == pytest.approx(whole[2, 2] / 2)
    assert np.linalg.matrix_rank(whole) == 2


@every_motion
def test_no_time_changes_nothing(name):
    motion = EVERY[name]
    x = draw(motion, 1)
    n = len(x)
    np.testing.assert_array_equal(motion.f(x, 0.0), x)
    np.testing.assert_array_equal(motion.jacobian(x, 0.0)[:, : n - 1], np.eye(n)[:, : n - 1])
    np.testing.assert_array_equal(motion.Q(x, 0.0), np.zeros((n, n)))


@every_motion
@pytest.mark.parametrize("batch", BATCHES)
@pytest.mark.parametrize("varying", [False, True])
def test_a_batch_is_its_lanes_also_when_each_has_its_own_time_step(name, batch, varying):
    motion = EVERY[name]
    x = draw(motion, 3, batch)
    n = len(x)
    dt = np.random.default_rng(4).uniform(0.1, 2.0, batch) if varying else 0.7
    f, J, Q = motion.f(x, dt), motion.jacobian(x, dt), motion.Q(x, dt)
    assert f.shape == (n, *batch)
    J, Q = (np.broadcast_to(value, (n, n, *batch)) for value in (J, Q))
    for lane in np.ndindex(*batch):
        own = float(np.broadcast_to(dt, batch)[lane])
        one = x[(slice(None), *lane)]
        assert_close(f[(..., *lane)], motion.f(one, own), tolerance=1e-12)
        assert_close(J[(..., *lane)], motion.jacobian(one, own), tolerance=1e-12)
        assert_close(Q[(..., *lane)], motion.Q(one, own), tolerance=1e-12)


@every_motion
@given(seed=st.integers(0, 2**32 - 1), dt=st.floats(1e-3, 10.0))
def test_q_is_exactly_symmetric_and_positive_semi_definite(name, seed, dt):
    motion = EVERY[name]
    Q = motion.Q(draw(motion, seed), dt)
    np.testing.assert_array_equal(Q, Q.T)
    assert np.linalg.eigvalsh(Q)[0] >= -1e-12 * np.abs(Q).max()


@every_motion
def test_motions_pickle(name):
    motion = EVERY[name]
    x = draw(motion, 5)
    again = pickle.loads(pickle.dumps(motion))
    np.testing.assert_array_equal(again.f(x, 0.3), motion.f(x, 0.3))
    np.testing.assert_array_equal(again.Q(x, 0.3), motion.Q(x, 0.3))


@pytest.mark.parametrize("name", [n for n in EVERY if n != "linear, damped"])
def test_motions_can_be_traced(name):
    assert not EVERY[name].why_opaque


# ---------------------------------------------------------------------------------- turns
@given(exponent=st.floats(-12.0, 0.5), sign=st.sampled_from([-1.0, 1.0]))
def test_a_turn_is_right_at_any_rate(exponent, sign):
    from mpmath import mp, mpf

    rate, dt = sign * 10.0**exponent, 1.0
    with mp.workdps(50):
        w = mpf(rate)
        ahead, aside = mp.sin(w) / w, (1 - mp.cos(w)) / w
        slope = [(w * mp.cos(w) - mp.sin(w)) / w**2, (w * mp.sin(w) - 1 + mp.cos(w)) / w**2]
        expected = [float(v) for v in (ahead, aside, *slope)]
    x = np.array([0.0, 0.0, 1.0, 0.0, rate])
    f, J = TURN.f(x, dt), TURN.jacobian(x, dt)
    np.testing.assert_allclose([*f[:2], *J[:2, 4]], expected, rtol=1e-12, atol=1e-16)


@given(turn=st.floats(-30.0, 30.0), share=st.floats(0.0, 1.0))
def test_the_noise_of_a_turn_composes_however_far_it_turns(turn, share):
    x = np.array([1.0, 2.0, 10.0, -4.0, turn])
    middle = TURN.f(x, share)
    F = TURN.jacobian(middle, 1.0 - share)
    together = F @ TURN.Q(x, share) @ F.T + TURN.Q(middle, 1.0 - share)
    assert_close(together, TURN.Q(x, 1.0), tolerance=1e-11)


def test_a_turn_at_rate_zero_is_a_straight_line_with_finite_derivatives():
    x = np.array([1.0, 2.0, 3.0, 4.0, 0.0])
    np.testing.assert_array_equal(TURN.f(x, 2.0), [7.0, 10.0, 3.0, 4.0, 0.0])
    J, H = TURN.jacobian(x, 2.0), TURN.hessian(x, 2.0)
    np.testing.assert_allclose(J[:4, 4], [-8.0, 6.0, -8.0, 6.0])  # paths bend to the left
    np.testing.assert_allclose(H[0, 4, 4], -3.0 * 8.0 / 3.0)
    assert np.isfinite(H).all()


def test_a_turn_without_turn_noise_spreads_like_constant_velocity():
    straight = coordinated_turn(0.3, 0.0).Q(np.array([1.0, 2.0, 30.0, 4.0, 0.0]), 1.7)
    np.testing.assert_allclose(straight[:4, :4], CV[2].Q(np.zeros(4), 1.7), rtol=1e-13, atol=1e-16)
    assert not straight[4].any()


def test_the_noise_of_a_turn_is_the_spread_of_disturbed_turns():
    rng = np.random.default_rng(8)
    density, turning, dt, steps, runs = 0.1, 1e-4, 2.0, 100, 40_000
    start = np.array([0.0, 0.0, 10.0, 5.0, 0.5])
    motion, h = coordinated_turn(density, turning), dt / steps
    x = np.repeat(start[:, None], runs, axis=1)
    for _ in range(steps):
        x = motion.f(x, h)
        x[2:4] += np.sqrt(density * h) * rng.standard_normal((2, runs))
        x[4] += np.sqrt(turning * h) * rng.standard_normal(runs)
    Q = motion.Q(start, dt)
    scale = np.sqrt(np.outer(np.diag(Q), np.diag(Q)))
    np.testing.assert_allclose(np.cov(x) / scale, Q / scale, atol=0.03)


# ------------------------------------------------------------------------------ parameters
def test_densities_may_differ_between_lanes_and_between_axes():
    lanes = constant_velocity(np.array([0.1, 0.2]))
    np.testing.assert_allclose(lanes.Q(np.zeros((4, 2)), 1.0)[2, 2], [0.1, 0.2])
    axes = constant_velocity((0.1, np.array([0.3, 0.4])))
    Q = axes.Q(np.zeros((4, 2)), 1.0)
    np.testing.assert_allclose(Q[2, 2], 0.1)
    np.testing.assert_allclose(Q[3, 3], [0.3, 0.4])
    tuned = constant_velocity(0.1).with_parameters(density=0.5)
    assert tuned.Q(np.zeros(4), 1.0)[2, 2] == pytest.approx(0.5)


def test_a_discrete_linear_motion_takes_one_step_per_call():
    F = [[0.77, 0.2, 0.0], [0.25, 0.75, 0.25], [0.05, 0.0, 0.75]]  # paper 4, eq. (3-11)
    motion = linear(Space.of("a", "b", "c"), F, Q=0.02 * np.eye(3))
    x = np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(motion.f(x, dt=1.0), F @ x)
    np.testing.assert_array_equal(motion.Q(x, dt=1.0), 0.02 * np.eye(3))
    assert motion.f(np.ones((3, 2, 0)), 1.0).shape == (3, 2, 0)


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda: constant_velocity(-0.1), DomainError, ("density", "-0.1", "non-negative", "m^2/s^3")),
        (lambda: constant_velocity(0.1, axes=4), DomainError, ("axes", "4", "1, 2, 3")),
        (lambda: constant_velocity((0.1, 0.2, 0.3)), ShapeError, ("density", "3 values", "per axis (2)")),
        (lambda: constant_velocity(0.1, discretisation="euler"), DomainError, ("discretisation", "'integral'")),
        (lambda: acceleration_input((0.1,)), ShapeError, ("sigma", "1 values", "per axis (2)")),
        (lambda: DRIVEN[2].f(np.zeros(4), 1.0, u=[1.0]), ShapeError, ("'u'", "(1,)", "ax", "ay")),
        (lambda: CV[2].f(np.zeros(3), 1.0), ShapeError, ("'x'", "(3,)", "(4, *batch)")),
        (lambda: linear(LINE, np.eye(3), Qc=np.eye(3)), ShapeError, ("'F'", "(3, 3)", "(2, 2)")),
        (lambda: linear(LINE, np.eye(2), Qc=np.eye(3)), ShapeError, ("'Qc'", "(3, 3)", "(2, 2)")),
        (lambda: linear(LINE, np.eye(2)), DomainError, ("Qc missing", "Q missing", "give Qc")),
        (lambda: linear(LINE, np.eye(2), Q=-np.eye(2)), DomainError, ("'Q'", "positive semi-definite")),
        (lambda: DAMPED.f([0.0, 0.0], 1.0, u=[1.0]), CapabilityError, ("no input",)),
    ],
)  # fmt: skip
def test_errors_name_the_argument_what_it_was_and_the_way_out(call, error, words):
    with pytest.raises(error) as raised:
        call()
    missing = [word for word in words if word not in str(raised.value)]
    assert not missing, f"the message should say {missing}: {raised.value}"


def test_noise_that_asks_for_what_Q_is_not_given_is_refused_instead_of_answered_with_zero():
    with pytest.raises(CapabilityError, match=r"noise: got .* asks for t"):
        ComponentMotion(
            name="aging",
            advance=lambda x, vx, *, dt, t: (x + dt * vx, vx),
            noise=lambda *, dt, t: ((dt * t, 0.0), (0.0, dt * t)),
            space=LINE,
        )
