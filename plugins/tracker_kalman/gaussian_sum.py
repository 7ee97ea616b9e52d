"""The Gaussian-sum filter (Alspach and Sorenson 1972) over any Gaussian filter; starts live elsewhere."""

from __future__ import annotations

import functools
import math
from typing import Any

import attrs
import numpy as np

from tracker.algebra import mix
from tracker.errors import DomainError, wording
from tracker.models import absolute, exp, isnan, less, log, maximum, where
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Gaussian, Innovation, Projection
from tracker_kalman.mixture import begun, chosen, gaussian_member, innovation, of_each, together

MOST = 16
"""Members of a compiled step, which has instructions of its own for each of them."""


# ------------------------------------------------------------------------------------- belief
@attrs.frozen(eq=False)
class GaussianSum:
    """Weighted Gaussians: K members of the same state, as a batch axis before those of the lanes.

    ``circular`` tells which components of the state live on a circle.

    Shapes:
        members: a belief over the batch ``(K, *batch)``; logs ``(K, *batch)``, logarithms of weights
        that sum to one, -inf for a member that was given up.
    """

    members: Any
    logs: Any
    circular: tuple[bool, ...]

    @property
    def weights(self) -> Any:
        """Weights, ``(K, *batch)``."""
        return exp(self.logs)

    def each(self) -> Gaussian:
        """Means and covariances of the members, over the batch ``(K, *batch)``."""
        found: Gaussian = of_each(lambda member: member.moments(), self.members)
        return found

    def moments(self) -> Gaussian:
        """Mean and covariance of the whole."""
        own = self.each()
        if self.logs.shape[0] == 1:
            dead = where(isnan(self.logs[0]), math.nan, 0.0)
            return Gaussian.trusted(own.mean[:, 0] + dead, own.cov[:, :, 0] + dead)
        return Gaussian.trusted(*mix(own.mean, own.cov, self.weights, self.circular))


def normalised(logs: Any) -> tuple[Any, Any]:
    """Logarithms of weights that sum to one, and the logarithm of the sum they had.

    Shapes:
        logs ``(K, *batch)``; results alike and ``(*batch)``. NaN where all weights are zero.
    """
    most = largest(logs)
    with np.errstate(all="ignore"):
        total = most + log(exp(logs - most).sum(axis=0))
        # of one member whose weight is zero, nodes would find logs - logs to be nothing
        total = where(less(-math.inf, most), total, math.nan)
        return logs - total, total


def largest(values: Any) -> Any:
    """The largest along the first axis."""
    if not values.dtype.hasobject:
        return np.max(values, axis=0)
    return functools.reduce(maximum, values)  # of graph nodes none is known to be larger


# ------------------------------------------------------------------------------------- filter
def _share(_: Any, attribute: Any, value: float) -> None:
    if not 0.0 <= value < 1.0:
        raise DomainError(
            wording(
                f"parameter {attribute.name!r}",
                got=value,
                expected="a number from 0 to below 1",
                do="pass for example 1e-6",
            )
        )


def _positive_count(_: Any, attribute: Any, value: int) -> None:
    if value < 1:
        raise DomainError(
            wording(
                f"parameter {attribute.name!r}",
                got=value,
                expected="at least one",
                do="pass how many Gaussians to keep",
            )
        )


@attrs.frozen
class GaussianSumFilter:
    """Several Gaussian filters side by side, weighted by how well they predict the measurements.

    Each of the members is an instance of ``filter``, narrow enough for it to be right; together
    they follow what no single Gaussian can. Weights are kept as logarithms, so that none underflows.

    `begin` splits a Gaussian prior into ``components`` along the direction in which the position (or,
    where the state has none, the state) is least certain, at the nodes of Gauss-Hermite quadrature:
    the mixture has all moments of the prior up to order ``2 components - 1``. A `GaussianSum` given
    as prior is taken as it is.

    ``prune``: members with less than this share of the heaviest one's weight are given up. ``merge``:
    at each step the two members whose merging costs least (Runnalls' bound, in nats) become one if
    that is below this; the place of the other is given up. Places are never removed, so that lanes
    stay together, and neither option saves time.

    A member whose state is no longer finite is given up, too; a lane is lost (``ok`` is False) only
    with all of its members. The innovation is that of the mixture: ``residual`` and ``S`` come from
    the moments of the predicted measurement, ``nis`` from these, ``loglik`` from the mixture itself.

    Compiled up to 16 members, if none are merged.

    Raises:
        DomainError: if components is below one, or prune or merge is out of range.
        CapabilityError: if its filter draws random numbers.
    Reference:
        Alspach and Sorenson (1972), IEEE Trans. Automatic Control 17 (4), pp. 439-448; Runnalls (2007),
        IEEE Trans. Aerospace and Electronic Systems 43 (3), pp. 989-999, for merging.
    Laws:
        those of kind "filter", for one component; equal members are one.

    Example:
    >>> import tracker as tk
    >>> prior = tk.Gaussian([0.0, 0.0], [[4.0, 1.0], [1.0, 2.0]])
    >>> belief = GaussianSumFilter("ekf1", components=5).begin(prior)
    >>> belief.weights.round(3).tolist(), belief.moments().cov.round(9).tolist()
    ([0.011, 0.222, 0.533, 0.222, 0.011], [[4.0, 1.0], [1.0, 2.0]])
    """

    filter: Any = attrs.field(default="ekf1", converter=gaussian_member)
    components: int = attrs.field(default=1, kw_only=True, validator=_positive_count)
    prune: float = attrs.field(default=0.0, kw_only=True, validator=_share)
    merge: float = attrs.field(default=0.0, kw_only=True, validator=_share)

    smoothers = ()

    @property
    def tags(self) -> tuple[str, ...]:
        """Whether it runs on arrays only."""
        return ("opaque",) if self.why_opaque else ()

    @property
    def why_opaque(self) -> str:
        """Why its step cannot be compiled, or ''."""
        if self.components > MOST:
            return f"{self.components} members are too many to unroll (at most {MOST})"
        if self.merge:
            return "which members are merged is found by comparing all pairs"
        return str(getattr(self.filter, "why_opaque", ""))

    @property
    def needs(self) -> tuple[str, ...]:
        """What its filter needs."""
        return tuple(self.filter.needs)

    @property
    def width(self) -> int:
        """Lanes that one run takes."""
        return self.components

    def beyond_moments(self, motion: MotionModel) -> str:  # noqa: ARG002 - the protocol
        """What it believes that mean and covariance do not say."""
        return f"a sum of {self.components} Gaussians" if self.components > 1 else ""

    def begin(self, prior: Any, motion: MotionModel | None = None) -> GaussianSum:
        """A prior split into members; a Gaussian sum as it is."""
        if isinstance(prior, GaussianSum):
            return prior
        n = len(prior.mean)
        flags = (False,) * n if motion is None else motion.space.circular
        places = () if motion is None else motion.space.position
        parts, weights = split(prior, self.components, places or tuple(range(n)))
        batch = prior.mean.shape[1:]
        logs = np.log(weights).reshape(-1, *(1,) * len(batch))
        logs = np.broadcast_to(logs, (self.components, *batch)).copy()
        return GaussianSum(begun(self.filter, parts), logs, flags)

    # --------------------------------------------------------------------------- the steps
    def predict(
        self, state: Any, motion: MotionModel, dt: Any, u: Any = None, t: Any = None
    ) -> GaussianSum:
        """Each member predicted; weights stay."""
        before = _sum(state, self.filter)
        given = _over_members(u)

        def ahead(member: Any) -> Any:
            return self.filter.predict(member, motion, dt, given, t)

        members = of_each(ahead, before.members)
        return attrs.evolve(before, members=members, circular=motion.space.circular)

    def project(self, state: Any, sensor: SensorModel, pose: Any = None) -> SumProjection:
        """Moments of the measurement that the members predict together."""
        before = _sum(state, self.filter)
        seen = self._projected(before, sensor, pose)
        own, m = before.each(), len(seen.z)
        mean = np.concatenate([own.mean, seen.z])
        cov = np.empty((len(mean),) * 2 + own.cov.shape[2:], own.cov.dtype)
        cov[:-m, :-m], cov[-m:, -m:] = own.cov, seen.S
        cov[:-m, -m:], cov[-m:, :-m] = seen.cross, seen.cross.swapaxes(0, 1)
        flags = (*before.circular, *sensor.space.circular)
        _, both = mix(mean, cov, before.weights, flags)
        z, S = together(seen.z, seen.S, before.weights, sensor)
        return SumProjection(z, S, both[:-m, -m:], seen)

    def update(
        self,
        state: Any,
        sensor: SensorModel,
        z: Any,
        pose: Any = None,
        projection: Any = None,
    ) -> tuple[GaussianSum, Innovation]:
        """Each member updated, and weighted by its likelihood; NaN in z was not measured."""
        before = _sum(state, self.filter)
        known = isinstance(projection, SumProjection)
        seen = projection.members if known else self._projected(before, sensor, pose)
        measured = np.broadcast_to(np.asarray(z)[:, None], seen.z.shape)
        place = _over_members(pose)

        def updated(member: Any, z: Any, its: Any) -> Any:
            return self.filter.update(member, sensor, z, place, its)

        members, told = of_each(updated, before.members, measured, seen)
        zhat, S = (
            (projection.z, projection.S)
            if known
            else together(seen.z, seen.S, before.weights, sensor)
        )
        alive = less(absolute(told.loglik), math.inf)
        members = chosen(alive, members, 0.0)
        logs, loglik = normalised(where(alive, before.logs + told.loglik, -math.inf))
        after = attrs.evolve(before, members=members, logs=logs)
        if self.merge:
            after = merged(after, self.merge, self.filter)
        if self.prune:
            after = pruned(after, self.prune)
        return after, innovation(sensor, z, zhat, S, loglik, told.count[0])

    def _projected(self, before: GaussianSum, sensor: SensorModel, pose: Any) -> Any:
        place = _over_members(pose)
        return of_each(lambda member: self.filter.project(member, sensor, place), before.members)


@attrs.frozen(eq=False)
class SumProjection:
    """What all members together predict of a measurement, and each of them alone.

    Shapes:
        z ``(m, *batch)``, S ``(m, m, *batch)`` and cross ``(n, m, *batch)``: moments of the mixture;
        members: a projection over the batch ``(K, *batch)``.
    """

    z: Any
    S: Any
    cross: Any
    members: Projection


def _sum(state: Any, rule: Any) -> GaussianSum:
    """A state as a sum; one that never began is a single member."""
    if isinstance(state, GaussianSum):
        return state
    whole = state.moments()
    one = Gaussian.trusted(whole.mean[:, None], whole.cov[:, :, None])
    logs = np.zeros((1, *whole.mean.shape[1:]))
    return GaussianSum(begun(rule, one), logs, (False,) * len(whole.mean))


def _over_members(values: Any) -> Any:
    """Inputs or poses per lane, with an axis for the members before the lanes."""
    if values is None or np.ndim(values) < 2:
        return values
    return np.asarray(values)[:, None]


# --------------------------------------------------------------------- split, prune and merge
def split(prior: Gaussian, count: int, places: tuple[int, ...]) -> tuple[Gaussian, Any]:
    """A Gaussian as ``count`` narrower ones along the least certain direction of some components.

    Shapes:
        prior ``(n, *batch)``; results ``(n, count, *batch)`` and weights ``(count,)``.
    Laws:
        mean and covariance of the mixture are those of the prior.
    """
    if count == 1:
        return Gaussian.trusted(prior.mean[:, None], prior.cov[:, :, None]), np.ones(1)
    nodes, weights = np.polynomial.hermite_e.hermegauss(count)
    weights = weights / weights.sum()
    narrow = 2.0 / (1.0 + count)  # of the variance: members overlap as their number grows
    P = np.moveaxis(prior.cov, (0, 1), (-2, -1))
    direction = np.zeros(P.shape[:-1])
    block = P[..., places, :][..., places]
    finite = np.isfinite(block).all(axis=(-1, -2), keepdims=True)
    _, vectors = np.linalg.eigh(np.where(finite, block, 0.0))
    direction[..., places] = vectors[..., :, -1]
    along = (P @ direction[..., None])[..., 0]
    length = np.sqrt(np.maximum((along * direction).sum(axis=-1), 0.0))[..., None]
    step = np.divide(along, length, out=np.zeros_like(along), where=length > 0.0)
    step = np.moveaxis(step, -1, 0)  # a standard deviation along it; what is correlated moves too
    shifts = nodes * math.sqrt(1.0 - narrow)
    mean = prior.mean[:, None] + step[:, None] * shifts.reshape(-1, *(1,) * len(prior.batch))
    cov = prior.cov - (1.0 - narrow) * step[:, None] * step
    shape = (*cov.shape[:2], count, *prior.batch)
    return Gaussian.trusted(mean, np.broadcast_to(cov[:, :, None], shape).copy()), weights


def pruned(belief: GaussianSum, share: float) -> GaussianSum:
    """The same without members of less than this share of the heaviest one's weight."""
    least = largest(belief.logs) + math.log(share)
    logs, _ = normalised(where(less(belief.logs, least), -math.inf, belief.logs))
    return attrs.evolve(belief, logs=logs)


def merged(belief: GaussianSum, cost: float, rule: Any) -> GaussianSum:
    """The same with the two members that differ least as one, where that costs less than ``cost`` nats.

    Reference:
        Runnalls (2007): an upper bound of the divergence between before and after.
    """
    own, weights = belief.each(), belief.weights
    first, second = np.triu_indices(len(weights), 1)
    if not len(first):
        return belief
    both = np.stack([weights[first], weights[second]])
    sums = both.sum(axis=0)
    with np.errstate(all="ignore"):
        flat = (*both.shape[:2], -1)
        x, P = (np.stack([v[..., first, :], v[..., second, :]], axis=-3) for v in _flat(own))
        mean, cov = mix(x, P, (both / sums).reshape(flat), belief.circular)
        single = _logdet(_flat(own)[1])
        told = sums.reshape(flat[1:]) * _logdet(cov)
        told = told - both[0].reshape(flat[1:]) * single[first]
        told = 0.5 * (told - both[1].reshape(flat[1:]) * single[second])
    # One that was given up costs nothing to merge, and would always be chosen.
    alive = (both > 0.0).all(axis=0).reshape(flat[1:])
    told = np.where(np.isfinite(told) & alive, told, math.inf)
    best = np.argmin(told, axis=0)
    lanes = np.arange(len(best))
    done = lanes[told[best, lanes] < cost]
    if not len(done):
        return belief
    pair = best[done]
    new = [value.copy() for value in _flat(own)]
    new[0][:, first[pair], done] = mean[:, pair, done]
    new[1][:, :, first[pair], done] = cov[:, :, pair, done]
    logs = belief.logs.reshape(len(weights), -1).copy()
    logs[first[pair], done] = np.log(sums.reshape(flat[1:])[pair, done])
    logs[second[pair], done] = -math.inf
    state = Gaussian.trusted(new[0].reshape(own.mean.shape), new[1].reshape(own.cov.shape))
    return attrs.evolve(belief, members=begun(rule, state), logs=logs.reshape(belief.logs.shape))


def _flat(own: Gaussian) -> tuple[Any, Any]:
    """Moments with one axis for all lanes."""
    n, count = own.mean.shape[:2]
    return own.mean.reshape(n, count, -1), own.cov.reshape(n, n, count, -1)


def _logdet(cov: Any) -> Any:
    return np.linalg.slogdet(np.moveaxis(cov, (0, 1), (-2, -1)))[1]
