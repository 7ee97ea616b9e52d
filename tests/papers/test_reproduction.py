"""The rules of verdicts, the schema of results, and intervals by resampling."""

import base64
import copy
import math

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.errors import ConfigError, ShapeError
from tracker.metrics.consistency import Interval
from tracker.metrics.resampling import bootstrap_interval, ratio_of_medians, spread_of_mean
from tracker.report.reproduction import write_up
from tracker.reproduction import (
    Claim,
    Erratum,
    Picture,
    Published,
    Reading,
    Reproduction,
    all_of,
    check_results,
    judged,
    paper_from_toml,
    row,
    verdict,
    within,
)

NUMBER = Published("table1/a", "Table 1", "row A", "0.25", runs=100)
numbers = st.floats(0.01, 10.0)
votes = st.lists(st.sampled_from([True, False, None]), max_size=6)


# ------------------------------------------------------------------------------ the rule
@given(value=numbers, half=st.floats(1e-6, 0.004))
def test_a_number_is_reproduced_exactly_if_it_lies_in_the_interval(value, half):
    number = Published("id", "t", "c", f"{value:.6f}")
    inside = Interval(value, value - half, value + half)
    assert verdict(number, inside)[0] == "reproduced"
    beside = Interval(value + 3 * half, value + 2 * half, value + 4 * half)
    assert verdict(number, beside)[0] == "not reproduced"
    assert f"{beside.low:.4g}" in verdict(number, beside)[1]


def test_a_number_is_reproduced_if_one_reading_gives_it_and_the_reading_is_named():
    ours = Interval(0.36, 0.35, 0.37)
    readings = [Reading("fast", 0.05, 0.06), Reading("slow", 0.2, 0.3)]
    word, why = verdict(NUMBER, ours, readings)
    assert word == "reproduced"
    assert "slow" in why
    assert "fast" not in why
    word, why = verdict(NUMBER, ours, readings[:1])
    assert word == "not reproduced"
    assert "fast" in why


def test_a_number_between_two_readings_is_not_reproduced_by_them():
    readings = [Reading("low", 0.1, 0.2), Reading("high", 0.3, 0.4)]
    assert verdict(NUMBER, Interval(0.15, 0.14, 0.16), readings)[0] == "not reproduced"


def test_rounding_of_the_published_number_is_allowed_for():
    exact = Interval(0.2549, 0.2549, 0.2549)
    assert verdict(NUMBER, exact)[0] == "reproduced"  # 0.25 may have been 0.2549
    assert verdict(Published("id", "t", "c", "0.250"), exact)[0] == "not reproduced"
    assert Published("id", "t", "c", "1.5e3").rounding == pytest.approx(50.0)
    assert Published("id", "t", "c", "12").rounding == pytest.approx(0.5)


def test_a_digit_that_cannot_be_read_makes_several_numbers():
    number = Published("id", "t", "c", "4[25].[25]3")
    assert number.values == (42.23, 42.53, 45.23, 45.53)
    assert number.value == 42.53
    assert number.rounding == pytest.approx(0.005)
    assert number.nearest(43.0) == 42.53
    assert number.nearest(math.nan) == number.value
    assert Published("id", "t", "c", "0.25").uncertain == ""


def test_a_number_that_may_be_several_is_reproduced_by_any_and_the_row_names_the_nearest():
    number = Published("id", "t", "c", "4[25]")
    found = row(number, Interval(45.2, 44.8, 45.6), 10)
    assert (found.verdict, found.published) == ("reproduced", 45.0)
    assert "one of 2 numbers from 42 to 45" in found.why
    between = row(number, Interval(43.5, 43.0, 44.0), 10)
    assert between.verdict == "not reproduced", "what lies between the two is neither of them"


def test_an_interval_wider_than_its_value_decides_nothing():
    wide = Interval(0.4, 0.1, 0.9)
    assert verdict(NUMBER, wide)[0] == "not comparable"
    assert verdict(NUMBER, wide, [Reading("slow", 0.2, 0.3)])[0] == "reproduced"
    assert verdict(NUMBER, wide, [Reading("fast", 0.05, 0.06)])[0] == "not reproduced"
    assert "too wide" in verdict(NUMBER, wide)[1]


def test_what_cannot_be_compared_says_why():
    assert verdict(NUMBER, Interval(0.25, 0.2, 0.3), not_comparable="Another unit.") == (
        "not comparable",
        "Another unit.",
    )
    assert verdict(NUMBER, Interval(math.nan, math.nan, math.nan))[0] == "not comparable"


@given(votes)
def test_a_claim_is_confirmed_by_all_votes_refuted_by_one_and_else_undecided(given_votes):
    word = judged(given_votes)
    assert (word == "confirmed") == (bool(given_votes) and set(given_votes) == {True})
    assert (word == "refuted") == (False in given_votes)


def test_a_row_names_the_reading_that_gives_its_number_where_ours_does_not():
    readings = [Reading("slow", 0.2, 0.3), Reading("fast", 0.05, 0.06), Reading("A", 0.1, 0.4)]
    assert row(NUMBER, Interval(0.36, 0.35, 0.37), 10, readings).given_by == ("slow", "A")
    assert row(NUMBER, Interval(0.25, 0.24, 0.26), 10, readings).given_by == ("ours",)
    assert row(NUMBER, Interval(0.36, 0.35, 0.37), 10, readings[1:2]).given_by == ()
    said = row(NUMBER, Interval(0.25, 0.24, 0.26), 10, readings, not_comparable="Another unit.")
    assert said.given_by == ()


@given(votes)
def test_a_compound_holds_only_if_every_part_does(given_votes):
    whole = all_of(given_votes)
    assert (whole is False) == (False in given_votes)
    assert (whole is True) == (bool(given_votes) and set(given_votes) == {True})


@given(middle=st.floats(-5, 5), half=st.floats(0, 3), low=st.floats(-5, 5), width=st.floats(0, 5))
def test_within_is_sure_only_where_the_whole_interval_is_on_one_side(middle, half, low, width):
    told = within(Interval(middle, middle - half, middle + half), low, low + width)
    edges = [low <= x <= low + width for x in (middle - half, middle, middle + half)]
    if told is True:
        assert all(edges)
    if told is False:
        assert not any(edges)
    if told is None:
        assert not all(edges)


# --------------------------------------------------------------------------------- schema
def made():
    return Reproduction(
        paper="9",
        title="A paper",
        seed=1,
        runs=10,
        rows=(
            row(NUMBER, Interval(0.26, 0.24, 0.28), 10),
            row(NUMBER, Interval(math.nan, math.nan, math.nan), 10),
        ),
        claims=(Claim("1", "All is well.", "x < 1.", {"A": True}, "x = 0.9."),),
        errata=(Erratum("eq. 1", "a", "b", "tests/a.py::test_b"),),
    )


def test_a_quick_page_shows_the_png_that_is_kept_beside_it():
    """One drawing for both; a full page shows vectors instead."""
    from matplotlib.figure import Figure

    count = []

    def draw():
        count.append(1)
        figure = Figure(figsize=(3, 2))
        figure.subplots().plot([0.0, 1.0], [1.0, 0.0])
        return figure

    one = attrs.evolve(made(), pictures=(Picture("a", "title", "caption", "words", draw),))
    for quick, form in ((True, "png"), (False, "svg+xml")):
        text, files = write_up(one, {}, quick=quick)
        assert text.count(f'src="data:image/{form};base64,') == 1
        assert files["a"].startswith(b"\x89PNG")
        shown = base64.b64encode(files["a"]).decode()
        assert (shown in text) is quick
    assert len(count) == 2


def test_results_obey_their_schema_and_have_null_for_what_is_undefined():
    results = made().results({"tracker": "0"})
    check_results(results)
    assert results["rows"][1]["ours"] is None
    assert results["rows"][1]["ci95"] == [None, None]
    assert results["claims"][0]["evidence"] == "Rule: x < 1. Found: A: holds. x = 0.9."


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        (("rows", 0, "verdict"), "maybe", "verdict"),
        (("rows", 0, "ci95"), [0.1], "ci95"),
        (("rows", 0, "id"), "", "id"),
        (("rows", 0, "published"), "0.25", "published"),
        (("claims", 0, "verdict"), "reproduced", "confirmed"),
        (("errata", 0, "shown_by"), None, "shown_by"),
        (("seed",), True, "seed"),
        (("extra",), 1, "exactly"),
    ],
)
def test_results_that_break_the_schema_are_refused(place, value, said):
    results = copy.deepcopy(made().results({"tracker": "0"}))
    part = results
    for step in place[:-1]:
        part = part[step]
    part[place[-1]] = value
    with pytest.raises(ConfigError, match=said):
        check_results(results)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("title = 'no number'", "paper"),
        ("paper = '9'\ntitle = 't'\n[[published]]\nid = 'a'", "value"),
        ("paper = '9'\ntitle = 't'\n[[erratum]]\nid = 'a'\nwrong = 'b'", "wrong"),
        (
            "paper = '9'\ntitle = 't'\n"
            + 2 * "[[published]]\nid = 'a'\ntable = 't'\ncell = 'c'\nvalue = '1'\n",
            "twice",
        ),
        ("paper = '9'\ntitle = 't'\n[[published]]\nid='a'\ntable=''\ncell=''\nvalue='x'", "float"),
        (
            "paper = '9'\ntitle = 't'\n[[published]]\nid='a'\ntable=''\ncell=''\nvalue='1[2'",
            "float",
        ),
    ],
)
def test_data_of_a_paper_that_are_malformed_are_named(text, said):
    with pytest.raises(ConfigError, match=said):
        paper_from_toml(text)


# ------------------------------------------------------------------------------ resampling
@pytest.mark.statistical
def test_a_bootstrap_interval_covers_the_truth_as_often_as_it_says():
    """200 intervals of a median: 95 % of them should hold it; the bootstrap of 60 runs is near that.

    With a true coverage of at least 0.90, fewer than 160 of 200 hold with probability below 1e-5.
    """
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(200):
        found = bootstrap_interval(
            lambda a: np.median(a, axis=-1), rng.exponential(size=60), rng=rng, draws=400
        )
        held += found.low <= math.log(2.0) <= found.high
    assert held >= 160


@pytest.mark.statistical
def test_the_spread_of_a_mean_of_few_runs_holds_means_of_few_runs():
    """Of 400 means of 25 runs about 95 % fall inside; fewer than 350 with probability below 1e-8."""
    rng = np.random.default_rng(1)
    spread = spread_of_mean(rng.exponential(size=20_000), 25, rng=rng)
    means = rng.exponential(size=(400, 25)).mean(axis=1)
    assert np.sum((spread.low <= means) & (means <= spread.high)) >= 350


def test_paired_samples_keep_their_pairs_and_lose_runs_that_are_not_finite():
    rng = np.random.default_rng(2)
    below = rng.exponential(size=50) + 0.1
    above = 3.0 * below
    above[7] = np.nan
    ratio = ratio_of_medians(above, below, rng=rng)
    assert (ratio.value, ratio.low, ratio.high) == pytest.approx((3.0, 3.0, 3.0))
    with pytest.raises(ShapeError):
        ratio_of_medians(above, below[:-1], rng=rng)


def test_no_run_or_one_run_has_no_interval():
    rng = np.random.default_rng(3)
    assert math.isnan(spread_of_mean([], 5, rng=rng).value)
    one = bootstrap_interval(lambda a: a.mean(axis=-1), [2.0], rng=rng)
    assert one.value == 2.0
    assert math.isnan(one.low)
