"""Sets of sigma points: where they lie and what they weigh; no filter belongs here.

A set is a frozen value that gives, for a dimension n, places ``(n, s)`` and weights such that the
weighted places have mean zero, covariance one, and as many further moments of the standard normal
distribution as the set claims (`degree`). Spread by a factor of a covariance they stand for that
Gaussian.
"""

from __future__ import annotations

import functools
import itertools
import math
from typing import Any, Protocol

import attrs
import numpy as np

from tracker.errors import DomainError, wording
from tracker.types import Array


@attrs.frozen(eq=False)
class SigmaPoints:
    """Points of a standard normal distribution.

    Shapes:
        places ``(n, s)``; mean and cov ``(s,)``: the weights of means and of covariances;
        cross ``(s, n)``: those of `tracker.algebra.weighted_mean` for a covariance with what was spread.
    """

    places: Array = attrs.field(repr=False)
    mean: Array
    cov: Array
    cross: Array = attrs.field(init=False, repr=False)

    @cross.default
    def _weighted_places(self) -> Array:
        return _kept((self.places * self.cov).T)

    def __len__(self) -> int:
        return len(self.mean)

    @property
    def negative(self) -> bool:
        """Whether a covariance weight is negative: then a sum of squares may be indefinite."""
        return bool((self.cov < 0.0).any())

    @property
    def rounding(self) -> float:
        """How much larger than their sum the covariance weights are: what cancels between them."""
        return float(np.abs(self.cov).sum())


class PointSet(Protocol):
    """Anything that gives points for a dimension; equal sets give equal points."""

    @property
    def degree(self) -> int:
        """Polynomials of up to this total degree are averaged exactly, in any dimension."""
        ...

    def points(self, n: int) -> SigmaPoints:
        """Points in n dimensions."""
        ...


def _kept(values: Any) -> Array:
    array = np.ascontiguousarray(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def _made(places: Any, mean: Any, cov: Any = None) -> SigmaPoints:
    """Points without those that weigh nothing."""
    mean = np.asarray(mean, dtype=np.float64)
    cov = mean if cov is None else np.asarray(cov, dtype=np.float64)
    used = (mean != 0.0) | (cov != 0.0)
    return SigmaPoints(_kept(places[:, used]), _kept(mean[used]), _kept(cov[used]))


def _axes(n: int) -> Array:
    """The unit points of both directions of every axis, ``(n, 2 n)``."""
    return np.concatenate([np.eye(n), -np.eye(n)], axis=1)


def _with_centre(places: Array) -> Array:
    return np.concatenate([np.zeros((len(places), 1)), places], axis=1)


@attrs.frozen
class Symmetric:
    """The 2n points at ``sqrt(n)`` on the axes, equally weighted: no centre, no parameter.

    The unscented set of paper 0, and the cubature rule of third degree.

    Reference:
        paper 0, eq. 12, 13; Arasaratnam and Haykin (2009), Cubature Kalman filters, IEEE Transactions
        on Automatic Control 54 (6), eq. 36.
    """

    @property
    def degree(self) -> int:
        """Three."""
        return 3

    @functools.lru_cache(maxsize=64)  # noqa: B019 - sets are small values, equal ones share
    def points(self, n: int) -> SigmaPoints:
        """2n points."""
        return _made(math.sqrt(n) * _axes(n), np.full(2 * n, 0.5 / n))


@attrs.frozen
class Scaled:
    """The centre and 2n points on the axes, as far out as alpha and kappa say.

    ``lambda = alpha^2 (n + kappa) - n``; points at ``sqrt(n + lambda)``; centre weight ``lambda / (n +
    lambda)``, to which ``1 - alpha^2 + beta`` is added for covariances. ``kappa=None`` is ``3 - n``.
    The defaults keep every weight positive; alpha below ``sqrt(n / (n + kappa))`` makes that of the
    centre negative.

    Reference:
        paper 2, eq. 23-30; Wan and van der Merwe (2001), The unscented Kalman filter, eq. 7.30-7.32;
        Julier (2002), The scaled unscented transformation.
    """

    alpha: float = attrs.field(default=1.0)
    beta: float = attrs.field(default=2.0)
    kappa: float | None = attrs.field(default=0.0)

    @alpha.validator
    def _positive(self, _attribute: object, alpha: float) -> None:
        if not alpha > 0.0:
            raise _refused("alpha", alpha, "a positive number", "the usual ones are 1e-3 to 1")

    @beta.validator
    @kappa.validator
    def _finite(self, attribute: Any, value: float | None) -> None:
        if value is not None and not math.isfinite(value):
            raise _refused(attribute.name, value, "a finite number", "the usual ones are 0 to 3")

    @property
    def degree(self) -> int:
        """Three: alpha, beta and kappa change only how errors of fourth order enter."""
        return 3

    @functools.lru_cache(maxsize=64)  # noqa: B019 - as above
    def points(self, n: int) -> SigmaPoints:
        """2n + 1 points, or 2n if the centre weighs nothing."""
        kappa = 3.0 - n if self.kappa is None else self.kappa
        spread = self.alpha**2 * (n + kappa)  # n + lambda
        if not spread > 0.0:
            raise _refused("kappa", kappa, f"more than {-n} in {n} dimensions", "raise kappa")
        mean = np.full(2 * n + 1, 0.5 / spread)
        mean[0] = 1.0 - n / spread
        cov = mean.copy()
        cov[0] += 1.0 - self.alpha**2 + self.beta
        return _made(_with_centre(math.sqrt(spread) * _axes(n)), mean, cov)


def general(kappa: float | None = None) -> Scaled:
    """The original unscented set: `Scaled` with alpha 1 and beta 0; kappa is by default ``3 - n``.

    With ``n + kappa = 3`` the fourth moment along each axis is right too; for n > 3 the centre then
    has a negative weight.

    Reference:
        Julier, Uhlmann and Durrant-Whyte (2000), A new method for the nonlinear transformation of
        means and covariances in filters and estimators, eq. 12.
    """
    return Scaled(1.0, 0.0, kappa)


@attrs.frozen
class SphericalSimplex:
    """n + 1 equally weighted points on a sphere, and a centre of weight ``centre``.

    The fewest points that a covariance needs; their third moments are not zero.

    Reference:
        Julier (2003), The spherical simplex unscented transformation, American Control Conference.
    """

    centre: float = attrs.field(default=0.0)

    @centre.validator
    def _weight(self, _attribute: object, centre: float) -> None:
        _check_centre(centre)

    @property
    def degree(self) -> int:
        """Two."""
        return 2

    @functools.lru_cache(maxsize=64)  # noqa: B019 - as above
    def points(self, n: int) -> SigmaPoints:
        """N + 1 points, and the centre if it weighs something."""
        weight = (1.0 - self.centre) / (n + 1)
        places = np.zeros((n, n + 2))
        for j in range(1, n + 1):
            unit = 1.0 / math.sqrt(j * (j + 1) * weight)
            places[j - 1, 1 : j + 1] = -unit
            places[j - 1, j + 1] = j * unit
        return _made(places, [self.centre, *[weight] * (n + 1)])


@attrs.frozen
class MinimalSimplex:
    """n + 1 points whose third moment along each axis is zero, and a centre of weight ``centre``.

    Weights double from point to point, and the first points lie ``2^(n/2)`` away: meant for few
    dimensions.

    Reference:
        Julier and Uhlmann (2002), Reduced sigma point filters for the propagation of means and
        covariances through nonlinear transformations, American Control Conference.
    """

    centre: float = attrs.field(default=0.0)

    @centre.validator
    def _weight(self, _attribute: object, centre: float) -> None:
        _check_centre(centre)

    @property
    def degree(self) -> int:
        """Two."""
        return 2

    @functools.lru_cache(maxsize=64)  # noqa: B019 - as above
    def points(self, n: int) -> SigmaPoints:
        """N + 1 points, and the centre if it weighs something."""
        first = (1.0 - self.centre) / 2.0**n
        weights = [self.centre, first, *(first * 2.0**i for i in range(n))]
        places = np.zeros((n, n + 2))
        for j in range(1, n + 1):
            away = 1.0 / math.sqrt(2.0 * weights[j + 1])
            places[j - 1, 1 : j + 1] = -away
            places[j - 1, j + 1] = away
        return _made(places, weights)


@attrs.frozen
class CubatureDegree5:
    """The ``2 n^2 + 1`` points of the cubature rule of fifth degree.

    The centre, ``sqrt(n + 2)`` on the axes, and as far on the diagonals between two axes. In more
    than four dimensions the points on the axes have negative weights.

    Reference:
        Jia, Xin and Cheng (2013), High-degree cubature Kalman filter, Automatica 49 (2), eq. 41.
    """

    @property
    def degree(self) -> int:
        """Five."""
        return 5

    @functools.lru_cache(maxsize=64)  # noqa: B019 - as above
    def points(self, n: int) -> SigmaPoints:
        """2 n^2 + 1 points; those on the axes weigh nothing in four dimensions."""
        axes, between = _axes(n), [np.zeros((n, 0))]
        for k, l in itertools.combinations(range(n), 2):
            both = np.zeros((n, 4))
            both[k], both[l] = (1.0, -1.0, 1.0, -1.0), (1.0, -1.0, -1.0, 1.0)
            between.append(both * math.sqrt(0.5))
        diagonals = np.concatenate(between, axis=1)
        weights = [
            2.0 / (n + 2.0),
            *[(4.0 - n) / (2.0 * (n + 2.0) ** 2)] * (2 * n),
            *[1.0 / (n + 2.0) ** 2] * diagonals.shape[1],
        ]
        places = _with_centre(math.sqrt(n + 2.0) * np.concatenate([axes, diagonals], axis=1))
        return _made(places, weights)


@attrs.frozen
class GaussHermite:
    """All combinations of ``order`` Gauss-Hermite points on each axis: ``order^n`` points.

    Reference:
        Ito and Xiong (2000), Gaussian filters for nonlinear filtering problems, IEEE Transactions on
        Automatic Control 45 (5), section IV; Särkkä (2013), section 6.3.
    """

    order: int = attrs.field(default=3)

    @order.validator
    def _at_least_two(self, _attribute: object, order: Any) -> None:
        if not (isinstance(order, int) and order >= 2):
            raise _refused("order", order, "an integer of at least 2", "one point has no spread")

    @property
    def degree(self) -> int:
        """``2 order - 1``, along each axis."""
        return 2 * self.order - 1

    @functools.lru_cache(maxsize=64)  # noqa: B019 - as above
    def points(self, n: int) -> SigmaPoints:
        """order^n points."""
        nodes, weights = np.polynomial.hermite_e.hermegauss(self.order)
        nodes, weights = 0.5 * (nodes - nodes[::-1]), 0.5 * (weights + weights[::-1])
        weights /= weights.sum()
        places = np.array(list(itertools.product(nodes, repeat=n))).T
        return _made(places, [math.prod(w) for w in itertools.product(weights, repeat=n)])


NAMED: dict[str, Any] = {
    "symmetric": Symmetric,
    "scaled": Scaled,
    "general": general,
    "spherical_simplex": SphericalSimplex,
    "minimal_simplex": MinimalSimplex,
    "cubature_3": Symmetric,
    "cubature_5": CubatureDegree5,
    "gauss_hermite": GaussHermite,
}
"""The sets that can be named instead of made, with their defaults; ``gauss_hermite_5`` has order 5."""


def point_set(value: str | PointSet) -> PointSet:
    """A set of points, or the one of that name.

    Raises:
        DomainError: for a name that is not in `NAMED`, or what is no set of points.

    Example:
    >>> point_set("gauss_hermite_5"), len(point_set("symmetric").points(4))
    (GaussHermite(order=5), 8)
    """
    if not isinstance(value, str):
        if hasattr(value, "points"):
            return value
    elif value in NAMED:
        made: PointSet = NAMED[value]()
        return made
    elif value.startswith("gauss_hermite_") and value.rsplit("_", 1)[1].isdecimal():
        return GaussHermite(int(value.rsplit("_", 1)[1]))
    raise _refused(
        "points",
        value,
        f"one of {', '.join(NAMED)}, gauss_hermite_N",
        "name one, or pass a point set",
    )


def _check_centre(weight: float) -> None:
    if not 0.0 <= weight < 1.0:
        raise _refused("centre", weight, "a weight of at least 0, below 1", "the usual one is 0")


def _refused(name: str, got: object, expected: str, do: str) -> DomainError:
    return DomainError(wording(f"parameter {name!r}", got=repr(got), expected=expected, do=do))
