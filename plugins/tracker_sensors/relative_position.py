"""Position of the target relative to a moving or fixed platform, axes parallel to those of the
state; what a platform's own axes see (range and azimuth) does not belong here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from tracker.models import ComponentSensor, diagonal, one_of, positive
from tracker.types import PLANAR, SPATIAL, ArrayLike, Space


def _measure_2(x: Any, y: Any, *, sx: Any, sy: Any) -> Any:
    return (x - sx, y - sy)


def _measure_3(x: Any, y: Any, z: Any, *, sx: Any, sy: Any, sz: Any) -> Any:
    return (x - sx, y - sy, z - sz)


def _place_2(dx: Any, dy: Any, *, sx: Any, sy: Any) -> Any:
    return (dx + sx, dy + sy)


def _place_3(dx: Any, dy: Any, dz: Any, *, sx: Any, sy: Any, sz: Any) -> Any:
    return (dx + sx, dy + sy, dz + sz)


def _noise_2(*, sigma: Any) -> Any:
    return diagonal(sigma**2, sigma**2)


def _noise_3(*, sigma: Any) -> Any:
    return diagonal(sigma**2, sigma**2, sigma**2)


_MEASURE: dict[int, Callable[..., Any]] = {2: _measure_2, 3: _measure_3}
_PLACE: dict[int, Callable[..., Any]] = {2: _place_2, 3: _place_3}
_NOISE: dict[int, Callable[..., Any]] = {2: _noise_2, 3: _noise_3}
_SPACE = {2: Space.of("dx [m]", "dy [m]"), 3: Space.of("dx [m]", "dy [m]", "dz [m]")}
_POSE = {2: Space.of("sx [m]", "sy [m]"), 3: Space.of("sx [m]", "sy [m]", "sz [m]")}


def relative_position(
    sigma: Annotated[ArrayLike, "m"], *, axes: int = 2, state: Space | None = None
) -> ComponentSensor:
    """Target minus sensor, in axes parallel to those of the state (radar or lidar, levelled to north).

    Shapes:
        measurement ``(axes, *batch)``; pose ``[sx, sy]`` or ``[sx, sy, sz]``, ``(axes, *batch)``.
    Units:
        m.

    Raises:
        DomainError: if sigma is not positive, or ``axes`` is neither 2 nor 3.
    Reference:
        paper 3, eq. (1)-(3).
    Laws:
        those of kind "sensor"; linear.

    Example:
    >>> relative_position(2.5).h([10.0, 7.0, 0.0, 0.0], pose=[4.0, 5.0]).tolist()
    [6.0, 2.0]
    """
    one_of("axes", axes, (2, 3))
    return ComponentSensor(
        name="relative_position",
        measure=_MEASURE[axes],
        noise=_NOISE[axes],
        space=_SPACE[axes],
        pose_space=_POSE[axes],
        state=state or (SPATIAL if axes == 3 else PLANAR),
        parameters={"sigma": positive("sigma", sigma, unit="m")},
        inverse=_PLACE[axes],
        told=("x", "y", "z")[:axes],
    )
