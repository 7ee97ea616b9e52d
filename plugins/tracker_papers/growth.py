"""The univariate growth model, whose measurement does not tell the sign: where Gaussian filters fail."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from tracker.models import ComponentMotion, ComponentSensor, cos, diagonal
from tracker.simulation import Scenario
from tracker.types import Gaussian, Space

SPACE = Space.of("x")


def _grow(x: Any, *, t: Any) -> Any:
    return (0.5 * x + 25.0 * x / (1.0 + x * x) + 8.0 * cos(1.2 * t),)


def growth(*, steps: Annotated[int, "1"] = 100) -> Scenario:
    """``x/2 + 25 x / (1 + x^2) + 8 cos(1.2 t)`` in unit noise, of which ``x^2 / 20`` is measured.

    The posterior often has two modes, one on either side of zero. Steps are of one second.

    Reference: Gordon, Salmond and Smith (1993); Kitagawa (1996).
    """
    return Scenario(
        name="growth",
        motion=ComponentMotion(
            name="growth", advance=_grow, noise=lambda: diagonal(1.0), space=SPACE
        ),
        sensor=ComponentSensor(
            name="square",
            measure=lambda x: (x * x / 20.0,),
            noise=lambda: diagonal(1.0),
            space=Space.of("z"),
            state=SPACE,
        ),
        prior=Gaussian([0.1], [[1.0]]),
        t=np.arange(1.0, steps + 1.0),
        summary="the univariate growth model",
    )
