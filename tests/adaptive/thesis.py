"""The linear example of the thesis (paper 4, section 3.5), and its filter as a textbook loop."""

from __future__ import annotations

import numpy as np

import tracker as tk
from tracker.models import ComponentMotion, ComponentSensor, diagonal
from tracker.types import Gaussian, Record, Space

F = np.array([[0.77, 0.20, 0.0], [0.25, 0.75, 0.25], [0.05, 0.0, 0.75]])
H = np.eye(2, 3)
SPACE = Space.of("p", "v", "a")
STEPS = 500


def _advance(p, v, a, *, dt):
    del dt
    return (0.77 * p + 0.2 * v, 0.25 * p + 0.75 * v + 0.25 * a, 0.05 * p + 0.75 * a)


def _noise(*, dt, q1, q2, q3):
    del dt
    return diagonal(q1, q2, q3)


def _measure(p, v):
    return (p, v)


def _spread(*, r1, r2):
    return diagonal(r1, r2)


def motion(Q):
    return ComponentMotion(
        name="thesis", advance=_advance, noise=_noise, space=SPACE,
        parameters=dict(zip(("q1", "q2", "q3"), Q, strict=True)),
    )  # fmt: skip


def sensor(R):
    return ComponentSensor(
        name="two", measure=_measure, noise=_spread, space=Space.of("z1", "z2"), state=SPACE,
        parameters=dict(zip(("r1", "r2"), R, strict=True)),
    )  # fmt: skip


def simulated(Q, R, runs, seed, steps=STEPS):
    """Truth ``(T, 3, runs)`` and measurements ``(T, 2, runs)``."""
    rng = np.random.default_rng(seed)
    x, truth, z = 0.1 * rng.standard_normal((3, runs)), [], []
    for _ in range(steps):
        x = F @ x + np.sqrt(Q)[:, None] * rng.standard_normal((3, runs))
        truth.append(x)
        z.append(x[:2] + np.sqrt(R)[:, None] * rng.standard_normal((2, runs)))
    return np.array(truth), np.array(z)


PRIOR = Gaussian(np.zeros(3), 0.01 * np.eye(3))


def filtered(z, Q, R, adapter=None, filter="kf"):  # noqa: A002 - as tk.estimator calls it
    est = tk.estimator(filter, motion=motion(Q), sensor=sensor(R), adapter=adapter)
    return tk.filter(est, Record(np.arange(1.0, len(z) + 1), z), PRIOR, start=0.0)


def rmse(history, truth):
    """Of each state, over time and then over runs, as the thesis's J3."""
    return np.sqrt(((history.filtered.mean - truth) ** 2).mean(axis=0)).mean(axis=-1)
