"""The linear example of chapter 3 of paper 4: a flying object whose filter is told the wrong noise."""

from __future__ import annotations

from types import MappingProxyType
from typing import Annotated, Any

import attrs
import numpy as np

from tracker.models import ComponentMotion, ComponentSensor, diagonal, one_of, positive
from tracker.simulation import Scenario
from tracker.types import Gaussian, Space

SPACE = Space.of("x [m]", "vx [m/s]", "ax [m/s^2]")
"""Position, velocity, acceleration, as the thesis calls them."""

MATRICES = MappingProxyType({
    "decoded": ((0.77, 0.20, 0.00), (0.25, 0.75, 0.25), (0.05, 0.00, 0.75)),
    "literal": ((0.77, 0.20, 0.00), (0.22, 0.72, 0.22), (0.02, 0.00, 0.72)),
})  # fmt: skip
"""Eq. 3-11; in print 2 and 5 are one sign, so that rows 2 and 3 can be read in two ways."""

TRUE_R = MappingProxyType({
    "R": {"text": (0.8, 9.0), "table": (0.1, 9.0)},
    "Q": {"table": (1.8, 3.0), "text": (0.8, 9.0)},
})  # fmt: skip
"""True measurement noise of each experiment: as the text says, and as row J1 of its table implies. The
first is the one adopted."""

TOLD_R = (8.0, 1.0)
TOLD_Q, TRUE_Q = (10.0, 0.2, 12.0), (1.0, 10.0, 2.0)
"""Diagonals in the Q experiment; printed are (10, 0.[2 or 5], 1[2 or 5]) and (1, 10, [2 or 5])."""

PRIOR_VARIANCE, PROCESS_NOISE = 0.01, 0.02


@attrs.frozen
class _Advance:
    """Eq. 3-11: one step, a matrix times the state."""

    rows: tuple[tuple[float, float, float], ...]
    positional: tuple[str, ...] = SPACE.names
    keywords: tuple[str, ...] = ()

    def __call__(self, x: Any, vx: Any, ax: Any) -> Any:
        return tuple(a * x + b * vx + c * ax for a, b, c in self.rows)


def _process(*, q_x: Any, q_vx: Any, q_ax: Any) -> Any:
    return diagonal(q_x, q_vx, q_ax)


def motion(matrix: str, variances: tuple[float, float, float]) -> ComponentMotion:
    """Eq. 3-11: a step of one second whatever dt, with process noise of these variances.

    Raises:
        DomainError: for another reading of the matrix.
    """
    one_of("matrix", matrix, tuple(MATRICES))
    return ComponentMotion(
        name="flying_object",
        advance=_Advance(MATRICES[matrix]),
        noise=_process,
        space=SPACE,
        parameters=dict(zip(("q_x", "q_vx", "q_ax"), variances, strict=True)),
    )


def _measure(x: Any, vx: Any) -> Any:
    return (x, vx)


def _noise(*, sigma_x: Any, sigma_vx: Any) -> Any:
    return diagonal(sigma_x**2, sigma_vx**2)


def sensor(variances: tuple[float, float]) -> ComponentSensor:
    """The first two components of the state with noise of these variances (eq. 3-12)."""
    sigmas = {
        name: positive(name, float(np.sqrt(value)), unit="1")
        for name, value in zip(("sigma_x", "sigma_vx"), variances, strict=True)
    }
    return ComponentSensor(
        name="position_and_speed",
        measure=_measure,
        noise=_noise,
        space=Space.of("x [m]", "vx [m/s]"),
        state=SPACE,
        parameters=sigmas,
    )


def flying_object(
    experiment: str = "R",
    *,
    reading: str | None = None,
    matrix: str = "decoded",
    told: bool = False,
    steps: Annotated[int, "1"] = 500,
) -> Scenario:
    """Three states, two of them measured, and a filter that is wrong about R, or about Q.

    ``experiment`` "R": Q is right, the filter is told R = diag(8, 1). ``experiment`` "Q": R is right,
    the filter is told Q = diag(10, 0.2, 12) where diag(1, 10, 2) is true. ``reading`` says what R is
    in truth: as the "text" says, or as the noise RMS in row J1 of the "table" implies, which differ
    (`TRUE_R`; by default the text in experiment R, the table in experiment Q). ``matrix`` is how the
    digits of F are read. With ``told`` the filter is told the truth: the best that adapting can reach.

    The motion is one of discrete time, a step being a second, whatever dt. The truth is drawn from
    the prior, N(0, 0.01 I), as its start is not given.

    Units: those of the thesis, which gives none: m, m/s, m/s^2 are ours.

    Raises:
        DomainError: for another experiment, reading or matrix.
    Source: paper 4, eq. 3-11, 3-12 and section 3.5.
    """
    one_of("experiment", experiment, tuple(TRUE_R))
    readings = TRUE_R[experiment]
    chosen = next(iter(readings)) if reading is None else reading
    one_of("reading", chosen, tuple(readings))
    true_r, true_q = readings[chosen], TRUE_Q if experiment == "Q" else (PROCESS_NOISE,) * 3
    told_r = true_r if told or experiment == "Q" else TOLD_R
    told_q = true_q if told or experiment == "R" else TOLD_Q
    return Scenario(
        name=f"flying_object ({experiment}, {chosen})",
        motion=motion(matrix, told_q),
        sensor=sensor(told_r),
        truth_motion=motion(matrix, true_q),
        truth_sensor=sensor(true_r),
        prior=Gaussian(np.zeros(3), PRIOR_VARIANCE * np.eye(3)),
        t=np.arange(1.0, steps + 1.0),
        summary=f"linear, the filter is wrong about {experiment}",
    )
