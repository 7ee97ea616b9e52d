"""The information filter (Fraser 1967; Maybeck 1979, section 5.7), on linear and linearised models."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.algebra import (
    apply,
    condition,
    congruence,
    dense,
    factor,
    finite,
    inverse,
    product,
    solve,
    symmetric_product,
    transpose,
    whiten,
    without_missing,
)
from tracker.algebra.gaussian import projected
from tracker.models import isnan, where
from tracker.models.linearise import linearise
from tracker.protocols import MotionModel, SensorModel
from tracker.types import SYMMETRIC, Gaussian, Innovation, Projection, brief
from tracker_kalman.inner import names


@attrs.frozen(eq=False)
class InformationState:
    """A normal distribution by ``y = P^-1 x`` and ``Y = P^-1``; zeros say that nothing is known.

    Shapes:
        vector ``(n, *batch)``; matrix ``(n, n, *batch)``, symmetric.
    """

    vector: Any = attrs.field(repr=brief)
    matrix: Any = attrs.field(repr=brief, metadata=SYMMETRIC)

    def moments(self) -> Gaussian:
        """Mean and covariance; NaN while some direction of the state is unknown."""
        cov = inverse(self.matrix)
        return Gaussian.trusted(apply(cov, self.vector), cov)


@attrs.frozen
class InformationFilter:
    """The first-order filter that carries information, to which a measurement simply adds.

    A start from nothing is exact: of the components named in ``unknown`` (all of them, if you like)
    the prior tells nothing, whatever it says. Until measurements have determined every component the
    moments are NaN and ``ok`` is False; models must be linear until then, because there is no mean to
    linearise about. Predictions need the inverse of F, which
    every motion in continuous time has. A covariance of condition c costs log10(c) digits where it is
    turned into information: prefer "square_root" for those.

    Reference: Maybeck (1979), Stochastic Models, Estimation and Control 1, section 5.7; Bar-Shalom,
        Li and Kirubarajan (2001), section 7.2.
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
            matrix = inverse(prior.cov)
            return InformationState(apply(matrix, prior.mean), matrix)
        without = motion.space.indices(*self.unknown)
        known = np.array([i for i in range(len(prior.mean)) if i not in without], dtype=np.intp)
        vector, matrix = _origin(prior.mean), _origin(prior.cov)
        if len(known):
            block = known[:, None], known
            matrix[block] = inverse(prior.cov[block])
            vector[known] = apply(matrix[block], prior.mean[known])
        return InformationState(vector, matrix)

    def predict(
        self, state: InformationState, motion: MotionModel, dt: Any, u: Any = None, t: Any = None
    ) -> InformationState:
        """``(F Y^-1 F' + Q)^-1``, without inverting Y or Q."""
        mean = state.moments().mean
        linear = getattr(motion, "linear", False)
        f, F = linearise(motion, _origin(mean) if linear else mean, dt, u, t)
        unit = _unit_like(state.matrix)
        back = solve(transpose(dense(F)), unit)  # F^-T
        M = congruence(back, state.matrix)
        L = factor(motion.Q(_known(mean) if linear else mean, dt))
        ML = transpose(product(M, L))
        # I + L' M L is never singular: what is certain (Q = 0) and unknown (M = 0) pass alike.
        root = factor(symmetric_product(transpose(L), ML) + unit)
        half = transpose(whiten(root, ML))
        matrix = M - symmetric_product(half, half)
        vector = apply(matrix, f)
        if linear:  # f(x) = f(0) + F x, whatever x is
            y = apply(back, state.vector)
            vector = vector + y - apply(half, whiten(root, apply(transpose(L), y)))
        return InformationState(vector, matrix)

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
        """``Y + H' R^-1 H``; components that are NaN were not measured."""
        prior = state.moments()
        seen = projected(prior, sensor, pose) if projection is None else projection
        v = sensor.residual(z, seen.z)
        told = condition(prior.mean, prior.cov, v, seen.S, seen.cross)[2:]
        x = prior.mean
        if getattr(sensor, "linear", False) and not any(sensor.space.circular):
            x = _origin(x)
        zhat, H = linearise(sensor, x, pose)
        e = sensor.residual(z, zhat) + apply(H, x)
        R, across = without_missing(sensor.R(_known(prior.mean), pose), transpose(dense(H)), e)
        root = factor(R)
        half = transpose(whiten(root, transpose(across)))
        vector = state.vector + apply(half, whiten(root, _known(e)))
        matrix = state.matrix + symmetric_product(half, half)
        innovation = Innovation(v, seen.S, *told, finite(told[0]))
        return InformationState(vector, matrix), innovation


def _known(v: Any) -> Any:
    """Zero where v is NaN."""
    return np.asarray(where(isnan(v), 0.0, v))


def _origin(x: Any) -> Any:
    return np.zeros(x.shape).astype(x.dtype)


def _unit_like(P: Any) -> Any:
    n = len(P)
    return np.eye(n).astype(P.dtype).reshape(n, n, *(1,) * (P.ndim - 2))
