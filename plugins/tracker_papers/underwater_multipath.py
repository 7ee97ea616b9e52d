"""Chapter 4 of paper 4: a target under water by the delays of its echoes at two hydrophones."""

from __future__ import annotations

from types import MappingProxyType
from typing import Annotated, Any

import attrs
import numpy as np

from tracker.models import ComponentMotion, diagonal, one_of
from tracker.simulation import Scenario
from tracker.types import SPATIAL, ArrayLike, Gaussian
from tracker_sensors.multipath_delays import multipath_delays
from tracker_sensors.signals import noise_sigma
from tracker_sensors.stack import stack

KMH = 1.0 / 3.6

SPEED_UNITS = MappingProxyType({"kmh": KMH, "raw": 1.0})
"""What a printed speed is in m/s: the text says km/h; raw takes the number as m/s."""


@attrs.frozen
class Channel:
    """How deep the hydrophones hang, how high above the bottom, and where they are [m]."""

    depth: float
    height: float
    places: tuple[tuple[float, float, float], tuple[float, float, float]]


PRESETS = MappingProxyType({
    "M1": Channel(285.0, 270.0, ((-200.0, -600.0, -160.0), (-550.0, -200.0, -160.0))),
    "near": Channel(285.0, 270.0, ((-200.0, -600.0, -160.0), (-250.0, -200.0, -160.0))),
    "surface_at_zero": Channel(160.0, 62.0, ((-200.0, -600.0, -160.0), (-550.0, -200.0, -160.0))),
    "printed": Channel(285.0, 55.0, ((-500.0, -600.0, -160.0), (-550.0, -500.0, -160.0))),
})  # fmt: skip
"""Readings of eq. 4-34 to 4-36, in which 2 and 5 are one sign and no choice makes the depths add up. M1
keeps the depth of the water (555), that of the hydrophones and their places, and lets the height
follow; "near" reads the second place as -250; "surface_at_zero" has the surface where z = 0 (222 m of
water); "printed" keeps the printed height 55."""

START = (0.0, -5.0, -98.0, -5.0, -1.0, -0.1)
GUESS = (0.0, 5.0, -88.0, -4.0, 0.0, -0.2)
"""Eq. 4-37, 4-38: true and assumed start; places m, speeds in printed numbers."""

PROCESS_VARIANCE = 1e-4
TOLD_R, TRUE_R = (1e-3, 1e-3), (1e-4, 1e-2)
"""Variances of the delays by surface and by bottom [s^2]."""


def _advance(x: Any, y: Any, z: Any, vx: Any, vy: Any, vz: Any) -> Any:
    return (x + vx, y + vy, z + vz, vx, vy, vz)


def _process(*, variance: Any) -> Any:
    return diagonal(*(variance,) * 6)


def constant_velocity_step(variance: float) -> ComponentMotion:
    """Eq. 4-12, 4-13: one second at constant velocity, and noise of this variance on all six states.

    A step is a second, whatever dt: the thesis' model is one of discrete time.
    """
    return ComponentMotion(
        name="constant_velocity_step",
        advance=_advance,
        noise=_process,
        space=SPATIAL,
        parameters={"variance": variance},
    )


def hydrophones(channel: Channel, variances: ArrayLike, speed: float = 1500.0) -> Any:
    """The delays at both hydrophones (eq. 4-14: four of them).

    ``variances`` are those of surface and bottom path, alike at both, or a row for each.
    """
    sigma = np.broadcast_to(np.sqrt(np.asarray(variances, dtype=float)), (2, 2)).tolist()
    return stack(
        [
            multipath_delays(each, depth=channel.depth, height=channel.height, speed=speed).at(
                sx=x, sy=y, sz=z
            )
            for each, (x, y, z) in zip(sigma, channel.places, strict=True)
        ]
    )


def underwater_multipath(
    preset: str = "M1",
    *,
    truth_noise: bool = True,
    speed_unit: str = "kmh",
    told: bool = False,
    speed: Annotated[float, "m/s"] = 1500.0,
    snr: Annotated[float | None, "dB"] = None,
    steps: Annotated[int, "1"] = 500,
) -> Scenario:
    """A target under water seen by four echo delays, whose noise the filter is told wrongly.

    The filter is told R = 1e-3 s^2 throughout; in truth the surface paths have 1e-4, the bottom paths
    1e-2. Its first estimate is 10 m off in y and in z where its covariance says 1 m: the thesis'
    numbers. ``preset`` is a reading of the geometry (`PRESETS`), ``speed_unit`` one of the speeds.
    ``truth_noise`` False: the target itself is not disturbed, while the filter assumes so. With
    ``told`` the filter is told the true R. ``speed`` is that of sound, known to the filter:
    `tracker_sensors.sound_speed` has it by temperature, salinity and depth. ``snr`` takes the place
    of the true R, as block 4 of figure 4-3 has it: each delay's noise is so far below the RMS of
    that delay over the path of an undisturbed target. The thesis' 20 dB are those of its R for the
    surface path; those of the bottom path are far lower.

    Units: m, m/s, s, dB; a step is a second, whatever dt.

    Raises:
        DomainError: for another preset or unit, or a speed of sound that is not positive.
    Source: paper 4, eq. 4-9 to 4-14 and 4-34 to 4-38; Table 4-1.
    """
    one_of("preset", preset, tuple(PRESETS))
    one_of("speed_unit", speed_unit, tuple(SPEED_UNITS))
    channel, scale = PRESETS[preset], np.array([1.0] * 3 + [SPEED_UNITS[speed_unit]] * 3)
    t, start, true = np.arange(1.0, steps + 1.0), scale * START, np.array([TRUE_R] * 2)
    if snr is not None:
        path = np.concatenate([start[:3, None] + start[3:, None] * t, np.zeros((3, steps))])
        delays = hydrophones(channel, TRUE_R, speed).h(path)
        true = noise_sigma(delays.T, snr).reshape(2, 2) ** 2
    return Scenario(
        name=f"underwater_multipath ({preset})",
        motion=constant_velocity_step(PROCESS_VARIANCE),
        sensor=hydrophones(channel, true if told else TOLD_R, speed),
        truth_motion=constant_velocity_step(PROCESS_VARIANCE if truth_noise else 0.0),
        truth_sensor=hydrophones(channel, true, speed),
        prior=Gaussian(scale * GUESS, np.eye(6)),
        start=start,
        initial="fixed",
        t=t,
        summary="two hydrophones, delays of echoes",
    )
