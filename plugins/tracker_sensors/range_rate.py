"""Range rate of a target seen from a moving or fixed sensor; the frequency that a Doppler receiver
measures is in `tracker_sensors.doppler_frequency`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from tracker.models import ComponentSensor, one_of, positive, sqrt
from tracker.types import PLANAR, SPATIAL, ArrayLike, Space


def _measure_2(x: Any, y: Any, vx: Any, vy: Any, *, sx: Any, sy: Any, svx: Any, svy: Any) -> Any:
    dx, dy = x - sx, y - sy
    return ((dx * (vx - svx) + dy * (vy - svy)) / sqrt(dx**2 + dy**2),)


def _measure_3(
    x: Any, y: Any, z: Any, vx: Any, vy: Any, vz: Any,
    *, sx: Any, sy: Any, sz: Any, svx: Any, svy: Any, svz: Any,
) -> Any:  # fmt: skip
    dx, dy, dz = x - sx, y - sy, z - sz
    along = dx * (vx - svx) + dy * (vy - svy) + dz * (vz - svz)
    return (along / sqrt(dx**2 + dy**2 + dz**2),)


def _noise(*, sigma: Any) -> Any:
    return ((sigma**2,),)


_MEASURE: dict[int, Callable[..., Any]] = {2: _measure_2, 3: _measure_3}
_POSE = {
    2: Space.of("sx [m]", "sy [m]", "svx [m/s]", "svy [m/s]"),
    3: Space.of("sx [m]", "sy [m]", "sz [m]", "svx [m/s]", "svy [m/s]", "svz [m/s]"),
}


def range_rate(
    sigma: Annotated[ArrayLike, "m/s"], *, axes: int = 2, state: Space | None = None
) -> ComponentSensor:
    """How fast the distance between sensor and target grows (negative when closing).

    The pose holds position and velocity of the sensor; ``.at(svx=0.0, svy=0.0)`` says that it does
    not move and leaves ``[sx, sy]`` as pose.

    Shapes:
        measurement ``(1, *batch)``; pose ``[sx, sy, svx, svy]``, or
        ``[sx, sy, sz, svx, svy, svz]``, ``(2 axes, *batch)``.
    Units:
        m/s.

    Raises:
        DomainError: if sigma is not positive, or ``axes`` is neither 2 nor 3.
    Reference:
        paper 3, eq. (3)-(4), differentiated in time.
    Laws:
        those of kind "sensor"; equal to the time derivative of the range; at zero range that lane
        is NaN.

    Example:
    >>> radar = range_rate(0.1).at(sx=0.0, sy=0.0, svx=1.0, svy=0.0)
    >>> radar.h([100.0, 0.0, -4.0, 3.0]).tolist()
    [-5.0]
    """
    one_of("axes", axes, (2, 3))
    return ComponentSensor(
        name="range_rate",
        measure=_MEASURE[axes],
        noise=_noise,
        space=Space.of("range_rate [m/s]"),
        pose_space=_POSE[axes],
        state=state or (SPATIAL if axes == 3 else PLANAR),
        planar=axes == 2,
        parameters={"sigma": positive("sigma", sigma, unit="m/s")},
    )
