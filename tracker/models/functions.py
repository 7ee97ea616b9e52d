"""The elementary functions a model author calls; each runs on floats, NumPy arrays and graph nodes.

Nothing but elementary functions belongs here. A component function that uses only these and the
operators ``+ - * / **`` can be traced: its Jacobian, its Hessian and its compiled form follow.
Both sides of `where` are always evaluated and differentiated, so guard before dividing:
``where(small, 1.0, w)`` first, then divide.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from tracker.models.graph import Node, alone

Scalar = Any
"""A float, an array of lanes, a graph node, or an array of components that are nodes."""

TAU = 2.0 * math.pi
_ABOVE_MINUS_PI = math.nextafter(-math.pi, 0.0)


def _define(op: str, scalar: Callable[..., Any], array: Callable[..., Any]) -> Callable[..., Any]:
    def function(*args: Scalar) -> Scalar:
        lanes = False
        for a in args:
            if isinstance(a, np.ndarray):
                if a.dtype.hasobject:  # components: one at a time
                    entries = (alone(b) if isinstance(b, Node) else b for b in args)
                    return np.frompyfunc(function, len(args), 1)(*entries)
                lanes = True
        if lanes:
            return array(*args)
        for a in args:
            if isinstance(a, Node):
                return a.graph.make(op, *args)
        return scalar(*args)

    return function


def _guarded(function: Callable[..., float], at_pole: float = math.nan) -> Callable[..., float]:
    """``math`` raises where NumPy answers NaN or inf; one diverged run must not stop the others."""

    def guarded(*args: float) -> float:
        try:
            return function(*args)
        except ValueError:
            return at_pole if args == (0.0,) else math.nan
        except OverflowError:
            return math.inf

    return guarded


def _minimum(a: float, b: float) -> float:
    return a if a < b or a != a else b  # noqa: PLR0124 - a != a is the test for NaN


def _maximum(a: float, b: float) -> float:
    return a if a > b or a != a else b  # noqa: PLR0124 - a != a is the test for NaN


def _floor(a: float) -> float:
    return float(math.floor(a)) if math.isfinite(a) else a


_sqrt = _define("sqrt", _guarded(math.sqrt), np.sqrt)
_sin = _define("sin", _guarded(math.sin), np.sin)
_cos = _define("cos", _guarded(math.cos), np.cos)
_exp = _define("exp", _guarded(math.exp), np.exp)
_log = _define("log", _guarded(math.log, -math.inf), np.log)
_atan2 = _define("atan2", math.atan2, np.arctan2)
_floor_of = _define("floor", _floor, np.floor)
_absolute = _define("abs", abs, np.abs)
_minimum_of = _define("min", _minimum, np.minimum)
_maximum_of = _define("max", _maximum, np.maximum)
_less = _define("less", lambda a, b: a < b, np.less)
_isnan = _define("isnan", lambda a: a != a, np.isnan)  # noqa: PLR0124 - the test for NaN
_where = _define("where", lambda c, a, b: a if c else b, np.where)


def sqrt(a: Scalar) -> Scalar:
    """Square root; NaN below zero."""
    return _sqrt(a)


def sin(a: Scalar) -> Scalar:
    """Sine of an angle in radians."""
    return _sin(a)


def cos(a: Scalar) -> Scalar:
    """Cosine of an angle in radians."""
    return _cos(a)


def tan(a: Scalar) -> Scalar:
    """Tangent of an angle in radians."""
    return _sin(a) / _cos(a)


def exp(a: Scalar) -> Scalar:
    """Exponential."""
    return _exp(a)


def log(a: Scalar) -> Scalar:
    """Natural logarithm; -inf at zero, NaN below."""
    return _log(a)


def atan2(y: Scalar, x: Scalar) -> Scalar:
    """Angle of the point (x, y) from the x axis, in (-pi, pi]."""
    return _atan2(y, x)


def atan(a: Scalar) -> Scalar:
    """Angle in (-pi/2, pi/2) whose tangent is ``a``."""
    return _atan2(a, 1.0)


def asin(a: Scalar) -> Scalar:
    """Angle in [-pi/2, pi/2] whose sine is ``a``; NaN outside [-1, 1]."""
    return _atan2(a, _sqrt((1.0 - a) * (1.0 + a)))


def acos(a: Scalar) -> Scalar:
    """Angle in [0, pi] whose cosine is ``a``; NaN outside [-1, 1]."""
    return _atan2(_sqrt((1.0 - a) * (1.0 + a)), a)


def hypot(a: Scalar, b: Scalar) -> Scalar:
    """Length of the vector (a, b)."""
    return _sqrt(a * a + b * b)


def floor(a: Scalar) -> Scalar:
    """Largest integer that is not above ``a``, as a float."""
    return _floor_of(a)


def absolute(a: Scalar) -> Scalar:
    """Absolute value."""
    return _absolute(a)


def minimum(a: Scalar, b: Scalar) -> Scalar:
    """The smaller of two; NaN if the first is NaN."""
    return _minimum_of(a, b)


def maximum(a: Scalar, b: Scalar) -> Scalar:
    """The larger of two; NaN if the first is NaN."""
    return _maximum_of(a, b)


def less(a: Scalar, b: Scalar) -> Scalar:
    """Whether a < b, to be given to `where`."""
    return _less(a, b)


def isnan(a: Scalar) -> Scalar:
    """Whether ``a`` is NaN, to be given to `where`."""
    return _isnan(a)


def where(condition: Scalar, a: Scalar, b: Scalar) -> Scalar:
    """``a`` where the condition holds, ``b`` elsewhere; both are evaluated."""
    return _where(condition, a, b)


def wrap(angle: Scalar) -> Scalar:
    """The same direction as ``angle``, in (-pi, pi].

    The result of rounding at the cut never leaves the interval: -pi becomes pi.

    Example:
    >>> wrap(-math.pi) == math.pi, wrap(math.pi) == math.pi, round(wrap(7.0), 6)
    (True, True, 0.716815)
    """
    turned = angle + TAU * _floor_of(0.5 - angle / TAU)
    return _maximum_of(_minimum_of(turned, math.pi), _ABOVE_MINUS_PI)
