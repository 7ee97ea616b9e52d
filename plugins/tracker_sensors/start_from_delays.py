"""A first estimate from echo delays at two or more receivers; one receiver's inverse is in `multipath_delays`."""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.errors import CapabilityError, ShapeError, wording
from tracker.protocols import SensorModel
from tracker.types import Array, ArrayLike, Gaussian, as_array
from tracker_sensors.multipath_delays import range_and_height

ITERATIONS = 6
"""Of Gauss and Newton; they begin where noise alone is between them and the answer."""


def start_from_delays(
    sensor: SensorModel, z: ArrayLike, rest: Gaussian, pose: ArrayLike | None = None
) -> Gaussian:
    """Where a target is by the delays of its echoes at two or more receivers, and how sure that is.

    The exact inverse at each receiver gives slant range and height, and the circles at which two
    receivers see the target cross in two places: the one nearer to the mean of ``rest`` is taken.
    Weighted least squares then uses every delay for what it is worth. The covariance is that of first
    order: right where delays are many times their noise, as those of the thesis' bottom paths are not.
    Velocities, and whatever else the state has, are as in ``rest``, uncorrelated with the place.

    Shapes:
        sensor: a `stack` of `multipath_delays`, each with the paths "surface" and "bottom" (more are
        used too); z ``(m, *batch)``; rest ``(n, *batch)`` or ``(n,)``; pose as the sensor's. A lane
        with a delay missing, or with delays that no place has, is NaN.

    Raises:
        CapabilityError: for another sensor, one receiver alone, or receivers above each other.
        ShapeError: if z is not that sensor's.
    Reference:
        paper 4, eq. 4-3, 4-4, at each receiver; least squares as in Bar-Shalom, Li and Kirubarajan
        (2001), Estimation with Applications to Tracking and Navigation, section 3.4.
    Laws:
        without noise, exactly the target's place; with little, NEES of the place is chi-square of 3
        (tests/property/test_start_from_delays.py).

    Example:
    >>> import tracker as tk
    >>> scene = tk.scenario("underwater_multipath")
    >>> echoes = scene.sensor.h([0.0, -5.0, -98.0, 0.0, 0.0, 0.0])
    >>> start_from_delays(scene.sensor, echoes, scene.prior).mean[:3].round(6).tolist()
    [0.0, -5.0, -98.0]
    """
    delays = as_array(z, "z")
    if delays.shape[:1] != (sensor.space.size,):
        raise ShapeError(
            wording(
                "argument 'z'",
                got=f"shape {delays.shape}",
                expected=f"({sensor.space.size}, *batch): {sensor.space}",
                do="pass all delays of one instant, first axis first",
            )
        )
    batch, space = delays.shape[1:], sensor.state
    places = list(space.indices("x", "y", "z"))
    lead = (1,) * len(batch) if not rest.batch else ()
    mean, cov = np.empty((space.size, *batch)), np.empty((space.size, space.size, *batch))
    mean[:] = rest.mean.reshape(*rest.mean.shape, *lead)
    cov[:] = rest.cov.reshape(*rest.cov.shape, *lead)
    with np.errstate(all="ignore"):
        mean[places] = _crossing(sensor, delays, mean[places], pose)
        for _ in range(ITERATIONS):
            H, weight = _rows(sensor, mean, places, pose)
            off = np.einsum(
                "ki...,k...->i...", weight, sensor.residual(delays, sensor.h(mean, pose))
            )
            mean[places] += _solved(np.einsum("ki...,kj...->ij...", weight, H), off[:, None])[:, 0]
        H, weight = _rows(sensor, mean, places, pose)
        identity = np.broadcast_to(np.eye(3).reshape(3, 3, *(1,) * len(batch)), (3, 3, *batch))
        spread = _solved(np.einsum("ki...,kj...->ij...", weight, H), identity)
    cov[places], cov[:, places] = 0.0, 0.0
    cov[np.ix_(places, places)] = 0.5 * (spread + spread.swapaxes(0, 1))
    return Gaussian.trusted(mean, cov)


def _crossing(sensor: SensorModel, z: Array, near: Array, pose: Any) -> Array:
    """Where the circles of the first two receivers cross, the crossing nearer to a place, ``(3, *batch)``."""
    at, level, height = [], [], []
    for receiver in _receivers(sensor, pose)[:2]:
        rows = [sensor.space.index(receiver[f"delay_{path}"]) for path in ("surface", "bottom")]
        channel = {name: receiver[name] for name in ("depth", "height", "speed")}
        distance, above = range_and_height(z[rows[0]], z[rows[1]], **channel)
        at.append(np.stack([np.broadcast_to(receiver[s], z.shape[1:]) for s in ("sx", "sy", "sz")]))
        level.append(distance**2 - above**2)
        height.append(at[-1][2] + above)
    base = at[1][:2] - at[0][:2]
    length = np.hypot(*base)
    if not (length > 0.0).all():
        raise CapabilityError(
            wording(
                "the receivers",
                got="two above each other",
                expected="receivers at different places on the map",
                do="add one beside them: these see a circle alone",
            )
        )
    along = (level[0] - level[1] + length**2) / (2.0 * length)
    aside = np.sqrt(level[0] - along**2)  # NaN: the circles do not meet
    one, across = base / length, np.stack([-base[1], base[0]]) / length
    sides = [at[0][:2] + along * one + sign * aside * across for sign in (1.0, -1.0)]
    far = [np.hypot(*(side - near[:2])) for side in sides]
    return np.concatenate([np.where(far[0] <= far[1], *sides), np.mean(height, axis=0)[None]])


def _receivers(sensor: SensorModel, pose: Any) -> list[dict[str, Any]]:
    """For each receiver its place and channel, and the names of its delays."""
    known = dict(getattr(sensor, "parameters", {}))
    if sensor.pose_space.size and pose is not None:
        known |= dict(zip(sensor.pose_space.names, np.asarray(pose), strict=True))
    suffixes = [name.removeprefix("depth") for name in known if name.startswith("depth_")]
    needed = ("sx", "sy", "sz", "depth", "height", "speed")
    paths = ("delay_surface", "delay_bottom")
    complete = [
        s for s in suffixes
        if all(n + s in known for n in needed) and all(p + s in sensor.space.names for p in paths)
    ]  # fmt: skip
    if len(complete) < 2 or len(complete) < len(suffixes):
        raise CapabilityError(
            wording(
                f"sensor {getattr(sensor, 'name', type(sensor).__name__)!r}",
                got=f"{len(complete)} receivers with the delays of surface and bottom and a known place",
                expected="a stack of at least two multipath_delays, fixed by .at(...) or with a pose",
                do="one receiver tells range and height alone: see range_and_height",
            )
        )
    return [{n: known[n + s] for n in needed} | {p: p + s for p in paths} for s in complete]


def _rows(sensor: SensorModel, x: Array, places: list[int], pose: Any) -> tuple[Array, Array]:
    """Derivatives by the place, and these weighted by the noise: both ``(m, 3, *batch)``."""
    batch = x.shape[1:]
    H = np.asarray(sensor.jacobian(x, pose))[:, places]
    H = np.broadcast_to(H, (*H.shape[:2], *batch))
    R = np.asarray(sensor.R(x, pose))
    R = R.reshape(*R.shape, *(1,) * (len(batch) + 2 - R.ndim))
    return H, _solved(np.broadcast_to(R, (*R.shape[:2], *batch)), H)


def _solved(A: Array, b: Array) -> Array:
    """Solutions of ``A x = b`` lane by lane; NaN where there is none."""
    stacked, right = np.moveaxis(A, (0, 1), (-2, -1)), np.moveaxis(b, (0, 1), (-2, -1))
    # LAPACK refuses all lanes for one that is singular: those are given another matrix, and then NaN
    good = np.isfinite(stacked).all(axis=(-2, -1)) & (np.linalg.slogdet(stacked)[0] != 0.0)
    safe = np.where(good[..., None, None], stacked, np.eye(stacked.shape[-1]))
    out: Array = np.where(good[..., None, None], np.linalg.solve(safe, right), np.nan)
    return np.asarray(np.moveaxis(out, (-2, -1), (0, 1)))
