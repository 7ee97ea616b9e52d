"""Azimuth and elevation of a target seen from a fixed or moving sensor; no range belongs here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from tracker.models import ComponentSensor, atan2, diagonal, one_of, positive, sqrt
from tracker.types import SPATIAL, ArrayLike, Space


def _elevation(dx: Any, dy: Any, dz: Any) -> Any:
    return atan2(dz, sqrt(dx**2 + dy**2))  # paper 3, eq. (12)


def _math(x: Any, y: Any, z: Any, *, sx: Any, sy: Any, sz: Any) -> Any:
    dx, dy, dz = x - sx, y - sy, z - sz
    return (atan2(dy, dx), _elevation(dx, dy, dz))  # paper 4, eq. (5-3), (5-5)


def _north(x: Any, y: Any, z: Any, *, sx: Any, sy: Any, sz: Any) -> Any:
    dx, dy, dz = x - sx, y - sy, z - sz
    return (atan2(dx, dy), _elevation(dx, dy, dz))  # paper 3, eq. (5)


def _noise(*, sigma_azimuth: Any, sigma_elevation: Any) -> Any:
    return diagonal(sigma_azimuth**2, sigma_elevation**2)


_MEASURE: dict[str, Callable[..., Any]] = {"math": _math, "north": _north}


def azimuth_elevation(
    sigma_azimuth: Annotated[ArrayLike, "rad"],
    sigma_elevation: Annotated[ArrayLike, "rad"],
    *,
    convention: str = "math",
    state: Space = SPATIAL,
) -> ComponentSensor:
    """Direction to the target: azimuth, and elevation above the horizontal plane (z is up).

    ``convention`` 'math' counts azimuth counter-clockwise from the x axis (east), 'north' clockwise
    from the y axis.

    Shapes:
        measurement ``(2, *batch)``; pose ``[sx, sy, sz]``, ``(3, *batch)``.
    Units:
        rad; azimuth in (-pi, pi], where residuals wrap; elevation in [-pi/2, pi/2].

    Raises:
        DomainError: if a sigma is not positive, or the convention unknown.
    Reference:
        paper 3, eq. (5), (12), relative to the sensor and with two-argument arctangents; paper 4,
        eq. (5-3)-(5-6), (5-10)-(5-12).
    Laws:
        those of kind "sensor"; straight above or below the sensor derivatives are not finite.

    Example:
    >>> sensor = azimuth_elevation(0.01, 0.01).at(sx=0.0, sy=0.0, sz=0.0)
    >>> sensor.h([0.0, 3.0, 3.0, 0.0, 0.0, 0.0]).round(4).tolist()
    [1.5708, 0.7854]
    """
    one_of("convention", convention, tuple(_MEASURE))
    return ComponentSensor(
        name="azimuth_elevation",
        measure=_MEASURE[convention],
        noise=_noise,
        space=Space.of("azimuth [rad] circular", "elevation [rad]"),
        pose_space=Space.of("sx [m]", "sy [m]", "sz [m]"),
        state=state,
        parameters={
            "sigma_azimuth": positive("sigma_azimuth", sigma_azimuth, unit="rad"),
            "sigma_elevation": positive("sigma_elevation", sigma_elevation, unit="rad"),
        },
    )
