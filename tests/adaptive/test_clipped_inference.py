"""Clipping and centroids: against another program, and against hand calculation."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.errors import CapabilityError, DomainError
from tracker_adaptive import (
    FuzzySystem,
    GaussianSet,
    TrapezoidalSet,
    TriangularSet,
    Variable,
    clipped,
    five_rules,
    from_scikit_fuzzy,
    to_scikit_fuzzy,
)
from tracker_adaptive.clipped_inference import union_of

REFERENCE = json.loads(
    (Path(__file__).parents[1] / "reference/data/mamdani/mamdani_fuzzy.json").read_text()
)
INPUTS = np.array(REFERENCE["tipping"]["inputs"], dtype=float).T


def tipping():
    terms = {
        "poor": TriangularSet(0, 0, 5),
        "average": TriangularSet(0, 5, 10),
        "good": TriangularSet(5, 10, 10),
    }
    tip = {
        "low": TriangularSet(0, 0, 13),
        "medium": TriangularSet(0, 13, 25),
        "high": TriangularSet(13, 25, 25),
    }
    return FuzzySystem(
        [Variable("quality", terms, (0, 10)), Variable("service", terms, (0, 10))],
        Variable("tip", tip, (0, 25)),
        [
            ("quality is poor or service is poor", "low"),
            ("service is average", "medium"),
            ("service is good or quality is good", "high"),
        ],
        name="tipping",
    )


def test_the_tipping_controller_is_that_of_another_program():
    # To the error of its 501 samples, where bends lie between them; else exactly.
    found = clipped(tipping(), *INPUTS)
    np.testing.assert_allclose(found, REFERENCE["tipping"]["tip_501pt_universe"], atol=3e-5)
    np.testing.assert_allclose(
        found[1:6], REFERENCE["tipping"]["tip_501pt_universe"][1:6], atol=1e-12
    )
    halves = clipped(tipping(), *INPUTS, reading="bisector")
    np.testing.assert_allclose(halves, REFERENCE["tipping"]["tip_bisector_501"], atol=2e-5)


def test_readings_of_one_union():
    on = {"on": TriangularSet(0, 1, 2)}
    out = {"a": TriangularSet(0, 2, 5), "b": TrapezoidalSet(4, 6, 8, 10)}
    system = FuzzySystem(
        [Variable("p", on), Variable("q", on)],
        Variable("y", out, (0, 10)),
        [("p is on", "a"), ("q is on", "b")],
    )
    union, want = union_of(system, 0.5, 0.8), REFERENCE["defuzz"]
    assert float(union.centroid()) == pytest.approx(want["centroid"], abs=1e-12)
    assert float(union.bisector()) == pytest.approx(want["bisector"], abs=1e-12)
    mean, low, high = (float(v) for v in union.maxima())
    assert (low, high, mean) == pytest.approx((5.6, 8.4, 7.0))  # samples of 0.1 end the top at 8.3
    assert low == pytest.approx(want["som"])


def test_a_triangle_clipped_by_hand():
    # Height 1 over [0, 3], clipped at 0.5: 0.5 over [0, 1.5], then falling to 0 at 3.
    x = Variable("x", {"on": TriangularSet(0, 1, 2)})
    y = Variable("y", {"up": TriangularSet(0, 0, 3)}, range=(0, 3))
    system = FuzzySystem(x, y, [("x is on", "up")], otherwise=-1.0)
    area, moment = 0.75 + 0.375, 0.75 * 0.75 + 0.375 * 2.0
    assert clipped(system, 0.5) == pytest.approx(moment / area, rel=1e-14)
    assert float(union_of(system, 0.5).area) == pytest.approx(area, rel=1e-14)
    assert clipped(system, 5.0) == -1.0  # no rule applies
    assert clipped(system, np.array([[0.5, 5.0]])).shape == (1, 2)
    assert clipped(system, np.empty(0)).shape == (0,)


@given(st.integers(0, 2**32 - 1))
def test_exact_integration_is_the_limit_of_sampling(seed):
    rng = np.random.default_rng(seed)
    corners = np.sort(rng.uniform(-5, 5, (4, 4)), axis=1)
    terms = {f"t{i}": TrapezoidalSet(*row) for i, row in enumerate(corners)}
    on = {"on": TriangularSet(0, 1, 2)}
    names = [f"x{i}" for i in range(4)]
    system = FuzzySystem(
        [Variable(n, on) for n in names],
        Variable("y", terms, (-5, 5)),
        [(f"{n} is on", f"t{i}") for i, n in enumerate(names)],
    )
    levels = rng.uniform(0.05, 1.0, 4)
    x = np.linspace(-5, 5, 200_001)
    heights = np.max(
        [np.minimum(t.membership(x), h) for t, h in zip(terms.values(), levels, strict=True)],
        axis=0,
    )
    sampled = np.trapezoid(x * heights, x) / np.trapezoid(heights, x)
    assert clipped(system, *levels) == pytest.approx(sampled, abs=2e-4)


def test_what_cannot_be_clipped_says_why():
    with pytest.raises(DomainError, match="no range"):
        clipped(five_rules(), 0.0)
    with pytest.raises(DomainError, match="centroid"):
        clipped(tipping(), 1.0, 1.0, reading="center")


def test_gaussian_output_sets_are_pieces():
    x = Variable("x", {"on": TriangularSet(0, 1, 2)})
    y = Variable("y", {"up": GaussianSet(1.0, 0.5)}, range=(-4, 6))
    assert clipped(FuzzySystem(x, y, [("x is on", "up")]), 0.7) == pytest.approx(1.0, abs=1e-9)


# ---------------------------------------------------------------------------- scikit-fuzzy
# It calls NumPy in a way that new releases warn of.
quiet = pytest.mark.filterwarnings("ignore:Passing more than 2:DeprecationWarning")


def simulated(system, values):
    from skfuzzy import control

    simulation = control.ControlSystemSimulation(system)
    for name, value in values.items():
        simulation.input[name] = value
    simulation.compute()
    return next(iter(simulation.output.values()))


@quiet
@pytest.mark.parametrize("points", [5001, 25001])
def test_what_is_exported_answers_alike(points):
    pytest.importorskip("skfuzzy.control")
    made = to_scikit_fuzzy(tipping(), points)
    for quality, service in INPUTS.T:
        found = simulated(made, {"quality": quality, "service": service})
        assert found == pytest.approx(clipped(tipping(), quality, service), abs=1e-6)


def test_what_is_exported_comes_back():
    pytest.importorskip("skfuzzy.control")
    back = from_scikit_fuzzy(to_scikit_fuzzy(tipping()))
    assert back.rules == tipping().rules
    assert {v.name for v in back.inputs} == {"quality", "service"}
    found = clipped(back, *(INPUTS[["quality", "service"].index(v.name)] for v in back.inputs))
    np.testing.assert_allclose(found, clipped(tipping(), *INPUTS), atol=1e-12)
    assert back.output.terms["medium"].peak == 13.0


@quiet
def test_what_was_made_there_is_read():
    pytest.importorskip("skfuzzy.control")
    import skfuzzy
    from skfuzzy import control

    x = control.Antecedent(np.linspace(0, 10, 1001), "x")
    y = control.Consequent(np.linspace(0, 1, 1001), "y")
    x["low"], x["high"] = skfuzzy.zmf(x.universe, 2, 6), skfuzzy.smf(x.universe, 4, 9)
    y["off"], y["on"] = (
        skfuzzy.trimf(y.universe, [0, 0, 0.6]),
        skfuzzy.gaussmf(y.universe, 0.8, 0.1),
    )
    system = control.ControlSystem(
        [control.Rule(x["low"] & ~x["high"], y["off"]), control.Rule(x["high"], y["on"])]
    )
    back = from_scikit_fuzzy(system)
    for value in (1.0, 4.5, 5.5, 9.5):
        assert simulated(system, {"x": value}) == pytest.approx(clipped(back, value), abs=1e-5)
    with pytest.raises(CapabilityError, match="sampled"):
        back.gradient(1.0)


def made_there(**functions):
    """A system of scikit-fuzzy with an "and" and an "or", and its output."""
    control = pytest.importorskip("skfuzzy.control")
    places = np.linspace(0.0, 1.0, 101)
    a, b = (control.Antecedent(places, name) for name in "ab")
    y = control.Consequent(places, "y")
    a["on"] = b["on"] = places
    y["low"], y["high"] = 1.0 - places, places
    rules = [control.Rule(a["on"] & b["on"], y["high"], **functions),
             control.Rule(~a["on"] | ~b["on"], y["low"], **functions)]  # fmt: skip
    return control.ControlSystem(rules), y


def test_another_reading_of_scikit_fuzzy_is_refused():
    system, y = made_there()
    from_scikit_fuzzy(system)
    y.defuzzify_method = "bisector"
    with pytest.raises(CapabilityError, match=r"'y' of scikit-fuzzy.*'bisector'.*reading="):
        from_scikit_fuzzy(system)


def test_another_and_or_or_of_scikit_fuzzy_is_refused():
    for name, function in (("and_func", np.multiply), ("or_func", np.add)):
        system, _ = made_there(**{name: function})
        with pytest.raises(CapabilityError, match=f"{name}={function.__name__}"):
            from_scikit_fuzzy(system)
    same, _ = made_there(and_func=np.minimum, or_func=np.maximum)
    assert len(from_scikit_fuzzy(same).rules) == 2


def test_another_union_of_scikit_fuzzy_is_refused():
    system, y = made_there()
    y.accumulation_method = np.multiply
    with pytest.raises(CapabilityError, match="accumulation_method=multiply"):
        from_scikit_fuzzy(system)
