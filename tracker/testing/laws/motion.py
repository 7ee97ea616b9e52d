"""Laws of motion models; what is compared is derived here by differences, never from the graph."""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.algebra import dense, residual
from tracker.errors import ShapeError
from tracker.models.graph import Graph, evaluate
from tracker.testing.calls import Call, Given, calls_of
from tracker.testing.differences import first, second
from tracker.testing.law import (
    Case,
    agree,
    lacks,
    law,
    not_negative,
    over_lanes,
    state_space,
    symmetric,
    untraceable,
)
from tracker.testing.strategies import spread
from tracker.types import Array

_TIME = 2.5


def _arguments(case: Case, batch: tuple[int, ...], dt: Any = None) -> tuple[Any, ...]:
    """x, dt, u and t."""
    x = case.state(batch)
    return x, case.dt() if dt is None else dt, case.inputs(batch), _TIME


@calls_of("motion")
def motion_calls(motion: Any, case: Case, batch: tuple[int, ...]) -> list[Call]:
    """How a motion is called."""
    x, dt, u, t = _arguments(case, batch)
    state, step = Given("x", x, 1), Given("dt", dt, None)
    given = (state, step, Given("u", u, 1), Given("t", t, None))
    made = [
        Call("f", lambda m, *a: (m.f(*a),), given, (1,), batch),
        Call("Q", lambda m, *a: (m.Q(*a),), (state, step), (2,), batch, shared=True),
    ]
    if not lacks("jacobian", 1.0)(motion):
        made.append(
            Call("jacobian", lambda m, *a: (m.jacobian(*a),), given, (2,), batch, shared=True)
        )
    if not lacks("hessian", 1.0)(motion):
        made.append(
            Call("hessian", lambda m, *a: (m.hessian(*a),), given, (3,), batch, shared=True)
        )
    if not lacks("linearise", 1.0)(motion):
        made.append(Call("linearise", _linearised, given, (1, 2), batch, shared=True))
    return made


def _linearised(model: Any, *arguments: Any) -> tuple[Any, Any]:
    value, jacobian = model.linearise(*arguments)
    return value, dense(jacobian)


def against_differences(
    what: str, exact: Array, found: tuple[Array, Array], scale: Array, slack: float, names: Any
) -> None:
    """Compare derivatives, all entries of a row in the units that a typical step of the state has."""
    best, error = found
    unit = scale if best.ndim == 3 else scale[:, None] * scale
    exact, best, error = exact * unit, best * unit, error * unit
    matrix = tuple(range(1, best.ndim - 1))
    size = np.abs(best).max(axis=matrix, keepdims=True, initial=0.0)
    tolerance = slack * size + 20.0 * np.minimum(error, 1e-3 * size) + 1e-13 * np.abs(unit).max()
    bad = ~(np.abs(exact - best) <= tolerance)
    if bad.any():
        at = np.argwhere(bad)[0]
        by = ", ".join(names[int(j)] for j in at[1:-1])
        divide = unit[tuple(at[1:])]
        raise AssertionError(
            f"{what}: the derivative of component {int(at[0])} by {by} is given as "
            f"{exact[tuple(at)] / divide:.9g}, differences say {best[tuple(at)] / divide:.9g}"
        )


def typical(x: Array, component: Any) -> Array:
    """A scale for steps of each component, ``(n, B)``: not smaller than a tenth of its spread."""
    wide = spread(state_space(component))[:, None] / 10.0
    return np.maximum(np.abs(x), wide)


def _difference(motion: Any) -> Any:
    flags = motion.space.circular

    def difference(a: Array, b: Array) -> Any:
        return residual(a, b, flags)

    return difference


def _repeated(value: Any, points: Array, lanes: int) -> Any:
    return None if value is None else np.tile(value, (1, points.shape[1] // lanes))


@law("motion", name="jacobian", unless=lacks("jacobian", 1.0))
def jacobian(motion: Any, case: Case) -> None:
    """The Jacobian is the derivative of f by the state."""
    x, dt, u, t = _arguments(case, (3,))
    scale = typical(x, motion)
    found = first(lambda p: motion.f(p, dt, _repeated(u, p, 3), t), x, scale, _difference(motion))
    exact = over_lanes(motion.jacobian(x, dt, u, t), found[0].shape, "jacobian")
    against_differences("jacobian", exact, found, scale, 1e-6, motion.space.names)


@law("motion", name="hessian", unless=lacks("hessian", 1.0))
def hessian(motion: Any, case: Case) -> None:
    """The Hessian is the second derivative of f by the state."""
    x, dt, u, t = _arguments(case, (3,))
    scale = typical(x, motion)
    found = second(lambda p: motion.f(p, dt, _repeated(u, p, 3), t), x, scale, _difference(motion))
    exact = over_lanes(motion.hessian(x, dt, u, t), found[0].shape, "hessian")
    against_differences("hessian", exact, found, scale, 1e-5, motion.space.names)


@law("motion", name="Q is a covariance")
def q_is_a_covariance(motion: Any, case: Case) -> None:
    """Q is symmetric positive semi-definite for every state and time step."""
    n = motion.space.size
    Q = over_lanes(motion.Q(case.state((3,)), case.dt(zero=True)), (n, n, 3), "Q")
    symmetric(Q, "Q is not symmetric", 1e-12)
    for i in range(Q.shape[-1]):
        not_negative(Q[..., i], "Q is not positive semi-definite: a noise of negative variance")


@law("motion", name="f composes")
def f_composes(motion: Any, case: Case) -> None:
    """Two shorter steps end where one step of their sum ends, input held constant."""
    x, dt, u, t = _arguments(case, (3,))
    part = dt * case.rng.uniform(0.2, 0.8)
    twice = motion.f(motion.f(x, part, u, t), dt - part, u, t + part)
    once = motion.f(x, dt, u, t)
    gap = _difference(motion)(np.array(twice), np.asarray(once))
    told = "two shorter steps of f do not end where one step of their sum does"
    size = np.abs(once).max(axis=1, keepdims=True) + typical(x, motion)
    agree(gap, np.zeros_like(gap), 1e-9, told, scale=size)


def _not_linear(motion: Any) -> str:
    reason = lacks("jacobian", 1.0)(motion)
    if reason:
        return reason
    declared = getattr(motion, "linear", None)
    if declared is None:
        n = motion.space.size
        rng = np.random.default_rng(0)
        F = np.asarray(motion.jacobian(rng.standard_normal((n, 2)), 1.0))
        declared = bool(np.all(F[..., :1] == F[..., -1:]))
    return "" if declared else "f is not linear, so Q depends on where the noise enters"


@law("motion", name="Q composes", unless=_not_linear)
def q_composes(motion: Any, case: Case) -> None:
    """The noise of two shorter steps, the first carried on by F, is the noise of one step."""
    x, dt, u, t = _arguments(case, ())
    part = dt * case.rng.uniform(0.2, 0.8)
    F = np.asarray(motion.jacobian(x, dt - part, u, t))
    Q = np.asarray(motion.Q(x, dt))
    twice = F @ motion.Q(x, part) @ F.T + motion.Q(x, dt - part)
    told = "the noise of two shorter steps is not that of one: results would depend on the rate"
    sigma = np.sqrt(np.maximum(np.diagonal(Q), np.diagonal(twice)))
    agree(twice, Q, 1e-9, told, scale=np.outer(sigma, sigma) + 1e-300)


@law("motion", name="zero step")
def zero_step(motion: Any, case: Case) -> None:
    """In no time nothing moves and no noise enters; in little time, little."""
    x = case.state((3,))
    u = case.inputs((3,))
    agree(motion.f(x, 0.0, u, _TIME), x, 1e-12, "f moves the state in a step of zero seconds")
    agree(motion.jacobian(x, 0.0, u, _TIME) + np.zeros((1, 1, 3)),
          np.eye(len(x))[..., None] + np.zeros(3), 1e-12,
          "the Jacobian of a step of zero seconds is not the identity",
          ) if not lacks("jacobian", 1.0)(motion) else None  # fmt: skip
    Q = np.asarray(motion.Q(x, 0.0))
    agree(Q, np.zeros_like(Q), 0.0, "Q is not zero for a step of zero seconds", scale=1.0)
    soon, size = motion.f(x, 1e-9, u, _TIME), typical(x, motion)
    agree(soon, x, 1e-6, "f jumps in a step of a nanosecond", scale=size)


@law("motion", name="time step per lane")
def time_step_per_lane(motion: Any, case: Case) -> None:
    """A time step per lane gives what each lane gives with its own, zero among them."""
    x, _, u, t = _arguments(case, (4,))
    dt = np.array([0.0, case.dt(), case.dt(), case.dt()])
    f, Q = motion.f(x, dt, u, t), np.asarray(motion.Q(x, dt))
    assert np.shape(f) == x.shape, f"f answers {np.shape(f)} to a time step per lane"
    Q = np.broadcast_to(Q, (len(x), *x.shape))
    for i in range(4):
        own = None if u is None else u[:, i]
        told = f"with a time step per lane, lane {i} differs from that lane alone in"
        agree(f[:, i], motion.f(x[:, i], float(dt[i]), own, t), 1e-12, f"{told} f")
        agree(Q[..., i], motion.Q(x[:, i], float(dt[i])), 1e-12, f"{told} Q")


@law(
    "motion",
    name="linear as declared",
    unless=lambda m: "" if getattr(m, "linear", False) else "it does not declare itself linear",
)
def linear_as_declared(motion: Any, case: Case) -> None:
    """A motion that declares itself linear moves differences of states by its Jacobian."""
    x, dt, u, t = _arguments(case, ())
    y = case.state()
    moved = motion.f(x, dt, u, t) - motion.f(y, dt, u, t)
    told = "it declares itself linear, but f(x) - f(y) is not F (x - y)"
    agree(moved, motion.jacobian(x, dt, u, t) @ (x - y), 1e-9, told)


@law("motion", name="interpretations agree", unless=untraceable)
def interpretations_agree(motion: Any, case: Case) -> None:
    """Traced on graph nodes, f, its Jacobian and Q are worth what they are on arrays, to 1e-9."""
    x, dt, u, t = _arguments(case, ())
    graph = Graph()
    values: dict[str, Any] = {}

    def node(name: str, value: Any) -> Any:
        values[name] = float(value)
        return graph.input(name)

    def nodes(name: str, vector: Any) -> Any:
        out = np.empty(len(vector), dtype=object)
        out[:] = [node(f"{name}{i}", v) for i, v in enumerate(vector)]
        return out

    state, step, time = nodes("x", x), node("dt", dt), node("t", t)
    inputs = None if u is None else nodes("u", u)
    for name, traced, plain in (
        ("f", motion.f(state, step, inputs, time), motion.f(x, dt, u, t)),
        ("jacobian", motion.jacobian(state, step, inputs, time), motion.jacobian(x, dt, u, t)),
        ("Q", motion.Q(state, step), motion.Q(x, dt)),
    ):
        worth = np.array(evaluate(list(np.ravel(traced)), values), dtype=np.float64)
        agree(worth, np.ravel(plain), 1e-9, f"{name} on graph nodes differs from {name} on arrays")


@law("motion", name="shape error", examples=2)
def shape_error(motion: Any, case: Case) -> None:
    """A state with a wrong number of components is refused with a ShapeError."""
    refuses(motion, "f", case.state((2,)), 1.0)


def refuses(model: Any, name: str, x: Array, *arguments: Any) -> None:
    """Assert that a method refuses states of wrong length."""
    for wrong in (np.concatenate([x, x[:1]]), x[:-1]):
        try:
            getattr(model, name)(wrong, *arguments)
        except ShapeError:
            continue
        except Exception as error:
            raise AssertionError(
                f"{name} meets {len(wrong)} components instead of {len(x)} with "
                f"{type(error).__name__}: raise ShapeError, saying what was expected"
            ) from error
        raise AssertionError(
            f"{name} accepts {len(wrong)} components instead of {len(x)}: raise ShapeError"
        )
