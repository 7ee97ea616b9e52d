"""Fuzzy systems as TOML that a person can read and write; what they compute lives elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tracker.errors import CapabilityError, DomainError, wording
from tracker.io.toml import Table, parse, path_text, read
from tracker_adaptive.fuzzy_rules import Antecedent, Rule, antecedent, claims
from tracker_adaptive.fuzzy_sets import SETS, FuzzySet, SampledSet, numbers_of_set
from tracker_adaptive.fuzzy_system import FuzzySystem, Variable

_MOST_RULES = 500


def read_rule_base(file: str | Path) -> FuzzySystem:
    """A fuzzy system from a file::

        name = "R from the degree of mismatch"
        otherwise = 0.0                            # where no rule applies

        [input.dom.terms]
        zero = { gaussian = [0.0, 1.0] }           # centre, width
        large = { trapezoidal = [0.5, 2.0, 9.0, 9.0] }

        [output.adjustment]
        range = [-1.0, 1.0]

        [output.adjustment.terms]
        keep = { triangular = [-0.1, 0.0, 0.1] }
        lower = { triangular = [-1.0, -0.5, 0.0] }

        [[rule]]
        if = "dom is zero"
        then = "adjustment is keep"

        [[rule]]
        if = "dom is large and not dom is zero"
        then = "adjustment is lower"
        weight = 0.5

    Raises:
        ConfigError: naming file, line and path, with a suggestion.
    """
    return _system(read(file))


def parse_rule_base(text: str, file: str = "rules") -> FuzzySystem:
    """A fuzzy system from the text of such a file.

    Raises:
        ConfigError: as `read_rule_base`.

    Example:
    >>> from tracker_adaptive.fuzzy_system import five_rules
    >>> parse_rule_base(rule_base_text(five_rules())).rules == five_rules().rules
    True
    """
    return _system(parse(text, file))


def _system(table: Table) -> FuzzySystem:
    table.only("name", "otherwise", "input", "output", "rule")
    inputs = _variables(table, "input")
    outputs = _variables(table, "output")
    if len(outputs) != 1:
        raise table.error(
            "output",
            got=f"{len(outputs)} of them",
            expected="one output",
            do="write a file for each output",
        )
    rules = [_rule(one, inputs, outputs[0]) for one in _rules(table)]
    otherwise = table.number("otherwise") if "otherwise" in table.values else 0.0
    name = table.text("name", default="")
    try:
        return FuzzySystem(inputs, outputs[0], rules, otherwise, name)
    except DomainError as error:
        raise table.error(got=f"a system that is none ({error})", expected="sets, rules and names that fit",
                          do="correct it") from None  # fmt: skip


def _rules(table: Table) -> tuple[Table, ...]:
    return table.tables("rule", expected="rules: [[rule]]", most=_MOST_RULES)


def _variables(table: Table, key: str) -> tuple[Variable, ...]:
    named = table.table(key, expected=f"a table of each {key}: [{key}.name]")
    out = []
    for name in named.values:
        one = named.table(name, expected=f"an {key}: [{key}.{name}]")
        one.only("range", "unit", "terms")
        terms = one.table("terms", expected="the terms: zero = { gaussian = [0.0, 1.0] }")
        ends = one.numbers("range", 2, of="low, high") if "range" in one.values else None
        found = {term: _set(terms, term) for term in terms.values}
        try:
            out.append(Variable(name, found, ends, one.text("unit", default="")))
        except DomainError as error:
            raise named.error(name, got=f"what is none ({error})", expected=f"an {key} with terms",
                              do="correct it") from None  # fmt: skip
    return tuple(out)


def _set(terms: Table, term: str) -> FuzzySet:
    known = (*SETS, "sampled")
    one = terms.table(
        term, expected=f"a set of kind {', '.join(known)}: {{ gaussian = [0.0, 1.0] }}"
    )
    if len(one.values) != 1:
        raise terms.error(
            term,
            got=f"{len(one.values)} entries",
            expected=f"one, of kind {', '.join(known)}",
            do="write for example { gaussian = [0.0, 1.0] }",
        )
    kind = next(iter(one.values))
    if kind not in known:
        raise one.unknown(kind, name=kind, kind="kind of set", known=known)
    try:
        if kind == "sampled":
            both = one.table(kind, expected="{ at = [...], membership = [...] }")
            both.only("at", "membership")
            places = both.value("at", "a list of places")
            count = len(places) if isinstance(places, list) else 0
            of = "one for each place"
            return SampledSet(both.numbers("at", count), both.numbers("membership", count, of=of))
        names = list(SETS[kind].__annotations__)
        names = [name for name in names if name != "kind"]
        made: FuzzySet = SETS[kind](*one.numbers(kind, len(names), of=", ".join(names)))
    except DomainError as error:
        raise one.error(kind, got=f"no such set ({error})", expected="numbers that fit",
                        do="check their order and signs") from None  # fmt: skip
    return made


def _read(one: Table, key: str) -> Antecedent:
    try:
        return antecedent(one.text(key))
    except DomainError as error:
        raise one.error(key, got=f"what cannot be read ({error})", expected="x is term, and, or, not",
                        do="correct it") from None  # fmt: skip


def _rule(one: Table, inputs: tuple[Variable, ...], output: Variable) -> Rule:
    one.only("if", "then", "weight")
    condition, then = _read(one, "if"), _read(one, "then")
    conclusion = list(claims(then))
    known = {v.name: v for v in inputs}
    for claim in claims(condition):
        if claim.variable not in known:
            raise one.unknown("if", name=claim.variable, kind="input", known=list(known))
        terms = list(known[claim.variable].terms)
        if claim.term not in terms:
            raise one.unknown("if", name=claim.term, kind=f"term of {claim.variable}", known=terms)
    if len(conclusion) != 1 or conclusion[0].variable != output.name:
        name = conclusion[0].variable if conclusion else ""
        raise one.unknown("then", name=name, kind="output", known=[output.name])
    if conclusion[0].term not in output.terms:
        raise one.unknown("then", name=conclusion[0].term, kind=f"term of {output.name}",
                          known=list(output.terms))  # fmt: skip
    weight = one.number("weight", above=0.0, to=1.0) if "weight" in one.values else 1.0
    return Rule(condition, conclusion[0].term, weight)


# ------------------------------------------------------------------------------------ writing
def rule_base_text(system: FuzzySystem) -> str:
    """A fuzzy system as the text of such a file; read back, it is the same to the last bit.

    Raises:
        CapabilityError: if its numbers differ per lane: a file holds one system.
    """
    lanes = [name for name, value in system.parameters.items() if np.ndim(value)]
    if lanes:
        raise CapabilityError(
            wording(
                "a rule base to be written",
                got=f"numbers that differ per lane ({lanes[0]}, ...)",
                expected="one number each",
                do="choose a lane: system.with_parameters(...)",
            )
        )
    lines = [f"name = {_text(system.name)}"] if system.name else []
    lines.append(f"otherwise = {float(system.otherwise)!r}")
    for key, variables in (("input", system.inputs), ("output", (system.output,))):
        for one in variables:
            lines += _variable_lines(key, one)
    for rule in system.rules:
        then = f"{system.output.name} is {rule.term}"
        lines += ["", "[[rule]]", f"if = {_text(str(rule.antecedent))}", f"then = {_text(then)}"]
        if rule.weight != 1.0:
            lines.append(f"weight = {rule.weight!r}")
    return "\n".join(lines) + "\n"


def _variable_lines(key: str, one: Variable) -> list[str]:
    head = path_text((key, one.name))
    lines = ["", f"[{head}]"] if one.range is not None or one.unit else []
    if one.range is not None:
        lines.append(f"range = {_numbers(one.range)}")
    if one.unit:
        lines.append(f"unit = {_text(one.unit)}")
    lines += ["", f"[{head}.terms]"]
    for term, fuzzy in one.terms.items():
        if isinstance(fuzzy, SampledSet):
            body = f"{{ at = {_numbers(fuzzy.places)}, membership = {_numbers(fuzzy.values)} }}"
        else:
            body = _numbers(numbers_of_set(fuzzy).values())
        lines.append(f"{term} = {{ {fuzzy.kind} = {body} }}")
    return lines


def _numbers(values: Any) -> str:
    return f"[{', '.join(repr(float(v)) for v in values)}]"


def _text(value: str) -> str:
    return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
