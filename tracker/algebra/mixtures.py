"""Moments of weighted Gaussians, over lanes and over components; filters that keep several are plugins."""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.algebra import components, lanes
from tracker.algebra.components import _symmetric, dot
from tracker.models.functions import less, where
from tracker.models.graph import plain

__all__ = ["mix"]


def mix(
    mean: Any,
    cov: Any,
    weights: Any,
    circular: bool | tuple[bool, ...] = False,
    about: Any = None,
) -> tuple[Any, Any]:
    """Mean and covariance of a mixture of Gaussians, ``sum w x`` and ``sum w (P + d d')``.

    Differences ``d`` from the mean wrap where a component lives on a circle, and the mean of such a
    component is the weighted mean of the turns from the likeliest member. Members of weight zero must
    be finite, too. The covariance is exactly symmetric, and no larger number is ever subtracted from
    another, so that it stays positive semi-definite however far apart the members are.

    Shapes:
        mean ``(n, K, *batch)``; cov ``(n, n, K, *batch)``; weights ``(K, *batch)``, which sum to one;
        circular: one flag for all components, or one each; about ``(n, *batch)``, what differences are
        taken from instead of the mean; results ``(n, *batch)`` and ``(n, n, *batch)``.
    Reference:
        Bar-Shalom, Li and Kirubarajan (2001), section 1.4.16.
    Laws:
        one member is itself; equal members are one; any order gives the same to rounding.
    """
    flags = (circular,) * len(mean) if isinstance(circular, bool) else circular
    chosen: Any = _on_components if cov.dtype.hasobject else _on_lanes
    return chosen(mean, cov, weights, flags, about)  # type: ignore[no-any-return]


def _on_lanes(mean: Any, cov: Any, weights: Any, flags: tuple[bool, ...], about: Any) -> Any:
    centre = about
    if about is None and not any(flags):
        centre = np.einsum("ik...,k...->i...", mean, weights)
    elif about is None:
        likeliest = np.argmax(weights, axis=0)[None, None]
        near = np.take_along_axis(mean, likeliest, axis=1)
        centre = near[:, 0] + np.einsum("ik...,k...->i...", _apart(mean, near, flags), weights)
    apart = _apart(mean, centre[:, None], flags)
    out = np.einsum("ik...,jk...->ij...", apart * weights, apart)
    out += np.einsum("ijk...,k...->ij...", cov, weights)
    lanes.mirror(out)
    return centre, out


def _apart(mean: Any, centre: Any, flags: tuple[bool, ...]) -> Any:
    out = mean - centre
    for i, flag in enumerate(flags):
        if flag:
            lanes.wrap_in_place(out[i])
    return out


def _on_components(mean: Any, cov: Any, weights: Any, flags: tuple[bool, ...], about: Any) -> Any:
    n, count = mean.shape
    centre = about
    if about is None:
        near = mean[:, 0]
        if any(flags):
            near, heaviest = near.copy(), weights[0]
            for k in range(1, count):
                closer = less(heaviest, weights[k])
                for i, flag in enumerate(flags):
                    if flag:
                        near[i] = plain(where(closer, mean[i, k], near[i]))
                heaviest = where(closer, weights[k], heaviest)
        from_there = components.residual(mean - near[:, None], flags)
        centre = np.empty(n, dtype=object)
        for i in range(n):
            centre[i] = plain(near[i] + dot(weights, from_there[i]))
    apart = components.residual(mean - centre[:, None], flags)
    scaled = [[plain(w * d) for w, d in zip(weights, row, strict=True)] for row in apart]

    def entry(i: int, j: int) -> Any:
        within = dot(weights, cov[i, j])
        return within + dot(scaled[i], apart[j])

    return centre, _symmetric(n, entry)
