"""KF, EKF1 and their smoothers against histories computed by another program, to 1e-9."""

import csv
import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tracker as tk
from tracker.models import ComponentMotion
from tracker.types import Array
from tracker_motion import constant_velocity
from tracker_sensors import azimuth, position, stack

DATA = Path(__file__).parent / "data"
TOLERANCE = 1e-9


@pytest.fixture(params=["off", "on"], ids=["arrays", "compiled where possible"])
def interpretation(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TRACKER_COMPILE", request.param)


both = pytest.mark.usefixtures("interpretation")


def read(path: Path) -> Array:
    """The numbers of a table below its header line."""
    with gzip.open(path, "rt") if path.suffix == ".gz" else path.open() as file:
        rows = list(csv.reader(file))[1:]
    return np.array(rows, dtype=np.float64)


def moments(path: Path, n: int) -> tuple[Array, Array]:
    """Means ``(T, n)`` and covariances ``(T, n, n)`` from rows of t, mean, upper triangle."""
    table = read(path)
    upper = np.triu_indices(n)
    cov = np.empty((len(table), n, n))
    cov[:, upper[0], upper[1]] = cov[:, upper[1], upper[0]] = table[:, 1 + n :]
    return table[:, 1 : 1 + n], cov


def two_bearings(seed: str) -> tuple[tk.Estimator, tk.Record, tk.Gaussian, float]:
    table = read(DATA / "bot_reference" / seed / "meas.csv.gz")
    sensor = stack([azimuth(0.05).at(sx=-1.0, sy=-2.0), azimuth(0.05).at(sx=1.0, sy=1.0)])
    estimator = tk.estimator("ekf1", motion=constant_velocity(0.1), sensor=sensor, smoother="rts")
    prior = tk.Gaussian(np.zeros(4), np.diag([0.1, 0.1, 10.0, 10.0]))
    return estimator, tk.Record(table[:, 0], table[:, 1:]), prior, 0.0


def white_jerk() -> ComponentMotion:
    """Constant acceleration with the noise matrix that the other program was given."""
    noise = tuple(map(tuple, read_matrix("kfcwpa", "Q")))

    def advance(x: Any, y: Any, vx: Any, vy: Any, ax: Any, ay: Any, *, dt: Any) -> Any:
        half = 0.5 * dt * dt
        return (
            x + dt * vx + half * ax,
            y + dt * vy + half * ay,
            vx + dt * ax,
            vy + dt * ay,
            ax,
            ay,
        )

    return ComponentMotion(
        name="white_jerk",
        advance=advance,
        noise=lambda: noise,
        space=tk.Space.of("x [m]", "y [m]", "vx [m/s]", "vy [m/s]", "ax [m/s^2]", "ay [m/s^2]"),
    )


def read_matrix(folder: str, name: str) -> list[list[float]]:
    return read(DATA / folder / f"{name}.csv").tolist()


def accelerating() -> tuple[tk.Estimator, tk.Record, tk.Gaussian, float]:
    table = read(DATA / "kfcwpa" / "meas.csv.gz")
    estimator = tk.estimator(
        "kf", motion=white_jerk(), sensor=position(np.sqrt(10.0)), smoother="rts"
    )
    prior = tk.Gaussian(np.zeros(6), np.diag([0.1, 0.1, 0.1, 0.1, 0.5, 0.5]))
    # The other program predicts before the first row too.
    return estimator, tk.Record(table[:, 0], table[:, 1:]), prior, float(table[0, 0]) - 0.5


def as_it_is(record: tk.Record) -> tk.Record:
    return record


def spread(batch: tuple[int, ...]) -> Callable[[tk.Record], tk.Record]:
    """The same measurements in the last lane; other ones in the others."""

    def over_lanes(record: tk.Record) -> tk.Record:
        rng = np.random.default_rng(5)
        z = record.z.reshape(*record.z.shape, *(1,) * len(batch))
        z = z + 0.01 * rng.standard_normal((*record.z.shape, *batch))
        z[(..., *(-1,) * len(batch))] = record.z
        return tk.Record(record.t, z)

    return over_lanes


SHAPES = {
    "one run": (as_it_is, ()),
    "one of eight lanes": (spread((8,)), (-1,)),
    "one of a grid of lanes": (spread((2, 3)), (-1, -1)),
}
shapes = pytest.mark.parametrize("shape", SHAPES)


def check(trajectory: tk.Trajectory, lane: tuple[int, ...], path: Path, what: str) -> None:
    mean, cov = moments(path, trajectory.mean.shape[1])
    for label, ours, theirs in (
        ("means", trajectory.mean[(..., *lane)], mean),
        ("covariances", trajectory.cov[(..., *lane)], cov),
    ):
        difference = np.abs(ours - theirs).max()
        assert difference < TOLERANCE, f"{what} {label} differ by {difference:.1e} from {path.name}"


@both
@pytest.mark.parametrize("seed", ["seed1", "seed2", "seed3"])
@shapes
def test_ekf1_and_rts_on_two_bearings_agree(seed: str, shape: str) -> None:
    estimator, record, prior, start = two_bearings(seed)
    change, lane = SHAPES[shape]
    history = tk.smooth(estimator, change(record), prior, start=start)
    assert history.smoothed is not None
    folder = DATA / "bot_reference" / seed
    check(history.filtered, lane, folder / "ekf1.csv.gz", "filtered")
    check(history.smoothed, lane, folder / "ekf1_rts.csv.gz", "smoothed")


@both
@shapes
def test_kf_and_rts_on_an_accelerating_target_agree(shape: str) -> None:
    estimator, record, prior, start = accelerating()
    change, lane = SHAPES[shape]
    history = tk.smooth(estimator, change(record), prior, start=start)
    assert history.smoothed is not None
    folder = DATA / "kfcwpa"
    check(history.filtered, lane, folder / "kf.csv.gz", "filtered")
    check(history.smoothed, lane, folder / "kf_rts.csv.gz", "smoothed")
    check(history.smoothed, lane, folder / "kf_tf.csv.gz", "two-filter smoothed")


@both
@pytest.mark.parametrize("name", ["ekf1", "ekf1_joseph"])
def test_an_extended_filter_on_a_linear_problem_is_the_kalman_filter(name: str) -> None:
    estimator, record, prior, start = accelerating()
    other = tk.estimator(name, motion=estimator.motion, sensor=estimator.sensors[0])
    filtered = tk.filter(other, record, prior, start=start).filtered
    check(filtered, (), DATA / "kfcwpa" / "kf.csv.gz", f"{name} filtered")


def test_on_arrays_the_step_on_line_is_the_filter_of_the_record(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("TRACKER_COMPILE", "off")
    estimator, record, prior, start = two_bearings("seed1")
    history = tk.filter(estimator, record, prior, start=start)
    state, before = prior, start
    for k, now in enumerate(record.t.tolist()):
        state, innovation = estimator.step(state, record.z[k], now - before)
        before = now
        assert np.array_equal(state.mean, history.filtered.mean[k]), f"means differ at step {k}"
        assert np.array_equal(state.cov, history.filtered.cov[k]), f"covariances differ at step {k}"
        assert innovation.nis == history.innovation.nis[k], f"NIS differs at step {k}"


def test_the_motion_models_are_those_of_the_other_program() -> None:
    F = constant_velocity(0.1).jacobian(np.zeros(4), 0.01)
    Q = constant_velocity(0.1).Q(np.zeros(4), 0.01)
    assert np.allclose(F, read_matrix("bot_reference", "A"), rtol=0, atol=1e-15)
    assert np.allclose(Q, read_matrix("bot_reference", "Q"), rtol=0, atol=1e-15)
    assert np.allclose(
        white_jerk().jacobian(np.zeros(6), 0.5), read_matrix("kfcwpa", "A"), rtol=0, atol=1e-15
    )
