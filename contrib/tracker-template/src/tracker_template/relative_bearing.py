"""Relative bearing of a target seen from a moving observer; nothing else is measured here."""

from typing import Annotated, Any

from tracker.models import ComponentSensor, atan2, positive, wrap
from tracker.types import PLANAR, ArrayLike, Space


def _measure(x: Any, y: Any, *, sx: Any, sy: Any, heading: Any) -> Any:
    return (wrap(atan2(x - sx, y - sy) - heading),)


def _noise(*, sigma: Any) -> Any:
    return ((sigma**2,),)


def relative_bearing(
    sigma: Annotated[ArrayLike, "rad"], *, state: Space = PLANAR
) -> ComponentSensor:
    """Direction to the target, clockwise from the bow; the heading is clockwise from north (y).

    Shapes:
        measurement ``(1, *batch)``; pose ``[sx, sy, heading]``, ``(3,)`` or ``(3, *batch)``.
    Units:
        rad, in (-pi, pi]; residuals wrap there.

    Raises:
        DomainError: if sigma is not positive.
    Reference:
        Bowditch: true bearing = heading + relative bearing.
    Laws:
        those of kind "sensor"; at zero range the derivatives of that lane are NaN.

    Example:
    >>> relative_bearing(0.02).h([100.0, 0.0, 0.0, 0.0], pose=[0.0, 0.0, 0.0]).round(4).tolist()
    [1.5708]
    """
    return ComponentSensor(
        name="relative_bearing",
        measure=_measure,
        noise=_noise,
        space=Space.of("relative_bearing [rad] circular"),
        pose_space=Space.of("sx [m]", "sy [m]", "heading [rad] circular"),
        state=state,
        parameters={"sigma": positive("sigma", sigma, unit="rad")},
    )
