"""What a callable takes by keyword: names, defaults and units, read from its signature.

Checking the values belongs to the callable, and naming components belongs in ``tracker.registry``.
"""

from __future__ import annotations

import ast
import inspect
import sys
import typing
from collections.abc import Callable
from typing import Any

import attrs


@attrs.frozen(kw_only=True)
class Parameter:
    """One parameter of a component, as its signature declares it; a required one has no default."""

    name: str
    required: bool
    default: str
    unit: str
    annotation: str


def declared_parameters(target: Callable[..., object]) -> list[inspect.Parameter] | None:
    """Return the parameters that keywords can reach; None where Python cannot tell (built-ins)."""
    try:
        parameters = inspect.signature(target).parameters.values()
    except (TypeError, ValueError):
        return None
    out_of_reach = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.VAR_POSITIONAL)
    return [p for p in parameters if p.kind not in out_of_reach]


def parameters_of(target: Callable[..., object]) -> tuple[Parameter, ...]:
    """Describe the parameters of a function or a class that a caller can give by keyword.

    Units: the first string in the annotation, as in ``typing.Annotated[float, "rad"]``; "" if none.

    Example:
    >>> def bearing(sigma: typing.Annotated[float, "rad"] = 0.01): ...
    >>> parameters_of(bearing)[0].unit, parameters_of(bearing)[0].default
    ('rad', '0.01')
    """
    fields = _fields(target)
    namespace = getattr(inspect.unwrap(target), "__globals__", {})
    described = []
    for p in declared_parameters(target) or ():
        if p.kind is p.VAR_KEYWORD:
            continue
        # The generated __init__ of an attrs class shows a converter's types, the field our own.
        annotation, module, default = fields.get(p.name, (p.annotation, namespace, p.default))
        described.append(
            Parameter(
                name=p.name,
                required=p.default is p.empty,
                default="" if p.default is p.empty else _default_text(default),
                unit=_unit(annotation, module),
                annotation="" if annotation is p.empty else _annotation_text(annotation),
            )
        )
    return tuple(described)


def _fields(target: object) -> dict[str, tuple[object, dict[str, Any], object]]:
    """Return annotation, namespace and default of each field of an attrs class, by its alias."""
    if not (isinstance(target, type) and attrs.has(target)):
        return {}
    annotations: dict[str, tuple[object, dict[str, Any]]] = {}
    for base in reversed(target.__mro__):
        module = vars(sys.modules.get(base.__module__, object))
        annotations |= {
            name: (text, dict(module)) for name, text in inspect.get_annotations(base).items()
        }
    return {
        field.alias or field.name: (*annotations.get(field.name, (field.type, {})), field.default)
        for field in attrs.fields(target)
    }


def _default_text(default: object) -> str:
    factory = getattr(default, "factory", None)
    if factory is not None:
        default = factory if getattr(default, "takes_self", False) else factory()
    if "__str__" in vars(type(default)) and not isinstance(default, (str, bytes)):
        return str(default)  # a value that has words of its own, such as a space
    return getattr(default, "__name__", None) or repr(default)


def _annotation_text(annotation: object) -> str:
    return annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)


def _unit(annotation: object, namespace: dict[str, Any]) -> str:
    def probe() -> None: ...

    probe.__annotations__ = {"it": annotation}
    try:
        resolved = typing.get_type_hints(probe, globalns=namespace, include_extras=True)["it"]
    except Exception:  # noqa: BLE001 - an annotation is arbitrary code of a stranger
        # Commonly a name imported for type checking only: the unit is still there to be read.
        return _unit_in_text(annotation) if isinstance(annotation, str) else ""
    return _unit_in_hint(resolved)


def _unit_in_hint(hint: object) -> str:
    if typing.get_origin(hint) is typing.Annotated:
        return next((extra for extra in typing.get_args(hint)[1:] if isinstance(extra, str)), "")
    return next(filter(None, map(_unit_in_hint, typing.get_args(hint))), "")


def _unit_in_text(annotation: str) -> str:
    try:
        tree = ast.parse(annotation, mode="eval")
    except SyntaxError:
        return ""
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Subscript)
            and isinstance(node.slice, ast.Tuple)
            and ast.unparse(node.value).endswith("Annotated")
        ):
            for extra in node.slice.elts[1:]:
                if isinstance(extra, ast.Constant) and isinstance(extra.value, str):
                    return extra.value
    return ""
