"""Fuzzy systems of Mamdani's kind with product inference and centre average (paper 4, eq. 3-10).

Variables, terms and rules as values, and the smooth function that they are. Clipping and centroids
live in `tracker_adaptive.clipped`, files in `tracker_adaptive.rule_base`; nothing here knows filters.
"""

from __future__ import annotations

import difflib
import functools
import re
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import attrs
import numpy as np

from tracker.errors import CapabilityError, DomainError, wording
from tracker.models import exp, less, maximum, minimum, where
from tracker.models.graph import Graph, Node, derivative, evaluate
from tracker.models.parameters import checked_parameters
from tracker_adaptive.fuzzy_rules import Antecedent, Is, Rule, antecedent, claims, plain, worth
from tracker_adaptive.fuzzy_sets import FuzzySet, GaussianSet, SampledSet, numbers_of_set

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_NO_STRENGTH = 1e-300
"""Below this sum of strengths no rule applies."""


def _named(name: Any, what: str) -> None:
    if not isinstance(name, str) or not _NAME.fullmatch(name) or name in {"is", "and", "or", "not"}:
        raise DomainError(
            wording(
                f"name of {what}",
                got=repr(name),
                expected="letters, digits and underscores, and none of is, and, or, not",
                do="write for example 'dom' or 'positive_small'",
            )
        )


def _terms(value: Mapping[str, FuzzySet]) -> Mapping[str, FuzzySet]:
    return MappingProxyType(dict(value))


def _range(value: Iterable[float] | None) -> tuple[float, float] | None:
    if value is None:
        return None
    low, high = (float(v) for v in value)
    return low, high


@attrs.frozen(eq=False)
class Variable:
    """An input or the output of a fuzzy system: its name, its terms, and its range.

    An input beyond its range counts as at the end of it. Clipped systems and plots need a range.

    Raises:
        DomainError: if a name is not a plain one, there are no terms, or the range is empty.
    """

    name: str
    terms: Mapping[str, FuzzySet] = attrs.field(converter=_terms)
    range: tuple[float, float] | None = attrs.field(default=None, converter=_range)
    unit: str = ""

    def __attrs_post_init__(self) -> None:
        _named(self.name, "a variable")
        for term in self.terms:
            _named(term, f"a term of {self.name!r}")
        if not self.terms or (self.range is not None and not self.range[0] < self.range[1]):
            raise DomainError(
                wording(
                    f"fuzzy variable {self.name!r}",
                    got=f"{len(self.terms)} terms, range {self.range}",
                    expected="at least one term, and a range from low to high or none",
                    do="correct it",
                )
            )

    def within(self, x: Any) -> Any:
        """x, or the end of the range that it lies beyond."""
        return x if self.range is None else minimum(maximum(x, self.range[0]), self.range[1])

    def numbers(self) -> dict[str, Any]:
        """Numbers of its terms as ``variable_term_number``."""
        return {
            f"{self.name}_{term}_{name}": value
            for term, one in self.terms.items()
            for name, value in numbers_of_set(one).items()
        }

    def with_numbers(self, values: Mapping[str, Any]) -> Variable:
        """The variable with these of its numbers replaced."""
        changed = dict(self.terms)
        for term, one in self.terms.items():
            prefix = f"{self.name}_{term}_"
            new = {k: values[prefix + k] for k in numbers_of_set(one) if prefix + k in values}
            if new:
                changed[term] = attrs.evolve(one, **new)
        return attrs.evolve(self, terms=changed)

    @property
    def structure(self) -> tuple[Any, ...]:
        """All but the numbers."""
        kinds = tuple(
            (t, one if isinstance(one, SampledSet) else one.kind) for t, one in self.terms.items()
        )
        return (self.name, kinds, self.range)


def _rules(value: Iterable[Any]) -> tuple[Rule, ...]:
    return tuple(one if isinstance(one, Rule) else _rule(*one) for one in value)


def _rule(condition: str | Antecedent, term: str, weight: float = 1.0) -> Rule:
    parsed = antecedent(condition) if isinstance(condition, str) else condition
    return Rule(parsed, term, float(weight))


def _variables(value: Iterable[Variable]) -> tuple[Variable, ...]:
    return (value,) if isinstance(value, Variable) else tuple(value)


@attrs.frozen(eq=False)
class FuzzySystem:
    """Rules that make one number of one or several: called, it is eq. 3-10 of paper 4.

    Singleton fuzzifier, product inference, centre-average defuzzifier: with strengths w of the rules
    and centres y of their output terms, ``sum(w y) / sum(w)``. "or" is ``a + b - a b``, "not" is
    ``1 - a``. Where all antecedents are Gaussian sets joined by "and", strengths are taken in relation
    to the largest, so that the answer is exact far from all sets, too: there the rule whose strength
    fades most slowly decides. This holds up to 1e15 times the distance of two centres whose sets are
    equally wide; numbers beyond do not tell these centres apart, and the answer is the mean of
    theirs. Otherwise, where no rule has any strength, the answer is ``otherwise``.

    Its numbers are `parameters`: ``dom_PS_centre``, ``dom_PS_width``, ``adjustment_D_centre``. Each
    may differ per lane. It runs on floats, arrays of lanes and graph nodes alike.

    Shapes:
        inputs scalars or ``(*batch)``, one argument each, in the order of ``inputs``.

    Raises:
        DomainError: for a rule about what does not exist, or a weight outside (0, 1].
    Source: paper 4, eq. 3-10, with the square that the print lacks; Wang, A Course in Fuzzy Systems
        and Control, 1997, lemma 9.2.
    Laws: the answer lies between the smallest and largest output centre, or is ``otherwise``.

    Example:
    >>> system = FuzzySystem(
    ...     inputs=Variable("x", {"low": GaussianSet(0.0, 1.0), "high": GaussianSet(1.0, 1.0)}),
    ...     output=Variable("y", {"off": GaussianSet(0.0, 1.0), "on": GaussianSet(10.0, 1.0)}),
    ...     rules=[("x is low", "off"), ("x is high", "on")])
    >>> system(0.5), round(system(100.0), 6)
    (5.0, 10.0)
    """

    inputs: tuple[Variable, ...] = attrs.field(converter=_variables)
    output: Variable
    rules: tuple[Rule, ...] = attrs.field(converter=_rules)
    otherwise: float = 0.0
    name: str = ""

    def __attrs_post_init__(self) -> None:
        self._check_names()
        known = {one.name: one.terms for one in self.inputs}
        for rule in self.rules:
            for claim in claims(rule.antecedent):
                self._known(rule, "input", claim.variable, known)
                self._known(rule, f"term of {claim.variable!r}", claim.term, known[claim.variable])
            self._known(rule, f"term of {self.output.name!r}", rule.term, self.output.terms)
            if not 0.0 < rule.weight <= 1.0:
                raise DomainError(
                    wording(
                        f"rule {str(rule)!r}",
                        got=f"weight {rule.weight}",
                        expected="a weight above 0 and at most 1",
                        do="leave it out for 1",
                    )
                )
        if not self.rules or not np.isfinite(self.otherwise):
            raise DomainError(
                wording(
                    "fuzzy system",
                    got=f"{len(self.rules)} rules, otherwise = {self.otherwise}",
                    expected="at least one rule, and a finite answer where none applies",
                    do="add a rule such as ('dom is PS', 'D')",
                )
            )

    def _check_names(self) -> None:
        names = [one.name for one in (*self.inputs, self.output)]
        numbers = [n for one in (*self.inputs, self.output) for n in one.numbers()]
        for what, found in (("variables", names), ("numbers", numbers)):
            twice = sorted({n for n in found if found.count(n) > 1})
            if twice:
                raise DomainError(
                    wording(
                        f"{what} of a fuzzy system",
                        got=f"{', '.join(twice)} twice",
                        expected="distinct names",
                        do="rename a variable or a term",
                    )
                )

    @staticmethod
    def _known(rule: Rule, what: str, name: str, there: Iterable[str]) -> None:
        names = list(there)
        if name not in names:
            near = difflib.get_close_matches(name, names, n=1)
            hint = f"write {near[0]!r}" if near else "correct the name"
            raise DomainError(
                wording(
                    f"rule {str(rule)!r}",
                    got=f"unknown {what} {name!r}",
                    expected=f"one of {', '.join(names)}",
                    do=hint,
                )
            )

    # ------------------------------------------------------------------------ the function
    def __call__(self, *inputs: Any) -> Any:
        """Centre average of the product-inferred rules."""
        values = self._given(inputs)
        centres = [self.output.terms[rule.term].middle for rule in self.rules]
        if self._gaussian:
            strengths = self._relative(values)
            total = functools.reduce(_plus, strengths)
            return functools.reduce(_plus, map(_times, strengths, centres)) / total
        strengths = self.strengths(*inputs)
        total = functools.reduce(_plus, strengths)
        none = less(total, _NO_STRENGTH)
        mean = functools.reduce(_plus, map(_times, strengths, centres)) / where(none, 1.0, total)
        return where(none, self.otherwise, mean)

    def strengths(self, *inputs: Any) -> list[Any]:
        """How far each rule applies: products of memberships, times the rule's weight."""
        values = self._given(inputs)
        member = self._memberships(values)
        return [
            rule.weight * worth(rule.antecedent, member, _times, _sum_less_product)
            for rule in self.rules
        ]

    def _given(self, inputs: Sequence[Any]) -> dict[str, Any]:
        if len(inputs) != len(self.inputs):
            raise DomainError(
                wording(
                    f"fuzzy system {self.name!r}",
                    got=f"{len(inputs)} inputs",
                    expected=f"{len(self.inputs)}: {', '.join(v.name for v in self.inputs)}",
                    do="pass one number or array for each",
                )
            )
        return {v.name: v.within(x) for v, x in zip(self.inputs, inputs, strict=True)}

    def _memberships(self, values: Mapping[str, Any]) -> Any:
        terms = {one.name: one.terms for one in self.inputs}

        @functools.cache
        def member(claim: Is) -> Any:
            return terms[claim.variable][claim.term].membership(values[claim.variable])

        return member

    @property
    def _gaussian(self) -> bool:
        terms = {one.name: one.terms for one in self.inputs}
        return all(
            plain(rule.antecedent)
            and all(
                isinstance(terms[c.variable][c.term], GaussianSet) for c in claims(rule.antecedent)
            )
            for rule in self.rules
        )

    def _relative(self, values: Mapping[str, Any]) -> list[Any]:
        """Strengths in relation to the largest, which is 1."""
        terms: Any = {one.name: one.terms for one in self.inputs}
        exponents = []
        for rule in self.rules:
            parts = [
                terms[c.variable][c.term].exponent(values[c.variable])
                for c in claims(rule.antecedent)
            ]
            weight = float(np.log(rule.weight))
            exponents.append(functools.reduce(_plus, parts) + weight)
        largest = functools.reduce(maximum, exponents)
        return [faded(e - largest) for e in exponents]

    # ------------------------------------------------------------------------- derivatives
    def gradient(self, *inputs: Any) -> Any:
        """Derivatives by the inputs, exact, ``(inputs, *batch)``; on a kink, those of one side."""
        return self._derivatives([v.name for v in self.inputs], inputs)

    def parameter_gradient(self, *inputs: Any) -> dict[str, Any]:
        """Derivatives by each of `parameters`, exact."""
        names = list(self.parameters)
        return dict(zip(names, self._derivatives(names, inputs), strict=True))

    def _derivatives(self, by: Sequence[str], inputs: Sequence[Any]) -> Any:
        if any(isinstance(one, SampledSet) for v in self.inputs for one in v.terms.values()):
            raise CapabilityError(
                f"fuzzy system {self.name!r} has sampled sets, which have no derivatives. "
                "Do this: use Gaussian, triangular or trapezoidal sets."
            )
        graph = Graph()
        names = [v.name for v in self.inputs]
        nodes = {name: graph.input(name) for name in (*names, *self.parameters)}
        traced = self.with_parameters(**{k: nodes[k] for k in self.parameters})
        answer = traced(*(nodes[name] for name in names))
        values = {**dict(zip(names, inputs, strict=True)), **self.parameters}
        roots = [derivative(answer, nodes[name]) for name in by]
        shape = np.broadcast_shapes(*(np.shape(v) for v in values.values()))
        return np.stack([np.broadcast_to(v, shape) for v in evaluate(roots, values)])

    # -------------------------------------------------------------------------- parameters
    @property
    def parameters(self) -> Mapping[str, Any]:
        """Numbers of the sets by name, ``variable_term_number``; scalars or ``(*batch)``."""
        out: dict[str, Any] = {}
        for one in (*self.inputs, self.output):
            out |= one.numbers()
        return MappingProxyType(out)

    def with_parameters(self, **parameters: Any) -> FuzzySystem:
        """The same system with other numbers.

        Raises:
            CapabilityError: for a number that it does not have.
        """
        known = self.parameters
        for name in parameters:
            if name not in known:
                near = difflib.get_close_matches(name, list(known), n=1)
                hint = f"; did you mean {near[0]!r}?" if near else ""
                raise CapabilityError(f"fuzzy system {self.name!r} has no number {name!r}{hint}")
        checked = checked_parameters(parameters)
        return attrs.evolve(
            self,
            inputs=[one.with_numbers(checked) for one in self.inputs],
            output=self.output.with_numbers(checked),
        )

    @property
    def structure(self) -> tuple[Any, ...]:
        """All but the numbers: systems of the same structure are compiled to the same code."""
        variables = tuple(one.structure for one in (*self.inputs, self.output))
        return (variables, self.rules, self.otherwise)


_FADED = (
    0.00018599472532538418,
    0.0013863895389950363,
    0.008333082502381264,
    0.04166665371953777,
    0.16666666634819646,
    0.49999999999706,
    0.9999999999999956,
)
"""Of (exp(y) - 1) / y in y, for y from -38 / 256 to 0."""


def faded(x: Any) -> Any:
    """``exp(x)`` for x that is not above zero: to 3e-13 on graph nodes, and 0 at -38 is 3e-17.

    Half the operations of `tracker.models.exp`, and no division: ten of them are most of what a
    compiled fuzzy adapter does.
    """
    if not (isinstance(x, Node) or (isinstance(x, np.ndarray) and x.dtype.hasobject)):
        return exp(x)
    y = maximum(x, -38.0) * (1.0 / 256.0)
    out: Any = _FADED[0]
    for coefficient in _FADED[1:]:
        out = out * y + coefficient
    out = out * y + 1.0
    for _ in range(8):
        out = out * out
    return out


def _plus(a: Any, b: Any) -> Any:
    return a + b


def _times(a: Any, b: Any) -> Any:
    return a * b


def _sum_less_product(a: Any, b: Any) -> Any:
    return a + b - a * b


TERMS = (("NM", "IL"), ("NS", "I"), ("ZE", "M"), ("PS", "D"), ("PM", "DL"))
"""Terms of the thesis: of the degree of mismatch, and what the noise then does."""


def five_rules(
    centres: Sequence[Any] = (-8.0, -2.0, 0.0, 2.0, 8.0),
    widths: Sequence[Any] = (2.5, 2.0, 1.0, 2.0, 2.5),
    outputs: Sequence[Any] = (0.5, 0.12, 0.0, -0.12, -0.5),
    output_widths: Sequence[Any] = (0.15, 0.1, 0.06, 0.1, 0.15),
    name: str = "five rules",
) -> FuzzySystem:
    """The thesis's system of one input and five rules; by default, one that was made by hand.

    Degree of mismatch negative medium, negative small, zero, positive small, positive medium: noise
    increases much, increases, stays, decreases, decreases much. Output widths are for plots alone.

    Source: paper 4, section 3.3 (rules); the numbers are ours.

    Example:
    >>> round(five_rules()(0.0), 12), round(five_rules()(50.0), 3)
    (0.0, -0.5)
    """
    inputs = {t: GaussianSet(c, w) for (t, _), c, w in zip(TERMS, centres, widths, strict=True)}
    output = {
        t: GaussianSet(c, w) for (_, t), c, w in zip(TERMS, outputs, output_widths, strict=True)
    }
    rules = [Rule(Is("dom", a), b) for a, b in TERMS]
    return FuzzySystem((Variable("dom", inputs),), Variable("adjustment", output), rules, name=name)
