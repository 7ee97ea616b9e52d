"""Fuzzy sets, rules and the centre average: closed forms, derivatives, lanes, graph nodes, errata."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.errors import CapabilityError, DomainError
from tracker.models.graph import Graph, evaluate
from tracker_adaptive import (
    FuzzySystem,
    GaussianSet,
    SampledSet,
    TrapezoidalSet,
    TriangularSet,
    Variable,
    antecedent,
    five_rules,
)
from tracker_adaptive.fuzzy_system import faded

REFERENCE = json.loads(
    (Path(__file__).parents[1] / "reference/data/mamdani/mamdani_fuzzy.json").read_text()
)["membership"]
PLACES = np.array(REFERENCE["x"])


@pytest.mark.parametrize(
    ("one", "name"),
    [
        (TriangularSet(2.0, 5.0, 9.0), "trimf_2_5_9"),
        (TrapezoidalSet(1.0, 3.0, 6.0, 8.0), "trapmf_1_3_6_8"),
        (GaussianSet(5.0, 1.5 * np.sqrt(2.0)), "gaussmf_mean5_sd1.5"),
        (SampledSet(PLACES, REFERENCE["zmf_2_6"]), "zmf_2_6"),
    ],
)
def test_memberships_are_those_of_another_program(one, name):
    np.testing.assert_allclose(one.membership(PLACES), REFERENCE[name], rtol=0, atol=1e-12)
    assert [float(one.membership(float(x))) for x in PLACES] == pytest.approx(REFERENCE[name])


def printed(system, x):
    """Eq. 3-10 as it should read, written out."""
    top = bottom = 0.0
    for rule in system.rules:
        fuzzy = system.inputs[0].terms[rule.antecedent.term]
        w = np.exp(-(((x - fuzzy.centre) / fuzzy.width) ** 2))
        top, bottom = top + w * system.output.terms[rule.term].centre, bottom + w
    return top / bottom


def test_the_centre_average_is_equation_3_10():
    x = np.linspace(-12.0, 12.0, 101)
    np.testing.assert_allclose(five_rules()(x), printed(five_rules(), x), rtol=1e-12, atol=1e-15)


def test_two_inputs_multiply():
    a, b = GaussianSet(0.0, 1.0), GaussianSet(1.0, 2.0)
    x = Variable("x", {"low": a, "high": b})
    y = Variable("y", {"low": b, "high": a})
    out = Variable("out", {"small": GaussianSet(-1.0, 1.0), "large": GaussianSet(3.0, 1.0)})
    system = FuzzySystem(
        [x, y], out, [("x is low and y is low", "small"), ("x is high and y is high", "large", 0.5)]
    )
    w = [a.membership(0.3) * b.membership(0.4), 0.5 * b.membership(0.3) * a.membership(0.4)]
    assert system(0.3, 0.4) == pytest.approx((3.0 * w[1] - w[0]) / (w[0] + w[1]), rel=1e-14)
    assert system.strengths(0.3, 0.4) == pytest.approx(w)


def test_erratum_3_10_without_the_square_a_membership_exceeds_one():
    fuzzy, x = five_rules().inputs[0].terms["PS"], np.linspace(-50.0, 50.0, 1001)
    without = np.exp(-(x - fuzzy.centre) / fuzzy.width)
    assert without.max() > 1e10  # left of the centre, as printed
    assert fuzzy.membership(x).max() <= 1.0
    mirrored = fuzzy.membership(2.0 * fuzzy.centre - x)
    np.testing.assert_allclose(mirrored, fuzzy.membership(x), rtol=1e-9)


@pytest.mark.parametrize("x", [1e3, 1e8, 1.6e16, 1e18, 1e149, 1e300, np.inf])
def test_far_from_all_gaussian_sets_the_answer_is_the_limit(x):
    # All strengths underflow there; in relation to the largest one they are numbers.
    assert np.isfinite(five_rules()(x))
    if x <= 1e15 * 16.0:  # the widest two sets stand that far apart
        assert five_rules()(x) == pytest.approx(-0.5, abs=1e-12)
        assert five_rules()(-x) == pytest.approx(0.5, abs=1e-12)
    elif x < 1e149:
        assert five_rules()(x) == 0.0  # their mean, as documented


def test_where_no_rule_applies_the_answer_is_the_documented_one():
    x = Variable("x", {"on": TriangularSet(0.0, 1.0, 2.0)})
    y = Variable("y", {"up": TriangularSet(4.0, 5.0, 6.0)})
    system = FuzzySystem(x, y, [("x is on", "up")], otherwise=-7.0)
    np.testing.assert_array_equal(system(np.array([-1.0, 0.5, 2.0, 9.0])), [-7.0, 5.0, -7.0, -7.0])
    assert np.isnan(system(np.nan))


def test_an_input_beyond_its_range_counts_as_its_end():
    base = five_rules()
    bounded = FuzzySystem(
        Variable("dom", base.inputs[0].terms, (-4.0, 4.0)), base.output, base.rules
    )
    assert bounded(1e9) == bounded(4.0)
    assert bounded(1.0) == base(1.0)


def test_or_and_not_of_products():
    sets = {"low": TriangularSet(0.0, 0.0, 1.0), "high": TriangularSet(0.0, 1.0, 1.0)}
    x, y = Variable("x", sets), Variable("y", sets)
    out = Variable("out", {"one": TriangularSet(0, 1, 2), "two": TriangularSet(1, 2, 3)})
    rules = [("x is low or not y is low", "one"), ("x is high", "two")]
    a, b = 0.75, 0.4  # x is low, y is low
    first = a + (1 - b) - a * (1 - b)
    assert FuzzySystem([x, y], out, rules)(0.25, 0.6) == pytest.approx(
        (first + 2 * 0.25) / (first + 0.25)
    )


@given(st.floats(-1e6, 1e6), st.integers(0, 2**32 - 1))
def test_the_answer_lies_between_the_output_centres(x, seed):
    rng = np.random.default_rng(seed)
    system = five_rules(np.sort(rng.normal(0, 5, 5)), rng.uniform(0.1, 9, 5), rng.normal(0, 1, 5))
    centres = [fuzzy.centre for fuzzy in system.output.terms.values()]
    assert min(centres) - 1e-12 <= system(x) <= max(centres) + 1e-12


KINDS = {
    "gaussian": five_rules(),
    "triangular": FuzzySystem(
        Variable("x", {"a": TriangularSet(-3, -1, 1), "b": TrapezoidalSet(-1, 1, 2, 5)}),
        Variable("y", {"u": GaussianSet(1.0, 1.0), "v": GaussianSet(4.0, 1.0)}),
        [("x is a", "u"), ("x is b or not x is a", "v")],
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_are_those_of_differences(kind):
    system, step = KINDS[kind], 1e-6
    x = np.array([-2.3, -0.7, 0.31, 0.83, 1.7])
    slope = (system(x + step) - system(x - step)) / (2 * step)
    np.testing.assert_allclose(system.gradient(x)[0], slope, rtol=1e-6, atol=1e-8)
    for name, found in system.parameter_gradient(x).items():
        value = system.parameters[name]
        two = [system.with_parameters(**{name: value + s})(x) for s in (step, -step)]
        np.testing.assert_allclose(found, (two[0] - two[1]) / (2 * step), rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_lanes_one_number_and_nodes_agree(kind):
    system = KINDS[kind]
    x = np.linspace(-6.0, 6.0, 41)
    together = system(x)
    assert system(x[:, None] + np.zeros((1, 2))).shape == (41, 2)
    assert system(np.empty((2, 0))).shape == (2, 0)
    graph = Graph()
    root = system(graph.input("x"))
    np.testing.assert_allclose(evaluate([root], {"x": x})[0], together, rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose([system(float(v)) for v in x], together, rtol=1e-12, atol=1e-15)


def test_the_cheap_exponential_is_the_exponential():
    graph = Graph()
    x = np.concatenate([np.linspace(-37.9, 0.0, 5001), [-1e3, -1e300]])
    found = evaluate([faded(graph.input("x"))], {"x": x})[0]
    np.testing.assert_allclose(found[:-2], np.exp(x[:-2]), rtol=3e-13)
    assert found[5000] == 1.0
    assert (found[-2:] < 4e-17).all()


def test_numbers_may_differ_per_lane():
    widths = np.array([0.5, 1.0, 4.0])
    lanes = five_rules().with_parameters(dom_ZE_width=widths, adjustment_M_centre=widths / 10)
    for lane, width in enumerate(widths):
        alone = five_rules().with_parameters(dom_ZE_width=width, adjustment_M_centre=width / 10)
        assert lanes(np.full(3, 0.7))[lane] == alone(0.7)
    assert lanes.structure == five_rules().structure
    again = pickle.loads(pickle.dumps(lanes))
    np.testing.assert_array_equal(again(0.3), lanes(0.3))


@pytest.mark.parametrize(
    ("text", "back"),
    [
        ("a is b", "a is b"),
        ("not a is b and c is d", "not a is b and c is d"),
        ("not (a is b and c is d) or e is f", "not (a is b and c is d) or e is f"),
        ("(a is b or c is d) and e is f", "(a is b or c is d) and e is f"),
        ("((a is b))", "a is b"),
    ],
)
def test_rules_read_and_write_alike(text, back):
    assert str(antecedent(text)) == back
    assert antecedent(back) == antecedent(text)


@pytest.mark.parametrize(
    "text", ["", "a", "a is", "a is b and", "a is b c is d", "(a is b", "a = b", "and is b"]
)
def test_what_is_no_rule_is_refused_in_words(text):
    with pytest.raises(DomainError, match="expected"):
        antecedent(text)


def test_mistakes_are_refused_with_a_suggestion():
    base = five_rules()
    with pytest.raises(DomainError, match="'ZE'"):
        FuzzySystem(base.inputs, base.output, [("dom is ZEE", "D")])
    with pytest.raises(DomainError, match="'dom'"):
        FuzzySystem(base.inputs, base.output, [("dim is PM", "D")])
    with pytest.raises(CapabilityError, match="dom_PM_centre"):
        base.with_parameters(dom_PM_center=1.0)
    with pytest.raises(DomainError, match="width"):
        GaussianSet(0.0, 0.0)
    with pytest.raises(DomainError, match="left"):
        TriangularSet(1.0, 0.0, 2.0)
    with pytest.raises(DomainError, match="finite"):
        GaussianSet(np.nan, 1.0)
    with pytest.raises(DomainError, match="twice"):
        FuzzySystem(
            [Variable("a_b", {"c": GaussianSet(0, 1)}), Variable("a", {"b_c": GaussianSet(0, 1)})],
            base.output,
            [("a_b is c", "D")],
        )
    with pytest.raises(DomainError, match="2 inputs"):
        base(1.0, 2.0)
