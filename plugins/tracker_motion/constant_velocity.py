"""Constant velocity disturbed by white acceleration, on 1 to 3 axes; no other motion lives here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

import attrs

from tracker.errors import ShapeError, wording
from tracker.models import ComponentMotion, diagonal, one_of, positive
from tracker.types import PLANAR, SPATIAL, ArrayLike, Space
from tracker_motion.discretisation import METHODS

_SPACES = {1: Space.of("x [m]", "vx [m/s]"), 2: PLANAR, 3: SPATIAL}


def _advance_1(x: Any, vx: Any, *, dt: Any) -> Any:
    return (x + dt * vx, vx)  # eq. (28)


def _advance_2(x: Any, y: Any, vx: Any, vy: Any, *, dt: Any) -> Any:
    return (x + dt * vx, y + dt * vy, vx, vy)  # eq. (28)


def _advance_3(x: Any, y: Any, z: Any, vx: Any, vy: Any, vz: Any, *, dt: Any) -> Any:
    return (x + dt * vx, y + dt * vy, z + dt * vz, vx, vy, vz)  # eq. (28)


def _covariance(dt: Any, *densities: Any) -> Any:
    """Eq. (29), with a density for each axis."""
    return _spread(((dt**3 / 3.0, dt**2 / 2.0), (dt**2 / 2.0, dt)), densities)


def _spread(one: Any, densities: tuple[Any, ...]) -> Any:
    """The covariance of one axis at density 1, repeated over the axes."""
    position = diagonal(*(q * one[0][0] for q in densities))
    cross = diagonal(*(q * one[0][1] for q in densities))
    velocity = diagonal(*(q * one[1][1] for q in densities))
    upper = tuple(p + c for p, c in zip(position, cross, strict=True))
    lower = tuple(c + v for c, v in zip(cross, velocity, strict=True))
    return upper + lower


def _noise_1(*, dt: Any, density: Any) -> Any:
    return _covariance(dt, density)


def _noise_2(*, dt: Any, density: Any) -> Any:
    return _covariance(dt, density, density)


def _noise_3(*, dt: Any, density: Any) -> Any:
    return _covariance(dt, density, density, density)


def _noise_x(*, dt: Any, density_x: Any) -> Any:
    return _covariance(dt, density_x)


def _noise_xy(*, dt: Any, density_x: Any, density_y: Any) -> Any:
    return _covariance(dt, density_x, density_y)


def _noise_xyz(*, dt: Any, density_x: Any, density_y: Any, density_z: Any) -> Any:
    return _covariance(dt, density_x, density_y, density_z)


_ADVANCE: dict[int, Callable[..., Any]] = {1: _advance_1, 2: _advance_2, 3: _advance_3}
_SHARED: dict[int, Callable[..., Any]] = {1: _noise_1, 2: _noise_2, 3: _noise_3}
_EACH: dict[int, Callable[..., Any]] = {1: _noise_x, 2: _noise_xy, 3: _noise_xyz}


@attrs.frozen
class _Discretised:
    """The same noise from F, L and Qc by a general method, to hold the closed form against."""

    axes: int
    method: str
    densities: tuple[str, ...]
    positional: tuple[str, ...] = ()

    @property
    def keywords(self) -> tuple[str, ...]:
        return ("dt", *self.densities)

    def __call__(self, *, dt: Any, **densities: Any) -> Any:
        F, L = ((0.0, 1.0), (0.0, 0.0)), ((0.0,), (1.0,))  # eq. (26), (27), of one axis
        one = METHODS[self.method](F, L, ((1.0,),), dt)
        each = tuple(densities[name] for name in self.densities)
        return _spread(one, each if len(each) == self.axes else each * self.axes)


def constant_velocity(
    density: Annotated[ArrayLike | tuple[ArrayLike, ...], "m^2/s^3"],
    *,
    axes: int = 2,
    discretisation: str = "closed form",
) -> ComponentMotion:
    """Constant velocity disturbed by white acceleration noise (a Wiener process in velocity).

    ``density`` is the spectral density of the acceleration, not a variance: over ``dt`` seconds
    each velocity component gains the variance ``density * dt``. One number serves all axes; a tuple
    or list holds one per axis, which become the parameters ``density_x``, ``density_y``,
    ``density_z``. An array holds one value per lane. ``discretisation`` says how the covariance of a
    step is computed: 'closed form' (default), 'integral' or 'matrix fraction'.

    Shapes:
        state ``(2 axes, *batch)``: positions, then velocities.
    Units:
        m, m/s, s; density m^2/s^3.

    Raises:
        DomainError: if a density is negative, or ``axes`` or ``discretisation`` is not offered.
        ShapeError: if the number of densities is not the number of axes.
    Reference:
        paper 0, eq. (26)-(29), and (3), (4) for the discretisations; paper 3, eq. (6)-(10).
    Laws:
        two half steps equal one step, in f and Q; the three discretisations agree to 1e-12.

    Example:
    >>> motion = constant_velocity(0.1)
    >>> motion.f([0.0, 0.0, 1.0, 2.0], dt=0.5).tolist()
    [0.5, 1.0, 1.0, 2.0]
    >>> motion.Q([0.0, 0.0, 1.0, 2.0], dt=3.0)[0].round(9).tolist()
    [0.9, 0.0, 0.45, 0.0]
    """
    one_of("axes", axes, (1, 2, 3))
    one_of("discretisation", discretisation, ("closed form", *METHODS))
    if isinstance(density, (tuple, list)):
        if len(density) != axes:
            raise ShapeError(
                wording(
                    "parameter 'density'",
                    got=f"{len(density)} values",
                    expected=f"one number, or one per axis ({axes})",
                    do="give as many values as axes",
                )
            )
        parameters = {
            f"density_{axis}": positive(f"density_{axis}", value, unit="m^2/s^3", zero=True)
            for axis, value in zip("xyz", density, strict=False)
        }
        noise = _EACH[axes]
    else:
        parameters = {"density": positive("density", density, unit="m^2/s^3", zero=True)}
        noise = _SHARED[axes]
    if discretisation != "closed form":
        noise = _Discretised(axes, discretisation, tuple(parameters))
    return ComponentMotion(
        name="constant_velocity",
        advance=_ADVANCE[axes],
        noise=noise,
        space=_SPACES[axes],
        parameters=parameters,
    )
