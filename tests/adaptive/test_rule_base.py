"""Rule bases as files: what is written is read, and what is wrong is said with its line."""

from __future__ import annotations

import re

import pytest

from tracker.errors import CapabilityError, ConfigError, DomainError
from tracker_adaptive import (
    FuzzySystem,
    SampledSet,
    TrapezoidalSet,
    TriangularSet,
    Variable,
    five_rules,
    membership_figure,
    read_rule_base,
    rule_base_text,
    surface_figure,
)
from tracker_adaptive.rule_base import parse_rule_base

TEXT = """name = "example"
otherwise = 0.25

[input.dom]
range = [-4.0, 4.0]
unit = "m2"

[input.dom.terms]
zero = { gaussian = [0.0, 1.0] }
large = { trapezoidal = [0.5, 2.0, 9.0, 9.0] }

[input.rate.terms]
slow = { sampled = { at = [0.0, 1.0, 2.0], membership = [1.0, 0.5, 0.0] } }

[output.adjustment.terms]
keep = { triangular = [-0.1, 0.0, 0.1] }
lower = { triangular = [-1.0, -0.5, 0.0] }

[[rule]]
if = "dom is zero"
then = "adjustment is keep"

[[rule]]
if = "dom is large and not (rate is slow or dom is zero)"
then = "adjustment is lower"
weight = 0.5
"""


def test_a_file_is_read_and_written_alike(tmp_path):
    file = tmp_path / "rules.toml"
    file.write_text(TEXT)
    system = read_rule_base(file)
    assert rule_base_text(system) == TEXT
    assert system.otherwise == 0.25
    assert system.inputs[0].range == (-4.0, 4.0)
    assert isinstance(system.inputs[0].terms["large"], TrapezoidalSet)
    assert isinstance(system.inputs[1].terms["slow"], SampledSet)
    assert [rule.weight for rule in system.rules] == [1.0, 0.5]


def test_the_hand_made_system_survives_to_the_last_bit():
    base = five_rules(centres=(-8.1, -2.0 / 3.0, 1e-17, 0.1 + 0.2, 7e5))
    back = parse_rule_base(rule_base_text(base))
    assert dict(back.parameters) == dict(base.parameters)
    assert back.rules == base.rules
    assert rule_base_text(back) == rule_base_text(base)


@pytest.mark.parametrize(
    ("old", "new", "line", "told"),
    [
        ("gaussian", "gausian", 9, 'did you mean "gaussian"'),
        ('"dom is zero"', '"dim is zero"', 20, 'did you mean "dom"'),
        ('"dom is zero"', '"dom is zerro"', 20, 'did you mean "zero"'),
        ('"dom is zero"', '"dom zero"', 20, "'is'"),
        ("adjustment is keep", "adjustment is kep", 21, 'did you mean "keep"'),
        ("adjustment is keep", "adjusment is keep", 21, 'did you mean "adjustment"'),
        ("[0.0, 1.0] }", "[0.0] }", 9, "centre, width"),
        ("[0.0, 1.0] }", "[0.0, -1.0] }", 9, "above zero"),
        ("[0.5, 2.0, 9.0, 9.0]", "[0.5, 2.0, 1.0, 9.0]", 10, "order"),
        ("weight = 0.5", "weight = 2.0", 26, "weight"),
        ("weight = 0.5", "wieght = 0.5", 26, 'did you mean "weight"'),
        ("range = [-4.0, 4.0]", "range = [4.0, -4.0]", 4, "range"),
        ("otherwise = 0.25", 'otherwise = "no"', 2, "a number"),
    ],
)
def test_mistakes_are_told_with_file_line_and_suggestion(old, new, line, told):
    assert TEXT.count(old) >= 1
    with pytest.raises(ConfigError, match=re.escape(told)) as caught:
        parse_rule_base(TEXT.replace(old, new, 1), "rules.toml")
    assert str(caught.value).startswith(f"rules.toml:{line}:"), caught.value


def test_numbers_per_lane_are_not_written():
    import numpy as np

    lanes = five_rules().with_parameters(dom_ZE_width=np.array([1.0, 2.0]))
    with pytest.raises(CapabilityError, match="dom_ZE_width"):
        rule_base_text(lanes)
    with pytest.raises(DomainError, match="per lane"):
        membership_figure(lanes)


def test_figures_show_every_term_and_the_answer(tmp_path):
    pytest.importorskip("matplotlib")
    figure = membership_figure(five_rules())
    figure.savefig(tmp_path / "sets.png")
    assert [len(axis.lines) for axis in figure.axes] == [5, 5]
    labels = {text.get_text() for axis in figure.axes for text in axis.texts}
    assert labels == {"NM", "NS", "ZE", "PS", "PM", "IL", "I", "M", "D", "DL"}
    curve = surface_figure(five_rules()).axes[0].lines[0]
    assert curve.get_ydata()[0] == pytest.approx(0.5, abs=1e-3)
    sets = {"low": TriangularSet(0, 0, 1), "high": TriangularSet(0, 1, 1)}
    two = FuzzySystem(
        [Variable("x", sets), Variable("y", sets)],
        Variable("out", sets),
        [("x is low or y is low", "low"), ("x is high and y is high", "high")],
    )
    surface_figure(two).savefig(tmp_path / "map.png")
    assert len(surface_figure(two, {"y": 0.3}).axes[0].lines) == 1
    with pytest.raises(DomainError, match="one or two"):
        surface_figure(two, {"x": 0.1, "y": 0.3})
