"""Azimuth (bearing) of a target seen from a fixed or moving sensor; no other angle belongs here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from tracker.models import ComponentSensor, atan2, cos, one_of, positive, sin
from tracker.types import PLANAR, ArrayLike, Space


def _math(x: Any, y: Any, *, sx: Any, sy: Any) -> Any:
    return (atan2(y - sy, x - sx),)  # paper 0, eq. (30)


def _north(x: Any, y: Any, *, sx: Any, sy: Any) -> Any:
    return (atan2(x - sx, y - sy),)  # paper 2, eq. (10)


def _noise(*, sigma: Any) -> Any:
    return ((sigma**2,),)


def sight(sensor: ComponentSensor) -> Callable[..., Any] | None:
    """Unit vector along a measured azimuth, as a function; None for a sensor of another kind."""
    return {_math: _along_math, _north: _along_north}.get(sensor.measure)


def _along_math(azimuth: Any) -> Any:
    return (cos(azimuth), sin(azimuth))


def _along_north(azimuth: Any) -> Any:
    return (sin(azimuth), cos(azimuth))


_MEASURE: dict[str, Callable[..., Any]] = {"math": _math, "north": _north}


def azimuth(
    sigma: Annotated[ArrayLike, "rad"], *, convention: str = "math", state: Space = PLANAR
) -> ComponentSensor:
    """Horizontal direction to the target, target minus sensor.

    ``convention`` 'math' counts counter-clockwise from the x axis (east), 'north' clockwise from the
    y axis. Given a pose ``[sx, sy]`` at each step the sensor moves; ``.at(sx=1.0, sy=1.1)`` fixes it.

    Shapes:
        measurement ``(1, *batch)``; pose ``(2,)`` or ``(2, *batch)``.
    Units:
        rad, in (-pi, pi]; residuals wrap there.

    Raises:
        DomainError: if sigma is not positive, or the convention unknown.
    Reference:
        paper 0, eq. (30)-(33), with the derivatives of eq. (31), as those of (32) and (33) are
        misprinted; paper 2, eq. (9)-(12), (20)-(22) for 'north'.
    Laws:
        those of kind "sensor"; at zero range the derivatives of that lane are NaN.

    Example:
    >>> station = azimuth(0.03).at(sx=1.0, sy=1.0)
    >>> station.h([1.0, 3.0, 0.0, 0.0]).round(4).tolist()
    [1.5708]
    """
    one_of("convention", convention, tuple(_MEASURE))
    return ComponentSensor(
        name="azimuth",
        measure=_MEASURE[convention],
        noise=_noise,
        space=Space.of("azimuth [rad] circular"),
        pose_space=Space.of("sx [m]", "sy [m]"),
        state=state,
        parameters={"sigma": positive("sigma", sigma, unit="rad")},
    )
