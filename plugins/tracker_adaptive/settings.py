"""Checks of the numbers that adapters are given, and of how those of their fuzzy systems are called."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import attrs
import numpy as np

from tracker.errors import DomainError, wording
from tracker.models.graph import Node
from tracker.models.parameters import checked_parameters, one_of
from tracker_adaptive.fuzzy_system import FuzzySystem, five_rules


def between(low: float, high: float, owner: str, *, closed: bool = False) -> Any:
    """A validator: a number, or one per lane, above ``low`` and below ``high`` (or there, if closed)."""

    def check(_instance: Any, attribute: Any, value: Any) -> None:
        if isinstance(value, Node):
            return
        good = False
        try:
            array = np.asarray(value, dtype=np.float64)
            good = bool(
                np.isfinite(array).all()
                and (
                    (array >= low) & (array <= high) if closed else (array > low) & (array < high)
                ).all()
            )
        except (TypeError, ValueError):
            pass
        if not good:
            where = (
                f"from {low:g} to {high:g}"
                if closed
                else f"above {low:g}" + (f" and below {high:g}" if np.isfinite(high) else "")
            )
            raise DomainError(
                wording(
                    f"parameter {attribute.name!r} of {owner}",
                    got=repr(value),
                    expected=f"a finite number {where}",
                    do="leave it out for the usual one",
                )
            )

    return check


def systems(value: Any) -> tuple[FuzzySystem, ...]:
    """One system for all entries, or one for each; the five rules by hand for None.

    Raises:
        DomainError: if there is none, or one has not exactly one input.
    """
    given = five_rules() if value is None else value
    found = (given,) if isinstance(given, FuzzySystem) else tuple(given)
    if not found or any(not isinstance(f, FuzzySystem) or len(f.inputs) != 1 for f in found):
        raise DomainError(
            wording(
                "fuzzy systems of a noise adapter",
                got=f"{[type(f).__name__ for f in found]}",
                expected="one system of one input (the degree of mismatch), or one for each entry",
                do="pass tracker_adaptive.five_rules(...), or read one from a file",
            )
        )
    return found


def unit_name(value: str) -> str:
    """In what a step is measured: the "given" variance, or the "present" one."""
    return one_of("unit", value, ("given", "present"))


def chosen(found: Sequence[FuzzySystem], entries: int, what: str) -> list[FuzzySystem]:
    """The system of each entry.

    Raises:
        DomainError: if there are several, and not as many as entries.
    """
    if len(found) == 1:
        return [found[0]] * entries
    if len(found) != entries:
        raise DomainError(
            wording(
                "fuzzy systems of a noise adapter",
                got=f"{len(found)}",
                expected=f"one, or {entries}: {what}",
                do="pass one for all, or one for each",
            )
        )
    return list(found)


def fuzzy_numbers(found: Sequence[FuzzySystem]) -> dict[str, Any]:
    """What the answers of systems depend on, by name; those of several begin with "entry2_" and so on.

    The widths of output sets, which a centre average never reads, are left out.
    """
    out: dict[str, Any] = {}
    for place, system in enumerate(found):
        prefix = f"entry{place + 1}_" if len(found) > 1 else ""
        unread = {f"{system.output.name}_{term}_width" for term in system.output.terms}
        out |= {prefix + k: v for k, v in system.parameters.items() if k not in unread}
    return out


def with_fuzzy_numbers(
    found: Sequence[FuzzySystem], values: Mapping[str, Any]
) -> tuple[FuzzySystem, ...]:
    """The systems with some of those numbers replaced."""
    out = []
    for place, system in enumerate(found):
        prefix = f"entry{place + 1}_" if len(found) > 1 else ""
        mine = {k: values[prefix + k] for k in system.parameters if prefix + k in values}
        out.append(system.with_parameters(**mine) if mine else system)
    return tuple(out)


def replaced(adapter: Any, own: Sequence[str], parameters: Mapping[str, Any], field: str) -> Any:
    """An adapter with some of its own numbers and of those of its fuzzy systems replaced.

    Raises:
        DomainError: for a name that is neither, or a number that is not finite.
    """
    known = adapter.parameters
    unknown = [name for name in parameters if name not in known]
    if unknown:
        raise DomainError(
            wording(
                f"parameters of {type(adapter).__name__}",
                got=", ".join(unknown),
                expected=f"names among {', '.join(known)}",
                do="correct the name",
            )
        )
    checked = checked_parameters(parameters)
    mine = {name: checked[name] for name in own if name in checked}
    made = with_fuzzy_numbers(getattr(adapter, field), checked)
    return attrs.evolve(adapter, **{field: made}, **mine)
