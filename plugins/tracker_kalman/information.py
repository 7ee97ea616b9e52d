"""The information filter in square-root form (Bierman 1977), on linear and linearised models."""

from __future__ import annotations

import math
from typing import Any

import attrs
import numpy as np

from tracker.algebra import (
    apply,
    beside,
    condition,
    dense,
    factor,
    finite,
    product,
    solve,
    symmetric_product,
    transpose,
    triangularise,
    whiten,
    without_missing,
)
from tracker.algebra.gaussian import projected
from tracker.models import isnan, less, where
from tracker.models.linearise import linearise
from tracker.protocols import MotionModel, SensorModel
from tracker.types import LOWER, Gaussian, Innovation, Projection, brief
from tracker_kalman.inner import names


@attrs.frozen(eq=False)
class InformationState:
    """A normal distribution by a root L of its information ``P^-1 = L L'``, and ``b = L' x``.

    Rows of zeros say that nothing is known of a direction of the state. The root is kept rather than
    its square because a covariance of condition c would cost all digits of c, not half of them.

    Shapes:
        data b ``(n, *batch)``; root ``(n, n, *batch)``, lower triangular.
    """

    data: Any = attrs.field(repr=brief)
    root: Any = attrs.field(repr=brief, metadata=LOWER)

    @property
    def matrix(self) -> Any:
        """The information ``P^-1``, ``(n, n, *batch)``."""
        return symmetric_product(self.root, self.root)

    @property
    def vector(self) -> Any:
        """The information vector ``P^-1 x``, ``(n, *batch)``."""
        return apply(self.root, self.data)

    def moments(self) -> Gaussian:
        """Mean and covariance; NaN while some direction of the state is unknown."""
        half = transpose(_inverted(self.root))
        return Gaussian.trusted(apply(half, self.data), symmetric_product(half, half))


@attrs.frozen
class InformationFilter:
    """The first-order filter that carries information, to which a measurement simply adds.

    A start from nothing is exact: of the components named in ``unknown`` (all of them, if you like)
    the prior tells nothing, whatever it says. Until measurements have determined every component the
    moments are NaN and ``ok`` is False; models must be linear until then, because there is no mean to
    linearise about. A prior that is certain of something (a singular covariance), and a measurement
    without noise (a singular R), have no information form: the lane becomes NaN. Use "square_root". Predictions need the inverse of F, which every motion in continuous time
    has.

    Reference: Bierman (1977), Factorization Methods for Discrete Sequential Estimation; Maybeck (1979),
        Stochastic Models, Estimation and Control 1, sections 5.7 and 7.7; Bar-Shalom, Li and
        Kirubarajan (2001), section 7.2.
    Laws: those of kind "filter"; from no information it is the least-squares solution.
    """

    unknown: tuple[str, ...] = attrs.field(default=(), converter=names)

    needs = ("jacobian",)

    def begin(
        self, prior: Gaussian | InformationState, motion: MotionModel | None = None
    ) -> InformationState:
        """The information in a prior, which must not be singular, about what is not ``unknown``."""
        if isinstance(prior, InformationState):
            return prior
        if not self.unknown or motion is None:
            return _informed(prior.mean, prior.cov)
        without = motion.space.indices(*self.unknown)
        known = np.array([i for i in range(len(prior.mean)) if i not in without], dtype=np.intp)
        data, root = _zeros_like(prior.mean), _zeros_like(prior.cov)
        if len(known):
            block = known[:, None], known
            part = _informed(prior.mean[known], prior.cov[block])
            data[known], root[block] = part.data, part.root
        return InformationState(data, root)

    def predict(
        self, state: InformationState, motion: MotionModel, dt: Any, u: Any = None, t: Any = None
    ) -> InformationState:
        """``(F Y^-1 F' + Q)^-1`` by its root, without inverting Y or Q."""
        mean = state.moments().mean
        linear = getattr(motion, "linear", False)
        f, F = linearise(motion, _zeros_like(mean) if linear else mean, dt, u, t)
        N = solve(transpose(dense(F)), state.root)  # F^-T L: a root of the information about F x
        noise = factor(motion.Q(_known(mean) if linear else mean, dt))
        seen = product(transpose(noise), N)
        n = len(mean)
        # With G G' = Q: [[I, G' N], [0, N]] has the square [[I + G' M G, G' M], [M G, M]], and that of
        # its lower right block, made triangular, is M - M G (I + G' M G)^-1 G' M. What is known of x
        # goes along as a further row.
        unit = _unit_like(state.root)
        none = 0.0 * unit
        joint = _stacked(beside(unit, seen), beside(none, N), beside(none[:1], state.data[None]))
        root, data = joint[n : 2 * n, n : 2 * n], joint[2 * n, n : 2 * n]
        offset = apply(transpose(root), f)
        # f(x) = f(0) + F x if it is linear; else the mean goes to f(x), whatever is known of it.
        return InformationState(data + offset if linear else offset, root)

    def project(self, state: InformationState, sensor: SensorModel, pose: Any = None) -> Projection:
        """``h(x)`` and ``H P H' + R``."""
        return projected(state.moments(), sensor, pose)

    def update(
        self,
        state: InformationState,
        sensor: SensorModel,
        z: Any,
        pose: Any = None,
        projection: Projection | None = None,
    ) -> tuple[InformationState, Innovation]:
        """``Y + H' R^-1 H`` by its root; components that are NaN were not measured."""
        prior = state.moments()
        seen = projected(prior, sensor, pose) if projection is None else projection
        v = sensor.residual(z, seen.z)
        _, _, nis, loglik, count = condition(prior.mean, None, v, seen.S, seen.cross)
        x = prior.mean
        if getattr(sensor, "linear", False) and not any(sensor.space.circular):
            x = _zeros_like(x)  # h(x) = h(0) + H x, whatever x is
        zhat, H = linearise(sensor, x, pose)
        e = sensor.residual(z, zhat) + apply(H, x)
        R, across = without_missing(sensor.R(_known(prior.mean), pose), transpose(dense(H)), e)
        noise = factor(R)
        flaw: Any = 0.0
        for i in range(len(e)):
            flaw = where(less(0.0, noise[i, i]), flaw, math.nan)
        gained = transpose(whiten(noise, transpose(across)))
        n = len(x)
        joint = _stacked(
            beside(state.root, gained), beside(state.data[None], whiten(noise, _known(e))[None])
        )
        nothing: Any = 1.0
        for component in e:
            nothing = where(isnan(component), nothing, 0.0)
        same = less(0.5, nothing)
        data = where(same, state.data, joint[n, :n])
        root = where(same, state.root, joint[:n, :n])
        root[0, 0], nis, loglik = root[0, 0] + flaw, nis + flaw, loglik + flaw
        innovation = Innovation(v, seen.S, nis, loglik, count, finite(nis))
        return InformationState(data, root), innovation


def _stacked(*rows: Any) -> Any:
    """Matrices above each other, as one lower triangular matrix of the same square."""
    batch = np.broadcast_shapes(*(part.shape[2:] for part in rows))
    return triangularise(
        np.concatenate([np.broadcast_to(part, part.shape[:2] + batch) for part in rows])
    )


def _informed(mean: Any, cov: Any) -> InformationState:
    """The information of a Gaussian; NaN where it is singular."""
    root = triangularise(transpose(_inverted(factor(cov))))
    return InformationState(apply(transpose(root), mean), root)


def _inverted(L: Any) -> Any:
    """``L^-1`` of a lower triangular L; NaN where it is singular."""
    flaw: Any = 0.0
    for i in range(len(L)):
        flaw = where(less(0.0, L[i, i]), flaw, math.nan)
    out = whiten(L, _unit_like(L))
    for i in range(len(L)):
        out[i, : i + 1] = out[i, : i + 1] + flaw
    return out


def _known(v: Any) -> Any:
    """Zero where v is NaN."""
    return np.asarray(where(isnan(v), 0.0, v))


def _zeros_like(x: Any) -> Any:
    return np.zeros(x.shape).astype(x.dtype)


def _unit_like(P: Any) -> Any:
    n = len(P)
    return np.eye(n).astype(P.dtype).reshape(n, n, *(1,) * (P.ndim - 2))
