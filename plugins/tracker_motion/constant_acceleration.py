"""Constant acceleration disturbed by white jerk, on 1 to 3 axes; no other motion lives here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from tracker.models import ComponentMotion, diagonal, one_of, positive
from tracker.types import ArrayLike, Space


def _advance_1(x: Any, vx: Any, ax: Any, *, dt: Any) -> Any:
    return (x + dt * vx + dt**2 / 2.0 * ax, vx + dt * ax, ax)


def _advance_2(x: Any, y: Any, vx: Any, vy: Any, ax: Any, ay: Any, *, dt: Any) -> Any:
    half = dt**2 / 2.0
    return (x + dt * vx + half * ax, y + dt * vy + half * ay, vx + dt * ax, vy + dt * ay, ax, ay)


def _advance_3(
    x: Any, y: Any, z: Any, vx: Any, vy: Any, vz: Any, ax: Any, ay: Any, az: Any, *, dt: Any
) -> Any:
    half = dt**2 / 2.0
    return (
        x + dt * vx + half * ax,
        y + dt * vy + half * ay,
        z + dt * vz + half * az,
        vx + dt * ax,
        vy + dt * ay,
        vz + dt * az,
        ax,
        ay,
        az,
    )


def _covariance(dt: Any, density: Any, axes: int) -> Any:
    """Paper 0, eq. (3), for a chain of three integrators, the same on each axis."""
    powers = (
        (dt**5 / 20.0, dt**4 / 8.0, dt**3 / 6.0),
        (dt**4 / 8.0, dt**3 / 3.0, dt**2 / 2.0),
        (dt**3 / 6.0, dt**2 / 2.0, dt),
    )
    rows: tuple[Any, ...] = ()
    for row in powers:
        blocks = [diagonal(*(density * power,) * axes) for power in row]
        rows += tuple(a + b + c for a, b, c in zip(*blocks, strict=True))
    return rows


def _noise_1(*, dt: Any, density: Any) -> Any:
    return _covariance(dt, density, 1)


def _noise_2(*, dt: Any, density: Any) -> Any:
    return _covariance(dt, density, 2)


def _noise_3(*, dt: Any, density: Any) -> Any:
    return _covariance(dt, density, 3)


_ADVANCE: dict[int, Callable[..., Any]] = {1: _advance_1, 2: _advance_2, 3: _advance_3}
_NOISE: dict[int, Callable[..., Any]] = {1: _noise_1, 2: _noise_2, 3: _noise_3}


def constant_acceleration(
    density: Annotated[ArrayLike, "m^2/s^5"], *, axes: int = 2
) -> ComponentMotion:
    """Constant acceleration disturbed by white jerk noise (a Wiener process in acceleration).

    ``density`` is the spectral density of the jerk: over ``dt`` seconds each acceleration component
    gains the variance ``density * dt``.

    Shapes:
        state ``(3 axes, *batch)``: positions, then velocities, then accelerations.
    Units:
        m, m/s, m/s^2, s; density m^2/s^5.

    Raises:
        DomainError: if the density is negative, or ``axes`` is not 1, 2 or 3.
    Reference:
        Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation,
        2001, section 6.2.3; discretised by paper 0, eq. (3).
    Laws:
        two half steps equal one step, in f and Q; equal to an independent program's A and Q.

    Example:
    >>> motion = constant_acceleration(0.2, axes=1)
    >>> motion.f([0.0, 1.0, 2.0], dt=2.0).tolist()
    [6.0, 5.0, 2.0]
    """
    one_of("axes", axes, (1, 2, 3))
    names = "xyz"[:axes]
    return ComponentMotion(
        name="constant_acceleration",
        advance=_ADVANCE[axes],
        noise=_NOISE[axes],
        space=Space.of(
            *(f"{axis} [m]" for axis in names),
            *(f"v{axis} [m/s]" for axis in names),
            *(f"a{axis} [m/s^2]" for axis in names),
        ),
        parameters={"density": positive("density", density, unit="m^2/s^5", zero=True)},
    )
