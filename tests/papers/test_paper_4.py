"""Paper 4 from one command; its claims' rules on numbers made up for them; tuning and indices by hand."""

import ast
import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import tracker as tk
from tracker.cli import main
from tracker.reproduction import check_results
from tracker_papers.flying_object import flying_object
from tracker_papers.paper4 import claims, methods, tables, tuning
from tracker_papers.paper4.scores import cross_mismatch, measured, mismatch, rms
from tracker_papers.paper4.study import PaperFour
from tracker_papers.underwater_multipath import underwater_multipath

ROOT = Path(__file__).parents[2]
PAPER = PaperFour().paper


def rng():
    return np.random.default_rng(0)


# ------------------------------------------------------------------------------- the command
@pytest.fixture(scope="module")
def told(tmp_path_factory):
    out = tmp_path_factory.mktemp("paper4")
    arguments = ["reproduce", "4", "--out", str(out), "--quick", "--runs", "12", "--seed", "5"]
    return CliRunner().invoke(main, arguments, catch_exceptions=False), out


def test_the_command_gives_a_verdict_for_every_cell_claim_and_erratum(told):
    result, out = told
    assert result.exit_code == 0, result.output
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    check_results(results)
    assert (results["paper"], results["seed"], results["runs"]) == ("4", 5, 12)
    assert [one["id"] for one in results["rows"]] == [one.id for one in PAPER.published]
    assert [one["id"] for one in results["claims"]] == ["1a", "1b", "1c", *"234567"]
    assert [one["id"] for one in results["errata"]] == [one.id for one in PAPER.errata]
    assert all(np.isfinite(one["ours"]) for one in results["rows"])


def test_every_figure_of_the_thesis_is_remade_or_named_as_left_out(told):
    _, out = told
    files = {path.stem for path in (out / "figures").glob("*.png")}
    report = (out / "report.html").read_text(encoding="utf-8")
    assert report.count("<img") == len(files)
    assert "http" not in report.replace("http-equiv", "")
    numbers = set()
    for words in re.findall(r"Figure ([0-9][0-9to ,\-]*)\. ", report):
        for part in words.split(","):
            ends = [int(end.split("-")[1]) for end in part.split(" to ")]
            chapter = part.strip()[0]
            numbers |= {(chapter, k) for k in range(ends[0], ends[-1] + 1)}
    listed = {("3", k) for k in range(7, 32)}
    listed |= {("4", k) for k in [1, 2, *range(4, 22)]}
    listed |= {("5", 1), *(("5", k) for k in range(3, 34))}
    assert numbers == listed
    note = next(note for note in tables.NOTES if note.startswith("Figures left out"))
    assert note in report
    left = {
        (chapter, k)
        for chapter, first, last in re.findall(r"(\d)-(\d+)(?: to \d-(\d+))?", note)
        for k in range(int(first), int(last or first) + 1)
    }
    last = {"3": 31, "4": 21, "5": 33}
    assert numbers | left == {(chapter, k) for chapter, n in last.items() for k in range(1, n + 1)}
    assert not numbers & left


def test_the_tables_hold_every_method_beside_the_others(told):
    _, out = told
    names = (
        "ekf", "ukf", "true", "hand", "fuzzy", "tuned on error", "fuzzy UKF", "fuzzy Q", "fuzzy R and Q",
        "network by hand", "network", "EM", *methods.BASELINES, *methods.WRAPPED,
    )  # fmt: skip
    for table in ("best_where", "best_where_fair"):
        best = (out / "tables" / f"{table}.csv").read_text(encoding="utf-8")
        for label in map(tables.label_of, names):
            assert best.count(f",{label},") + best.count(f',"{label}",') == 4, (table, label)


def test_the_same_seed_gives_the_same_results(told):
    _, out = told
    again = PaperFour().run(runs=12, seed=5, quick=True, progress=lambda *_: None)
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    assert json.loads(json.dumps(again.results(results["versions"]))) == results


def test_every_test_that_shows_an_erratum_exists_and_belongs_to_one():
    file = "tests/papers/test_paper_4_errata.py"
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    tests = {f"{file}::{n.name}" for n in tree.body if getattr(n, "name", "").startswith("test_")}
    assert tests == {name for erratum in PAPER.errata for name in erratum.shown_by.split()}


# ---------------------------------------------------------------------------- published data
def test_every_cell_is_what_the_extracted_signs_allow():
    """Cells hold the signs as extracted: 2 is 2 or 5, a point is 6, one 0 the decimal mark."""
    for one in PAPER.published:
        raw = re.search(r"printed ([0-9.]+)\)", one.cell).group(1)
        signs = {"2": "25", ".": "6"}
        for value in one.values:
            digits = f"{value:.10f}".rstrip("0").rstrip(".")
            text = one.text if "[" not in one.text else None
            shown = text or digits
            decimals = len(re.sub(r"\[\d+\]", "0", one.text).partition(".")[2])
            shown = f"{value:.{decimals}f}"
            marks = shown.replace(".", "0") if "." in shown else shown
            assert len(marks) == len(raw), (one.id, shown, raw)
            for sign, digit in zip(raw, marks, strict=True):
                assert digit in signs.get(sign, sign), (one.id, shown, raw)


def test_there_is_a_number_for_every_surviving_cell():
    count = {}
    for one in PAPER.published:
        table = one.id.split("/")[0]
        count[table] = count.get(table, 0) + 1
    assert count == {
        "table3-1": 26, "table3-2": 9, "table3-3": 26, "table3-4": 3,
        "table4-1": 21, "table5-1": 21, "table5-2": 21, "table5-3": 21,
    }  # fmt: skip


# ---------------------------------------------------------------------------------- indices
@pytest.fixture(scope="module")
def history():
    scene = flying_object()
    made = scene.simulate(2, 3)
    return tk.filter(methods.estimator(scene, "kf"), made.record, made.prior, start=made.start)


def test_the_mismatch_is_that_of_a_loop_over_the_window(history):
    found, cross = mismatch(history), cross_mismatch(history)
    v, S = np.asarray(history.innovation.residual), np.asarray(history.innovation.S)
    for k in (24, 25, 100, 499):
        window = v[k - 24 : k + 1]
        sample = np.einsum("ti...,tj...->ij...", window, window) / 25
        for i in range(2):
            np.testing.assert_allclose(found.dom[k, i], S[k, i, i] - sample[i, i], atol=1e-9)
        np.testing.assert_allclose(cross[k], S[k, 0, 1] - sample[0, 1], atol=1e-9)
    assert not found.sample[:24].any()
    assert not found.dom[:24].any()
    np.testing.assert_array_equal(found.dom_from_the_start[:24], found.theory[:24])


def test_the_mismatch_is_the_adapters_own(history):
    mismatches = pytest.importorskip("tracker_adaptive.mismatch")
    theirs = mismatches.degree_of_mismatch(history.innovation)
    np.testing.assert_allclose(
        mismatch(history).dom_from_the_start, np.einsum("tii...->ti...", theirs.dom), atol=1e-9
    )


def test_the_noise_that_was_used_is_found_again():
    scene = underwater_multipath()
    hand = methods.estimator(scene, "ekf1", methods.fuzzy_r(scene))
    found = measured(scene, {"plain": methods.estimator(scene, "ekf1"), "hand": hand}, 4, 1)
    np.testing.assert_allclose(found["plain"].late_R, 1e-3, rtol=1e-9)
    assert (np.abs(found["hand"].late_R / np.array([[1e-4], [1e-2]] * 2) - 1.0) < 1.0).all()


def test_j1_is_the_root_mean_square_of_the_noise():
    scene = flying_object()
    found = measured(scene, {}, 100, 1).j1
    # 500 squares in each of 100 runs: five standard errors of their mean
    np.testing.assert_allclose(np.mean(found**2, axis=1), (0.8, 9.0), rtol=5 * np.sqrt(2 / 50_000))


def test_runs_do_not_depend_on_their_company():
    scene = flying_object()
    made = {"kf": methods.estimator(scene, "kf")}
    many = measured(scene, made, 150, 1)["kf"].rmse  # more than a tile
    np.testing.assert_array_equal(many[:, [3, 140]], measured(scene, made, [3, 140], 1)["kf"].rmse)


# ------------------------------------------------------------------------------ under water
def test_a_fair_start_holds_the_truth_and_makes_who_knows_the_noise_consistent():
    """NEES / n of 64 runs of 100 steps is 3 and more as the thesis begins; begun fairly, within 0.3 of 1.

    The start is one and the same in all runs: a spread of NEES / n of 0.1, and three of it.
    """
    scene = underwater_multipath(told=True, steps=100)
    fair = methods.fairly_begun(scene)
    off = scene.start - fair.prior.mean
    assert (off**2 <= np.diag(fair.prior.cov)).all()
    found = [
        measured(one, {"true": methods.estimator(one, "ekf1")}, 64, 1)["true"].nees.mean()
        for one in (scene, fair)
    ]
    assert found[0] > 3.0
    assert found[1] == pytest.approx(1.0, abs=0.3)


def test_the_likeliest_noise_of_runs_without_their_truth_is_the_true_one():
    """10 runs of 200 steps: 2,000 squares have a standard error of 3.2 %; 20 % is six of it."""
    scene = underwater_multipath(steps=200)
    R = methods.likeliest_noise(scene, scene.simulate(3, 10))
    np.testing.assert_allclose(np.diag(R), tuning.true_variances(scene, "R"), rtol=0.2)
    np.testing.assert_array_equal(R, np.diag(np.diag(R)))


# ----------------------------------------------------------------------------------- tuning
def small(objective="dom", restarts=3):
    scene = flying_object()
    made = tuning.problem(
        scene, "kf", methods.fuzzy_r(scene), restarts, 1, shared=(0, 1), objective=objective
    )
    return scene, made


def test_the_cost_of_a_population_is_that_of_each_run_by_itself():
    scene, asked = small()
    draw = np.random.default_rng(3).uniform(size=(30, 4, 3))
    low, high = asked.bounds.T[..., None, None]
    x = low + draw * (high - low)
    whole = asked.cost(x)
    for individual, restart in ((0, 0), (3, 2), (1, 1)):
        made = scene.simulate(1, [restart], condition=tuning.TRAINING)
        one = asked.estimator(x[:, individual, restart])
        alone = tk.filter(one, made.record, made.prior, start=made.start)
        cost = 1000.0 * rms(mismatch(alone).dom).sum(axis=0)
        np.testing.assert_allclose(whole[individual, restart], cost[0], rtol=1e-9)


def test_rules_by_hand_are_the_adapter_by_hand():
    scene, asked = small()
    by_hand = methods.by_hand(methods.HAND, 2)
    named = {"numbers": asked.estimator(by_hand)}
    named["adapter"] = methods.estimator(scene, "kf", methods.fuzzy_r(scene))
    found = measured(scene, named, 5, 2)
    np.testing.assert_allclose(found["numbers"].rmse, found["adapter"].rmse, rtol=1e-9)


def test_tuning_finds_less_than_its_first_guess_with_the_same_budget_for_all():
    _, asked = small()
    found = tuning.tune(asked, tuning.OPTIMISERS, population=10, generations=6, seed=4)
    assert found.evaluations == 60
    for name in tuning.OPTIMISERS:
        history = found.history[name]
        assert (np.diff(history, axis=0) <= 0.0).all()
        assert (history[-1] <= history[0]).all()
        assert (history[-1] < history[0]).any()
        np.testing.assert_array_equal(found.cost[name], history[-1])
        np.testing.assert_allclose(
            asked.cost(found.numbers[name][:, None])[0], found.cost[name], rtol=1e-12
        )
        low, high = asked.bounds.T[..., None]
        assert ((found.numbers[name] >= low) & (found.numbers[name] <= high)).all()


def test_answers_keep_the_sign_of_their_rule_within_the_bounds():
    bounds = methods.bounds(np.array([4.0]))
    assert bounds.shape == (15, 2)
    assert (bounds[:, 0] < bounds[:, 1]).all()
    increase, decrease = bounds[10:12], bounds[13:15]
    assert (increase >= 0.0).all()
    assert (decrease <= 0.0).all()
    hand = methods.by_hand(0.25, 1)
    assert ((bounds[:, 0] <= hand) & (hand <= bounds[:, 1]))[:5].all()


# ----------------------------------------------------------------- rules on made-up numbers
def runs_of(scale, count=400):
    return scale * np.exp(0.2 * np.random.default_rng(1).normal(size=count))


def states(*scales):
    return np.stack([runs_of(s) for s in scales])


def costs(ga, pso, ica, count=30):
    noise = np.random.default_rng(2)
    base = 1000.0 + 100.0 * noise.normal(size=count)
    return {
        name: base + shift + noise.normal(size=count)
        for name, shift in (("ga", ga), ("pso", pso), ("ica", ica))
    }


@pytest.mark.parametrize(("tuned", "word"), [(0.5, "confirmed"), (1.5, "refuted")])
def test_claim_1a_asks_for_gain_in_every_state(tuned, word):
    rmse = {"kf": states(1, 1, 1)} | {n: states(tuned, tuned, tuned) for n in ("ga", "pso", "ica")}
    assert claims.fuzzy_beats(PAPER, {"R": rmse, "Q": rmse}, rng()).verdict == word
    one = rmse | {"ga": states(tuned, 1.5, tuned)}
    assert claims.fuzzy_beats(PAPER, {"R": one, "Q": rmse}, rng()).verdict != "confirmed"


@pytest.mark.parametrize(
    ("order", "word"),
    [
        ((20.0, 10.0, 0.0), "confirmed"),
        ((0.0, 0.0, 0.0), "undecided"),
        ((0.0, 10.0, 20.0), "refuted"),
    ],
)
def test_claims_1b_and_1c_ask_for_the_order(order, word):
    ranked = {"R": costs(*order), "Q": costs(*order)}
    for name in ("1b", "1c"):
        assert claims.in_order(PAPER, name, ranked).verdict == word


def test_a_ranking_needs_every_step_of_the_order():
    assert claims.ranking(costs(20.0, 10.0, 0.0))[0] is True
    assert claims.ranking(costs(10.0, 10.0, 0.0))[0] is None
    assert claims.ranking(costs(20.0, 0.0, 10.0))[0] is False
    same = dict.fromkeys(("ga", "pso", "ica"), np.arange(10.0))
    assert claims.signed_rank(same["ga"], same["pso"]) == (1.0, 1.0)


@pytest.mark.parametrize(("factors", "word"), [((2.0, 1.2), "confirmed"), ((1.2, 2.0), "refuted")])
def test_claim_2_compares_the_factors_of_both_experiments(factors, word):
    r, q = factors
    rmse = {
        "R": {"kf": states(r, r, q), "ica": states(1, 1, 1)},
        "Q": {"kf": states(q, q, r), "ica": states(1, 1, 1)},
    }
    assert claims.measurement_rather_than_process(PAPER, rmse, rng()).verdict == word


@pytest.mark.parametrize(
    ("scales", "word"),
    [((0.5, 0.8, 1.0), "confirmed"), ((0.5, 1.0, 1.0), "refuted"), ((1.2, 1.1, 1.0), "refuted")],
)
def test_claim_3_asks_for_the_order_of_three_filters(scales, word):
    place = {
        table: {name: runs_of(s) for name, s in zip(("fuzzy", "ukf", "ekf"), scales, strict=True)}
        for table in ("Table 4-1", "Table 5-1")
    }
    assert claims.fuzzy_then_unscented_then_extended(PAPER, place, rng()).verdict == word


@pytest.mark.parametrize(
    ("left", "reached", "word"),
    [(0.01, 1.0, "confirmed"), (0.5, 1.0, "refuted"), (0.01, 2.0, "refuted")],
)
def test_claim_4_asks_for_no_mismatch_and_a_good_r(left, reached, word):
    late = {
        "here": {"plain": states(5, 5), "dom": left * states(5, 5), "R": states(reached, reached)}
    }
    assert claims.mismatch_vanishes(PAPER, late, rng()).verdict == word


@pytest.mark.parametrize(
    ("scales", "word"), [((9, 3, 1), "confirmed"), ((1, 3, 9), "refuted"), ((9, 3, 3), "refuted")]
)
def test_claim_5_asks_for_improvement_at_every_step(scales, word):
    x1 = dict(zip(("static", "constant", "manoeuvring"), map(runs_of, scales), strict=True))
    assert claims.motion_helps(PAPER, {"ekf": x1, "fuzzy": x1}, rng()).verdict == word


@pytest.mark.parametrize(("early", "word"), [(0.2, "confirmed"), (0.9, "refuted")])
def test_claim_6_looks_75_steps_after_the_start(early, word):
    error = np.tile(runs_of(10.0), (200, 1))
    fuzzy = error.copy()
    fuzzy[claims.SOON - 1 :] *= early
    by = {"here": {"ekf": error, "fuzzy": fuzzy}}
    assert claims.jumps_soon(PAPER, by, rng()).verdict == word


@pytest.mark.parametrize(("error", "word"), [(0.02, "confirmed"), (0.5, "refuted")])
def test_claim_7_asks_for_errors_small_against_the_distance(error, word):
    assert claims.tracked_in_large_noise(PAPER, {"here": runs_of(error)}).verdict == word
    lost = np.full(50, np.nan)
    assert claims.tracked_in_large_noise(PAPER, {"here": lost}).verdict == "refuted"


def test_a_share_of_all_is_not_known_to_be_all():
    few = claims._share(np.ones(10))
    assert few.value == 1.0
    assert few.low < 0.8


def test_a_statistic_of_fifteen_restarts_lies_within_those_there_are():
    values = np.random.default_rng(0).normal(1000.0, 50.0, size=30)
    for what in ("best", "mean", "worst"):
        found = tables._of_fifteen(values, what, rng())
        assert values.min() <= found.low <= found.value <= found.high <= values.max()


# -------------------------------------------------------------------------------- the numbers
@pytest.mark.statistical
def test_the_fuzzy_filter_agrees_with_an_independent_trial():
    """An independent program with the same rules by hand and R = diag(0.8, 9): 20 runs, spread 10 %.

    The medians of 120 of ours are within 15 % of its, four standard errors of both.
    """
    scene, right = flying_object(), flying_object(told=True)
    made = methods.linear_estimators(scene, right, methods.fuzzy_r(scene))
    found = measured(scene, made, 120, 3)
    np.testing.assert_allclose(found["hand"].rmse.mean(axis=1), (0.318, 0.388, 0.215), rtol=0.15)
    assert np.mean(found["kf"].cost()) == pytest.approx(15_280, rel=0.1)
    assert np.mean(found["true"].cost()) == pytest.approx(2_720, rel=0.15)
