"""Checks and cuts of the numbers that models are given: parameters, states, lanes."""

from __future__ import annotations

import copy
import copyreg
import functools
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import attrs
import numpy as np

from tracker.errors import DomainError, ShapeError, wording
from tracker.models.graph import Node
from tracker.types import Array, ArrayLike, Space, as_array

_FLOAT = np.dtype(np.float64)


def _read_only(values: dict[str, Any]) -> Mapping[str, Any]:
    return MappingProxyType(values)


def _reduced(view: Mapping[str, Any]) -> Any:
    return _read_only, (dict(view),)


# Read-only views do not pickle by themselves, and models must.
copyreg.pickle(MappingProxyType, _reduced)


def checked_parameters(parameters: Mapping[str, Any]) -> MappingProxyType[str, Any]:
    """Parameters as floats, float64 arrays or graph nodes, refusing NaN and inf."""
    out: dict[str, Any] = {}
    for name, value in parameters.items():
        if isinstance(value, Node):
            out[name] = value
            continue
        array = as_array(value, name)
        if not np.isfinite(array).all():
            raise DomainError(
                wording(
                    f"parameter {name!r}",
                    got=f"{value!r}",
                    expected="finite numbers",
                    do="give a number, or an array with the batch shape",
                )
            )
        if array.ndim == 0:
            out[name] = float(array)
            continue
        if array.flags.writeable:  # what a caller does to an array later must not change a model
            array = array.copy()
            array.setflags(write=False)
        out[name] = array
    return MappingProxyType(out)


def positive(name: str, value: ArrayLike, *, unit: str = "", zero: bool = False) -> Any:
    """``value`` if all of it is positive (or zero, when allowed).

    Raises:
        DomainError: naming the parameter, if not.
    """
    array = as_array(value, name)
    good = (array >= 0) if zero else (array > 0)
    if not (good & np.isfinite(array)).all():
        raise DomainError(
            wording(
                f"parameter {name!r}",
                got=f"{array}",
                expected=f"a {'non-negative' if zero else 'positive'} number"
                + (f" [{unit}]" if unit else ""),
                do="check sign and unit",
            )
        )
    return float(array) if array.ndim == 0 else array


def one_of(name: str, value: object, choices: tuple[object, ...]) -> str:
    """``value`` if it is one of the choices.

    Raises:
        DomainError: naming the parameter and the choices, if not.
    """
    if value not in choices:
        raise DomainError(
            wording(
                f"parameter {name!r}",
                got=repr(value),
                expected=f"one of {', '.join(map(repr, choices))}",
                do="pick one of them",
            )
        )
    return str(value)


def shaped(x: ArrayLike, space: Space, name: str, owner: str) -> Any:
    """``x`` as an array whose leading axis has the size of ``space``; object arrays pass through."""
    array: Array = x if isinstance(x, np.ndarray) else as_array(x, name)
    if array.dtype is _FLOAT and array.ndim and len(array) == len(space.axes):
        return array
    if array.ndim == 0 or array.shape[0] != space.size:
        raise ShapeError(
            wording(
                f"argument {name!r} of {owner!r}",
                got=f"shape {array.shape}",
                expected=f"({space.size}, *batch): {space}",
                do="put the components on the leading axis",
            )
        )
    return array if array.dtype.hasobject else as_array(array, name)


def lanes_of(parameters: Mapping[str, Any], index: Any) -> Mapping[str, Any]:
    """Parameters with those that differ per lane cut to ``index`` of their last axis."""
    if not any(isinstance(v, np.ndarray) for v in parameters.values()):
        return parameters
    return {
        k: v[..., index] if isinstance(v, np.ndarray) and v.shape[-1] > 1 else v
        for k, v in parameters.items()
    }


def lanes_of_component(component: Any, index: Any) -> Any:
    """A component with its per-lane numbers cut to some lanes; itself if it has none."""
    if hasattr(component, "lanes"):
        return component.lanes(index)
    values = numbers_of(component)
    cut = lanes_of(values, index)
    return component if cut is values else with_numbers(component, cut)


def numbers_of(component: Any) -> Mapping[str, Any]:
    """The numbers of a component that may differ per lane: those it offers, or fields marked so."""
    offered = getattr(component, "parameters", None)
    if offered is not None:
        return offered  # type: ignore[no-any-return]
    return {name: getattr(component, name) for name in _marked(component.__class__)}


def with_numbers(component: Any, values: Mapping[str, Any]) -> Any:
    """The component with other numbers, unchecked: they may be lanes or graph nodes."""
    if not values:
        return component
    if hasattr(component, "with_parameters"):
        return component.with_parameters(**values)
    made = copy.copy(component)
    for name, value in values.items():
        object.__setattr__(made, name, value)
    return made


@functools.cache
def _marked(kind: type) -> tuple[str, ...]:
    if not attrs.has(kind):
        return ()
    return tuple(f.name for f in attrs.fields(kind) if f.metadata.get("form") == "parameter")


def filled(value: Any, lead: int, batch: tuple[int, ...]) -> Any:
    """``value``, of ``lead`` component axes, with shared batch axes repeated (as a view)."""
    if value.shape[lead:] == batch:
        return value
    return np.broadcast_to(
        value, value.shape[:lead] + np.broadcast_shapes(value.shape[lead:], batch)
    )


def shown(parameters: Mapping[str, Any]) -> str:
    """Parameters as a person reads them."""
    return ", ".join(f"{name}={value}" for name, value in parameters.items())
