"""Frequency at which a tone of known carrier is received from a moving target; the range rate itself
is in `tracker_sensors.range_rate`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from tracker.models import ComponentSensor, one_of, positive, sqrt
from tracker.types import PLANAR, SPATIAL, ArrayLike, Space


def _measure_2(
    x: Any, y: Any, vx: Any, vy: Any,
    *, sx: Any, sy: Any, svx: Any, svy: Any, carrier: Any, speed: Any,
) -> Any:  # fmt: skip
    dx, dy = x - sx, y - sy
    r = sqrt(dx**2 + dy**2)
    receiver = (dx * svx + dy * svy) / r  # each along the line of sight, away from the receiver
    source = (dx * vx + dy * vy) / r
    return (carrier * (speed + receiver) / (speed + source),)


def _measure_3(
    x: Any, y: Any, z: Any, vx: Any, vy: Any, vz: Any,
    *, sx: Any, sy: Any, sz: Any, svx: Any, svy: Any, svz: Any, carrier: Any, speed: Any,
) -> Any:  # fmt: skip
    dx, dy, dz = x - sx, y - sy, z - sz
    r = sqrt(dx**2 + dy**2 + dz**2)
    receiver = (dx * svx + dy * svy + dz * svz) / r
    source = (dx * vx + dy * vy + dz * vz) / r
    return (carrier * (speed + receiver) / (speed + source),)


def _noise(*, sigma: Any) -> Any:
    return ((sigma**2,),)


_MEASURE: dict[int, Callable[..., Any]] = {2: _measure_2, 3: _measure_3}
_POSE = {
    2: Space.of("sx [m]", "sy [m]", "svx [m/s]", "svy [m/s]"),
    3: Space.of("sx [m]", "sy [m]", "sz [m]", "svx [m/s]", "svy [m/s]", "svz [m/s]"),
}


def doppler_frequency(
    sigma: Annotated[ArrayLike, "Hz"],
    carrier: Annotated[ArrayLike, "Hz"],
    *,
    speed: Annotated[ArrayLike, "m/s"] = 1500.0,
    axes: int = 2,
    state: Space | None = None,
) -> ComponentSensor:
    """Received frequency of a tone that the target emits at frequency ``carrier``.

    The formula is that of waves in a medium at rest, ``carrier (c + v_receiver) / (c + v_source)``,
    velocities along the line of sight from receiver to source. For small velocities it equals
    ``carrier (1 - range rate / c)``, which is also what holds for radio waves. The delay of
    propagation is neglected. ``speed`` is the speed of propagation c: by default that of sound in
    sea water; 343 in air, 299792458 for radio.

    Shapes:
        measurement ``(1, *batch)``; pose ``[sx, sy, svx, svy]``, or
        ``[sx, sy, sz, svx, svy, svz]``, ``(2 axes, *batch)``.
    Units:
        Hz, m/s.

    Raises:
        DomainError: if sigma, carrier or speed is not positive, or ``axes`` is neither 2 nor 3.
    Reference:
        Landau and Lifshitz, Fluid Mechanics, 2nd edition, 1987, section 68.
    Laws:
        those of kind "sensor"; first order equal to the range rate; at zero range that lane is NaN.

    Example:
    >>> tone = doppler_frequency(0.01, 300.0).at(sx=0.0, sy=0.0, svx=0.0, svy=0.0)
    >>> tone.h([1000.0, 0.0, -15.0, 0.0]).round(3).tolist()
    [303.03]
    """
    one_of("axes", axes, (2, 3))
    return ComponentSensor(
        name="doppler_frequency",
        measure=_MEASURE[axes],
        noise=_noise,
        space=Space.of("frequency [Hz]"),
        pose_space=_POSE[axes],
        state=state or (SPATIAL if axes == 3 else PLANAR),
        planar=axes == 2,
        parameters={
            "sigma": positive("sigma", sigma, unit="Hz"),
            "carrier": positive("carrier", carrier, unit="Hz"),
            "speed": positive("speed", speed, unit="m/s"),
        },
    )
