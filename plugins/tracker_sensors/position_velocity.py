"""Position and velocity of the target in the frame of the state; no pose belongs here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from tracker.models import ComponentSensor, diagonal, one_of, positive
from tracker.types import PLANAR, SPATIAL, ArrayLike, Space


def _measure_2(x: Any, y: Any, vx: Any, vy: Any) -> Any:
    return (x, y, vx, vy)


def _measure_3(x: Any, y: Any, z: Any, vx: Any, vy: Any, vz: Any) -> Any:
    return (x, y, z, vx, vy, vz)


def _noise_2(*, sigma: Any, sigma_velocity: Any) -> Any:
    return diagonal(sigma**2, sigma**2, sigma_velocity**2, sigma_velocity**2)


def _noise_3(*, sigma: Any, sigma_velocity: Any) -> Any:
    return diagonal(*(sigma**2,) * 3, *(sigma_velocity**2,) * 3)


_MEASURE: dict[int, Callable[..., Any]] = {2: _measure_2, 3: _measure_3}
_NOISE: dict[int, Callable[..., Any]] = {2: _noise_2, 3: _noise_3}
_SPACE = {2: PLANAR, 3: SPATIAL}


def position_velocity(
    sigma: Annotated[ArrayLike, "m"],
    sigma_velocity: Annotated[ArrayLike, "m/s"],
    *,
    axes: int = 2,
    state: Space | None = None,
) -> ComponentSensor:
    """Cartesian position and velocity with independent errors, as satellite navigation reports them.

    Shapes:
        measurement ``(2 axes, *batch)``, positions before velocities; no pose.
    Units:
        m, m/s.

    Raises:
        DomainError: if a sigma is not positive, or ``axes`` is neither 2 nor 3.
    Reference:
        paper 1, eq. (7).
    Laws:
        those of kind "sensor"; linear.

    Example:
    >>> position_velocity(5.0, 0.2).h([1.0, 2.0, 3.0, 4.0]).tolist()
    [1.0, 2.0, 3.0, 4.0]
    """
    one_of("axes", axes, (2, 3))
    return ComponentSensor(
        name="position_velocity",
        measure=_MEASURE[axes],
        noise=_NOISE[axes],
        space=_SPACE[axes],
        state=state or _SPACE[axes],
        inverse=_MEASURE[axes],  # what is measured is the state itself
        told=_SPACE[axes].names,
        parameters={
            "sigma": positive("sigma", sigma, unit="m"),
            "sigma_velocity": positive("sigma_velocity", sigma_velocity, unit="m/s"),
        },
    )
