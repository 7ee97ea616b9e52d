"""Small problems that the tests of this folder share."""

from typing import Any

import numpy as np

import tracker as tk
from tracker.models import ComponentMotion, ComponentSensor, cos
from tracker.types import square_root
from tracker_motion import constant_velocity
from tracker_sensors import position

PLANE = ("x", "y", "vx", "vy")


def linear(steps: int = 12, batch: tuple[int, ...] = (), seed: int = 5) -> Any:
    """A target in the plane whose position is measured: models, a record of them, and the prior."""
    rng = np.random.default_rng(seed)
    motion, sensor = constant_velocity(density=0.5), position(sigma=2.0)
    t = np.cumsum(rng.uniform(0.3, 1.5, steps))
    prior = tk.Gaussian(np.zeros(4), np.diag([25.0, 25.0, 4.0, 4.0]))
    flat = int(np.prod(batch, dtype=int))
    x = np.sqrt(np.diagonal(prior.cov))[:, None] * rng.standard_normal((4, flat))
    z, before = np.empty((steps, 2, flat)), 0.0
    for k, now in enumerate(t.tolist()):
        root = square_root(motion.Q(x, now - before)[..., 0])
        x = motion.f(x, now - before) + root @ rng.standard_normal((4, flat))
        z[k], before = x[:2] + 2.0 * rng.standard_normal((2, flat)), now
    z[rng.uniform(size=z.shape) < 0.15] = np.nan
    z[3] = np.nan
    return {"motion": motion, "sensor": sensor}, tk.Record(t, z.reshape(steps, 2, *batch)), prior


def kalman(models: Any, record: tk.Record, prior: tk.Gaussian, smoother: Any = None) -> tk.History:
    """The exact answer to a linear problem."""
    estimator = tk.estimator("kf", **models, smoother=smoother)
    run = tk.filter if smoother is None else tk.smooth
    return run(estimator, record, prior, start=0.0)


def ran(rule: Any, problem: Any, seed: int = 1, rng: Any = None) -> tk.History:
    """A particle filter on a problem."""
    models, record, prior = problem
    draws = np.random.default_rng(seed) if rng is None else rng
    return tk.filter(tk.estimator(rule, **models), record, prior, start=0.0, rng=draws)


def growth() -> tk.Scenario:
    """The univariate nonstationary growth model, a hundred steps."""
    space = tk.Space.of("x")
    motion = ComponentMotion(
        name="growth",
        advance=lambda x, *, t: (0.5 * x + 25.0 * x / (1.0 + x * x) + 8.0 * cos(1.2 * t),),
        noise=lambda: ((10.0,),),
        space=space,
    )
    sensor = ComponentSensor(
        name="square",
        measure=lambda x: (x * x / 20.0,),
        noise=lambda: ((1.0,),),
        space=tk.Space.of("z"),
        state=space,
    )
    prior = tk.Gaussian([0.1], [[2.0]])
    t = np.arange(1.0, 101.0)
    return tk.Scenario(name="growth", motion=motion, sensor=sensor, prior=prior, t=t)
