"""Distance of a target from a fixed or moving sensor, in 2-D or 3-D; no angle belongs here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from tracker.models import ComponentSensor, one_of, positive, sqrt
from tracker.types import PLANAR, SPATIAL, ArrayLike, Space


def _measure_2(x: Any, y: Any, *, sx: Any, sy: Any) -> Any:
    return (sqrt((x - sx) ** 2 + (y - sy) ** 2),)


def _measure_3(x: Any, y: Any, z: Any, *, sx: Any, sy: Any, sz: Any) -> Any:
    return (sqrt((x - sx) ** 2 + (y - sy) ** 2 + (z - sz) ** 2),)  # paper 3, eq. (4)


def _noise(*, sigma: Any) -> Any:
    return ((sigma**2,),)


_MEASURE: dict[int, Callable[..., Any]] = {2: _measure_2, 3: _measure_3}
_POSE = {2: Space.of("sx [m]", "sy [m]"), 3: Space.of("sx [m]", "sy [m]", "sz [m]")}


def range_only(
    sigma: Annotated[ArrayLike, "m"], *, axes: int = 2, state: Space | None = None
) -> ComponentSensor:
    """Distance to the target; in 2-D the horizontal distance.

    Shapes:
        measurement ``(1, *batch)``; pose ``[sx, sy]`` or ``[sx, sy, sz]``, ``(axes, *batch)``.
    Units:
        m.

    Raises:
        DomainError: if sigma is not positive, or ``axes`` is neither 2 nor 3.
    Reference:
        paper 3, eq. (3)-(4), with the norm and the vector told apart.
    Laws:
        those of kind "sensor"; at zero range the derivatives of that lane are NaN.

    Example:
    >>> range_only(5.0).h([3.0, 4.0, 0.0, 0.0], pose=[0.0, 0.0]).tolist()
    [5.0]
    """
    one_of("axes", axes, (2, 3))
    return ComponentSensor(
        name="range_only",
        measure=_MEASURE[axes],
        noise=_noise,
        space=Space.of("range [m]"),
        pose_space=_POSE[axes],
        state=state or (SPATIAL if axes == 3 else PLANAR),
        planar=axes == 2,
        parameters={"sigma": positive("sigma", sigma, unit="m")},
    )
