"""Branch-free elementary functions, written over components like everything else.

They replace ``atan2``, ``sin``, ``cos``, ``exp`` and ``log`` of a graph before it is emitted, because
a vector of lanes cannot call a scalar library. Accuracy: at most 2 ulp of the C library's answer
(``sin`` and ``cos`` for ``|x|`` up to 1e5, by absolute error of 1 ulp of 1 near their zeros). NaN in
gives NaN out. Not like the C library: zeros have no sign in ``atan2``, which is 0 at the origin and
inaccurate within 1e-300 of it and beyond 8e307; two infinities have the angle of the x axis; and
``exp`` gives 0 below -708 (no subnormal results).

Reference: S. L. Moshier, Cephes Mathematical Library, exp.c; the reductions are those of W. J.
Cody and W. Waite, Software Manual for the Elementary Functions; log after the polynomial of FDLIBM.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from tracker.models.functions import absolute, floor, isnan, less, maximum, minimum, where

LARGEST = 1.7976931348623157e308
SMALLEST = 5e-324


def _polynomial(z: Any, *coefficients: float) -> Any:
    """Horner's rule, highest power first."""
    out: Any = coefficients[0]
    for c in coefficients[1:]:
        out = out * z + c
    return out


def _two_chains(z: Any, *coefficients: float) -> Any:
    """A polynomial by its even and odd powers, highest power first: half as long to wait for."""
    square = z * z
    even, odd = coefficients[1::2], coefficients[::2]
    if len(coefficients) % 2:
        even, odd = odd, even
    return _polynomial(square, *odd) * z + _polynomial(square, *even)


def atan2(y: Any, x: Any) -> Any:
    """Angle of the point (x, y)."""
    ax, ay = absolute(x), absolute(y)
    wide = less(ax, ay)
    # Either NaN reaches the quotient, because comparisons with it are false.
    longer, shorter = where(wide, ay, ax), where(wide, ax, ay)
    steep = less(0.41421356237309503 * longer, shorter)
    # Reduced to |q| <= tan(pi/8); the bounds keep 0/0 and inf/inf at 0.
    above = minimum(where(steep, shorter - longer, shorter), LARGEST)
    q = above / maximum(where(steep, shorter + longer, longer), 1e-300)
    z = q * q
    r = q + (q * z) * _two_chains(z, *_ARCTANGENT)
    r = where(steep, r + 0.7853981633974483, r)
    r = where(wide, 1.5707963267948966 - r, r)
    r = where(less(x, 0.0), math.pi - r, r)
    return where(less(y, 0.0), -r, r)


_ARCTANGENT = (
    -0.017905018243030178,
    0.03806212010643049,
    -0.050391896366747554,
    0.05847859097557908,
    -0.0666309917993315,
    0.07692059715425502,
    -0.0909089772515136,
    0.11111110782152478,
    -0.14285714280166556,
    0.1999999999995325,
    -0.333333333333332,
)
"""Of (atan(q) - q) / q^3 in q^2, minimax for the relative error of atan(q): 1.3e-18."""


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
    e, m = graph.make("exponent", scaled), graph.make("mantissa", scaled)
    e = where(tiny, e - 54.0, e)
    f = m - 1.0
    q = f / (1.0 + 0.5 * f)  # log(1 + f) = 2 artanh(q / 2)
    z = q * q
    p = _polynomial(
        z,
        1.479819860510658591e-1 / 2**15,
        1.531383769920937332e-1 / 2**13,
        1.818357216161805012e-1 / 2**11,
        2.222219843214978396e-1 / 2**9,
        2.857142874366239149e-1 / 2**7,
        3.999999999940941908e-1 / 2**5,
        6.666666666666735130e-1 / 2**3,
    )
    # In two parts, so that the product of the first with e is exact.
    value = e * 6.93147180369123816490e-1 + (e * 1.90821492927058770002e-10 + (q + q * (z * p)))
    value = where(less(x, math.inf), value, x)
    return where(less(x, SMALLEST), where(less(x, 0.0), math.nan, -math.inf), value)


EXPANSIONS: Mapping[str, Callable[..., Any]] = {
    "atan2": atan2, "sin": sin, "cos": cos, "exp": exp, "log": log,
}  # fmt: skip
"""Operations that a back end replaces before it emits a graph."""
