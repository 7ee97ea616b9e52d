"""Azimuth and relative height of a target; no elevation angle and no range belong here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from tracker.models import ComponentSensor, atan2, diagonal, one_of, positive
from tracker.types import SPATIAL, ArrayLike, Space


def _math(x: Any, y: Any, z: Any, *, sx: Any, sy: Any, sz: Any) -> Any:
    return (atan2(y - sy, x - sx), z - sz)  # eq. (15)


def _north(x: Any, y: Any, z: Any, *, sx: Any, sy: Any, sz: Any) -> Any:
    return (atan2(x - sx, y - sy), z - sz)  # eq. (5), (15)


def _noise(*, sigma_azimuth: Any, sigma_height: Any) -> Any:
    return diagonal(sigma_azimuth**2, sigma_height**2)


_MEASURE: dict[str, Callable[..., Any]] = {"math": _math, "north": _north}


def azimuth_height(
    sigma_azimuth: Annotated[ArrayLike, "rad"],
    sigma_height: Annotated[ArrayLike, "m"],
    *,
    convention: str = "math",
    state: Space = SPATIAL,
) -> ComponentSensor:
    """Azimuth of the target and its height above the sensor (an emitter heard by an aircraft).

    ``convention`` 'math' counts azimuth counter-clockwise from the x axis (east), 'north' clockwise
    from the y axis.

    Shapes:
        measurement ``(2, *batch)``, azimuth first; pose ``[sx, sy, sz]``, ``(3, *batch)``.
    Units:
        rad, in (-pi, pi], where residuals wrap; m.

    Raises:
        DomainError: if a sigma is not positive, or the convention unknown.
    Reference:
        paper 3, eq. (15), which lists height first and azimuth as a plain arctangent; eq. (14) with
        variances on the diagonal.
    Laws:
        those of kind "sensor"; straight above or below the sensor derivatives are not finite.

    Example:
    >>> sensor = azimuth_height(0.05, 2.0).at(sx=0.0, sy=0.0, sz=10.0)
    >>> sensor.h([0.0, 3.0, 30.0, 0.0, 0.0, 0.0]).round(4).tolist()
    [1.5708, 20.0]
    """
    one_of("convention", convention, tuple(_MEASURE))
    return ComponentSensor(
        name="azimuth_height",
        measure=_MEASURE[convention],
        noise=_noise,
        space=Space.of("azimuth [rad] circular", "height [m]"),
        pose_space=Space.of("sx [m]", "sy [m]", "sz [m]"),
        state=state,
        parameters={
            "sigma_azimuth": positive("sigma_azimuth", sigma_azimuth, unit="rad"),
            "sigma_height": positive("sigma_height", sigma_height, unit="m"),
        },
    )
