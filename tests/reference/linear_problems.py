"""Linear problems and their exact solution by conditioning the joint Gaussian of all states at once.

It shares no line with the algebra or any smoother: products, one solve, and nothing recursive but the
motion itself. Q may be singular and dt zero.
"""

import attrs
import numpy as np

import tracker as tk
from tracker.types import Array
from tracker_motion import constant_velocity
from tracker_sensors import position

SIGMA = 3.0
SENSOR = position(SIGMA)
SHAPES = [(), (7,), (3, 5)]


def F(dt: float) -> Array:
    out = np.eye(4)
    out[0, 2] = out[1, 3] = dt
    return out


def Q(dt: float, density: float) -> Array:
    block = density * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
    return np.kron(block, np.eye(2))


@attrs.frozen(eq=False)
class Problem:
    """Uneven times, some equal; some components missing; a noise density per step and lane."""

    prior: tk.Gaussian
    record: tk.Record
    density: Array  # (T, *batch), of the step into each row

    def motion(self, step: int) -> object:
        return constant_velocity(
            self.density[step] if self.record.batch else float(self.density[step])
        )


def problem(
    seed: int, batch: tuple[int, ...] = (), steps: int = 12, *, varied: bool = False
) -> Problem:
    rng = np.random.default_rng(seed)
    gaps = rng.uniform(0.1, 3.0, steps) * rng.choice([0.0, 1.0, 1.0, 1.0], steps)
    z = rng.normal(0.0, 30.0, (steps, 2, *batch))
    z[rng.uniform(size=z.shape) < 0.25] = np.nan
    mean = rng.normal(0.0, 10.0, (4, *batch))
    root = rng.normal(0.0, 1.0, (4, 4, *batch)) * np.array([9.0, 9.0, 2.0, 2.0]).reshape(
        4, 1, *(1,) * len(batch)
    )
    cov = np.einsum("ik...,jk...->ij...", root, root)
    density = np.full((steps, *batch), 0.5)
    if varied:
        density = density * rng.uniform(0.1, 10.0, density.shape)
    return Problem(tk.Gaussian(mean, cov), tk.Record(np.cumsum(gaps), z), density)


def filtered(given: Problem, sensor: object = SENSOR, rule: str = "kf") -> tk.History:
    """The history of a filter whose process noise is that of each step and lane, on arrays."""
    record, state, before = given.record, given.prior, float(given.record.t[0])
    kf = tk.filters.make(rule)
    rows = []
    for k, t in enumerate(record.t.tolist()):
        predicted = kf.predict(state, given.motion(k), t - before)
        state, innovation = kf.update(predicted, sensor, record.z[k])
        rows.append((predicted, state, innovation))
        before = t
    fields = attrs.fields(tk.Innovation)
    return tk.History(
        record.t,
        *(
            tk.Trajectory(np.stack([r[i].mean for r in rows]), np.stack([r[i].cov for r in rows]))
            for i in (0, 1)
        ),
        tk.Innovation(**{f.name: np.stack([getattr(r[2], f.name) for r in rows]) for f in fields}),
    )


def solution(
    given: Problem, lane: tuple[int, ...] = (), upto: int | None = None
) -> tuple[Array, Array]:
    """Mean ``(T, 4)`` and covariance ``(T, 4, 4)`` of every state given the rows before ``upto``."""
    at = (..., *lane)
    t, z = given.record.t, given.record.z[at]
    steps = len(t)
    # Every state is a sum of the first one and of the noise of each step.
    maps = np.zeros((steps, 4, 4 * steps))
    cov = np.zeros((4 * steps, 4 * steps))
    mean = np.zeros((steps, 4))
    for k in range(steps):
        own = slice(4 * k, 4 * k + 4)
        if k == 0:
            mean[0], cov[own, own] = given.prior.mean[at], given.prior.cov[at]
        else:
            dt = float(t[k] - t[k - 1])
            mean[k] = F(dt) @ mean[k - 1]
            maps[k] = F(dt) @ maps[k - 1]
            cov[own, own] = Q(dt, float(given.density[k][lane]))
        maps[k, :, own] = np.eye(4)
    A = maps.reshape(4 * steps, 4 * steps)
    joint = A @ cov @ A.T
    seen = ~np.isnan(z)
    seen[len(z) if upto is None else max(upto, 0) :] = False
    places = np.array([4 * k + i for k, i in np.argwhere(seen)], dtype=int)
    S = joint[np.ix_(places, places)] + SIGMA**2 * np.eye(len(places))
    K = np.linalg.solve(S, joint[places]).T
    found = mean.ravel() + K @ (z[seen] - mean.ravel()[places])
    left = joint - K @ joint[places]
    blocks = np.stack([left[4 * k : 4 * k + 4, 4 * k : 4 * k + 4] for k in range(steps)])
    return found.reshape(steps, 4), blocks


def agree(ours: tk.Trajectory, given: Problem, lane: tuple[int, ...], told: str, rows=None) -> None:
    """To 1e-9 of the standard deviations before any measurement."""
    at = (..., *lane)
    mean, cov = solution(given, lane) if rows is None else rows
    prior = np.sqrt(np.einsum("kii->ki", solution(given, lane, upto=0)[1])) + 1.0
    scale = np.abs(mean) + prior
    gap = np.abs((ours.mean[at] - mean) / scale).max()
    assert gap < 1e-9, f"{told}: means differ from the exact solution by {gap:.1e}"
    gap = np.abs((ours.cov[at] - cov) / (prior[:, :, None] * prior[:, None])).max()
    assert gap < 1e-9, f"{told}: covariances differ from the exact solution by {gap:.1e}"
