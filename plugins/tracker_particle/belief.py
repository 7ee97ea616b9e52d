"""A cloud of weighted particles as a belief, and its moments; no filter lives here."""

from __future__ import annotations

import math
from typing import Any

import attrs
import numpy as np

from tracker.algebra import residual
from tracker.types import Array, Gaussian, brief
from tracker_particle import draws

Flags = tuple[bool, ...]


@attrs.frozen(eq=False)
class Particles:
    """Places with weights, and what makes the numbers drawn for them from here on reproducible.

    ``step`` counts what was drawn since the belief began; ``circular`` says which components live on
    a circle, as the models that it met have said.

    Shapes:
        points ``(n, N, *batch)``; log_weights ``(N, *batch)``, whose exponentials sum to one; key
        ``(2, *batch)``.
    """

    points: Array = attrs.field(repr=brief)
    log_weights: Array = attrs.field(repr=brief)
    key: draws.Keys = attrs.field(repr=False)
    step: int = 0
    circular: Flags = ()
    known: Gaussian | None = attrs.field(default=None, init=False, repr=False)
    """The moments, where they were found on the way; a changed copy does not have them."""
    known_size: Any = attrs.field(default=None, init=False, repr=False)
    memory: Any = attrs.field(default=None, init=False, repr=False)
    """What points and log weights look into, where a compiled pass wrote them."""

    @classmethod
    def known_as(
        cls,
        points: Array,
        log_weights: Array,
        key: draws.Keys,
        step: int,
        circular: Flags,
        moments: Gaussian | None,
        size: Any = None,
        memory: Any = None,
    ) -> Particles:
        """Particles whose moments, and perhaps effective sample size, are known already."""
        made = object.__new__(cls)
        for fill, value in zip(
            _FILL,
            (points, log_weights, key, step, circular, moments, size, memory),
            strict=True,
        ):
            fill(made, value)
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        kept = (self.points, self.log_weights, self.key, self.step, self.circular)
        return Particles.known_as, (*kept, self.known, self.known_size)

    @property
    def weights(self) -> Array:
        """Weights, ``(N, *batch)``."""
        return np.asarray(np.exp(self.log_weights))

    @property
    def effective_sample_size(self) -> Any:
        """How many equally weighted particles would be worth as much, ``(*batch)``: 1 to N.

        Reference:
            Kong, Liu and Wong 1994; Doucet, Godsill and Andrieu 2000, eq. 51.
        """
        if self.known_size is not None:
            return self.known_size
        return effective_sample_size(self.weights)

    def moments(self) -> Gaussian:
        """Mean and covariance; circular components by their mean direction and the turns from it."""
        if self.known is not None:
            return self.known
        return moments(self.points, self.weights, self.circular)


# A frozen class refuses assignment, and object.__setattr__ costs twice what a slot's setter does.
_FILL = tuple(vars(Particles)[field.name].__set__ for field in attrs.fields(Particles))


def effective_sample_size(weights: Array) -> Any:
    """``1 / sum w**2`` of weights ``(N, *batch)`` that sum to one."""
    if weights.ndim == 1:
        return 1.0 / float(weights.dot(weights))
    return 1.0 / np.einsum("s...,s...->...", weights, weights)


def mean_of(points: Array, weights: Array) -> Array:
    """``sum w x``: points ``(n, N, *batch)``, weights ``(N, *batch)``; result ``(n, *batch)``."""
    if weights.ndim == 1:
        return np.asarray(points.dot(weights))
    return np.asarray(np.einsum("is...,s...->i...", points, weights))


def outer(a: Array, weights: Array, b: Array | None = None) -> Array:
    """``sum w a b'``; exactly symmetric where b is not given.

    Shapes:
        a ``(n, N, *batch)``, b ``(m, N, *batch)``; result ``(n, m, *batch)``.
    """
    if b is None:
        root = a * np.sqrt(weights)
        if weights.ndim == 1:
            return np.asarray(root.dot(root.T))  # BLAS computes one triangle
        out: Array = np.einsum("is...,js...->ij...", root, root)
        for j in range(len(out) - 1):
            out[j + 1 :, j] = out[j, j + 1 :]
        return out
    scaled = a * weights
    if weights.ndim == 1:
        return np.asarray(scaled.dot(b.T))
    return np.asarray(np.einsum("is...,js...->ij...", scaled, b))


def centred(points: Array, weights: Array, circular: Flags) -> tuple[Array, Array]:
    """Mean, and what is left of the points without it; circular means in (-pi, pi].

    Reference:
        Mardia and Jupp, Directional Statistics, section 2.2.1, for what is circular.
    """
    mean = mean_of(points, weights)
    if not any(circular):
        return mean, points - mean[:, None]
    for i in np.flatnonzero(circular):
        sine, cosine = np.sin(points[i]), np.cos(points[i])
        mean[i] = np.arctan2(mean_of(sine[None], weights)[0], mean_of(cosine[None], weights)[0])
    # The mean direction is where turns are measured from; their own mean is then added, so that on a
    # small arc the result is that of a line.
    d = residual(points, mean[:, None], circular)
    turn = mean_of(d, weights)
    mean += np.where(np.reshape(circular, (-1, *(1,) * (mean.ndim - 1))), turn, 0.0)
    return wrapped(mean, circular), d - turn[:, None]


def wrapped(x: Array, circular: Flags) -> Array:
    """Values whose circular components lie in (-pi, pi]."""
    return np.asarray(residual(x, np.zeros_like(x), circular))


def moments(points: Array, weights: Array, circular: Flags = ()) -> Gaussian:
    """Weighted mean and covariance of points.

    Shapes:
        points ``(n, N, *batch)``; weights ``(N, *batch)``, which sum to one.
    """
    mean, d = centred(points, weights, circular)
    return Gaussian.trusted(mean, outer(d, weights))


def spread(root: Array, noise: Array) -> Array:
    """``root @ noise`` for each particle.

    Shapes:
        root ``(n, k, 1 or N, *batch)``, axes of length 1 shared; noise ``(k, N, *batch)``.
    """
    if noise.ndim == 2 and root.shape[2] == 1:
        return np.asarray(root[:, :, 0].dot(noise))
    total: Array = root[:, 0] * noise[0] if len(noise) else np.zeros((len(root), *noise.shape[1:]))
    for j in range(1, len(noise)):
        total += root[:, j] * noise[j]
    return total


def even(count: int, batch: tuple[int, ...]) -> Array:
    """Log weights of particles that weigh the same, ``(count, *batch)``."""
    return np.full((count, *batch), -math.log(count))
