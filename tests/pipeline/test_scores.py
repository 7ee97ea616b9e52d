"""Scores of tracks against known targets: the numbers, and the words for them."""

import attrs
import numpy as np
import pytest

from tracker.errors import DomainError, ShapeError
from tracker.io.detections import TruthTrack
from tracker.metrics.tracking import score_tracks, true_start
from tracker.pipeline import PipelineHistory
from tracker.types import PLANAR, SPATIAL, Array, Space

RNG = np.random.default_rng(3)
SCANS = 400


def history(sigma: float = 1.0, nis: float = 2.0) -> tuple[PipelineHistory, list[Array]]:
    """Two standing tracks of unit covariance whose true errors have deviation ``sigma``."""
    truth = [np.full((2, SCANS), 10.0), np.full((2, SCANS), -10.0)]
    mean = np.zeros((SCANS, 4, 2))
    mean[:, :2] = np.stack(truth, axis=-1).swapaxes(0, 1) + RNG.normal(0, sigma, (SCANS, 2, 2))
    detection = np.zeros((SCANS, 2), dtype=np.intp)
    detection[::4, 1] = -1
    values = np.full((SCANS, 2), nis)
    made = PipelineHistory(
        t=np.arange(float(SCANS)),
        sensor=("radar",) * SCANS,
        mean=mean,
        cov=np.broadcast_to(np.eye(4)[:, :, None], (SCANS, 4, 4, 2)),
        detection=detection,
        residual=np.zeros((SCANS, 2, 2)),
        nis=np.where(detection < 0, np.nan, values),
        count=np.where(detection < 0, 0, 2),
        seconds=np.full(SCANS, 1e-4),
        ids=("one", "two"),
    )
    return made, truth


def test_a_consistent_track_is_called_so() -> None:
    one, two = score_tracks(*history())
    assert (one.id, two.id) == ("one", "two")
    assert one.rmse == pytest.approx(np.sqrt(2.0), rel=0.1)
    assert one.nees == pytest.approx(2.0, rel=0.2)
    assert (one.nis, one.used, two.used) == (2.0, 1.0, 0.75)
    assert one.seconds == pytest.approx(1e-4)
    assert one.verdict == two.verdict == "consistent"
    assert one.nis_band.high < two.nis_band.high, "fewer scans used, a wider band"


def test_overconfidence_is_said_in_words_whichever_statistic_shows_it() -> None:
    wrong, _ = score_tracks(*history(sigma=5.0, nis=1.0))
    assert wrong.words.startswith("overconfident: mean position NEES")
    assert "above the 95 % band [0.0506, 7.38]; mean NIS 1 below" in wrong.words
    surprised, _ = score_tracks(*history(nis=4.1))
    assert surprised.verdict == "overconfident"
    assert "mean NIS 4.1 above the 95 % band [1.8" in surprised.words


def test_too_little_confidence_is_said_too() -> None:
    score, _ = score_tracks(*history(nis=0.5))
    assert score.verdict == "underconfident"


def test_small_residuals_do_not_acquit_large_errors() -> None:
    score, _ = score_tracks(*history(sigma=1.8, nis=0.5))
    assert 2.0 < score.nees < 7.38
    assert score.verdict == "mixed"


def test_only_the_span_of_the_truth_is_judged() -> None:
    made, truth = history()
    made.mean[300:] += 1000.0
    for path in truth:
        path[:, 300:] = np.nan
    assert all(score.rmse < 2.0 for score in score_tracks(made, truth))
    lost, _ = score_tracks(made, [np.full((2, SCANS), np.nan)] * 2)
    assert np.isnan(lost.rmse)
    assert lost.words.startswith("undefined: mean position NEES undefined; mean NIS 2 inside")


def test_a_track_that_diverged_is_not_scored_by_what_is_left_of_it() -> None:
    made, truth = history()
    made.mean[350:, :, 0] = np.nan
    made.nis[350:, 0] = np.nan
    lost, other = score_tracks(made, truth)
    assert np.isnan([lost.rmse, lost.nis, lost.nees]).all()
    assert lost.verdict == "undefined"
    assert other.verdict == "consistent"


def test_truth_that_does_not_fit_is_refused() -> None:
    made, truth = history()
    for wrong in (truth[:1], [path[:, :5] for path in truth], [path.T for path in truth]):
        with pytest.raises(ShapeError, match=r"2 paths of shape \(2, 400\)"):
            score_tracks(made, wrong)
    with pytest.raises(ShapeError, match="no batch axes"):
        score_tracks(attrs.evolve(made, mean=made.mean[..., None]), truth)


def test_a_true_start_is_the_line_through_the_first_fixes_that_all_paths_have() -> None:
    t = np.linspace(0.0, 20.0, 201)
    bent = np.where(t > 8.0, 50.0, 2.0 * t)
    truth = {"x": TruthTrack(t, [bent, 5.0 - t]), "y": TruthTrack(t[50:], [t[50:], -t[50:]])}
    start = true_start(truth, PLANAR, seconds=3.0, sigma=(10.0, 10.0, 1.0, 1.0))
    assert start.t == pytest.approx(5.0)
    assert start.ids == ("x", "y")
    expected = [[10.0, 5.0], [0.0, -5.0], [2.0, 1.0], [-1.0, -1.0]]
    np.testing.assert_allclose(start.state.mean, expected, atol=1e-9)
    np.testing.assert_array_equal(start.state.cov[..., 1], np.diag([100.0, 100.0, 1.0, 1.0]))
    solid = true_start(truth, SPATIAL, seconds=3.0, sigma=(1.0,) * 6)
    assert solid.state.mean[[2, 5]].tolist() == [[0.0, 0.0]] * 2


def test_a_start_needs_two_fixes_and_a_velocity() -> None:
    t = np.arange(10.0)
    truth = {"x": TruthTrack(t, [t, t]), "y": TruthTrack(t + 100.0, [t, t])}
    with pytest.raises(DomainError, match=r"the truth of 'x': got 0 fixes from 100.0 s to 103.0 s"):
        true_start(truth, PLANAR, seconds=3.0, sigma=(1.0,) * 4)
    with pytest.raises(DomainError, match="'vx'"):
        true_start({"x": truth["x"]}, Space.of("x [m]", "y [m]"), seconds=3.0, sigma=(1.0, 1.0))
