"""A target that turns at a nearly constant, unknown rate; no other manoeuvre lives here."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from tracker.models import ComponentMotion, cos, positive, sin, where
from tracker.types import PLANAR, ArrayLike, Space

# (1 - sin(a)/a) / a^2 = 1/3! - a^2/5! + a^4/7! - ...
_SERIES = tuple((-1.0) ** k / float(np.prod(np.arange(2.0, 2 * k + 4))) for k in range(10))
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(8)


def _flattening(a: Any) -> Any:
    """``(1 - sin(a)/a) / a^2``, to full precision with its derivatives at any angle, 0 included."""
    square = a * a
    small = square < 1.0  # the series has converged there; the closed form loses digits near 0
    near = where(small, square, 0.0)
    series: Any = _SERIES[-1]
    for coefficient in _SERIES[-2::-1]:
        series = coefficient + near * series
    far = where(small, 1.0, a)
    return where(small, series, (1.0 - sin(far) / far) / (far * far))


def _chord(a: Any) -> tuple[Any, Any]:
    """``sin(a)/a`` and ``(1 - cos(a))/a``: the way covered ahead and aside, per unit of path."""
    half = a / 2.0
    sinc = 1.0 - half * half * _flattening(half)
    return 1.0 - a * a * _flattening(a), half * sinc * sinc


def _advance(x: Any, y: Any, vx: Any, vy: Any, omega: Any, *, dt: Any) -> Any:
    a = omega * dt
    ahead, aside = _chord(a)
    return (
        x + dt * (vx * ahead - vy * aside),
        y + dt * (vx * aside + vy * ahead),
        vx * cos(a) - vy * sin(a),
        vx * sin(a) + vy * cos(a),
        omega,
    )


def _noise(vx: Any, vy: Any, omega: Any, *, dt: Any, density: Any, turn_density: Any) -> Any:
    total = [[0.0] * 5 for _ in range(5)]
    for point, weight in zip(_POINTS.tolist(), _WEIGHTS.tolist(), strict=True):
        lag = dt * ((1.0 + point) / 2.0)  # between a disturbance and the end of the step
        step = dt * (weight / 2.0)
        velocity, rate = _responses(vx, vy, omega, dt, lag)
        for i in range(5):
            for j in range(i, 5):
                spread = density * sum(column[i] * column[j] for column in velocity)
                total[i][j] += step * (spread + turn_density * rate[i] * rate[j])
    return tuple(tuple(total[min(i, j)][max(i, j)] for j in range(5)) for i in range(5))


def _responses(vx: Any, vy: Any, omega: Any, dt: Any, lag: Any) -> tuple[Any, Any]:
    """What unit disturbances of vx and vy, and of omega, become ``lag`` seconds later."""
    b = omega * lag
    ahead, aside = _chord(b)
    c, s = cos(b), sin(b)
    velocity = (
        (lag * ahead, lag * aside, c, s, 0.0),
        (-(lag * aside), lag * ahead, -s, c, 0.0),
    )
    # With v the velocity at the end as a complex number: it moves by i lag v, the position by
    # (lag/omega + i (1 - exp(-i b))/omega^2) v.
    end = omega * dt
    ex, ey = vx * cos(end) - vy * sin(end), vx * sin(end) + vy * cos(end)
    half = b / 2.0
    sinc = 1.0 - half * half * _flattening(half)
    real, imaginary = lag * lag * b * _flattening(b), lag * lag / 2.0 * sinc * sinc
    rate = (
        real * ex - imaginary * ey,
        imaginary * ex + real * ey,
        -(lag * ey),
        lag * ex,
        1.0,
    )
    return velocity, rate


def coordinated_turn(
    density: Annotated[ArrayLike, "m^2/s^3"], turn_density: Annotated[ArrayLike, "rad^2/s^3"]
) -> ComponentMotion:
    """Constant speed and turn rate, disturbed by white acceleration and white turn acceleration.

    The turn rate ``omega`` is part of the state, positive to the left (counter-clockwise). ``f`` is
    exact at any turn rate, zero included. ``density`` is the spectral density of the acceleration on
    each axis, ``turn_density`` that of the turn rate's derivative. The noise of a step is not Gaussian;
    Q is its covariance to first order in the disturbances: each is carried along the undisturbed turn
    to the end of the step, and their contributions are integrated by an 8-point Gauss-Legendre rule
    (relative error below 1e-9 for turns of up to half a circle in a step). This keeps what simpler
    choices give up: Q depends on speed and direction, couples turn rate with position, goes over
    into that of constant velocity as omega and turn_density vanish, and composes over steps.

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
