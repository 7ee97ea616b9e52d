"""Laws of sensors; every difference of measurements goes through the sensor's own residual."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

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
    symmetric,
    untraceable,
)
from tracker.testing.laws.motion import (
    _linearised,
    against_differences,
    refuses,
    typical,
)
from tracker.types import Array, Gaussian

TAU = 2.0 * np.pi


def _lacks(name: str) -> Any:
    def reason(sensor: Any) -> str:
        space = sensor.pose_space
        pose = np.linspace(-1.0, 1.5, space.size) if space.size else None
        return lacks(name, pose)(sensor)

    return reason


@calls_of("sensor")
def sensor_calls(sensor: Any, case: Case, batch: tuple[int, ...]) -> list[Call]:
    """How a sensor is called."""
    given = (Given("x", case.state(batch), 1), Given("pose", case.pose(batch), 1))
    made = [
        Call("h", lambda s, *a: (s.h(*a),), given, (1,), batch),
        Call("R", lambda s, *a: (s.R(*a),), given, (2,), batch, shared=True),
    ]
    if not _lacks("jacobian")(sensor):
        made.append(
            Call("jacobian", lambda s, *a: (s.jacobian(*a),), given, (2,), batch, shared=True)
        )
    if not _lacks("hessian")(sensor):
        made.append(
            Call("hessian", lambda s, *a: (s.hessian(*a),), given, (3,), batch, shared=True)
        )
    if not _lacks("linearise")(sensor):
        made.append(Call("linearise", _linearised, given, (1, 2), batch, shared=True))
    shape = (sensor.space.size, *batch)
    z, zhat = (Given(name, case.rng.uniform(-3.0, 3.0, shape), 1) for name in ("z", "zhat"))
    made.append(Call("residual", lambda s, *a: (s.residual(*a),), (z, zhat), (1,), batch))
    return made


def _tiled(pose: Array | None, points: Array) -> Array | None:
    return None if pose is None else np.tile(pose, (1, points.shape[1] // pose.shape[1]))


def _difference(sensor: Any) -> Any:
    """The residual over any axes: called with one axis of lanes, as the law of a batch is another's."""

    def difference(a: Array, b: Array) -> Any:
        flat = sensor.residual(a.reshape(len(a), -1).copy(), b.reshape(len(b), -1).copy())
        return np.asarray(flat).reshape(a.shape)

    return difference


@law("sensor", name="jacobian", unless=_lacks("jacobian"))
def jacobian(sensor: Any, case: Case) -> None:
    """The Jacobian is the derivative of h by the state, differences taken through the residual."""
    x, pose = case.state((3,)), case.pose((3,))
    scale = typical(x, sensor)
    found = first(lambda p: sensor.h(p, _tiled(pose, p)), x, scale, _difference(sensor))
    exact = over_lanes(sensor.jacobian(x, pose), found[0].shape, "jacobian")
    against_differences("jacobian", exact, found, scale, 1e-6, sensor.state.names)


@law("sensor", name="hessian", unless=_lacks("hessian"))
def hessian(sensor: Any, case: Case) -> None:
    """The Hessian is the second derivative of h by the state, through the residual."""
    x, pose = case.state((3,)), case.pose((3,))
    scale = typical(x, sensor)
    found = second(lambda p: sensor.h(p, _tiled(pose, p)), x, scale, _difference(sensor))
    exact = over_lanes(sensor.hessian(x, pose), found[0].shape, "hessian")
    against_differences("hessian", exact, found, scale, 1e-5, sensor.state.names)


def _not_circular(sensor: Any) -> str:
    return "" if any(sensor.space.circular) else "its space declares no circular component"


@law("sensor", name="wraps at the cut", unless=_not_circular)
def wraps_at_the_cut(sensor: Any, case: Case) -> None:
    """The residual of a circular component is in (-pi, pi], small across the cut, blind to turns."""
    circular = np.array(sensor.space.circular)
    m, gap = sensor.space.size, case.rng.uniform(1e-6, 1e-1)
    z = np.where(circular, np.pi - gap, 1.0)
    zhat = np.where(circular, -np.pi + gap, 1.0)
    told = "angles on either side of the cut are neighbours, but the residual says otherwise"
    agree(sensor.residual(z, zhat), np.where(circular, -2 * gap, 0.0), 1e-9, told, scale=1.0)
    agree(sensor.residual(zhat, z), np.where(circular, 2 * gap, 0.0), 1e-9, told, scale=1.0)
    z, zhat = case.rng.uniform(-3.0, 3.0, (2, m))
    turns = np.where(circular, TAU * case.rng.integers(-3, 4, m), 0.0)
    plain = sensor.residual(z.copy(), zhat.copy())
    told = "a whole turn more in the measurement changes the residual"
    agree(sensor.residual(z + turns, zhat.copy()), plain, 1e-9, told, scale=1.0)
    far = np.asarray(sensor.residual(case.rng.uniform(-20.0, 20.0, (m, 50)), np.zeros((m, 50))))[
        circular
    ]
    assert (far > -np.pi).all(), "a residual is not above -pi"
    assert (far <= np.pi).all(), "a residual is above pi"


@law("sensor", name="residual subtracts")
def residual_subtracts(sensor: Any, case: Case) -> None:
    """The residual is z - zhat, up to whole turns where circular, and NaN where z is NaN."""
    circular = np.array(sensor.space.circular).reshape(-1, 1)
    z, zhat = case.rng.uniform(-100.0, 100.0, (2, sensor.space.size, 5))
    found = np.asarray(sensor.residual(z.copy(), zhat.copy()))
    off = found - (z - zhat)
    off = np.where(circular, off - TAU * np.round(off / TAU), off)
    agree(off, np.zeros_like(off), 1e-9, "the residual is not z - zhat", scale=1.0)
    z[0, 1] = np.nan
    assert np.isnan(sensor.residual(z, zhat)[0, 1]), "the residual of a NaN is not NaN"


def _no_way_round(sensor: Any) -> str:
    return "" if {"x", "y"} <= set(sensor.state.names) else "its state has no x and y to circle in"


@law("sensor", name="continuous through the residual", examples=3, unless=_no_way_round)
def continuous(sensor: Any, case: Case) -> None:
    """A measurement never jumps, through the residual, while the target circles smoothly."""
    x, pose = case.state(), case.pose()
    i, j = sensor.state.indices("x", "y")

    def measured(angle: Array) -> Any:
        points = np.repeat(x[:, None], len(angle), axis=1)
        cos, sin = np.cos(angle), np.sin(angle)
        points[i], points[j] = cos * x[i] - sin * x[j], sin * x[i] + cos * x[j]
        return sensor.h(points, None if pose is None else np.repeat(pose[:, None], len(angle), 1))

    angle = np.linspace(0.0, TAU, 181)
    z = np.asarray(measured(angle))
    jumps = np.abs(sensor.residual(z[:, 1:].copy(), z[:, :-1].copy()))
    for k, row in enumerate(jumps):
        at = int(row.argmax())
        low, high = angle[at], angle[at + 1]
        for _ in range(30):  # a smooth function's largest change dies as its interval is halved
            middle = 0.5 * (low + high)
            ends = np.asarray(measured(np.array([low, middle, high])))
            first_half, second_half = np.abs(
                sensor.residual(ends[:, 1:].copy(), ends[:, :-1].copy())
            )[k]
            low, high = (low, middle) if first_half > second_half else (middle, high)
            left = max(first_half, second_half)
        told = f"component {sensor.space.names[k]!r} jumps by {left:.4g} as the target moves on"
        assert left <= 1e-3 * row[at] + 1e-9, f"{told}: is it circular, and wrapped?"


@law("sensor", name="R is a covariance")
def r_is_a_covariance(sensor: Any, case: Case) -> None:
    """R is symmetric positive semi-definite for every state and pose."""
    m = sensor.space.size
    R = over_lanes(sensor.R(case.state((3,)), case.pose((3,))), (m, m, 3), "R")
    symmetric(R, "R is not symmetric", 1e-12)
    for i in range(R.shape[-1]):
        not_negative(R[..., i], "R is not positive semi-definite: a noise of negative variance")


@law("sensor", name="linear as declared",
     unless=lambda s: "" if getattr(s, "linear", False) else "it does not declare itself linear")  # fmt: skip
def linear_as_declared(sensor: Any, case: Case) -> None:
    """A sensor that declares itself linear maps differences of states by its Jacobian."""
    x, y, pose = case.state(), case.state(), case.pose()
    seen = sensor.h(x, pose) - sensor.h(y, pose)
    told = "it declares itself linear, but h(x) - h(y) is not H (x - y)"
    agree(seen, sensor.jacobian(x, pose) @ (x - y), 1e-9, told, scale=np.abs(x - y).max())


def _no_pose(sensor: Any) -> str:
    return "" if sensor.pose_space.size else "it takes no pose"


@law("sensor", name="pose is used", unless=_no_pose, examples=1)
def pose_is_used(sensor: Any, case: Case) -> None:
    """Every component of the pose has an influence on the measurement or its noise."""
    x, pose = case.state((20,)), case.pose((20,))
    assert pose is not None
    before = np.asarray(sensor.h(x, pose)), np.asarray(sensor.R(x, pose))
    for i, name in enumerate(sensor.pose_space.names):
        moved = pose.copy()
        moved[i] += 0.37 * (1.0 + np.abs(pose[i]))
        after = np.asarray(sensor.h(x, moved)), np.asarray(sensor.R(x, moved))
        same = all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
        assert not same, f"pose component {name!r} changes nothing: h ignores it"


@law("sensor", name="shared pose", unless=_no_pose, examples=3)
def shared_pose(sensor: Any, case: Case) -> None:
    """A pose given once serves all lanes."""
    x, pose = case.state((3,)), case.pose()
    assert pose is not None
    each = np.repeat(pose[:, None], 3, axis=1)
    told = "a pose given once, (p,), is not the same as that pose in every lane"
    agree(sensor.h(x, pose), sensor.h(x, each), 1e-12, told)


def _shifts(sensor: Any) -> dict[str, list[int]]:
    """Places in the pose of what moves along with x, y and z."""
    out: dict[str, list[int]] = {"x": [], "y": [], "z": []}
    for i, name in enumerate(sensor.pose_space.names):
        match = re.fullmatch(r"s?([xyz])(_\w+)?", name)
        if match:
            out[match[1]].append(i)
    return {name: places for name, places in out.items() if places}


def _not_movable(sensor: Any) -> str:
    if not _shifts(sensor):
        return "its pose has no position components (sx, sy, sz)"
    fixed = {name for name in sensor.state.names if name in {"x", "y", "z"}} - set(_shifts(sensor))
    return f"its pose has no s{min(fixed)}" if fixed else ""


@law("sensor", name="follows a translation", unless=_not_movable)
def follows_a_translation(sensor: Any, case: Case) -> None:
    """Target and sensor moved alike, the measurement stays what it was."""
    x, pose = case.state((3,)), case.pose((3,))
    assert pose is not None
    far, along = x.copy(), pose.copy()
    for name, places in _shifts(sensor).items():
        by = case.rng.uniform(-500.0, 500.0)
        if name in sensor.state.names:
            far[sensor.state.index(name)] += by
            along[places] += by
    gap = sensor.residual(np.array(sensor.h(far, along)), np.array(sensor.h(x, pose)))
    told = "moving target and sensor alike changes the measurement"
    agree(gap, np.zeros_like(gap), 1e-9, told, scale=1.0 + np.abs(sensor.h(x, pose)))


@law("sensor", name="prior reproduces its measurement",
     unless=lambda s: "" if hasattr(s, "prior") else "it offers no prior")  # fmt: skip
def prior_reproduces(sensor: Any, case: Case) -> None:
    """The state that a measurement suggests is seen as that measurement."""
    x, pose = case.state(), case.pose()
    z = np.array(sensor.h(x, pose))
    rest = Gaussian(case.state(), np.eye(len(x)))
    guess = sensor.prior(z.copy(), pose, rest)
    symmetric(guess.cov, "the covariance of the prior is not symmetric")
    not_negative(guess.cov, "the covariance of the prior is not positive semi-definite")
    gap = sensor.residual(np.array(sensor.h(guess.mean, pose)), z)
    agree(gap, np.zeros_like(gap), 1e-6, "h(prior(z)) is not z", scale=1.0 + np.abs(z))


@law("sensor", name="interpretations agree", unless=untraceable)
def interpretations_agree(sensor: Any, case: Case) -> None:
    """Traced on graph nodes, h, its Jacobian, R and the residual are worth what they are on arrays."""
    x, pose = case.state(), case.pose()
    graph = Graph()
    values: dict[str, float] = {}

    def nodes(name: str, vector: Any) -> Any:
        out = np.empty(len(vector), dtype=object)
        for i, value in enumerate(vector):
            values[f"{name}{i}"] = float(value)
            out[i] = graph.input(f"{name}{i}")
        return out

    state, where = nodes("x", x), None if pose is None else nodes("p", pose)
    z = np.array(sensor.h(case.state(), pose))
    h = np.array(sensor.h(x, pose))
    for name, traced, plain in (
        ("h", sensor.h(state, where), h),
        ("jacobian", sensor.jacobian(state, where), sensor.jacobian(x, pose)),
        ("R", sensor.R(state, where), sensor.R(x, pose)),
        (
            "residual",
            sensor.residual(nodes("z", z), nodes("h", h)),
            sensor.residual(z.copy(), h.copy()),
        ),
    ):
        worth = np.array(evaluate(list(np.ravel(traced)), values), dtype=np.float64)
        agree(worth, np.ravel(plain), 1e-9, f"{name} on graph nodes differs from {name} on arrays")


@law("sensor", name="shape error", examples=2)
def shape_error(sensor: Any, case: Case) -> None:
    """A state with a wrong number of components is refused with a ShapeError."""
    refuses(sensor, "h", case.state((2,)), case.pose())
