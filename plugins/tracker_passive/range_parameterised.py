"""A start that does not know the range: a bank of filters along the line of the first direction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from tracker.algebra import condition, congruence
from tracker.errors import CapabilityError, DomainError, wording
from tracker.models import absolute, cos, isnan, less, log, sin, where
from tracker.models.graph import Node
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Gaussian, Innovation
from tracker_kalman.gaussian_sum import GaussianSum, GaussianSumFilter, normalised
from tracker_kalman.mixture import begun, chosen, gaussian_member, of_each

ANGLES = ("azimuth", "elevation")


@attrs.frozen(eq=False)
class Bank:
    """A Gaussian sum, and whether a first direction has laid out its members along a line.

    Shapes:
        sum: K members; started ``(*batch)``, 1 where it has, 0 where all members are still the prior.
    """

    sum: GaussianSum
    started: Any

    @property
    def weights(self) -> Any:
        """Weights of the members, ``(K, *batch)``."""
        return self.sum.weights

    def moments(self) -> Gaussian:
        """Mean and covariance of the whole."""
        return self.sum.moments()


def _range(_: Any, attribute: Any, value: float) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise DomainError(
            wording(
                f"parameter {attribute.name!r}",
                got=value,
                expected="a positive range [m]",
                do="pass for example nearest=50.0, farthest=20_000.0",
            )
        )


@attrs.frozen
class RangeParameterised:
    """A bank of filters, one for each interval of the range at which the first direction was measured.

    Until a direction is measured all members are the prior. The first one lays them out: the ranges
    from ``nearest`` to ``farthest`` are cut geometrically into ``components`` cells, so that each
    is as wide relative to its range as any other. What the measurement says of the position, which is
    not Gaussian, becomes a sum of Gaussians, one in each cell: centred on the line of sight, as long as
    the cell, as wide as the error of the angle there, and as heavy as the cell is large (range times width;
    squared range in space). The prior is conditioned on each of them: this gives the velocity that goes
    with the position, and the weight: prior density times size. From then on it is a Gaussian sum.

    Directions are those of a sensor that measures "azimuth", or "azimuth" and "elevation", and nothing
    else, from a site that is its pose or its parameters "sx", "sy" (and "sz"); how angles are counted it
    is asked itself. Other sensors update the members as they are. Any ``filter`` will do for these.

    ``prune`` and ``merge`` as in `tracker_kalman.GaussianSumFilter`; compiled up to 16 components.

    Shapes:
        states with "x", "y" (and, for elevation, "z") of any batch shape.
    Units:
        m.

    Raises:
        DomainError: if ranges are not positive and in order, or components below one.
        CapabilityError: at the first direction, if the sensor was not where it seems to be.
    Reference:
        Peach (1995), Bearings-only tracking using a set of range-parameterised extended Kalman
        filters, IEE Proc. Control Theory and Applications 142 (1), pp. 73-80, for the cells and the bank.
        There all cells are as likely as another; here they weigh what prior and area say.
    Laws:
        those of kind "filter", before the first direction; a turn of everything turns the estimate.
    """

    filter: Any = attrs.field(default="ekf1", converter=gaussian_member)
    components: int = attrs.field(default=32, kw_only=True)
    nearest: float = attrs.field(default=50.0, kw_only=True, validator=_range)
    farthest: float = attrs.field(default=20_000.0, kw_only=True, validator=_range)
    prune: float = attrs.field(default=0.0, kw_only=True)
    merge: float = attrs.field(default=0.0, kw_only=True)
    _sum: GaussianSumFilter = attrs.field(init=False, repr=False)

    @_sum.default
    def _gaussian_sum(self) -> GaussianSumFilter:
        return GaussianSumFilter(
            self.filter, components=self.components, prune=self.prune, merge=self.merge
        )

    def __attrs_post_init__(self) -> None:
        if self.nearest >= self.farthest:
            raise DomainError(
                wording(
                    "parameters 'nearest' and 'farthest'",
                    got=f"{self.nearest} m and {self.farthest} m",
                    expected="a nearest range below the farthest",
                    do="exchange them",
                )
            )

    smoothers = ()

    @property
    def tags(self) -> tuple[str, ...]:
        """Whether it runs on arrays only."""
        return self._sum.tags

    @property
    def why_opaque(self) -> str:
        """Why its step cannot be compiled, or ''."""
        return self._sum.why_opaque

    @property
    def needs(self) -> tuple[str, ...]:
        """What its filter needs."""
        return tuple(self.filter.needs)

    @property
    def width(self) -> int:
        """Lanes that one run takes."""
        return self.components

    # --------------------------------------------------------------------------- the steps
    def beyond_moments(self, motion: MotionModel) -> str:  # noqa: ARG002 - the protocol
        """What it believes that mean and covariance do not say."""
        return f"a sum of {self.components} Gaussians" if self.components > 1 else ""

    def begin(
        self,
        prior: Any,
        motion: MotionModel | None = None,
        sensors: Sequence[SensorModel] = (),
    ) -> Bank:
        """A bank that waits for its first direction: all members are the prior.

        Raises:
            CapabilityError: if a sensor of directions does not measure them from where it seems to be.
        """
        if isinstance(prior, Bank):
            return prior
        for sensor in sensors:
            if _sees_direction(sensor):
                _Sight.probe(sensor, prior.mean, self.nearest)
        count, batch = self.components, prior.mean.shape[1:]
        logs = np.full((count, *batch), -math.log(count))
        flags = (False,) * len(prior.mean) if motion is None else motion.space.circular
        members = begun(self.filter, self._of_prior(prior))
        return Bank(GaussianSum(members, logs, flags), np.zeros(batch))

    def predict(
        self, state: Any, motion: MotionModel, dt: Any, u: Any = None, t: Any = None
    ) -> Bank:
        """Each member predicted; weights stay."""
        before = self.begin(state, motion)
        return attrs.evolve(before, sum=self._sum.predict(before.sum, motion, dt, u, t))

    def project(self, state: Any, sensor: SensorModel, pose: Any = None) -> Any:
        """Moments of the measurement that the members predict together."""
        return self._sum.project(self.begin(state).sum, sensor, pose)

    def update(
        self,
        state: Any,
        sensor: SensorModel,
        z: Any,
        pose: Any = None,
        projection: Any = None,
    ) -> tuple[Bank, Innovation]:
        """Each member updated and weighted; the first direction lays them out.

        The innovation of that step is the one of the prior, with the log-likelihood of the bank.
        """
        before = self.begin(state)
        after, told = self._sum.update(before.sum, sensor, z, pose, projection)
        values = np.asarray(z)
        measured: Any = 1.0
        for value in values:
            measured = where(isnan(value), 0.0, measured)
        fresh = less(0.5, measured - before.started)
        idle = isinstance(fresh, (bool, np.bool_, np.ndarray)) and not np.any(fresh)
        if idle or not _sees_direction(sensor):
            return attrs.evolve(before, sum=after), told
        members = before.sum.each()
        prior = Gaussian.trusted(members.mean[:, 0], members.cov[:, :, 0])
        logs, laid, loglik = self._laid_out(prior, sensor, values, pose)
        begin = of_each(lambda member: begun(self.filter, member), laid)
        first = attrs.evolve(after, members=begin, logs=logs)
        sound = where(less(absolute(told.nis), math.inf), loglik, told.loglik)
        told = attrs.evolve(told, loglik=where(fresh, sound, told.loglik))
        return Bank(chosen(fresh, first, after), where(fresh, 1.0, before.started)), told

    # -------------------------------------------------------------------------- the layout
    def _laid_out(
        self, prior: Gaussian, sensor: Any, z: Any, pose: Any
    ) -> tuple[Any, Gaussian, Any]:
        """Logarithms of weights, members along a line of sight, log-likelihood of the direction."""
        batch = z.shape[1:]
        sight = _Sight.of(sensor, z, pose, prior.mean, self.nearest)
        d = len(sight.towards)
        edges = np.geomspace(self.nearest, self.farthest, self.components + 1)
        middle, spread, size = (v.reshape(-1, *(1,) * len(batch)) for v in cells(edges, d))
        along = sight.towards[:, None] * sight.towards
        across = congruence(sight.turning, sensor.R(prior.mean, pose))
        places = list(sensor.state.position[:d])

        def laid(wide: Gaussian, centre: Any, S: Any) -> tuple[Gaussian, Any]:
            v, S = centre - wide.mean[places], S + wide.cov[np.ix_(places, places)]
            mean, cov, _, fit, _ = condition(wide.mean, wide.cov, v, S, wide.cov[:, places])
            return Gaussian.trusted(mean, cov), fit

        def of_all(value: Any) -> Any:
            return _repeated(value, self.components, len(batch))

        centre = of_all(sight.site) + of_all(sight.towards) * middle
        if not centre.dtype.hasobject:  # graph nodes have no numbers to look at: see `begin`
            sight.check(sensor, z, pose, prior.mean, centre)
        S = of_all(along) * spread + of_all(across) * (middle**2 + spread)
        members, fit = of_each(laid, self._of_prior(prior), centre, S)
        fit = fit + np.log(size) + sight.logarea
        alive = less(absolute(fit), math.inf)
        logs, loglik = normalised(where(alive, fit, -math.inf))
        return logs, chosen(alive, members, 0.0), loglik

    def _of_prior(self, prior: Gaussian) -> Gaussian:
        """A Gaussian several times, on an axis before those of the batch."""
        axes = prior.mean.ndim - 1
        return Gaussian.trusted(
            _repeated(prior.mean, self.components, axes),
            _repeated(prior.cov, self.components, axes),
        )


def cells(edges: Any, dimensions: int) -> tuple[Any, Any, Any]:
    """Mean and variance of the range, and size, of cells in which every place is as likely as another.

    Shapes:
        edges ``(cells + 1,)``; results ``(cells,)``. The size is that of an angle of 1 rad, in space of
        1 sr: ranges have the density ``r`` in the plane and ``r^2`` in space.

    Example:
    >>> middle, spread, size = cells(np.array([0.0, 3.0]), 2)
    >>> middle.tolist(), spread.tolist(), size.tolist()
    ([2.0], [0.5], [4.5])
    """

    def moment(k: int) -> Any:
        return np.diff(edges ** (dimensions + k)) / (dimensions + k)

    size = moment(0)
    middle = moment(1) / size
    return middle, moment(2) / size - middle**2, size


def _repeated(values: Any, count: int, axes: int) -> Any:
    """An array several times, on an axis before those of the batch."""
    axis = values.ndim - axes
    return np.repeat(np.expand_dims(values, axis), count, axis=axis)


# ------------------------------------------------------------------------------ line of sight
def _sees_direction(sensor: Any) -> bool:
    names = sensor.space.names
    return names in {ANGLES, ANGLES[:1]} and len(sensor.state.position) >= len(names) + 1


@attrs.frozen(eq=False)
class _Sight:
    """The line on which a direction was measured.

    Shapes:
        site ``(d, *batch)``; towards, a unit vector ``(d, *batch)``; turning ``(d, d - 1, *batch)``, how
        that turns with the angles; logarea ``(*batch)`` or 0, of a unit of the angles.
    """

    site: Any
    towards: Any
    turning: Any
    logarea: Any

    @classmethod
    def of(cls, sensor: Any, z: Any, pose: Any, mean: Any, distance: float) -> _Sight:
        """From what the sensor itself says of places around it: no convention is assumed."""
        d = len(sensor.space) + 1
        site = _site(sensor, pose, d, z.shape[1:])

        def angles(direction: tuple[float, ...]) -> Any:
            unit = np.reshape(direction, (d, *(1,) * (z.ndim - 1)))
            return sensor.h(_moved(sensor, mean, site + distance * unit), pose)

        if d == 2:
            ahead, left = angles((1.0, 0.0)), angles((0.0, 1.0))
        else:
            ahead, left = angles((1.0, 0.0, 0.0)), angles((0.0, 1.0, 0.0))
        sense = _sign(sensor.residual(left, ahead)[0])
        turn = sense * sensor.residual(z, ahead)[0]
        c, s = cos(turn), sin(turn)
        if d == 2:
            towards, turning = np.stack([c, s]), np.stack([-s, c])[:, None] * sense
            return cls(site, towards, turning, 0.0)
        upwards = _sign(angles((1.0, 0.0, 1.0))[1])
        up = upwards * z[1]
        cu, su = cos(up), sin(up)
        towards = np.stack([cu * c, cu * s, su])
        sideways = np.stack([-cu * s, cu * c, 0.0 * c]) * sense
        rising = np.stack([-su * c, -su * s, cu]) * upwards
        return cls(site, towards, np.stack([sideways, rising], axis=1), log(cu))

    @classmethod
    def probe(cls, sensor: Any, mean: Any, distance: float) -> None:
        """Refuse a sensor that does not measure from where it seems to be: before anything was measured.

        Raises:
            CapabilityError: as `check`.
        """
        told = getattr(sensor, "parameters", {}).values()
        batch = np.broadcast_shapes(mean.shape[1:], *map(np.shape, told))
        mean = np.broadcast_to(mean.reshape(*mean.shape, *(1,) * (len(batch) + 1 - mean.ndim)),
                               (len(mean), *batch))  # fmt: skip
        size, d = sensor.pose_space.size, len(sensor.space) + 1
        pose = 10.0 * np.arange(1.0, size + 1.0).reshape(-1, *(1,) * len(batch)) if size else None
        aside = distance * np.reshape((0.6, 0.8, 0.5)[:d], (d, *(1,) * len(batch)))
        z = sensor.h(_moved(sensor, mean, _site(sensor, pose, d, batch) + aside), pose)
        sight = cls.of(sensor, z, pose, mean, distance)
        sight.check(sensor, z, pose, mean, (sight.site + distance * sight.towards)[:, None])

    def check(self, sensor: Any, z: Any, pose: Any, mean: Any, centre: Any) -> None:
        """Refuse a sensor that would not have measured z from the places found.

        Raises:
            CapabilityError: saying what is expected of a sensor.
        """
        for k in (0, centre.shape[1] - 1):
            again = sensor.h(_moved(sensor, mean, centre[:, k]), pose)
            if (np.abs(sensor.residual(z, again)) > SAME).any():
                raise CapabilityError(
                    wording(
                        f"sensor {getattr(sensor, 'name', type(sensor).__name__)!r}",
                        got="angles that do not lead back to the place that they were found from",
                        expected="azimuth (and elevation) of a target seen from the pose, or the "
                        "parameters, sx, sy (and sz)",
                        do="name the sensor's site so, or start with another filter",
                    )
                )


def _sign(value: Any) -> Any:
    return where(less(0.0, value), 1.0, -1.0)


SAME = 1e-6
"""Angles are the same if they differ by less than this [rad]."""


def _site(sensor: Any, pose: Any, d: int, batch: tuple[int, ...]) -> Any:
    """Where the sensor is, from its pose or its parameters; without either it is the origin."""
    names = sensor.pose_space.names
    offered = getattr(sensor, "parameters", {})
    given = None if pose is None else np.asarray(pose)
    rows = [
        given[names.index(name)] if name in names and given is not None else offered.get(name, 0.0)
        for name in ("sx", "sy", "sz")[:d]
    ]
    nodes = any(isinstance(row, Node) for row in rows)
    out = np.empty((d, *batch), dtype=object if nodes else np.float64)
    for k, row in enumerate(rows):
        out[k] = row
    return out


def _moved(sensor: Any, mean: Any, place: Any) -> Any:
    """A state like ``mean``, somewhere else."""
    state = np.array(mean)
    for k, component in enumerate(sensor.state.position[: len(place)]):
        state[component] = place[k]
    return state
