"""EKF1 on two bearings by hand: what a patient NumPy programmer writes for this one problem.

The yardstick for the array interpretation: constant velocity, two fixed stations, 1,000 runs at
once, batch axis last, Jacobian in a reused buffer, masks. Nothing here knows the framework, and
nothing else belongs here.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

TAU = 2.0 * math.pi
LOG_TAU = math.log(TAU)


def transition(dt: float) -> Any:
    F = np.eye(4)
    F[0, 2] = F[1, 3] = dt
    return F


def white_acceleration(dt: float, density: float) -> Any:
    block = np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]) * density
    return np.kron(block, np.eye(2))


class TwoBearings:
    """Azimuths from two stations and their derivatives by x and y, in a buffer of its own."""

    def __init__(self, stations: Any, lanes: int) -> None:
        self.stations = stations
        self.slopes = np.empty((2, 2, lanes))

    def linearise(self, x: Any) -> tuple[Any, Any]:
        h = np.empty((2, x.shape[1]))
        for k, (sx, sy) in enumerate(self.stations):
            dx, dy = x[0] - sx, x[1] - sy
            inverse = 1.0 / (dx * dx + dy * dy)
            np.arctan2(dy, dx, out=h[k])
            np.multiply(dy, -inverse, out=self.slopes[k, 0])
            np.multiply(dx, inverse, out=self.slopes[k, 1])
        return h, self.slopes


def propagated(F: Any, P: Any) -> Any:
    """F P F' for all lanes as two matrix products."""
    n, lanes = len(F), P.shape[-1]
    half = (F @ P.reshape(n, -1)).reshape(n, n, lanes)
    out = (F @ half.swapaxes(0, 1).reshape(n, -1)).reshape(n, n, lanes)
    for j in range(n - 1):  # a matrix product is symmetric only to rounding
        out[j + 1 :, j] = out[j, j + 1 :]
    return out


def conditioned(x: Any, P: Any, v: Any, HP: Any, S: Any, seen: Any) -> tuple[Any, ...]:
    """The whitened update; ``seen`` holds one or zero, and v zero where nothing was measured."""
    m = len(v)
    if seen is not None:
        v, HP = v * seen, HP * seen[:, None]
        S = S * (seen[:, None] * seen)
        for k in range(m):
            S[k, k] += 1.0 - seen[k]
    W: list[Any] = []
    y: list[Any] = []
    rows: list[list[Any]] = []
    nis, determinant = 0.0, 1.0
    for k in range(m):
        s, w, u, row = S[k, k], HP[k], v[k], []
        for j in range(k):
            entry = S[k, j]
            for i in range(j):
                entry = entry - row[i] * rows[j][i]
            entry = entry * rows[j][j]
            row.append(entry)
            s, w, u = s - entry * entry, w - entry * W[j], u - entry * y[j]
        determinant = determinant * s
        inverse = 1.0 / np.sqrt(s)
        rows.append([*row, inverse])
        w, u = w * inverse, u * inverse
        W.append(w)
        y.append(u)
        x = x + w * u
        P = P - w[:, None] * w
        nis = nis + u * u
    count = m if seen is None else seen.sum(0)
    return x, P, nis, -0.5 * (nis + np.log(determinant) + LOG_TAU * count)


def filtered(
    z: Any, x: Any, P: Any, *, stations: Any, dt: float, density: float, sigma: float
) -> tuple[Any, Any]:
    """Means ``(T, 4, lanes)`` and the summed log-likelihood.

    Shapes:
        z ``(T, 2, lanes)`` with NaN where nothing was measured; x ``(4, lanes)``; P
        ``(4, 4, lanes)``: the prior one step before the first row.
    """
    missing = np.isnan(z)
    masked = bool(missing.any())
    z, seen = np.where(missing, 0.0, z), (~missing).astype(np.float64)
    F, Q = transition(dt), white_acceleration(dt, density)[..., None]
    R = (sigma**2 * np.eye(2))[..., None]
    sensor = TwoBearings(stations, z.shape[-1])
    means = np.empty((len(z), *x.shape))
    total = np.zeros(z.shape[-1])
    for k in range(len(z)):
        x, P = F @ x, propagated(F, P) + Q
        h, H = sensor.linearise(x)
        HP = H[:, 0, None] * P[0]
        HP += H[:, 1, None] * P[1]
        S = np.einsum("ajb,cjb->acb", HP[:, :2], H) + R
        v = z[k] - h
        v -= TAU * np.rint(v * (1.0 / TAU))
        x, P, _, loglik = conditioned(x, P, v, HP, S, seen[k] if masked else None)
        means[k] = x
        total += loglik
    return means, total
