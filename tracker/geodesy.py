"""Positions on the WGS-84 ellipsoid and in a local tangent plane, courses and bearings; no state, no filter.

Everything works in radians, metres and seconds. Data in degrees pass through ``numpy.radians`` on the
way in, speeds in knots are multiplied by ``KNOT``. An element with a NaN in any of its components
becomes NaN as a whole and harms no neighbour; numbers that are out of range are an error.
"""

from __future__ import annotations

import attrs
import numpy as np
import numpy.typing as npt

from tracker.errors import DomainError, ShapeError, wording
from tracker.types import Array, ArrayLike, as_array

SEMI_MAJOR = 6378137.0
"""Equatorial radius of the WGS-84 ellipsoid, m."""
FLATTENING = 1.0 / 298.257223563
"""Flattening of the WGS-84 ellipsoid."""
KNOT = 1852.0 / 3600.0
"""One knot in m/s."""

_SEMI_MINOR = SEMI_MAJOR * (1.0 - FLATTENING)
_ECCENTRICITY2 = FLATTENING * (2.0 - FLATTENING)
_SECOND_ECCENTRICITY2 = _ECCENTRICITY2 / (1.0 - FLATTENING) ** 2
_NEAREST = 1.0e6  # of the Earth's centre, m; the latitude loses its meaning at 43 km
_ROUNDS = 3  # two reach rounding above -1000 km, three above -5000 km


def _refuse(wrong: npt.NDArray[np.bool_], name: str, values: Array, expected: str, do: str) -> None:
    if wrong.any():
        got = f"{float(values[wrong].flat[0])}"
        raise DomainError(wording(f"argument {name!r}", got=got, expected=expected, do=do))


def _finite(values: Array, name: str) -> Array:
    unit = "finite numbers, or NaN where unknown"
    _refuse(np.isinf(values), name, values, unit, "replace inf by NaN if it is unknown")
    return values


def _vector(value: ArrayLike, name: str, size: int) -> Array:
    vector = as_array(value, name)
    if vector.ndim == 0 or vector.shape[0] != size:
        raise ShapeError(
            wording(
                f"argument {name!r}",
                got=f"shape {vector.shape}",
                expected=f"({size}, *batch)",
                do="put the components on the first axis",
            )
        )
    return _finite(vector, name)


def _together(*pairs: tuple[ArrayLike, str]) -> list[Array]:
    """Arguments as arrays of one shape, NaN in all of them where any of them is."""
    arrays = [as_array(value, name) for value, name in pairs]
    try:
        arrays = list(np.broadcast_arrays(*arrays))
    except ValueError:
        names = ", ".join(name for _, name in pairs)
        raise ShapeError(
            wording(
                f"arguments {names}",
                got=f"shapes {', '.join(str(array.shape) for array in arrays)}",
                expected="shapes that broadcast",
                do="give one value per point, or scalars",
            )
        ) from None
    unknown = np.isnan(arrays).any(axis=0)
    return [np.where(unknown, np.nan, array) for array in arrays]


# ---------------------------------------------------------------------------- the whole Earth
def ecef_from_geodetic(latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike = 0.0) -> Array:
    """Earth-centred, Earth-fixed position of geodetic coordinates.

    Shapes:
        any that broadcast to ``batch``; result ``(3, *batch)``.
    Units:
        rad, rad, m above the ellipsoid; result m.

    Raises:
        DomainError: latitude outside [-pi/2, pi/2], longitude outside [-2 pi, 2 pi] (degrees, most
            likely), or inf.
    Laws:
        ``geodetic_from_ecef`` is its inverse (tests/property/test_geodesy_laws.py).

    Example:
    >>> ecef_from_geodetic(0.0, np.pi / 2, 1000.0).round(6).tolist()
    [0.0, 6379137.0, 0.0]
    """
    lat, lon, h = _together((latitude, "latitude"), (longitude, "longitude"), (height, "height"))
    for angle, name, limit, text in (
        (lat, "latitude", np.pi / 2, "radians in [-pi/2, pi/2]"),
        (lon, "longitude", 2 * np.pi, "radians in [-2 pi, 2 pi]"),
    ):
        do = f"convert degrees with np.radians({name})"
        _refuse(np.abs(angle) > limit, name, angle, text, do)
    _finite(h, "height")
    normal = SEMI_MAJOR / np.sqrt(1.0 - _ECCENTRICITY2 * np.sin(lat) ** 2)
    across = (normal + h) * np.cos(lat)
    up = (normal * (1.0 - _ECCENTRICITY2) + h) * np.sin(lat)
    return np.stack([across * np.cos(lon), across * np.sin(lon), up])


def geodetic_from_ecef(position: ArrayLike) -> Array:
    """Latitude, longitude and height of an Earth-centred, Earth-fixed position.

    Shapes:
        position ``(3, *batch)``; result ``(3, *batch)``.
    Units:
        m; result rad in [-pi/2, pi/2], rad in [-pi, pi], m above the ellipsoid.

    Raises:
        DomainError: within 1000 km of the Earth's centre, where geodetic latitude loses its meaning.
    Reference:
        Bowring, "Transformation from spatial to geographical coordinates", Survey Review 23 (1976),
        iterated to rounding; the height by Bowring, "The accuracy of geodetic latitude and height
        equations", Survey Review 28 (1985), which is exact at the poles too.

    Example:
    >>> geodetic_from_ecef([0.0, 0.0, 6356752.314245179]).tolist()[0] == np.pi / 2
    True
    """
    x, y, z = _together(*zip(_vector(position, "position", 3), "xyz", strict=True))
    across = np.hypot(x, y)
    radius = np.hypot(across, z)
    _refuse(
        radius < _NEAREST,
        "position",
        radius,
        "a distance from the Earth's centre of at least 1e6 m",
        "check that the position is Earth-centred and in metres",
    )
    # The reduced latitude, kept as a direction so that the poles need no special case.
    cosine, sine = _direction(across, z / (1.0 - FLATTENING))
    for _ in range(_ROUNDS):
        upward = z + _SECOND_ECCENTRICITY2 * _SEMI_MINOR * sine**3
        outward = across - _ECCENTRICITY2 * SEMI_MAJOR * cosine**3
        cosine, sine = _direction(outward, (1.0 - FLATTENING) * upward)
    cosine, sine = _direction((1.0 - FLATTENING) * cosine, sine)
    height = across * cosine + z * sine - SEMI_MAJOR * np.sqrt(1.0 - _ECCENTRICITY2 * sine**2)
    return np.stack([np.arctan2(sine, cosine), np.arctan2(y, x), height])


def _direction(along: Array, up: Array) -> tuple[Array, Array]:
    length = np.hypot(along, up)
    return along / length, up / length


# ------------------------------------------------------------------------------- a small part
@attrs.frozen
class LocalTangentPlane:
    """East, north and up of a place on the Earth: Cartesian axes for data in latitude and longitude.

    Units:
        latitude and longitude in rad, height in m above the ellipsoid.

    Raises:
        DomainError: if the place is not finite or out of range.
    Laws:
        Lengths are those of space; ``to_geodetic`` undoes ``from_geodetic``
        (tests/property/test_geodesy_laws.py).

    Example:
    >>> plane = LocalTangentPlane(*np.radians([50.75, -1.10]))
    >>> enu = plane.from_geodetic(*np.radians([50.76, -1.10]))
    >>> enu[1:].round(3).tolist()
    [1112.436, -0.097]
    >>> np.degrees(plane.to_geodetic(enu)[:2]).round(9).tolist()
    [50.76, -1.1]
    """

    latitude: float = attrs.field(converter=float)
    longitude: float = attrs.field(converter=float)
    height: float = attrs.field(default=0.0, converter=float)

    def __attrs_post_init__(self) -> None:
        if np.isnan(self._origin()).any():
            raise DomainError(
                wording(
                    "the origin of a LocalTangentPlane",
                    got=f"({self.latitude}, {self.longitude}, {self.height})",
                    expected="finite numbers",
                    do="give a known place",
                )
            )

    def from_geodetic(
        self, latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike = 0.0
    ) -> Array:
        """East, north, up of geodetic coordinates.

        Shapes:
            any that broadcast to ``batch``; result ``(3, *batch)``.
        Units:
            rad, rad, m; result m.

        Raises:
            DomainError: as ``ecef_from_geodetic``.
        """
        position = ecef_from_geodetic(latitude, longitude, height)
        origin = self._origin().reshape(3, *(1,) * (position.ndim - 1))
        return np.tensordot(self._axes(), position - origin, axes=1)

    def to_geodetic(self, enu: ArrayLike) -> Array:
        """Latitude, longitude and height of a position in the plane.

        Shapes:
            enu ``(3, *batch)``: east, north, up; result ``(3, *batch)``.
        Units:
            m; result rad, rad, m.

        Raises:
            DomainError: as ``geodetic_from_ecef``.
        """
        local = _vector(enu, "enu", 3)
        origin = self._origin().reshape(3, *(1,) * (local.ndim - 1))
        return geodetic_from_ecef(origin + np.tensordot(self._axes().T, local, axes=1))

    def _origin(self) -> Array:
        return ecef_from_geodetic(self.latitude, self.longitude, self.height)

    def _axes(self) -> Array:
        sin_lat, cos_lat = np.sin(self.latitude), np.cos(self.latitude)
        sin_lon, cos_lon = np.sin(self.longitude), np.cos(self.longitude)
        return np.array(
            [
                [-sin_lon, cos_lon, 0.0],
                [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
                [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
            ]
        )


# ----------------------------------------------------------------------- courses and bearings
def velocity_from_course(course: ArrayLike, speed: ArrayLike) -> Array:
    """East and north velocity of a course over ground, which counts from north towards east.

    Shapes:
        any that broadcast to ``batch``; result ``(2, *batch)``.
    Units:
        rad, m/s; result m/s.

    Example:
    >>> (velocity_from_course(np.radians(90.0), 10 * KNOT) / KNOT).round(9).tolist()
    [10.0, 0.0]
    """
    angle, pace = _together((course, "course"), (speed, "speed"))
    _finite(angle, "course")
    _finite(pace, "speed")
    return np.stack([pace * np.sin(angle), pace * np.cos(angle)])


def course_from_velocity(velocity: ArrayLike) -> Array:
    """Course over ground and speed of an east and north velocity; standing still heads north.

    Shapes:
        velocity ``(2, *batch)``; result ``(2, *batch)``: course, speed.
    Units:
        m/s; result rad in [0, 2 pi), m/s.

    Example:
    >>> course, speed = course_from_velocity([-3.0, 0.0])
    >>> float(np.degrees(course)), float(speed)
    (270.0, 3.0)
    """
    east, north = _together(*zip(_vector(velocity, "velocity", 2), ("east", "north"), strict=True))
    return np.stack([_full_turn(np.arctan2(east, north)), np.hypot(east, north)])


def angle_from_bearing(bearing: ArrayLike) -> Array:
    """Mathematical angle, from east towards north, of a bearing, from north towards east.

    Units:
        rad; result in (-pi, pi].

    Example:
    >>> np.degrees(angle_from_bearing(np.radians([0.0, 90.0, 270.0]))).tolist()
    [90.0, 0.0, 180.0]
    """
    opposite = _finite(as_array(bearing, "bearing"), "bearing") + np.pi / 2
    return np.pi - _full_turn(opposite)


def bearing_from_angle(angle: ArrayLike) -> Array:
    """Bearing, from north towards east, of a mathematical angle, from east towards north.

    Units:
        rad; result in [0, 2 pi).

    Example:
    >>> np.degrees(bearing_from_angle(np.radians([0.0, 90.0, 180.0]))).tolist()
    [90.0, 0.0, 270.0]
    """
    return _full_turn(np.pi / 2 - _finite(as_array(angle, "angle"), "angle"))


def _full_turn(angle: Array) -> Array:
    turned = np.mod(angle, 2 * np.pi)
    return np.where(turned == 2 * np.pi, 0.0, turned)  # mod rounds -1e-20 up to a full turn
