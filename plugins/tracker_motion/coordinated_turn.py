"""A target that turns at a nearly constant, unknown rate; no other manoeuvre lives here."""

from __future__ import annotations

from collections.abc import Callable
from math import factorial
from typing import Annotated, Any

from tracker.models import ComponentMotion, cos, positive, sin, where
from tracker.types import PLANAR, ArrayLike, Space

_TERMS = 11


def _even(a: Any, coefficient: Callable[[int], float], closed: Callable[[Any], Any]) -> Any:
    """``sum (-1)^k coefficient(k) a^(2k)``, whose closed form would lose digits for small angles.

    Both forms, and their derivatives, are good to rounding on their side of one radian.
    """
    square = a * a
    small = square < 1.0
    near = where(small, square, 0.0)
    series: Any = 0.0
    for k in reversed(range(_TERMS)):
        series = (-1.0) ** k * coefficient(k) + near * series
    return where(small, series, closed(where(small, 1.0, a)))


def _flattening(a: Any) -> Any:
    """``(a - sin(a)) / a^3``, 1/6 at 0."""
    return _even(a, lambda k: 1.0 / factorial(2 * k + 3), lambda b: (b - sin(b)) / b**3)


def _sinc(a: Any) -> Any:
    """``sin(a) / a``, 1 at 0."""
    return 1.0 - a * a * _flattening(a)


def _advance(x: Any, y: Any, vx: Any, vy: Any, omega: Any, *, dt: Any) -> Any:
    a = omega * dt
    ahead, aside = _sinc(a), a / 2.0 * _sinc(a / 2.0) ** 2  # sin(a)/a, (1 - cos(a))/a
    return (
        x + dt * (vx * ahead - vy * aside),
        y + dt * (vx * aside + vy * ahead),
        vx * cos(a) - vy * sin(a),
        vx * sin(a) + vy * cos(a),
        omega,
    )


def _noise(vx: Any, vy: Any, omega: Any, *, dt: Any, density: Any, turn_density: Any) -> Any:
    a = omega * dt
    # An acceleration: what is left of it turns, what it has become as position lies on a chord.
    position = density * 2.0 * dt**3 * _flattening(a)
    along = density * dt**2 / 2.0 * _sinc(a / 2.0) ** 2
    across = density * dt**2 * a * _flattening(a)
    velocity = density * dt
    # A change of turn rate ``lag`` seconds before the end moves the velocity v there, as a complex
    # number, by i lag v, and the position by (ahead + i aside) v.
    ex, ey = vx * cos(a) - vy * sin(a), vx * sin(a) + vy * cos(a)
    xx, xy, yy = turn_density * ex * ex, turn_density * ex * ey, turn_density * ey * ey
    wx, wy = turn_density * ex, turn_density * ey
    g, i, gg, gi, ii, gt, it = _moments(omega, dt)
    t, tt = dt**2 / 2.0, dt**3 / 3.0
    return _symmetric(
        (position + gg * xx - 2.0 * gi * xy + ii * yy, (gg - ii) * xy + gi * (xx - yy),
         along - gt * xy + it * yy, across + gt * xx - it * xy, g * wx - i * wy),
        (position + ii * xx + 2.0 * gi * xy + gg * yy,
         -across - it * xy - gt * yy, along + it * xx + gt * xy, i * wx + g * wy),
        (velocity + tt * yy, -tt * xy, -t * wy),
        (velocity + tt * xx, t * wx),
        (turn_density * dt,),
    )  # fmt: skip


def _moments(omega: Any, dt: Any) -> tuple[Any, ...]:
    """Integrals over a step of g, i, g g, g i, i i, g lag and i lag: g ahead, i aside, as above.

    With ``b = omega lag``: ``g = (b - sin(b)) / omega^2``, ``i = (1 - cos(b)) / omega^2``.
    """
    a = omega * dt
    flat = _flattening(a)
    g = _even(a, lambda k: 1.0 / factorial(2 * k + 4), lambda b: (b**2 / 2.0 - 1.0 + cos(b)) / b**4)
    gg = _even(
        a,
        lambda k: (2.0 ** (2 * k + 5) - 4.0 * k - 12.0) / factorial(2 * k + 7),
        lambda b: (
            (b**3 / 3.0 - 2.0 * sin(b) + 2.0 * b * cos(b) + b / 2.0 - sin(b) * cos(b) / 2.0) / b**7
        ),
    )
    ii = _even(
        a,
        lambda k: (2.0 ** (2 * k + 3) - 2.0) / factorial(2 * k + 5),
        lambda b: (1.5 * b - 2.0 * sin(b) + sin(b) * cos(b) / 2.0) / b**5,
    )
    gt = _even(
        a,
        lambda k: (2.0 * k + 4.0) / factorial(2 * k + 5),
        lambda b: (b**3 / 3.0 - sin(b) + b * cos(b)) / b**5,
    )
    it = _even(
        a,
        lambda k: (2.0 * k + 3.0) / factorial(2 * k + 4),
        lambda b: (b**2 / 2.0 - b * sin(b) - cos(b) + 1.0) / b**4,
    )
    return (
        dt**3 * a * g, dt**3 * flat, dt**5 * a * a * gg, dt**5 * a * flat**2 / 2.0, dt**5 * ii,
        dt**4 * a * gt, dt**4 * it,
    )  # fmt: skip


def _symmetric(*upper: tuple[Any, ...]) -> Any:
    n = len(upper)
    return tuple(tuple(upper[min(i, j)][abs(i - j)] for j in range(n)) for i in range(n))


def coordinated_turn(
    density: Annotated[ArrayLike, "m^2/s^3"], turn_density: Annotated[ArrayLike, "rad^2/s^3"]
) -> ComponentMotion:
    """Constant speed and turn rate, disturbed by white acceleration and white turn acceleration.

    The turn rate ``omega`` is part of the state, positive to the left (counter-clockwise). ``f`` is
    exact at any turn rate, zero included. ``density`` is the spectral density of the acceleration on
    each axis, ``turn_density`` that of the turn rate's derivative. The noise of a step is not Gaussian;
    Q is its covariance to first order in the disturbances: each is carried along the undisturbed turn
    to the end of the step, and their contributions are integrated in closed form. This keeps what
    simpler choices give up: Q depends on speed and direction, couples turn rate with position, goes
    over into that of constant velocity as omega and turn_density vanish, and composes over steps.

    Shapes:
        state ``(5, *batch)``: x, y, vx, vy, omega.
    Units:
        m, m/s, rad/s, s; density m^2/s^3, turn_density rad^2/s^3.

    Raises:
        DomainError: if a density is negative.
    Reference:
        Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation,
        2001, section 11.7, for f; Q by paper 0, eq. (3), along the turn instead of a fixed F.
    Laws:
        two half steps equal one step, in f and, through the Jacobian on the way, in Q.

    Example:
    >>> import math
    >>> motion = coordinated_turn(0.1, 1e-6)
    >>> motion.f([0.0, 0.0, 1.0, 0.0, math.pi / 2], dt=1.0).round(4).tolist()
    [0.6366, 0.6366, 0.0, 1.0, 1.5708]
    """
    return ComponentMotion(
        name="coordinated_turn",
        advance=_advance,
        noise=_noise,
        space=PLANAR + Space.of("omega [rad/s]"),
        parameters={
            "density": positive("density", density, unit="m^2/s^3", zero=True),
            "turn_density": positive("turn_density", turn_density, unit="rad^2/s^3", zero=True),
        },
    )
