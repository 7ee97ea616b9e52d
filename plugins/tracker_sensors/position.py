"""Position of the target in the frame of the state, in 1-D to 3-D; no pose belongs here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from tracker.errors import ShapeError, wording
from tracker.models import ComponentSensor, diagonal, one_of, positive
from tracker.types import PLANAR, SPATIAL, ArrayLike, Space


def _measure_1(x: Any) -> Any:
    return (x,)


def _measure_2(x: Any, y: Any) -> Any:
    return (x, y)


def _measure_3(x: Any, y: Any, z: Any) -> Any:
    return (x, y, z)


def _noise_1(*, sigma: Any) -> Any:
    return diagonal(sigma**2)


def _noise_2(*, sigma: Any) -> Any:
    return diagonal(sigma**2, sigma**2)


def _noise_3(*, sigma: Any) -> Any:
    return diagonal(sigma**2, sigma**2, sigma**2)


def _noise_x(*, sigma_x: Any) -> Any:
    return diagonal(sigma_x**2)


def _noise_xy(*, sigma_x: Any, sigma_y: Any) -> Any:
    return diagonal(sigma_x**2, sigma_y**2)


def _noise_xyz(*, sigma_x: Any, sigma_y: Any, sigma_z: Any) -> Any:
    return diagonal(sigma_x**2, sigma_y**2, sigma_z**2)


_MEASURE: dict[int, Callable[..., Any]] = {1: _measure_1, 2: _measure_2, 3: _measure_3}
_SHARED: dict[int, Callable[..., Any]] = {1: _noise_1, 2: _noise_2, 3: _noise_3}
_EACH: dict[int, Callable[..., Any]] = {1: _noise_x, 2: _noise_xy, 3: _noise_xyz}
_STATE = {1: Space.of("x [m]", "vx [m/s]"), 2: PLANAR, 3: SPATIAL}


def position(
    sigma: Annotated[ArrayLike | tuple[ArrayLike, ...], "m"],
    *,
    axes: int = 2,
    state: Space | None = None,
) -> ComponentSensor:
    """Cartesian position, with independent errors on the axes.

    ``sigma`` is one standard deviation for all axes; a tuple or list holds one per axis, which become
    the parameters ``sigma_x``, ``sigma_y``, ``sigma_z``. An array holds one value per lane.

    Shapes:
        measurement ``(axes, *batch)``; no pose.
    Units:
        m.

    Raises:
        DomainError: if a sigma is not positive, or ``axes`` is not 1, 2 or 3.
        ShapeError: if the number of sigmas is not the number of axes.
    Reference:
        paper 1, eq. (7); paper 4, eq. (3-12).
    Laws:
        those of kind "sensor"; linear.

    Example:
    >>> sensor = position((2.0, 3.0))
    >>> sensor.h([5.0, 6.0, 0.0, 0.0]).tolist(), sensor.R([5.0, 6.0, 0.0, 0.0]).tolist()
    ([5.0, 6.0], [[4.0, 0.0], [0.0, 9.0]])
    """
    one_of("axes", axes, (1, 2, 3))
    if isinstance(sigma, (tuple, list)):
        if len(sigma) != axes:
            raise ShapeError(
                wording(
                    "parameter 'sigma'",
                    got=f"{len(sigma)} values",
                    expected=f"one number, or one per axis ({axes})",
                    do="give as many values as axes",
                )
            )
        parameters = {
            f"sigma_{axis}": positive(f"sigma_{axis}", value, unit="m")
            for axis, value in zip("xyz", sigma, strict=False)
        }
    else:
        parameters = {"sigma": positive("sigma", sigma, unit="m")}
    return ComponentSensor(
        name="position",
        measure=_MEASURE[axes],
        noise=(_SHARED if "sigma" in parameters else _EACH)[axes],
        space=Space(_STATE[axes].axes[:axes]),
        state=state or _STATE[axes],
        parameters=parameters,
        inverse=_MEASURE[axes],  # what is measured is the place itself
        told=("x", "y", "z")[:axes],
    )
