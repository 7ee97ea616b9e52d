"""Range and azimuth of a target, as a plan-position radar measures them; no elevation belongs here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from tracker.models import ComponentSensor, atan2, cos, diagonal, one_of, positive, sin, sqrt
from tracker.types import PLANAR, ArrayLike, Space


def _math(x: Any, y: Any, *, sx: Any, sy: Any) -> Any:
    dx, dy = x - sx, y - sy
    return (sqrt(dx**2 + dy**2), atan2(dy, dx))


def _north(x: Any, y: Any, *, sx: Any, sy: Any) -> Any:
    dx, dy = x - sx, y - sy
    return (sqrt(dx**2 + dy**2), atan2(dx, dy))  # paper 4, eq. (4-5), (4-6)


def _place_math(range: Any, azimuth: Any, *, sx: Any, sy: Any) -> Any:  # noqa: A002 - its name
    return (sx + range * cos(azimuth), sy + range * sin(azimuth))


def _place_north(range: Any, azimuth: Any, *, sx: Any, sy: Any) -> Any:  # noqa: A002 - its name
    return (sx + range * sin(azimuth), sy + range * cos(azimuth))


def _noise(*, sigma_range: Any, sigma_azimuth: Any) -> Any:
    return diagonal(sigma_range**2, sigma_azimuth**2)


_MEASURE: dict[str, Callable[..., Any]] = {"math": _math, "north": _north}
_PLACE: dict[str, Callable[..., Any]] = {"math": _place_math, "north": _place_north}


def range_azimuth(
    sigma_range: Annotated[ArrayLike, "m"],
    sigma_azimuth: Annotated[ArrayLike, "rad"],
    *,
    convention: str = "math",
    state: Space = PLANAR,
) -> ComponentSensor:
    """Horizontal distance and direction of the target.

    ``convention`` 'math' counts azimuth counter-clockwise from the x axis (east), 'north' clockwise
    from the y axis.

    Shapes:
        measurement ``(2, *batch)``, range first; pose ``[sx, sy]``, ``(2, *batch)``.
    Units:
        m; rad, in (-pi, pi], where residuals wrap.

    Raises:
        DomainError: if a sigma is not positive, or the convention unknown.
    Reference:
        paper 4, eq. (4-5)-(4-7).
    Laws:
        those of kind "sensor"; at zero range the derivatives of that lane are NaN.

    Example:
    >>> sensor = range_azimuth(5.0, 0.01, convention="north").at(sx=0.0, sy=0.0)
    >>> sensor.h([2.0, 0.0, 0.0, 0.0]).round(4).tolist()
    [2.0, 1.5708]
    """
    one_of("convention", convention, tuple(_MEASURE))
    return ComponentSensor(
        name="range_azimuth",
        measure=_MEASURE[convention],
        noise=_noise,
        space=Space.of("range [m]", "azimuth [rad] circular"),
        pose_space=Space.of("sx [m]", "sy [m]"),
        state=state,
        inverse=_PLACE[convention],
        told=("x", "y"),
        parameters={
            "sigma_range": positive("sigma_range", sigma_range, unit="m"),
            "sigma_azimuth": positive("sigma_azimuth", sigma_azimuth, unit="rad"),
        },
    )
