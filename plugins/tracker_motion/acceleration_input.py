"""Constant velocity driven by accelerations that are constant over each step, known or random; white
noise in continuous time is `tracker_motion.constant_velocity`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from tracker.errors import ShapeError, wording
from tracker.models import ComponentMotion, diagonal, one_of, positive
from tracker.types import PLANAR, SPATIAL, ArrayLike, Space


def _advance_1(x: Any, vx: Any, *, dt: Any, ax: Any) -> Any:
    return (x + dt * vx + ax * dt**2 / 2.0, vx + ax * dt)


def _advance_2(x: Any, y: Any, vx: Any, vy: Any, *, dt: Any, ax: Any, ay: Any) -> Any:
    half = dt**2 / 2.0
    # eq. (3) with the matrices of (5) and (6)
    return (x + dt * vx + ax * half, y + dt * vy + ay * half, vx + ax * dt, vy + ay * dt)


def _advance_3(
    x: Any, y: Any, z: Any, vx: Any, vy: Any, vz: Any, *, dt: Any, ax: Any, ay: Any, az: Any
) -> Any:
    half = dt**2 / 2.0
    return (
        x + dt * vx + ax * half,
        y + dt * vy + ay * half,
        z + dt * vz + az * half,
        vx + ax * dt,
        vy + ay * dt,
        vz + az * dt,
    )


def _covariance(dt: Any, *sigmas: Any) -> Any:
    """``B Q B'`` of eq. (7), (8): an acceleration moves the position by ``dt^2/2``, the velocity by dt."""
    position = diagonal(*(s**2 * dt**4 / 4.0 for s in sigmas))
    cross = diagonal(*(s**2 * dt**3 / 2.0 for s in sigmas))
    velocity = diagonal(*(s**2 * dt**2 for s in sigmas))
    upper = tuple(p + c for p, c in zip(position, cross, strict=True))
    lower = tuple(c + v for c, v in zip(cross, velocity, strict=True))
    return upper + lower


def _noise_1(*, dt: Any, sigma_x: Any) -> Any:
    return _covariance(dt, sigma_x)


def _noise_2(*, dt: Any, sigma_x: Any, sigma_y: Any) -> Any:
    return _covariance(dt, sigma_x, sigma_y)


def _noise_3(*, dt: Any, sigma_x: Any, sigma_y: Any, sigma_z: Any) -> Any:
    return _covariance(dt, sigma_x, sigma_y, sigma_z)


_SPACE = {1: Space.of("x [m]", "vx [m/s]"), 2: PLANAR, 3: SPATIAL}
_ADVANCE: dict[int, Callable[..., Any]] = {1: _advance_1, 2: _advance_2, 3: _advance_3}
_NOISE: dict[int, Callable[..., Any]] = {1: _noise_1, 2: _noise_2, 3: _noise_3}


def acceleration_input(
    sigma: Annotated[ArrayLike | tuple[ArrayLike, ...], "m/s^2"], *, axes: int = 2
) -> ComponentMotion:
    """Constant velocity plus an acceleration that is constant over each step: ``A x + B (u + w)``.

    ``w`` is random, new in every step, with standard deviation ``sigma`` on each axis; a tuple or
    list holds one per axis. ``u`` is a known acceleration, zero where not given. The noise belongs to
    the step, not to time: halving the step halves the variance that the velocity gains in a
    second, and Q has only the rank of the axes. Where steps vary use
    `tracker_motion.constant_velocity`.

    Shapes:
        state ``(2 axes, *batch)``: positions, then velocities; u ``(axes, *batch)`` or None.
    Units:
        m, m/s, s; sigma and u m/s^2.

    Raises:
        DomainError: if a sigma is negative, or ``axes`` is not 1, 2 or 3.
        ShapeError: if the number of sigmas is not the number of axes.
    Reference:
        paper 2, eq. (3)-(8); known input as in paper 1, eq. (6), (14).
    Laws:
        two half steps equal one step in f for the same u, but not in Q.

    Example:
    >>> motion = acceleration_input((0.02, 0.05))
    >>> motion.f([0.0, 0.0, 1.0, 0.0], dt=2.0, u=[0.5, 0.0]).tolist()
    [3.0, 0.0, 2.0, 0.0]
    """
    one_of("axes", axes, (1, 2, 3))
    sigmas = tuple(sigma) if isinstance(sigma, (tuple, list)) else (sigma,) * axes
    if len(sigmas) != axes:
        raise ShapeError(
            wording(
                "parameter 'sigma'",
                got=f"{len(sigmas)} values",
                expected=f"one number, or one per axis ({axes})",
                do="give as many values as axes",
            )
        )
    return ComponentMotion(
        name="acceleration_input",
        advance=_ADVANCE[axes],
        noise=_NOISE[axes],
        space=_SPACE[axes],
        input_space=Space.of(*(f"a{axis} [m/s^2]" for axis in "xyz"[:axes])),
        parameters={
            f"sigma_{axis}": positive(f"sigma_{axis}", value, unit="m/s^2", zero=True)
            for axis, value in zip("xyz", sigmas, strict=False)
        },
    )
