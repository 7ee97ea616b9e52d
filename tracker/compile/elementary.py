"""Branch-free elementary functions, written over components like everything else.

They replace ``atan2``, ``sin``, ``cos``, ``exp`` and ``log`` of a graph before it is emitted, because
a vector of lanes cannot call a scalar library. Accuracy: at most 2 ulp of the C library's answer
(``sin`` and ``cos`` for ``|x|`` up to 1e5, by absolute error of 1 ulp of 1 near their zeros). NaN in
gives NaN out. Not like the C library: zeros have no sign in ``atan2``, which is 0 at
the origin and inaccurate within 1e-300 of it; two infinities have the angle of the x axis; and ``exp`` gives 0 below -708 (no subnormal results).

Reference: S. L. Moshier, Cephes Mathematical Library, atan.c, exp.c; the reductions are those of W. J.
Cody and W. Waite, Software Manual for the Elementary Functions; log after the polynomial of FDLIBM.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from tracker.models.functions import absolute, floor, isnan, less, maximum, minimum, where

LARGEST = 1.7976931348623157e308


def _polynomial(z: Any, *coefficients: float) -> Any:
    """Horner's rule, highest power first."""
    out: Any = coefficients[0]
    for c in coefficients[1:]:
        out = out * z + c
    return out


def atan2(y: Any, x: Any) -> Any:
    """Angle of the point (x, y)."""
    ax, ay = absolute(x), absolute(y)
    longer, shorter = maximum(ax, ay), minimum(ay, ax)
    steep = less(0.41421356237309503 * longer, shorter)
    # Reduced to |q| <= tan(pi/8); the bound keeps 0/0 of the origin at 0. The quotient is corrected
    # once, because a product with a reciprocal is an ulp off and the sum below amplifies it.
    above = where(steep, shorter - longer, shorter)
    below = maximum(where(steep, shorter + longer, longer), 1e-300)
    inverse = 1.0 / below
    q = above * inverse
    q = where(less(LARGEST, longer), 0.0, q + (above - q * below) * inverse)
    z = q * q
    p = _polynomial(
        z,
        -8.750608600031904122785e-1,
        -1.615753718733365076637e1,
        -7.500855792314704667340e1,
        -1.228866684490136173410e2,
        -6.485021904942025371773e1,
    )
    d = _polynomial(
        z,
        1.0,
        2.485846490142306297962e1,
        1.650270098316988542046e2,
        4.328810604912902668951e2,
        4.853903996359136964868e2,
        1.945506571482613964425e2,
    )
    r = q + q * (z * p / d)
    r = where(steep, r + 0.7853981633974483, r)
    r = where(less(ax, ay), 1.5707963267948966 - r, r)
    r = where(less(x, 0.0), math.pi - r, r)
    r = where(less(y, 0.0), -r, r)
    return where(isnan(x), x, where(isnan(y), y, r))


def _sine_and_cosine(x: Any) -> tuple[Any, Any, Any]:
    """Sine and cosine of the remainder by pi/2, and the quadrant 0 to 3."""
    k = floor(x * 0.6366197723675814 + 0.5)
    r = ((x - k * 1.5707963267341256) - k * 6.077100506506192e-11) - k * 2.0222662487959506e-21
    z = r * r
    s = r + r * z * _polynomial(
        z,
        1.58962301576546568060e-10,
        -2.50507477628578072866e-8,
        2.75573136213857245213e-6,
        -1.98412698295895385996e-4,
        8.33333333332211858878e-3,
        -1.66666666666666307295e-1,
    )
    c = (1.0 - 0.5 * z) + z * z * _polynomial(
        z,
        -1.13585365213876817300e-11,
        2.08757008419747316778e-9,
        -2.75573141792967388112e-7,
        2.48015872888517045348e-5,
        -1.38888888888730564116e-3,
        4.16666666666665929218e-2,
    )
    return s, c, k - 4.0 * floor(k * 0.25)


def sin(x: Any) -> Any:
    """Sine."""
    s, c, quadrant = _sine_and_cosine(x)
    odd = less(0.5, quadrant - 2.0 * floor(quadrant * 0.5))
    value = where(odd, c, s)
    return where(less(1.5, quadrant), -value, value)


def cos(x: Any) -> Any:
    """Cosine."""
    s, c, quadrant = _sine_and_cosine(x)
    odd = less(0.5, quadrant - 2.0 * floor(quadrant * 0.5))
    value = where(odd, s, c)
    return where(less(absolute(quadrant - 1.5), 1.0), -value, value)


def exp(x: Any) -> Any:
    """Exponential; 0 below -708, inf above 709.78."""
    bounded = minimum(maximum(x, -708.0), 709.9)
    k = floor(bounded * 1.4426950408889634 + 0.5)
    r = (bounded - k * 6.93145751953125e-1) - k * 1.42860682030941723212e-6
    z = r * r
    p = r * _polynomial(
        z, 1.26177193074810590878e-4, 3.02994407707441961300e-2, 9.99999999999999999910e-1
    )
    q = _polynomial(
        z,
        3.00198505138664455042e-6,
        2.52448340349684104192e-3,
        2.27265548208155028766e-1,
        2.00000000000000000009e0,
    )
    # 2**k in two factors: k is 1024 for the largest finite results.
    value = (2.0 + 4.0 * (p / (q - p))) * x.graph.make("pow2", k - 1.0)
    value = where(less(709.782712893384, x), math.inf, value)
    return where(isnan(x), x, where(less(x, -708.0), 0.0, value))


def log(x: Any) -> Any:
    """Natural logarithm; -inf at zero, NaN below, inf at inf."""
    graph = x.graph
    # Subnormal numbers are scaled up first: their exponent field is zero.
    tiny = less(x, 2.2250738585072014e-308)
    scaled = where(tiny, x * 18014398509481984.0, x)
    exponent, mantissa = graph.make("exponent", scaled), graph.make("mantissa", scaled)
    exponent = where(tiny, exponent - 54.0, exponent)
    big = less(1.4142135623730951, mantissa)
    m, e = where(big, 0.5 * mantissa, mantissa), where(big, exponent + 1.0, exponent)
    f = m - 1.0
    s = f / (2.0 + f)
    z = s * s
    p = z * _polynomial(
        z,
        1.479819860510658591e-1,
        1.531383769920937332e-1,
        1.818357216161805012e-1,
        2.222219843214978396e-1,
        2.857142874366239149e-1,
        3.999999999940941908e-1,
        6.666666666666735130e-1,
    )
    h = 0.5 * f * f
    value = e * 6.93147180369123816490e-1 - (
        (h - (s * (h + p) + e * 1.90821492927058770002e-10)) - f
    )
    value = where(less(x, math.inf), value, x)
    value = where(less(0.0, x), value, where(less(x, 0.0), math.nan, -math.inf))
    return where(isnan(x), x, value)


EXPANSIONS: Mapping[str, Callable[..., Any]] = {
    "atan2": atan2, "sin": sin, "cos": cos, "exp": exp, "log": log,
}  # fmt: skip
"""Operations that a back end replaces before it emits a graph."""
