"""How a filter may begin: from its first two measurements, or from a draw around what is known.

One measurement is a start where the sensor has a `prior`; starts that do not know the range are in
``tracker_passive``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.errors import CapabilityError, DomainError, wording
from tracker.types import Array, ArrayLike, Gaussian


def two_point(
    sensor: Any,
    before: ArrayLike,
    after: ArrayLike,
    dt: Any,
    *,
    pose_before: ArrayLike | None = None,
    pose_after: ArrayLike | None = None,
    rest: Gaussian | None = None,
) -> Gaussian:
    """Two-point differencing: place from the later measurement, velocity from the difference of both.

    ``x = p(0)``, ``v = (p(0) - p(-1)) / T``, and with the covariances R of the two places
    ``P = [[R0, R0 / T], [R0 / T, (R0 + R-1) / T^2]]``. It holds at the time of the later measurement,
    for a target that did not manoeuvre between them: process noise is left out.

    Shapes:
        sensor: one with a `prior`, that tells places; before, after ``(m, *batch)``; dt scalar or
        ``(*batch)``, positive seconds; poses ``(p,)`` or ``(p, *batch)``; rest ``(n, *batch)`` or
        ``(n,)``: what is known of components that are neither place nor velocity, needed if there are any.
        A lane in which a measurement is incomplete is NaN.

    Raises:
        CapabilityError: if the sensor cannot tell a place, or something is left that nobody told.
        DomainError: if dt is not positive.
    Reference:
        paper 4, eq. 2-20 to 2-22; Bar-Shalom, Li and Kirubarajan (2001), section 5.5.3.

    Example:
    >>> from tracker_sensors import position
    >>> start = two_point(position(2.0), [0.0, 0.0], [10.0, 4.0], dt=2.0)
    >>> start.mean.tolist(), start.sigma.round(3).tolist()
    ([10.0, 4.0, 5.0, 2.0], [2.0, 2.0, 1.414, 1.414])
    """
    if not hasattr(sensor, "prior"):
        raise CapabilityError(
            wording(
                f"sensor {getattr(sensor, 'name', type(sensor).__name__)!r}",
                got="a sensor that cannot tell a state from one measurement (it has no prior)",
                expected="position, range_azimuth, two azimuths in a stack, or the like",
                do="use a start that does not know the range, see `tracker list filter`",
            )
        )
    T = np.asarray(dt, dtype=np.float64)
    if not (T > 0).all():
        raise DomainError(
            wording(
                "argument 'dt'", got=f"{dt}", expected="positive seconds", do="order them by time"
            )
        )
    space, n = sensor.state, sensor.state.size
    pairs = [(p, space.index("v" + space.names[p])) for p in space.position
             if "v" + space.names[p] in space.names]  # fmt: skip
    other = set(space.names) - {space.names[i] for pair in pairs for i in pair}
    if rest is None and other:
        raise CapabilityError(
            wording(
                "argument 'rest'",
                got="nothing about " + ", ".join(sorted(other)),
                expected="what is known of the components that are neither place nor velocity",
                do="pass rest=Gaussian(...) over the whole state",
            )
        )
    blank = Gaussian(np.zeros(n), np.eye(n)) if rest is None else rest
    late = sensor.prior(after, pose_after, blank)
    early = sensor.prior(before, pose_before, blank)
    place, velocity = [p for p, _ in pairs], [v for _, v in pairs]
    block, both = np.ix_(place, place), place + velocity
    mean, cov = np.array(late.mean), np.array(late.cov)
    R0, R1 = late.cov[block], early.cov[block]
    mean[velocity] = (late.mean[place] - early.mean[place]) / T
    cov[both], cov[:, both] = 0.0, 0.0
    cov[block] = R0
    cov[np.ix_(place, velocity)] = R0 / T
    cov[np.ix_(velocity, place)] = R0 / T
    cov[np.ix_(velocity, velocity)] = (R0 + R1) / T**2
    return Gaussian.trusted(mean, cov)


def drawn(truth: ArrayLike, cov: ArrayLike, *, rng: np.random.Generator) -> Gaussian:
    """A start that is as wrong as it says: its mean drawn from ``N(truth, cov)``, its covariance cov.

    For simulations: each lane draws its own. A scenario does so by itself with
    ``initial="prior around truth"``.

    Shapes:
        truth ``(n, *batch)``; cov ``(n, n, *batch)`` or ``(n, n)``.

    Raises:
        ShapeError, DomainError: as `Gaussian`.
    Reference:
        paper 4, eq. 2-19, with P(0|0) in the place of the misprinted P(K|K).

    Example:
    >>> start = drawn(np.zeros((2, 5)), np.diag([1.0, 4.0]), rng=np.random.default_rng(1))
    >>> start.mean.shape, bool((start.mean != 0.0).all())
    ((2, 5), True)
    """
    around = Gaussian(truth, cov)
    mean: Array = around.sample(rng=rng)
    return Gaussian.trusted(mean, around.cov)
