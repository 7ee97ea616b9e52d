"""Random component functions: derivatives against 50-digit differences and SymPy, forms against forms.

A function is a tree of operations; it is written out over `tracker.models`, over 50-digit numbers
and over SymPy's symbols.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mpmath
import numpy as np
import pytest
import sympy
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from tracker import PLANAR, Gaussian, Space, estimator, models
from tracker.errors import CapabilityError, TraceError
from tracker.models.component import ComponentFunction, Trace
from tracker.models.graph import Node, evaluate, inputs_of, needed
from tracker.types import Columns
from tracker_motion import constant_velocity

STATE = ("x", "y", "vx", "unused")
INPUTS = ("x", "y", "vx", "q")
LEAVES = (*INPUTS, 0.0, 1.0, -1.0, 0.5, 2.0, -3.0)
DEPTH = 8
DIGITS = 50

SMOOTH_UNARY = (
    *("neg", "square", "cube", "root", "reciprocal", "sqrt", "sin", "cos", "tan", "exp"),
    *("log", "atan", "asin", "acos"),
)
SMOOTH_BINARY = ("add", "sub", "mul", "div", "atan2", "hypot")
ROUGH_UNARY = ("absolute", "floor", "wrap")
ROUGH_BINARY = ("minimum", "maximum", "where")


def trees(unary: Sequence[str], binary: Sequence[str], depth: int) -> st.SearchStrategy[Any]:
    """Expressions of at most that depth, seldom with more than a few dozen operations."""
    leaf = st.sampled_from(LEAVES)
    levels: list[st.SearchStrategy[Any]] = [leaf]
    for _ in range(depth):
        pair = st.tuples(st.sampled_from(binary), levels[-1], leaf | levels[-1])
        levels.append(st.one_of(st.tuples(st.sampled_from(unary), levels[-1]), pair, pair))
    return st.one_of(levels)


smooth = trees(SMOOTH_UNARY, SMOOTH_BINARY, DEPTH)
any_tree = trees(SMOOTH_UNARY + ROUGH_UNARY, SMOOTH_BINARY + ROUGH_BINARY, DEPTH)
points = st.tuples(*[st.floats(-3.0, 3.0).map(lambda v: round(v, 3) + 1e-4)] * len(INPUTS))


def build(tree: Any, given: Mapping[str, Any], f: Mapping[str, Callable[..., Any]]) -> Any:
    """The tree over some arithmetic; every function is kept inside its domain, away from poles."""
    if not isinstance(tree, tuple):
        return given[tree] if isinstance(tree, str) else tree
    op, *parts = tree
    a = build(parts[0], given, f)
    b = build(parts[1], given, f) if len(parts) > 1 else None
    match op:
        case "add":
            return a + b
        case "sub":
            return a - b
        case "mul":
            return a * b
        case "neg":
            return -a
        case "square":
            return a**2
        case "cube":
            return a**3
        case "root":
            return (1.0 + a * a) ** 0.5
        case "reciprocal":
            return (1.5 + f["sin"](a)) ** -1
        case "div":
            return a / (1.0 + b * b)
        case "sqrt" | "log":
            return f[op](1.0 + a * a)
        case "exp" | "tan":
            return f[op](f["sin"](a))
        case "asin" | "acos":
            return f[op](0.9 * f["cos"](a))
        case "atan2":
            return f[op](a, 1.0 + b * b)
        case "hypot":
            return f[op](a, 1.0 + b)
        case "where":
            return f["where"](a < b, a * b, a - 2.0 * b)
    return f[op](a) if b is None else f[op](a, b)


def author(tree: Any) -> Callable[..., Any]:
    """The component function that a person would write down for the tree."""

    def measure(x: Any, y: Any, vx: Any, *, q: Any) -> Any:
        out = build(tree, {"x": x, "y": y, "vx": vx, "q": q}, vars(models))
        return (out, out * x)

    return measure


def exact_where(condition: Any, a: Any, b: Any) -> Any:
    return a if condition else b


EXACT: dict[str, Callable[..., Any]] = {
    **{n: getattr(mpmath, n) for n in ("sqrt", "sin", "cos", "tan", "exp", "log", "atan")},
    **{n: getattr(mpmath, n) for n in ("asin", "acos", "atan2", "hypot", "floor")},
    "absolute": abs,
    "abs": abs,
    "minimum": min,
    "maximum": max,
    "min": min,
    "max": max,
    "where": exact_where,
    "wrap": lambda a: a + models.functions.TAU * mpmath.floor(0.5 - a / models.functions.TAU),
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "neg": lambda a: -a,
    "recip": lambda a: 1 / a,
    "less": lambda a, b: a < b,
    "isnan": lambda _: False,
}


def exactly(roots: Sequence[Any], values: Mapping[str, Any]) -> list[Any]:
    """What graph nodes are worth in 50 digits: formulas are judged, not rounding."""
    worth: dict[int, Any] = {}
    for node in needed(roots):
        if node.op == "const":
            worth[node.index] = mpmath.mpf(node.value)
        elif node.op == "input":
            worth[node.index] = values[node.value]
        else:
            worth[node.index] = EXACT[node.op](*(worth[a.index] for a in node.args))
    return [worth[r.index] if isinstance(r, Node) else mpmath.mpf(r) for r in roots]


STEP = mpmath.mpf(10) ** -16


def slope_at(
    function: Callable[[dict[str, Any]], Any], at: Mapping[str, Any], name: str, tolerance: float
) -> Any:
    """The central difference; an example on a kink, where both sides differ, is left out."""
    here = function(dict(at))
    up = (function({**at, name: at[name] + STEP}) - here) / STEP
    down = (here - function({**at, name: at[name] - STEP})) / STEP
    assume(close(up, down, tolerance))
    return (up + down) / 2


def close(ours: Any, theirs: Any, tolerance: Any) -> bool:
    return abs(ours - theirs) <= tolerance * (1 + abs(theirs))


# --------------------------------------------------------------------------------- derivatives
@given(any_tree, points)
def test_derivatives_are_those_of_differences_in_fifty_digits(
    tree: Any, point: tuple[float, ...]
) -> None:
    trace = Trace(author(tree))
    with mpmath.workdps(DIGITS):
        at = {name: mpmath.mpf(v) for name, v in zip(INPUTS, point, strict=True)}

        def value(inputs: dict[str, Any]) -> Any:
            return mpmath.mpf(build(tree, inputs, EXACT))

        for j, name in enumerate(INPUTS[:3]):
            slope = slope_at(value, at, name, 1e-9)
            (ours,) = exactly([trace.first[0][j]], at)
            assert close(ours, slope, 1e-12), f"d/d{name} is {ours}, by differences {slope}"
            for i, other in enumerate(INPUTS[:3]):

                def first(inputs: dict[str, Any], j: int = j) -> Any:
                    return exactly([trace.first[0][j]], inputs)[0]

                curve = slope_at(first, at, other, 1e-9)
                (ours,) = exactly([trace.second[0][i][j]], at)
                assert close(ours, curve, 1e-12), f"d2/d{name}d{other} is {ours}, not {curve}"


SYMBOLS = {name: sympy.Symbol(name, real=True) for name in INPUTS}
SYMBOLIC: dict[str, Callable[..., Any]] = {
    **{n: getattr(sympy, n) for n in ("sqrt", "sin", "cos", "tan", "exp", "log", "atan")},
    **{n: getattr(sympy, n) for n in ("asin", "acos", "atan2")},
    "hypot": lambda a, b: sympy.sqrt(a * a + b * b),
    "absolute": lambda a: sympy.Piecewise((-a, a < 0), (a, True)),
    "minimum": lambda a, b: sympy.Piecewise((b, b < a), (a, True)),
    "maximum": lambda a, b: sympy.Piecewise((b, a < b), (a, True)),
    "where": lambda condition, a, b: sympy.Piecewise((a, condition), (b, True)),
}


OFF_KINKS = {"DiracDelta": lambda *_: 0}
"""SymPy knows what happens on a kink; no example lies on one."""


@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(trees((*SMOOTH_UNARY, "absolute"), (*SMOOTH_BINARY, "minimum", "maximum"), 3), points)
def test_derivatives_are_those_of_sympy(tree: Any, point: tuple[float, ...]) -> None:
    trace = Trace(author(tree))
    whole = sympy.sympify(build(tree, SYMBOLS, SYMBOLIC))
    with mpmath.workdps(DIGITS):
        at = {name: mpmath.mpf(v) for name, v in zip(INPUTS, point, strict=True)}
        for j, name in enumerate(INPUTS[:3]):
            slope = sympy.diff(whole, SYMBOLS[name])
            for i, other in enumerate(INPUTS[:3]):
                pairs = [(slope, trace.first[0][j])] if i == 0 else []
                pairs.append((sympy.diff(slope, SYMBOLS[other]), trace.second[0][i][j]))
                for expression, node in pairs:
                    number = sympy.lambdify(
                        list(SYMBOLS.values()), expression, [OFF_KINKS, "mpmath"]
                    )
                    theirs = number(*at.values())
                    (ours,) = exactly([node], at)
                    assert close(ours, theirs, 1e-12), f"{ours}, by SymPy {theirs}: {expression}"


# -------------------------------------------------------------------------------------- forms
@given(any_tree, st.lists(points, min_size=2, max_size=5))
def test_floats_arrays_and_nodes_give_the_same(tree: Any, rows: list[tuple[float, ...]]) -> None:
    function = ComponentFunction(author(tree), STATE, "a test")
    values = np.array(rows).T
    x, q = np.vstack([values[:3], np.full(len(rows), 7.0)]), values[3]
    trace = function.trace
    every = [*trace.roots, *(e for row in trace.first for e in row)]
    worth = evaluate(needed(every), dict(zip(INPUTS, values, strict=True)))
    assume(all(np.abs(np.asarray(w, dtype=float)).max() < 1e4 for w in worth))
    for call in (function.evaluate, function.first, function.second):
        lanes = call(x, {"q": q})
        for k in range(len(rows)):
            alone = call(x[:, k].copy(), {"q": float(q[k])})
            own = np.broadcast_to(lanes, (*lanes.shape[:-1], len(rows)))[..., k]
            # The last bits of elementary functions differ between NumPy and the math library.
            near = np.isclose(alone, own, rtol=1e-7, atol=1e-7)
            assert near.mean() == 1.0 or on_an_edge(tree, rows[k]), (
                f"{alone} alone, {own} in a lane"
            )
    h, H = function.linearise(x, {"q": q})
    assert isinstance(H, Columns)
    assert np.all(h == function.evaluate(x, {"q": q}))
    assert np.allclose(H.dense(), function.first(x, {"q": q}), rtol=1e-12, atol=1e-12)
    assert not H.dense()[:, 3].any(), "a component that is not an argument has no slope"


def on_an_edge(tree: Any, point: tuple[float, ...]) -> bool:
    """Whether a jump of floor, wrap or where is so near that the last bit decides."""
    with mpmath.workdps(DIGITS):
        at = {name: mpmath.mpf(v) for name, v in zip(INPUTS, point, strict=True)}
        around = [
            mpmath.mpf(build(tree, {**at, name: at[name] + sign * mpmath.mpf(10) ** -12}, EXACT))
            for name in INPUTS
            for sign in (-1, 0, 1)
        ]
        return max(around) - min(around) > 1e-7


@given(smooth, points)
def test_nan_in_gives_nan_out_where_the_output_depends_on_the_input(
    tree: Any, point: tuple[float, ...]
) -> None:
    function = ComponentFunction(author(tree), STATE, "a test")
    depends = [inputs_of([root]) for root in function.trace.roots]
    for i, name in enumerate(INPUTS):
        values = list(point)
        values[i] = math.nan
        x, q = np.array([*values[:3], 7.0]), values[3]
        lanes = np.stack([x, np.array([*point[:3], 7.0])], axis=1)
        alone = function.evaluate(x, {"q": q})
        together = function.evaluate(lanes, {"q": np.array([q, point[3]])})
        for k, inputs in enumerate(depends):
            assert math.isnan(alone[k]) == (name in inputs)
            assert np.isnan(together[k, 0]) == (name in inputs)
            assert not np.isnan(together[k, 1]), "a NaN must stay in its lane"


@given(any_tree)
def test_equal_expressions_are_one_node_and_tracing_twice_is_tracing_once(tree: Any) -> None:
    first, second = Trace(author(tree)), Trace(author(tree))
    assert [repr(n) for n in needed(first.roots)] == [repr(n) for n in needed(second.roots)]
    hessian = first.second[0]
    for i in range(3):
        for j in range(i):
            assert hessian[i][j] is hessian[j][i] or hessian[i][j] == hessian[j][i] == 0.0


# ------------------------------------------------------------------------- what is not traced
def branches(x: Any, y: Any) -> Any:
    if x > y:
        return (x + y,)
    return (x - y,)


def chooses(x: Any, y: Any) -> Any:
    return (max(x, y),)


def uses_math(x: Any, y: Any) -> Any:
    return (math.sin(x) + y,)


def uses_numpy(x: Any, y: Any) -> Any:
    return (np.sin(x) + y,)


def uses_numpy_arrays(x: Any, y: Any) -> Any:
    return (np.sqrt(np.array([x, y]))[0],)


def compares(x: Any, y: Any) -> Any:
    return (0.0 if x == y else 1.0,)


def differs(x: Any, y: Any) -> Any:
    return (0.0 if x != y else 1.0,)


def orders(x: Any, y: Any) -> Any:
    return (models.where(x <= y, x, y),)


def odd_power(x: Any, y: Any) -> Any:
    return (x**1.3 + y,)


def power_of_symbol(x: Any, y: Any) -> Any:
    return (x**y,)


def base_to_symbol(x: Any, y: Any) -> Any:
    return (2.0**x + y,)


def remainder(x: Any, y: Any) -> Any:
    return (x % 2.0 + y,)


def bare(x: Any, y: Any) -> Any:
    return x + y


def ragged(x: Any, y: Any) -> Any:
    return ((x, y), (x,))


def empty(_x: Any) -> Any:
    return ()


def many(*args: Any) -> Any:
    return (args[0],)


def named(x: Any, **rest: Any) -> Any:
    return (x + rest["q"],)


@pytest.mark.parametrize(
    ("function", "said"),
    [
        (branches, "where"),
        (chooses, "minimum or maximum"),
        (uses_math, "tracker.models"),
        (uses_numpy, "tracker.models"),
        (uses_numpy_arrays, "tracker.models"),
        (compares, "absolute"),
        (differs, "absolute"),
        (orders, "less"),
        (odd_power, "exp"),
        (power_of_symbol, "exp"),
        (base_to_symbol, "exp"),
        (remainder, "wrap"),
        (bare, "(value,)"),
        (ragged, "equal length"),
        (empty, "one entry per component"),
        (many, "name every state component"),
        (named, "name every state component"),
    ],
)
def test_what_cannot_be_traced_names_the_function_and_the_way_out(
    function: Callable[..., Any], said: str
) -> None:
    with pytest.raises(TraceError) as caught:
        Trace(function)
    assert function.__name__ in str(caught.value), "the message must name the function"
    assert said in str(caught.value), f"the message must say what to do: {caught.value}"


def test_a_function_that_cannot_be_traced_still_measures() -> None:
    def noise() -> Any:
        return ((0.01,),)

    def slopes(x: Any, y: Any) -> Any:
        return ((np.cos(x), np.ones_like(y)),)

    kept = {"name": "opaque", "noise": noise, "space": Space.of("z"), "state": PLANAR}
    sensor = models.ComponentSensor(measure=uses_numpy, **kept)
    assert "tracker.models" in sensor.why_opaque
    x = np.array([[0.5, 1.0], [2.0, 3.0], [0.0, 0.0], [0.0, 0.0]])
    assert np.allclose(sensor.h(x), np.sin(x[:1]) + x[1:2])
    assert np.allclose(sensor.h(x[:, 0]), np.sin(0.5) + 2.0)
    with pytest.raises(CapabilityError, match="cannot be traced"):
        sensor.jacobian(x)
    with pytest.raises(CapabilityError, match="uses_numpy"):
        estimator("ekf1", motion=constant_velocity(0.1), sensor=sensor)
    by_hand = models.ComponentSensor(measure=uses_numpy, derivative=slopes, **kept)
    assert np.allclose(by_hand.jacobian(x)[0, :2], [np.cos(x[0]), [1.0, 1.0]])
    built = estimator("ekf1", motion=constant_velocity(0.1), sensor=by_hand)
    state, innovation = built.step(Gaussian(x[:, 0], np.eye(4)), [2.5], 0.1)
    assert np.isfinite(state.mean).all()
    assert innovation.count == 1.0
