"""Two boats in a harbour, measured: tracked as well as by an independent program, and judged honestly.

Expected: column "radar+lidar, global NN from a true start" of the baseline that came with the data (a
plain constant-velocity filter in NumPy), RMSE in metres of target 1 and 2. Its values are fixed, not
tuned: acceleration density 0.05 m^2/s^3, standard deviations 6 m (radar) and 2.5 m (lidar) per axis,
squared-distance gate 13.8, start covariance diag(10^2, 10^2, 1, 1).
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tracker.io.detections import read_detection_log
from tracker.metrics.tracking import TrackScore, score_tracks, true_start
from tracker.pipeline import Pipeline, PipelineHistory
from tracker_association import ChiSquareGate, GlobalNearestNeighbour
from tracker_kalman import ExtendedKalmanFilter
from tracker_motion import constant_velocity
from tracker_sensors import azimuth, relative_position

ROOT = Path(__file__).parents[2]
LOGS = {
    "02": ROOT / "examples/data/autoferry/scenario02",
    "13": ROOT / "tests/reference/data/autoferry/scenario13",
    "16": ROOT / "tests/reference/data/autoferry/scenario16",
}
BASELINE = {"02": (3.6, 8.0), "13": (2.9, 4.6), "16": (6.8, 2.8)}
SETS = {
    "radar and lidar": ("radar", "lidar"),
    "cameras only": ("eo", "ir"),
    "all four": ("radar", "lidar", "eo", "ir"),
}
CAMERA = azimuth(np.radians(2.5), convention="north")
SENSORS = {
    "radar": relative_position(6.0),
    "lidar": relative_position(2.5),
    "eo": CAMERA,
    "ir": CAMERA,
}


@cache
def tracked(scenario: str, sensors: str) -> tuple[PipelineHistory, tuple[TrackScore, ...]]:
    log = read_detection_log(LOGS[scenario], sensors=SETS[sensors])
    pipeline = Pipeline(
        motion=constant_velocity(0.05),
        sensors={name: SENSORS[name] for name in SETS[sensors]},
        filter=ExtendedKalmanFilter(),
        gate=ChiSquareGate(squared_distance=13.8),
        associator=GlobalNearestNeighbour(),
    )
    start = true_start(log.truth, pipeline.motion.space, seconds=3.0, sigma=(10.0, 10.0, 1.0, 1.0))
    history = pipeline.run(start, [scan for scan in log.scans if scan.t >= start.t])
    return history, score_tracks(history, [log.truth[name].at(history.t) for name in history.ids])


@pytest.mark.parametrize("scenario", LOGS)
def test_radar_and_lidar_follow_both_boats_as_well_as_the_baseline(scenario: str) -> None:
    _, scores = tracked(scenario, "radar and lidar")
    for score, baseline in zip(scores, BASELINE[scenario], strict=True):
        assert score.rmse <= 1.1 * baseline, f"boat {score.id} of scenario {scenario} is worse"


@pytest.mark.parametrize("scenario", LOGS)
def test_overconfidence_of_cameras_alone_is_said_in_words(scenario: str) -> None:
    _, scores = tracked(scenario, "cameras only")
    for score in scores:
        assert score.rmse > 20.0, "bearings of a ferry that hardly moves cannot do this well"
        assert score.words.startswith("overconfident: mean position NEES ")
        assert np.isfinite(score.nis)


@pytest.mark.parametrize("scenario", LOGS)
@pytest.mark.parametrize("sensors", SETS)
def test_every_track_stays_finite_and_no_detection_is_used_twice(
    scenario: str, sensors: str
) -> None:
    history, scores = tracked(scenario, sensors)
    assert np.isfinite(history.mean).all()
    np.testing.assert_array_equal(history.cov, history.cov.swapaxes(1, 2))
    assert np.linalg.eigvalsh(np.moveaxis(history.cov, 3, 1)).min() > 0.0
    both = (history.detection >= 0).all(axis=1)
    assert (history.detection[both, 0] != history.detection[both, 1]).all()
    assert np.isnan(history.nis[history.detection < 0]).all()
    assert all(0.0 < score.used < 1.0 for score in scores)
