"""Estimation as a textbook prints it, on matrices, for laws to compare with; nothing here is fast.

It shares no line with the algebra or with any filter: solves, products and stacked least squares.
"""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.models import ComponentMotion, ComponentSensor, atan2, diagonal
from tracker.types import PLANAR, Array, History, Innovation, Space, Trajectory

DENSITY, SIGMA = 0.4, (3.0, 5.0)


def F(dt: float) -> Array:
    """Constant velocity in the plane."""
    out = np.eye(4)
    out[0, 2] = out[1, 3] = dt
    return out


def Q(dt: float) -> Array:
    """White acceleration of density `DENSITY` (paper 0, eq. 29)."""
    block = DENSITY * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
    return np.kron(block, np.eye(2)).astype(np.float64)


H = np.eye(2, 4)
R = np.diag(np.square(SIGMA))


def _advance(x: Any, y: Any, vx: Any, vy: Any, *, dt: Any) -> Any:
    return (x + dt * vx, y + dt * vy, vx, vy)


def _noise(*, dt: Any) -> Any:
    a, b, c = DENSITY * dt**3 / 3.0, DENSITY * dt**2 / 2.0, DENSITY * dt
    return ((a, 0.0, b, 0.0), (0.0, a, 0.0, b), (b, 0.0, c, 0.0), (0.0, b, 0.0, c))


def _position(x: Any, y: Any) -> Any:
    return (x, y)


def _abscissa(x: Any) -> Any:
    return (x,)


def _ordinate(y: Any) -> Any:
    return (y,)


def _spreads(*, sigma_x: Any, sigma_y: Any) -> Any:
    return diagonal(sigma_x**2, sigma_y**2)


def _spread(*, sigma: Any) -> Any:
    return ((sigma**2,),)


def _bearing(x: Any, y: Any) -> Any:
    return (atan2(y, x),)


def _turn(heading: Any, rate: Any, *, dt: Any) -> Any:
    return (heading + dt * rate, rate)


def _heading(heading: Any) -> Any:
    return (heading,)


MOTION = ComponentMotion(name="constant velocity", advance=_advance, noise=_noise, space=PLANAR)
POSITION = ComponentSensor(
    name="position", measure=_position, noise=_spreads, space=Space.of("x [m]", "y [m]"),
    parameters={"sigma_x": SIGMA[0], "sigma_y": SIGMA[1]},
)  # fmt: skip
ABSCISSA = ComponentSensor(
    name="x", measure=_abscissa, noise=_spread, space=Space.of("x [m]"),
    parameters={"sigma": SIGMA[0]},
)  # fmt: skip
ORDINATE = ComponentSensor(
    name="y", measure=_ordinate, noise=_spread, space=Space.of("y [m]"),
    parameters={"sigma": SIGMA[1]},
)  # fmt: skip
BEARING = ComponentSensor(
    name="bearing", measure=_bearing, noise=_spread, space=Space.of("azimuth [rad] circular"),
    parameters={"sigma": 0.02},
)  # fmt: skip
COMPASS = ComponentSensor(
    name="compass", measure=_heading, noise=_spread, space=Space.of("heading [rad] circular"),
    state=Space.of("heading [rad] circular", "rate [rad/s]"), parameters={"sigma": 0.1},
)  # fmt: skip


def predict(x: Array, P: Array, dt: float) -> tuple[Array, Array]:
    """Särkkä, eq. 4.20."""
    return F(dt) @ x, F(dt) @ P @ F(dt).T + Q(dt)


def update(x: Array, P: Array, z: Array) -> tuple[Array, Array, float, float]:
    """Särkkä, eq. 4.21, on the measured components, with the squared distance and log-likelihood."""
    seen = ~np.isnan(z)
    if not seen.any():
        return x, P, 0.0, 0.0
    C, v = H[seen], z[seen] - H[seen] @ x
    S = C @ P @ C.T + R[np.ix_(seen, seen)]
    K = np.linalg.solve(S, C @ P).T
    distance = float(v @ np.linalg.solve(S, v))
    loglik = -0.5 * (distance + float(np.linalg.slogdet(2.0 * np.pi * S)[1]))
    return x + K @ v, P - K @ S @ K.T, distance, loglik


@attrs.frozen(eq=False)
class Problem:
    """A linear problem for a smoother: a prior at the first time, times, measurements.

    Shapes:
        mean ``(4, *batch)``; cov ``(4, 4, *batch)``; t ``(T,)``; z ``(T, 2, *batch)``.
    """

    mean: Array
    cov: Array
    t: Array
    z: Array

    @property
    def batch(self) -> tuple[int, ...]:
        """Shape of the batch axes."""
        return self.mean.shape[1:]

    def lane(self, index: tuple[int, ...]) -> Problem:
        """One lane."""
        at: Any = (..., *index)
        return Problem(self.mean[at], self.cov[at], self.t, self.z[at])

    def filtered(self) -> History:
        """The history that the textbook filter leaves."""
        steps, batch = len(self.t), self.batch
        means, covs = np.empty((2, steps, 4, *batch)), np.empty((2, steps, 4, 4, *batch))
        for index in np.ndindex(*batch):
            lane = self.lane(index)
            x, P = lane.mean, lane.cov
            for k in range(steps):
                if k:
                    x, P = predict(x, P, float(self.t[k] - self.t[k - 1]))
                (
                    means[(0, k, slice(None), *index)],
                    covs[(0, k, slice(None), slice(None), *index)],
                ) = x, P
                x, P, _, _ = update(x, P, lane.z[k])
                P = 0.5 * (P + P.T)
                (
                    means[(1, k, slice(None), *index)],
                    covs[(1, k, slice(None), slice(None), *index)],
                ) = x, P
        return history(self.t, means[0], covs[0], means[1], covs[1])

    def batch_least_squares(self) -> tuple[Array, Array]:
        """Mean ``(T, 4)`` and covariance ``(T, 4, 4)`` of all states at once, of a single lane.

        Every prior, step and measurement is a row of one linear system, weighted by the root of its
        information; the solution is that of its QR factorisation. Steps need noise: dt > 0.
        """
        steps = len(self.t)
        rows, targets = [], []

        def add(blocks: dict[int, Array], value: Array, cov: Array) -> None:
            weight = np.linalg.solve(np.linalg.cholesky(cov), np.eye(len(cov)))
            row = np.zeros((len(cov), 4 * steps))
            for k, block in blocks.items():
                row[:, 4 * k : 4 * k + 4] = weight @ block
            rows.append(row)
            targets.append(weight @ value)

        add({0: np.eye(4)}, self.mean, self.cov)
        for k in range(1, steps):
            dt = float(self.t[k] - self.t[k - 1])
            add({k - 1: -F(dt), k: np.eye(4)}, np.zeros(4), Q(dt))
        for k in range(steps):
            seen = ~np.isnan(self.z[k])
            if seen.any():
                add({k: H[seen]}, self.z[k][seen], R[np.ix_(seen, seen)])
        q, r = np.linalg.qr(np.concatenate(rows))
        half = np.linalg.solve(r, np.eye(4 * steps))
        cov = half @ half.T
        own = np.stack([cov[4 * k : 4 * k + 4, 4 * k : 4 * k + 4] for k in range(steps)])
        return (half @ (q.T @ np.concatenate(targets))).reshape(steps, 4), own


def history(t: Array, *moments: Array) -> History:
    """A history from predicted and filtered means and covariances; its innovations say nothing."""
    steps, batch = len(t), moments[0].shape[2:]
    blank = np.zeros((steps, *batch))
    innovation = Innovation(
        np.zeros((steps, 2, *batch)), np.zeros((steps, 2, 2, *batch)), blank, blank, blank,
        np.ones((steps, *batch), dtype=bool),
    )  # fmt: skip
    mean, cov, after, spread = moments
    return History(t, Trajectory(mean, cov), Trajectory(after, spread), innovation)
