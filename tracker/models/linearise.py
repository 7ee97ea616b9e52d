"""Value and derivatives of any model in one call, whether or not the model offers that itself."""

from __future__ import annotations

from typing import Any


def linearise(model: Any, x: Any, *arguments: Any) -> tuple[Any, Any]:
    """``(f(x), F)`` of a motion (arguments dt, u, t) or ``(h(x), H)`` of a sensor (argument pose).

    The Jacobian is an array ``(rows, n, *batch)`` or, in arrays of lanes, `tracker.types.Columns`.
    """
    joint = getattr(model, "linearise", None)
    if joint is not None:
        return joint(x, *arguments)  # type: ignore[no-any-return]
    value = getattr(model, "f", None) or model.h
    return value(x, *arguments), model.jacobian(x, *arguments)


def expand(model: Any, x: Any, *arguments: Any) -> tuple[Any, Any, Any]:
    """Value and Jacobian as in `linearise`, and the Hessians: the expansion to second order.

    The Hessians are an array ``(rows, n, n, *batch)`` or `tracker.types.Block`.
    """
    joint = getattr(model, "expand", None)
    if joint is not None:
        return joint(x, *arguments)  # type: ignore[no-any-return]
    return *linearise(model, x, *arguments), model.hessian(x, *arguments)
