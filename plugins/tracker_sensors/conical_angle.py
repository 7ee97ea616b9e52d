"""Angle between the axis of a line array and the direction to the target, and nothing that would
tell left from right.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from tracker.models import ComponentSensor, absolute, atan2, cos, one_of, positive, sin, sqrt
from tracker.types import PLANAR, SPATIAL, ArrayLike, Space


def _parts_2(x: Any, y: Any, *, sx: Any, sy: Any, heading: Any) -> tuple[Any, Any]:
    """Components of the line of sight along the array, and across it (never negative)."""
    dx, dy = x - sx, y - sy
    return dx * cos(heading) + dy * sin(heading), absolute(dy * cos(heading) - dx * sin(heading))


def _parts_3(x: Any, y: Any, z: Any, *, sx: Any, sy: Any, sz: Any, heading: Any) -> tuple[Any, Any]:
    along, across = _parts_2(x, y, sx=sx, sy=sy, heading=heading)
    return along, sqrt(across**2 + (z - sz) ** 2)


def _angle_2(x: Any, y: Any, *, sx: Any, sy: Any, heading: Any) -> Any:
    along, across = _parts_2(x, y, sx=sx, sy=sy, heading=heading)
    return (atan2(across, along),)  # arccos(along / range), without its loss of digits at the ends


def _angle_3(x: Any, y: Any, z: Any, *, sx: Any, sy: Any, sz: Any, heading: Any) -> Any:
    along, across = _parts_3(x, y, z, sx=sx, sy=sy, sz=sz, heading=heading)
    return (atan2(across, along),)


def _cosine_2(x: Any, y: Any, *, sx: Any, sy: Any, heading: Any) -> Any:
    along, across = _parts_2(x, y, sx=sx, sy=sy, heading=heading)
    return (along / sqrt(along**2 + across**2),)


def _cosine_3(x: Any, y: Any, z: Any, *, sx: Any, sy: Any, sz: Any, heading: Any) -> Any:
    along, across = _parts_3(x, y, z, sx=sx, sy=sy, sz=sz, heading=heading)
    return (along / sqrt(along**2 + across**2),)


def _noise(*, sigma: Any) -> Any:
    return ((sigma**2,),)


_MEASURE: dict[tuple[str, int], Callable[..., Any]] = {
    ("angle", 2): _angle_2,
    ("angle", 3): _angle_3,
    ("cosine", 2): _cosine_2,
    ("cosine", 3): _cosine_3,
}
_SPACE = {"angle": Space.of("conical_angle [rad]"), "cosine": Space.of("conical_cosine [1]")}
_POSE = {
    2: Space.of("sx [m]", "sy [m]", "heading [rad] circular"),
    3: Space.of("sx [m]", "sy [m]", "sz [m]", "heading [rad] circular"),
}


def conical_angle(
    sigma: Annotated[ArrayLike, "rad (or 1 for the cosine)"],
    *,
    form: str = "angle",
    axes: int = 2,
    state: Space | None = None,
) -> ComponentSensor:
    """Angle at which a wave meets a horizontal line array: 0 ahead, pi/2 abeam, pi astern.

    The target lies on a cone around the array. In the plane that leaves two directions, left and
    right, which this measurement cannot tell apart: an estimator that starts on the wrong side
    stays there until the array turns. With ``form='cosine'`` the cosine of the angle is measured,
    which is what a beamformer resolves uniformly; its derivatives are smooth at endfire, where those
    of the angle jump. ``heading`` counts counter-clockwise from the x axis.

    Shapes:
        measurement ``(1, *batch)``; pose ``[sx, sy, heading]`` or ``[sx, sy, sz, heading]``,
        ``(axes + 1, *batch)``.
    Units:
        rad, in [0, pi], not circular; or 1, in [-1, 1].

    Raises:
        DomainError: if sigma is not positive, or ``form`` or ``axes`` is not offered.
    Reference:
        Van Trees, Optimum Array Processing, 2002, chapter 2.
    Laws:
        those of kind "sensor"; the cosine is the dot product of array axis and direction; mirrored
        targets measure alike.

    Example:
    >>> array = conical_angle(0.02).at(sx=0.0, sy=0.0, heading=0.0)
    >>> [array.h([3.0, side, 0.0, 0.0]).round(4).item() for side in (3.0, -3.0)]
    [0.7854, 0.7854]
    """
    one_of("form", form, ("angle", "cosine"))
    one_of("axes", axes, (2, 3))
    return ComponentSensor(
        name="conical_angle",
        measure=_MEASURE[form, axes],
        noise=_noise,
        space=_SPACE[form],
        pose_space=_POSE[axes],
        state=state or (SPATIAL if axes == 3 else PLANAR),
        planar=axes == 2,
        parameters={"sigma": positive("sigma", sigma, unit="rad" if form == "angle" else "")},
    )
