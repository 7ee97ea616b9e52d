"""Delays between the paths by which one sound reaches one receiver: direct, by surface and by bottom.

Several receivers of one wave front are `time_difference`; how fast sound is lives in `sound_speed`.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Annotated, Any

import attrs
import numpy as np

from tracker.errors import DomainError, ShapeError, wording
from tracker.models import ComponentSensor, diagonal, positive, sqrt
from tracker.types import SPATIAL, Array, ArrayLike, Axis, Space, as_array

BOUNDARIES = ("surface", "bottom")


@attrs.frozen
class _Delays:
    """How much later than the direct one each reflected path arrives."""

    paths: tuple[tuple[str, ...], ...]
    positional: tuple[str, ...] = ("x", "y", "z")
    keywords: tuple[str, ...] = ("sx", "sy", "sz", "depth", "height", "speed")

    def __call__(
        self,
        x: Any,
        y: Any,
        z: Any,
        *,
        sx: Any,
        sy: Any,
        sz: Any,
        depth: Any,
        height: Any,
        speed: Any,
    ) -> Any:
        dx, dy, dz = x - sx, y - sy, z - sz
        level = dx * dx + dy * dy
        direct = sqrt(level + dz * dz)
        delays = []
        for path in self.paths:
            image = dz
            for boundary in path:  # each mirror puts the image where the target would be above it
                image = 2.0 * depth - image if boundary == "surface" else -2.0 * height - image
            length = sqrt(level + image * image)
            # length - direct, without the difference of two large numbers
            delays.append((image - dz) * (image + dz) / ((length + direct) * speed))
        return tuple(delays)


@attrs.frozen
class _Noise:
    """Independent errors, one variance for each path."""

    keywords: tuple[str, ...]
    positional: tuple[str, ...] = ()

    def __call__(self, **sigmas: Any) -> Any:
        return diagonal(*(sigmas[name] ** 2 for name in self.keywords))


def multipath_delays(
    sigma: Annotated[ArrayLike | Sequence[ArrayLike], "s"],
    *,
    depth: Annotated[ArrayLike, "m"],
    height: Annotated[ArrayLike, "m"],
    paths: Sequence[str] = BOUNDARIES,
    speed: Annotated[ArrayLike, "m/s"] = 1500.0,
    state: Space = SPATIAL,
) -> ComponentSensor:
    """Delays of reflected paths against the direct one, at one receiver in a channel with flat mirrors.

    The receiver is ``depth`` below the surface and ``height`` above the bottom, with z upward. A
    path is named by its reflections in the order in which the sound meets them: "surface",
    "bottom", "surface bottom", "bottom surface bottom", and so on. Sound is as fast everywhere.
    ``sigma`` is one number for all paths or one for each.

    Two delays tell slant range and height difference (`range_and_height`), never the azimuth: two
    receivers see a target on either side of the line between them alike.

    Shapes:
        measurement ``(paths, *batch)``; pose ``[sx, sy, sz]``, ``(3, *batch)``.
    Units:
        s, m, m/s.

    Raises:
        DomainError: if a number is not positive, or a path has other words than surface and bottom,
            or the same one twice in a row.
        ShapeError: if there is not one sigma or one for each path.
    Reference:
        paper 4, eq. 4-1, 4-2, and 4-14 to 4-30, in which the bottom path of 4-25 and 4-30 is corrected
        (``+ 2 height``, ``+ 4 height dz``); images as in Brekhovskikh and Lysanov (2003), Fundamentals
        of Ocean Acoustics, section 5.1.
    Laws:
        those of kind "sensor"; delays are positive for a target between surface and bottom.

    Example:
    >>> sensor = multipath_delays(1e-3, depth=100.0, height=100.0).at(sx=0.0, sy=0.0, sz=-100.0)
    >>> sensor.h([1000.0, 0.0, -50.0, 0.0, 0.0, 0.0]).round(6).tolist()
    [0.006625, 0.019685]
    """
    routes = tuple(_route(path) for path in paths)
    names = tuple("_".join(route) for route in routes)
    if not routes or len(set(routes)) < len(routes):
        raise DomainError(
            wording(
                "parameter 'paths'",
                got=f"{tuple(paths)}",
                expected="different paths, at least one",
                do="name each path once, such as 'surface' and 'bottom'",
            )
        )
    # One number, or one for each lane, serves all paths; a tuple or list holds one for each path.
    sigmas: list[Any] = list(sigma) if isinstance(sigma, (tuple, list)) else [sigma] * len(routes)
    if len(sigmas) != len(routes):
        raise ShapeError(
            wording(
                "parameter 'sigma'",
                got=f"{len(sigmas)} numbers",
                expected=f"one, or {len(routes)}: one for each of {', '.join(names)}",
                do="give as many as there are paths",
            )
        )
    noise = {
        f"sigma_{name}": positive(f"sigma_{name}", value, unit="s")
        for name, value in zip(names, sigmas, strict=True)
    }
    return ComponentSensor(
        name="multipath_delays",
        measure=_Delays(routes),
        noise=_Noise(tuple(noise)),
        space=Space(tuple(Axis(f"delay_{name}", "s") for name in names)),
        pose_space=Space.of("sx [m]", "sy [m]", "sz [m]"),
        state=state,
        parameters={
            **noise,
            "depth": positive("depth", depth, unit="m"),
            "height": positive("height", height, unit="m"),
            "speed": positive("speed", speed, unit="m/s"),
        },
    )


def _route(path: str) -> tuple[str, ...]:
    route = tuple(path.split())
    twice = any(a == b for a, b in itertools.pairwise(route))
    if not route or twice or not set(route) <= set(BOUNDARIES):
        raise DomainError(
            wording(
                "parameter 'paths'",
                got=repr(path),
                expected="'surface' and 'bottom' in turn",
                do="name the reflections in order, such as 'surface bottom'",
            )
        )
    return route


def range_and_height(
    surface: ArrayLike,
    bottom: ArrayLike,
    *,
    depth: ArrayLike,
    height: ArrayLike,
    speed: ArrayLike = 1500.0,
) -> tuple[Array, Array]:
    """Slant range and height above the receiver, from the delays of both single reflections.

    The exact inverse of `multipath_delays`: where a filter may start. Delays that no target between
    surface and bottom has give a range that is not positive, or a height outside; both are returned
    as they come, since noise makes such delays.

    Shapes:
        all scalars or ``(*batch)``; result ``(*batch)`` each.
    Units:
        s, m, m/s.
    Reference:
        paper 4, eq. 4-3, 4-4.

    Example:
    >>> [round(float(v), 3) for v in range_and_height(
    ...     0.006625467388529918, 0.019684791119583905, depth=100.0, height=100.0)]
    [1001.249, 50.0]
    """
    first, second = as_array(surface, "surface"), as_array(bottom, "bottom")
    up, down = as_array(depth, "depth"), as_array(height, "height")
    c = as_array(speed, "speed")
    with np.errstate(all="ignore"):
        whole = 4.0 * up * down * (up + down) - c**2 * (first**2 * down + second**2 * up)
        slant = whole / (2.0 * c * (first * down + second * up))
        above = (second**2 * c**2 + 2.0 * slant * second * c - 4.0 * down**2) / (4.0 * down)
    return slant, above
