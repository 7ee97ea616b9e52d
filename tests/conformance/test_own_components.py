"""Every component of the registry obeys the laws of its kind, except where its record says why not."""

from __future__ import annotations

from typing import Any

import attrs
import pytest

from tracker.errors import CapabilityError
from tracker.registry import Component, default_registry
from tracker.testing import KINDS, Check, check_record, from_record, laws, parametrize_checks
from tracker.testing.kit import ENOUGH

RECORDS = [record for record in default_registry() if record.kind in KINDS]


def checks() -> list[Any]:
    rows = []
    for record in RECORDS:
        component, excuses = from_record(record), dict(record.deviations)
        marks = parametrize_checks([component], excuses, kind=record.kind).args[1]
        rows += [
            pytest.param(*row.values, id=f"{record.kind} {record.name}: {row.values[1].law}",
                         marks=row.marks)
            for row in marks
        ]  # fmt: skip
    return rows


@pytest.mark.parametrize(("component", "check"), checks())
def test_our_own_components_obey_the_laws(component: Any, check: Check) -> None:
    check(component)


def test_every_kind_that_has_laws_has_a_component() -> None:
    assert {record.kind for record in RECORDS} == set(KINDS)


def test_a_record_is_checked_with_the_deviations_that_it_declares() -> None:
    record = default_registry().get("gate", "chi_square")
    told = attrs.evolve(record, deviations={"NaN never passes": "an untrue excuse"})
    assert check_record(record).ok
    assert check_record(told).failed == ("NaN never passes",)
    assert ENOUGH not in check_record(record).ran


def test_what_cannot_be_made_or_has_no_laws_says_so() -> None:
    stacked = attrs.evolve(default_registry().get("sensor", "stack"), examples=())
    with pytest.raises(CapabilityError, match="no example"):
        check_record(stacked)
    with pytest.raises(CapabilityError, match="no laws yet"):
        check_record(Component("function", "half", "fractions:Fraction", "a fake", "0"))


def test_laws_of_derivatives_are_not_skipped_for_our_own_models() -> None:
    for record in RECORDS:
        if record.kind in {"motion", "sensor"}:
            skipped = {law.name for law in laws(record.kind) if law.why_not(from_record(record))}
            assert not skipped & {"jacobian", "hessian", "interpretations agree"}, record
