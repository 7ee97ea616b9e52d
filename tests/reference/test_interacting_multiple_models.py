"""Interacting multiple models against histories computed by another program.

Its filters leave a component that a mode lacks out of the covariance of the mixture; with that convention
(``missing="common"``) means, covariances and mode probabilities agree to 1e-9, over KF, EKF and UKF.

Its smoothers run a second filter backwards in time, which begins at the last filtered estimate (so that the
last measurements count twice) and gives a component that a mode lacks zero mean and unit variance; ours use each
measurement once and follow one convention throughout. They are therefore compared by their errors: with
``missing="prior"``, where that component has unit variance too, ours are smaller. The modes are told apart as
well: mean squared error of the probability of the true one.
"""

import numpy as np
import pytest
from problems import DATA, Problem, fixed, measured, read

import tracker as tk
from tracker.models import ComponentMotion
from tracker_kalman import InteractingMultipleModels, ModeSmoother
from tracker_motion import constant_acceleration, constant_velocity, coordinated_turn, switching
from tracker_sensors import azimuth, position, stack


@pytest.fixture(params=["off", "on"], ids=["arrays", "compiled where possible"])
def interpretation(request, monkeypatch):
    monkeypatch.setenv("TRACKER_COMPILE", request.param)


both = pytest.mark.usefixtures("interpretation")


def accelerating_or_not() -> Problem:
    folder = DATA / "imm"
    motion = switching(
        [constant_velocity(0.01), constant_acceleration(1.0)],
        [[0.98, 0.02], [0.02, 0.98]],
        initial=[0.9, 0.1],
    )
    prior = tk.Gaussian([0.0, 0.0, 0.0, -1.0, 0.0, 0.0], np.diag([0.1] * 4 + [0.5] * 2))
    return Problem(folder, motion, position(np.sqrt(0.1)), prior, measured(folder), -0.1)


def turning_or_not() -> Problem:
    folder, dt = DATA / "botm", 0.1
    rows = [[0.0] * 5 for _ in range(5)]
    rows[4][4] = 0.15 * dt
    turn = coordinated_turn(0.0, 0.0)
    turn = ComponentMotion(
        name="turn", advance=turn.advance, noise=fixed(*map(tuple, rows)), space=turn.space
    )
    motion = switching(
        [constant_velocity(0.01), turn], [[0.9, 0.1], [0.1, 0.9]], initial=[0.95, 0.05]
    )
    places = (-0.5, 3.5), (-0.5, -3.5), (7.0, -3.5), (7.0, 3.5)
    sensor = stack([azimuth(0.1).at(sx=x, sy=y) for x, y in places])
    prior = tk.Gaussian([0.0, 0.0, 1.0, 0.0, 0.0], np.diag([0.1] * 4 + [1.0]))
    return Problem(folder, motion, sensor, prior, measured(folder), -dt)


def error(problem: Problem, mean) -> float:
    truth = read(problem.folder / "truth.csv.gz")[:, 1:3]
    return float(np.sqrt(((mean[:, :2] - truth) ** 2).sum(axis=1).mean()))


CASES = [
    (accelerating_or_not, "kf", "imm", (1, 2)),
    (accelerating_or_not, "ekf1", "imm", (1, 2)),
    (turning_or_not, "ekf1", "eimm", (1, 2)),
    (turning_or_not, "ukf_general", "uimm", (3, 4)),
]


@both
@pytest.mark.parametrize(("make", "rule", "table", "columns"), CASES)
def test_filters_of_modes_agree(make, rule, table, columns):
    problem = make()
    history = problem.run(InteractingMultipleModels(rule, missing="common"))
    problem.agrees(history.filtered, table)


@pytest.mark.parametrize(("make", "rule", "table", "columns"), CASES)
def test_mode_probabilities_agree(make, rule, table, columns):
    problem = make()
    rule = InteractingMultipleModels(rule, missing="common")
    kept = problem.run(rule, ModeSmoother()).beliefs
    ours = np.array([belief.probabilities for belief in kept.filtered])
    theirs = read(problem.folder / "mode_prob.csv.gz")[:, columns]
    assert np.abs(ours - theirs).max() < 1e-9


BANDS = [
    (accelerating_or_not, "ekf1", 0.216),
    (turning_or_not, "ekf1", 0.363),
    (turning_or_not, "ukf_general", 0.324),
]


@pytest.mark.parametrize(("make", "rule", "theirs"), BANDS)
def test_what_a_mode_lacks_may_be_zero_or_as_in_the_prior_with_no_larger_errors(make, rule, theirs):
    problem = make()
    for missing in ("zero", "prior"):
        ours = error(
            problem, problem.run(InteractingMultipleModels(rule, missing=missing)).filtered.mean
        )
        assert ours < theirs + 0.0005, f"missing={missing!r}: {ours:.4f}"


SMOOTHED = [("ekf1", "eimm_smooth", 0.150, 5), ("ukf_general", "uimm_smooth", 0.124, 7)]


@pytest.mark.parametrize(("rule", "table", "theirs", "column"), SMOOTHED)
def test_smoothed_errors_and_modes_are_no_worse(rule, table, theirs, column):
    problem = turning_or_not()
    history = problem.run(InteractingMultipleModels(rule, missing="prior"), ModeSmoother())
    assert error(problem, history.smoothed.mean) < theirs
    _, modes = ModeSmoother().modes(history, problem.motion)
    straight = read(problem.folder / "truth.csv.gz")[:, 6] == 1
    told = read(problem.folder / "mode_prob.csv.gz")

    def score(probability) -> float:
        return float(np.mean((probability - straight) ** 2))

    ours = score(np.array([belief.probabilities[0] for belief in modes]))
    before = score(np.array([b.probabilities[0] for b in history.beliefs.filtered]))
    assert ours < score(told[:, column]) + 0.005
    assert ours < 0.75 * before
