"""How fast sound is in sea water, by temperature, salinity and depth; its paths live with the sensors."""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.types import Array, ArrayLike, as_array

# Rows by power of temperature, columns by power of pressure in bar (Chen and Millero 1977).
_WATER = (
    (1402.388, 0.153563, 3.1260e-5, -9.7729e-9),
    (5.03711, 6.8982e-4, -1.7107e-6, 3.8504e-10),
    (-5.80852e-2, -8.1788e-6, 2.5974e-8, -2.3643e-12),
    (3.3420e-4, 1.3621e-7, -2.5335e-10, 0.0),
    (-1.47800e-6, -6.1185e-10, 1.0405e-12, 0.0),
    (3.1464e-9, 0.0, 0.0, 0.0),
)
_SALT = (
    (1.389, 9.4742e-5, -3.9064e-7, 1.100e-10),
    (-1.262e-2, -1.2580e-5, 9.1041e-9, 6.649e-12),
    (7.164e-5, -6.4885e-8, -1.6002e-10, -3.389e-13),
    (2.006e-6, 1.0507e-8, 7.988e-12, 0.0),
    (-3.21e-8, -2.0122e-10, 0.0, 0.0),
)


def mackenzie(temperature: ArrayLike, salinity: ArrayLike, depth: ArrayLike) -> Array:
    """Speed of sound [m/s] by nine terms: 2 to 30 degrees, 25 to 40 psu, to 8,000 m; to 0.07 m/s.

    Shapes:
        all scalars or ``(*batch)``, broadcast; result alike.
    Units:
        temperature degrees Celsius; salinity practical salinity units; depth m.
    Reference:
        Mackenzie (1981), Nine-term equation for sound speed in the oceans, JASA 70 (3) 807-812.

    Example:
    >>> round(float(mackenzie(25.0, 35.0, 1000.0)), 3)
    1550.744
    """
    t, s = as_array(temperature, "temperature"), as_array(salinity, "salinity") - 35.0
    d = as_array(depth, "depth")
    value: Any = 1448.96 + 4.591 * t - 5.304e-2 * t**2 + 2.374e-4 * t**3 + 1.340 * s
    value = value + 1.630e-2 * d + 1.675e-7 * d**2 - 1.025e-2 * t * s - 7.139e-13 * t * d**3
    return np.asarray(value)


def unesco(temperature: ArrayLike, salinity: ArrayLike, pressure: ArrayLike) -> Array:
    """Speed of sound [m/s] after Chen and Millero: 0 to 40 degrees, 0 to 40 psu, to 10,000 dbar.

    Shapes:
        all scalars or ``(*batch)``, broadcast; result alike.
    Units:
        temperature degrees Celsius, on the scale of 1990 (converted to that of 1968, in which the
        equation is written); salinity psu; pressure dbar above that of the atmosphere.
    Reference:
        Chen and Millero (1977), JASA 62 (5) 1129-1135; Fofonoff and Millard (1983), UNESCO technical
        papers in marine science 44.

    Example:
    >>> round(float(unesco(40.0 / 1.00024, 40.0, 10_000.0)), 3)
    1731.995
    """
    t = as_array(temperature, "temperature") * 1.00024
    s, p = as_array(salinity, "salinity"), as_array(pressure, "pressure") / 10.0
    water, salt = _polynomial(_WATER, t, p), _polynomial(_SALT, t, p)
    root = -1.922e-2 - 4.42e-5 * t + (7.3637e-5 + 1.7945e-7 * t) * p
    square = 1.727e-3 - 7.9836e-6 * p
    return np.asarray(water + salt * s + root * s**1.5 + square * s**2)


def _polynomial(rows: tuple[tuple[float, ...], ...], t: Any, p: Any) -> Any:
    total: Any = 0.0
    for row in reversed(rows):
        inner: Any = 0.0
        for coefficient in reversed(row):
            inner = inner * p + coefficient
        total = total * t + inner
    return total
