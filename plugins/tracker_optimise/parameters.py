"""What the parameters of optimisers must be, and the words when they are not."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from tracker.errors import DomainError, wording

Validator = Callable[[object, Any, Any], None]


def _refuse(attribute: Any, value: Any, expected: str, do: str) -> DomainError:
    what = f"parameter {attribute.name!r}"
    return DomainError(wording(what, got=repr(value), expected=expected, do=do))


def count(least: int, *, even: bool = False) -> Validator:
    """Refuse what is not a whole number of at least ``least``."""

    def check(_instance: object, attribute: Any, value: Any) -> None:
        whole = isinstance(value, int) and not isinstance(value, bool)
        if not whole or value < least or (even and value % 2):
            kind = "an even number" if even else "a whole number"
            raise _refuse(attribute, value, f"{kind}, at least {least}", "pass for example 50")

    return check


def number(low: float, high: float = math.inf, *, open_: bool = False) -> Validator:
    """Refuse what is not a finite number from ``low`` to ``high``; ``open_`` excludes ``low``."""

    def check(_instance: object, attribute: Any, value: Any) -> None:
        ok = isinstance(value, (int, float)) and math.isfinite(value) and low <= value <= high
        if not ok or (open_ and value == low):
            above = f"above {low:g}" if open_ else f"from {low:g}"
            upto = f" to {high:g}" if math.isfinite(high) else " on" if not open_ else ""
            raise _refuse(attribute, value, f"a finite number {above}{upto}", "choose one")

    return check


def optional(validator: Validator) -> Validator:
    """Let None pass."""

    def check(instance: object, attribute: Any, value: Any) -> None:
        if value is not None:
            validator(instance, attribute, value)

    return check


def one_of(names: tuple[str, ...] | Mapping[str, Any]) -> Validator:
    """Refuse a text that is none of these."""

    def check(_instance: object, attribute: Any, value: Any) -> None:
        if value not in tuple(names):
            raise _refuse(attribute, value, f"one of {', '.join(names)}", "choose one of them")

    return check


def span(low: float, high: float) -> Validator:
    """Refuse what is not two numbers within ``low`` and ``high``."""

    def check(instance: object, attribute: Any, value: Any) -> None:
        inner = number(low, high)
        if not (isinstance(value, tuple) and len(value) == 2):
            raise _refuse(attribute, value, "two numbers", f"pass for example ({low:g}, {high:g})")
        for one in value:
            inner(instance, attribute, one)

    return check
