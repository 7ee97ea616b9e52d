"""What paper 0 compares, with its printed equations beside the right ones, and what a step costs.

The filters themselves are in `tracker_kalman`; here they are only named, and given their options.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

import attrs
import numpy as np

import tracker as tk
from tracker.compile.fuse import vector
from tracker.compile.program import Program, Rate
from tracker.compile.values import pack, unpack
from tracker.errors import TraceError
from tracker.models.graph import needed
from tracker.types import Array, Gaussian
from tracker_papers.gulf_to_oman import STATIONS

METHODS = ("ekf1", "ekf2", "ukf")
"""The paper's three filters, in its order, with the equations corrected."""

TITLES = MappingProxyType({"ekf1": "EKF1", "ekf2": "EKF2", "ukf": "UKF"})

VARIANTS = MappingProxyType({
    "ekf1": ("ekf1", {}),
    "ekf2": ("ekf2", {}),
    "ekf2 as printed": ("ekf2", {"second_order_innovation": False}),
    "ukf": ("ukf_symmetric", {}),
    "ukf, points kept": ("ukf_symmetric", {"redraw": False}),
})  # fmt: skip
"""Filters by registered name and options: eq. 10 as printed; the points of the UKF not redrawn, which
the paper calls cheaper and less good."""

BELONGS = MappingProxyType({"ekf2 as printed": "ekf2", "ukf, points kept": "ukf"})
"""The row of Table 1 that a variant is a reading of."""

WRONG_HESSIAN = "ekf2, Hessian of eq. 33"


def estimators(scene: tk.Scenario, names: tuple[str, ...] = tuple(VARIANTS)) -> dict[str, Any]:
    """Filters of `VARIANTS`, each followed by a Rauch-Tung-Striebel smoother, on a scenario's models."""
    return {
        name: tk.estimator(
            tk.filters.make(VARIANTS[name][0], **VARIANTS[name][1]),
            motion=scene.motion,
            sensor=scene.sensor,
            smoother="rts",
        )
        for name in names
    }


def with_printed_hessian(scene: tk.Scenario) -> dict[str, Any]:
    """EKF2, complete but for the second derivatives, which are those that eq. 33 prints."""
    sensor = PrintedHessian(scene.sensor, STATIONS)
    made = tk.estimator("ekf2", motion=scene.motion, sensor=sensor, smoother="rts")
    return {WRONG_HESSIAN: made}


@attrs.frozen(eq=False)
class PrintedHessian:
    """A stack of azimuth sensors whose Hessian is what eq. 33 prints, and wrong in xx and yy.

    Only the mixed term is a second derivative; the others have the dimension of an inverse cube of a
    length. The same formula sits in a public toolbox. It serves one purpose: to show the harm.

    Reference: paper 0, eq. 33 as printed.
    """

    sensor: Any
    stations: tuple[tuple[float, float], ...]

    name = "azimuths with the Hessian of eq. 33 as printed"

    @property
    def space(self) -> Any:
        """That of the sensor."""
        return self.sensor.space

    @property
    def pose_space(self) -> Any:
        """That of the sensor."""
        return self.sensor.pose_space

    @property
    def state(self) -> Any:
        """That of the sensor."""
        return self.sensor.state

    def h(self, x: Any, pose: Any = None) -> Any:
        """That of the sensor."""
        return self.sensor.h(x, pose)

    def jacobian(self, x: Any, pose: Any = None) -> Any:
        """That of the sensor: eq. 31."""
        return self.sensor.jacobian(x, pose)

    def R(self, x: Any, pose: Any = None) -> Any:
        """That of the sensor."""
        return self.sensor.R(x, pose)

    def residual(self, z: Any, zhat: Any) -> Any:
        """That of the sensor."""
        return self.sensor.residual(z, zhat)

    def hessian(self, x: Any, pose: Any = None) -> Array:  # noqa: ARG002 - the stations are fixed
        """Eq. 33 as printed, ``(m, 4, 4, *batch)``."""
        x = np.asarray(x, dtype=np.float64)
        out = np.zeros((len(self.stations), 4, 4, *x.shape[1:]))
        for row, (sx, sy) in zip(out, self.stations, strict=True):
            dx, dy = x[0] - sx, x[1] - sy
            r4 = (dx**2 + dy**2) ** 2
            row[0, 0], row[1, 1] = -2 * dx / r4, -2 * dy / r4
            row[0, 1] = row[1, 0] = (dy**2 - dx**2) / r4
        return out


def operations(estimator: Any) -> int | None:
    """Arithmetic operations of one step, forwards and backwards, counted in its graph.

    None for a filter or smoother that cannot be traced. Elementary functions count as what they
    are made of. The number, unlike a time, is the same on every machine.
    """
    n, m = estimator.motion.space.size, estimator.sensors[0].space.size
    ahead, back = Program(), Program()

    def gaussian(program: Program, name: str) -> Gaussian:
        entries = program.input(f"P_{name}", n * (n + 1) // 2, Rate.BOTH)
        return Gaussian.trusted(
            vector(program.input(f"x_{name}", n, Rate.BOTH)), unpack(entries, n)
        )

    try:
        (dt,) = ahead.input("dt", 1, Rate.STEP)
        state = estimator.filter.predict(gaussian(ahead, "filtered"), estimator.motion, dt)
        z = vector(ahead.input("z", m, Rate.BOTH))
        state, _ = estimator.filter.update(state, estimator.sensors[0], z)
        ahead.history("filtered", [*state.mean, *pack(state.cov)])
        (dt,) = back.input("dt", 1, Rate.STEP)
        known = [gaussian(back, name) for name in ("filtered", "predicted", "smoothed")]
        state = estimator.smoother.step(*known, estimator.motion, dt)
        back.history("smoothed", [*state.mean, *pack(state.cov)])
    except (TraceError, TypeError, AttributeError, ValueError, IndexError):
        return None
    return sum(_count(program) for program in (ahead, back))


def _count(program: Program) -> int:
    program.finished()
    roots = program.lowered().roots(0)
    return sum(node.op not in {"input", "const"} for node in needed(roots))
