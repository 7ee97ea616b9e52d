"""Fuzzy systems to and from scikit-fuzzy's control objects; it is imported here alone, and late."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import numpy as np

from tracker.errors import CapabilityError, PluginError, wording
from tracker_adaptive.fuzzy_rules import And, Antecedent, Is, Not, Or, Rule
from tracker_adaptive.fuzzy_sets import FuzzySet, SampledSet, TrapezoidalSet, TriangularSet
from tracker_adaptive.fuzzy_system import FuzzySystem, Variable


def _control() -> Any:
    if find_spec("skfuzzy") is None or find_spec("networkx") is None:
        raise PluginError(
            wording(
                "scikit-fuzzy objects",
                got="no scikit-fuzzy",
                expected="scikit-fuzzy and networkx, which its control objects need",
                do="pip install 'tracker-lab[fuzzy]'",
            )
        )
    from skfuzzy import control

    return control


def to_scikit_fuzzy(system: FuzzySystem, points: int = 501) -> Any:
    """The system as a ``skfuzzy.control.ControlSystem``, to be simulated, plotted or taught with.

    Every variable needs a range, sampled at ``points``. A simulation takes 2 ms for one input; its
    answer is `tracker_adaptive.clipped_inference.clipped`, up to the sampling.

    Raises:
        PluginError: if scikit-fuzzy is not installed.
        CapabilityError: if a variable has no range, or numbers differ per lane.
    """
    control = _control()
    made = {}
    for one in (*system.inputs, system.output):
        if one.range is None or any(np.ndim(v) for v in one.numbers().values()):
            raise CapabilityError(
                wording(
                    f"variable {one.name!r} for scikit-fuzzy",
                    got="no range" if one.range is None else "numbers that differ per lane",
                    expected="a range, which is sampled, and one number each",
                    do="give Variable(..., range=(low, high))",
                )
            )
        universe = np.linspace(*one.range, points)
        kind = control.Consequent if one is system.output else control.Antecedent
        made[one.name] = kind(universe, one.name)
        for term, fuzzy in one.terms.items():
            made[one.name][term] = np.asarray(fuzzy.membership(universe))
    rules = []
    for rule in system.rules:
        term = made[system.output.name][rule.term]
        then = term if rule.weight == 1.0 else term % rule.weight
        rules.append(control.Rule(_exported(rule.antecedent, made), then))
    return control.ControlSystem(rules)


def _exported(part: Antecedent, made: dict[str, Any]) -> Any:
    if isinstance(part, Is):
        return made[part.variable][part.term]
    if isinstance(part, Not):
        return ~_exported(part.part, made)
    left, right = _exported(part.left, made), _exported(part.right, made)
    return left & right if isinstance(part, And) else left | right


def from_scikit_fuzzy(system: Any) -> FuzzySystem:
    """The system that a ``skfuzzy.control.ControlSystem`` of one output is.

    Its sets are sampled ones; those that are triangles or trapezia on its samples become that. What
    a system cannot say of itself is refused: it is `tracker_adaptive.clipped_inference.clipped` that
    answers as scikit-fuzzy does, with the smaller for "and", the larger for "or" and for the union,
    and the centroid.

    Raises:
        PluginError: if scikit-fuzzy is not installed.
        CapabilityError: if it has several outputs, or infers in another way.
    """
    control = _control()
    outputs = list(system.consequents)
    if len(outputs) != 1:
        raise CapabilityError(
            wording(
                "a control system of scikit-fuzzy",
                got=f"{len(outputs)} outputs",
                expected="one",
                do="make a system for each output",
            )
        )
    _as_here(outputs[0], control.accumulation_max)
    rules = []
    for rule in system.rules:
        condition = _imported(rule.antecedent, rule)
        rules += [Rule(condition, c.term.label, float(c.weight)) for c in rule.consequent]
    inputs = [_variable(one) for one in system.antecedents]
    return FuzzySystem(inputs, _variable(outputs[0]), rules)


def _as_here(output: Any, largest: Any) -> None:
    """Refuse an output that is united or read off in another way than `clipped` does by default."""
    if output.defuzzify_method != "centroid":
        raise _otherwise(
            f"output {output.label!r}",
            f"defuzzify_method={output.defuzzify_method!r}",
            "'centroid', which a system answers with by default",
            "set it to 'centroid', and give clipped(..., reading=) what was asked for there",
        )
    if output.accumulation_method not in (largest, *_LARGER):
        raise _otherwise(
            f"output {output.label!r}",
            f"accumulation_method={_name(output.accumulation_method)}",
            "the union of the clipped sets (accumulation_max)",
            "leave it as it is made",
        )


_SMALLER, _LARGER = (np.fmin, np.minimum), (np.fmax, np.maximum)


def _otherwise(where: str, got: str, expected: str, do: str) -> CapabilityError:
    return CapabilityError(wording(f"{where} of scikit-fuzzy", got=got, expected=expected, do=do))


def _name(function: Any) -> str:
    return str(getattr(function, "__name__", function))


def _imported(part: Any, rule: Any) -> Antecedent:
    if hasattr(part, "parent"):
        return Is(part.parent.label, part.label)
    if part.kind == "not":
        return Not(_imported(part.term1, rule))
    both = part.kind == "and"
    used = rule.and_func if both else rule.or_func
    if used not in (_SMALLER if both else _LARGER):
        raise _otherwise(
            f"rule with {str(part)!r}",
            f"{part.kind}_func={_name(used)}",
            f"the {'smaller (np.fmin)' if both else 'larger (np.fmax)'} of two",
            "leave it out, or build a FuzzySystem: called itself, it multiplies",
        )
    kind = And if both else Or
    return kind(_imported(part.term1, rule), _imported(part.term2, rule))


def _variable(one: Any) -> Variable:
    universe = np.asarray(one.universe, dtype=np.float64)
    terms = {name: _set(universe, np.asarray(term.mf)) for name, term in one.terms.items()}
    return Variable(one.label, terms, (float(universe[0]), float(universe[-1])))


def _set(x: Any, y: Any) -> FuzzySet:
    """A sampled set, or the triangle or trapezium that it is on its samples."""
    bends = [
        0,
        *(np.flatnonzero(np.abs(np.diff(np.diff(y) / np.diff(x))) > 1e-9) + 1).tolist(),
        len(x) - 1,
    ]
    places, values = x[bends], y[bends]
    inside = [float(p) for p, v in zip(places, values, strict=True) if v > 1.0 - 1e-12]
    if inside and len(places) <= 5:
        left = (
            places[np.flatnonzero(places <= inside[0])[-1] - 1] if inside[0] > x[0] else inside[0]
        )
        right = (
            places[np.flatnonzero(places >= inside[-1])[0] + 1]
            if inside[-1] < x[-1]
            else inside[-1]
        )
        corners = float(left), inside[0], inside[-1], float(right)
        made: FuzzySet = (
            TriangularSet(corners[0], corners[1], corners[3])
            if inside[0] == inside[-1]
            else TrapezoidalSet(*corners)
        )
        if np.allclose(made.membership(x), y, rtol=0.0, atol=1e-12):
            return made
    return SampledSet(places, values)
