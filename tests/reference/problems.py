"""Estimation problems that other programs have solved too: models, records, and how to compare.

The numbers of those programs are in ``data``, with a README each; tests import this module by its
name. What is compared, and why something differs on purpose, belongs in the tests.
"""

import csv
import gzip
from pathlib import Path
from typing import Any

import attrs
import numpy as np

import tracker as tk
from tracker.models import ComponentMotion, ComponentSensor, atan2, cos, exp, hypot, sin
from tracker.types import Array
from tracker_motion import constant_velocity
from tracker_sensors import azimuth, position, stack

DATA = Path(__file__).parent / "data"
TOLERANCE = 1e-9


@attrs.frozen(eq=False)
class Problem:
    """Models, prior and record of a problem; ``folder`` holds what other programs computed."""

    folder: Path
    motion: Any
    sensor: Any
    prior: tk.Gaussian
    record: tk.Record
    start: float
    """Time of the prior: that of the first row less one step, where it is predicted to, too."""

    def run(self, rule: Any, smoother: Any = None, record: tk.Record | None = None) -> tk.History:
        """What our filter, an object or a name, makes of it; smoothed too if asked for."""
        estimator = tk.estimator(rule, motion=self.motion, sensor=self.sensor, smoother=smoother)
        run = tk.filter if smoother is None else tk.smooth
        return run(
            estimator, self.record if record is None else record, self.prior, start=self.start
        )

    def differences(
        self, trajectory: tk.Trajectory, name: str, lane: tuple[int, ...] = ()
    ) -> tuple[float, float]:
        """Largest differences of means and of covariances from the table called ``name``."""
        n = trajectory.mean.shape[1]
        t, mean, cov = moments(self.folder / f"{name}.csv.gz", n)
        rows = np.searchsorted(self.record.t, t - 1e-9)
        assert np.allclose(self.record.t[rows], t, rtol=0, atol=1e-9), "the table has other times"
        ours = trajectory.mean[(rows, ..., *lane)], trajectory.cov[(rows, ..., *lane)]
        return float(np.abs(ours[0] - mean).max()), float(np.abs(ours[1] - cov).max())

    def agrees(
        self,
        trajectory: tk.Trajectory,
        name: str,
        tolerance: float = TOLERANCE,
        lane: tuple[int, ...] = (),
    ) -> None:
        """Assert that all means and covariances agree with the table called ``name``."""
        for what, gap in zip(
            ("means", "covariances"), self.differences(trajectory, name, lane), strict=True
        ):
            assert gap < tolerance, f"{what} differ by {gap:.1e} from {self.folder.name}/{name}"


def read(path: Path) -> Array:
    """The numbers of a table below its header line."""
    with gzip.open(path, "rt") if path.suffix == ".gz" else path.open() as file:
        rows = list(csv.reader(file))[1:]
    return np.array(rows, dtype=np.float64)


def moments(path: Path, n: int) -> tuple[Array, Array, Array]:
    """Times, means ``(T, n)`` and covariances ``(T, n, n)``, from t, mean and upper triangle."""
    table = read(path)
    upper = np.triu_indices(n)
    cov = np.empty((len(table), n, n))
    cov[:, upper[0], upper[1]] = cov[:, upper[1], upper[0]] = table[:, 1 + n :]
    return table[:, 0], table[:, 1 : 1 + n], cov


def measured(folder: Path) -> tk.Record:
    """The measurements of a problem."""
    table = read(folder / "meas.csv.gz")
    return tk.Record(table[:, 0], table[:, 1:])


def fixed(*rows: Any) -> Any:
    """A noise function that returns the same covariance whatever it is asked."""
    entries = tuple(tuple(float(e) for e in row) for row in rows)
    return lambda: entries


# ------------------------------------------------------------------------------ linear motion
def two_bearings(seed: str = "seed1") -> Problem:
    """Azimuths from two stations; a strongly nonlinear start."""
    folder = DATA / "bot_reference" / seed
    sensor = stack([azimuth(0.05).at(sx=-1.0, sy=-2.0), azimuth(0.05).at(sx=1.0, sy=1.0)])
    prior = tk.Gaussian(np.zeros(4), np.diag([0.1, 0.1, 10.0, 10.0]))
    return Problem(folder, constant_velocity(0.1), sensor, prior, measured(folder), 0.0)


FOUR_STATIONS = ((-0.5, 3.5), (-0.5, -3.5), (7.0, -3.5), (7.0, 3.5))


def four_bearings() -> Problem:
    """Azimuths from four stations, of a target that turns while the model does not."""
    folder = DATA / "botm"
    sensor = stack([azimuth(0.1).at(sx=x, sy=y) for x, y in FOUR_STATIONS])
    prior = tk.Gaussian([0.0, 0.0, 0.0, -1.0], np.diag([1.1, 1.1, 0.1, 0.1]))
    return Problem(folder, constant_velocity(0.05), sensor, prior, measured(folder), -0.1)


def accelerating() -> Problem:
    """Position of a target with constant acceleration: linear throughout."""
    folder = DATA / "kfcwpa"

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

    motion = ComponentMotion(
        name="white_jerk",
        advance=advance,
        noise=fixed(*read(folder / "Q.csv")),
        space=tk.Space.of("x [m]", "y [m]", "vx [m/s]", "vy [m/s]", "ax [m/s^2]", "ay [m/s^2]"),
    )
    prior = tk.Gaussian(np.zeros(6), np.diag([0.1, 0.1, 0.1, 0.1, 0.5, 0.5]))
    sensor = position(np.sqrt(10.0)).over(motion.space)
    return Problem(folder, motion, sensor, prior, measured(folder), -0.5)


def sine() -> Problem:
    """A sinusoid of unknown phase, rate and amplitude, in noise as large as itself."""
    folder = DATA / "sine"
    space = tk.Space.of("theta [rad]", "omega [rad/s]", "a")
    motion = ComponentMotion(
        name="rotating",
        advance=lambda theta, omega, a, *, dt: (theta + dt * omega, omega, a),
        noise=fixed(*read(folder / "Q.csv")),
        space=space,
    )
    sensor = ComponentSensor(
        name="sine",
        measure=lambda theta, a: (a * sin(theta),),
        noise=fixed([1.0]),
        space=tk.Space.of("z"),
        state=space,
    )
    prior = tk.Gaussian([0.0, 10.0, 1.0], 3.0 * np.eye(3))
    return Problem(folder, motion, sensor, prior, measured(folder), -0.01)


# --------------------------------------------------------------------------- nonlinear motion
RE_ENTRY = tk.Space.of("x1 [km]", "x2 [km]", "x3 [km/s]", "x4 [km/s]", "x5")


def _falling(x1: Any, x2: Any, x3: Any, x4: Any, x5: Any, *, dt: Any) -> Any:
    distance = hypot(x1, x2)
    speed = hypot(x3, x4)
    drag = -0.59783 * exp(x5) * exp((6374.0 - distance) / 13.406) * speed
    gravity = -3.986e5 / distance**3
    return (
        x1 + dt * x3,
        x2 + dt * x4,
        x3 + dt * (drag * x3 + gravity * x1),
        x4 + dt * (drag * x4 + gravity * x2),
        x5,
    )


def reentry() -> Problem:
    """A vehicle that falls through the atmosphere, seen by a radar (Julier and Uhlmann 2004)."""
    folder = DATA / "reentry"
    motion = ComponentMotion(
        name="reentry",
        advance=_falling,
        noise=fixed(*np.diag([0.0, 0.0, 2.4064e-5, 2.4064e-5, 1e-6])),
        space=RE_ENTRY,
    )
    sensor = ComponentSensor(
        name="radar",
        measure=lambda x1, x2: (hypot(x1 - 6374.0, x2), atan2(x2, x1 - 6374.0)),
        noise=fixed(*np.diag([1e-3**2, 0.17e-3**2])),
        space=tk.Space.of("range [km]", "azimuth [rad] circular"),
        state=RE_ENTRY,
    )
    prior = tk.Gaussian(
        [6500.4, 349.14, -1.8093, -6.7967, 0.0], np.diag([1e-6, 1e-6, 1e-6, 1e-6, 1.0])
    )
    return Problem(folder, motion, sensor, prior, measured(folder), 0.0)


def growth() -> Problem:
    """The univariate nonstationary growth model, whose measurement does not tell the sign."""
    folder = DATA / "ungm"
    space = tk.Space.of("x")
    motion = ComponentMotion(
        name="growth",
        # t is the time at the start of the step: k - 1
        advance=lambda x, *, t: (0.5 * x + 25.0 * x / (1.0 + x * x) + 8.0 * cos(1.2 * t),),
        noise=fixed([1.0]),
        space=space,
    )
    sensor = ComponentSensor(
        name="square",
        measure=lambda x: (x * x / 20.0,),
        noise=fixed([1.0]),
        space=tk.Space.of("z"),
        state=space,
    )
    prior = tk.Gaussian([0.1], [[1.0]])
    return Problem(folder, motion, sensor, prior, measured(folder), 0.0)
