"""Several sensors read at the same instant as one sensor; no measurement of its own belongs here."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Self

import attrs
import numpy as np

from tracker.errors import CapabilityError, ShapeError, wording
from tracker.models import ComponentSensor, less, where
from tracker.models.component import signature_of
from tracker.protocols import SensorModel
from tracker.types import ArrayLike, Axis, Space
from tracker_sensors.azimuth import sight


def stack(
    sensors: Sequence[SensorModel], names: Sequence[str] | None = None
) -> ComponentSensor | StackedSensors:
    """One sensor that measures what all of the ``sensors`` measure, with independent errors.

    Names of measurements, of pose components and of parameters get the suffix ``_1``, ``_2``, ... of
    their sensor, or ``_`` and its entry of ``names``; poses are laid end to end, those of fixed
    sensors taking no room. The state is the largest among the sensors; the others are moved to it
    by ``over``. Where every sensor can be traced so can the stack, as a single `ComponentSensor`;
    one opaque sensor, or one with a hand-written derivative, makes it a `StackedSensors`.

    Shapes:
        measurement ``(m1 + m2 + ..., *batch)``; pose ``(p1 + p2 + ..., *batch)``.

    Raises:
        ShapeError: if there is no sensor, or ``names`` does not fit.
        CapabilityError: if a sensor lacks a component of the state, or cannot be moved to it.
    Reference:
        paper 0, eq. (30): two stations; paper 4, eq. (4-14), (5-10).
    Laws:
        equal to its parts; those of kind "sensor". Two azimuths have a `prior`: where they cross.

    Example:
    >>> from tracker_sensors import azimuth, range_only
    >>> both = stack([azimuth(0.03).at(sx=1.0, sy=1.0), range_only(5.0)], names=["west", "radar"])
    >>> both.space.names, both.pose_space.names
    (('azimuth_west', 'range_radar'), ('sx_radar', 'sy_radar'))
    >>> both.h([4.0, 5.0, 0.0, 0.0], pose=[4.0, 2.0]).round(4).tolist()
    [0.9273, 3.0]
    """
    suffixes = _suffixes(sensors, names)
    state = max((sensor.state for sensor in sensors), key=len)
    parts = tuple(_moved(sensor, state) for sensor in sensors)
    traced = [p for p in parts if isinstance(p, ComponentSensor) and _can_join(p)]
    if len(traced) < len(parts):
        return StackedSensors(parts, suffixes)
    return ComponentSensor(
        name="stack",
        measure=_Joined.of([p.measure for p in traced], suffixes),
        noise=_BlockDiagonal.of([p.noise for p in traced], suffixes),
        space=_suffixed((p.space for p in traced), suffixes),
        pose_space=_suffixed((p.pose_space for p in traced), suffixes),
        state=state,
        planar=any(p.planar for p in traced),
        parts=tuple(dict.fromkeys(name for p in traced for name in (p.parts or (p.name,)))),
        **_triangulation(traced, suffixes),
        parameters={
            name + suffix: value
            for part, suffix in zip(traced, suffixes, strict=True)
            for name, value in part.parameters.items()
        },
    )


# ------------------------------------------------------------------- all of them traceable
@attrs.frozen
class _Composed:
    """Component functions side by side, their keywords told apart by suffixes.

    Equal if made of the same functions, so that equal stacks share a trace and a kernel.
    """

    functions: tuple[Callable[..., Any], ...]
    suffixes: tuple[str, ...]
    positional: tuple[str, ...]
    keywords: tuple[str, ...]

    @classmethod
    def of(cls, functions: Sequence[Callable[..., Any]], suffixes: tuple[str, ...]) -> Self:
        signatures = [signature_of(function) for function in functions]
        positional = dict.fromkeys(name for names, _ in signatures for name in names)
        keywords = dict.fromkeys(
            name + suffix
            for (_, names), suffix in zip(signatures, suffixes, strict=True)
            for name in names
        )
        return cls(tuple(functions), suffixes, tuple(positional), tuple(keywords))

    def outputs(self, components: tuple[Any, ...], given: dict[str, Any]) -> list[Any]:
        value = dict(zip(self.positional, components, strict=True))
        out = []
        for function, suffix in zip(self.functions, self.suffixes, strict=True):
            positional, keywords = signature_of(function)
            chosen = {name: given[name + suffix] for name in keywords}
            out.append(function(*(value[name] for name in positional), **chosen))
        return out


@attrs.frozen
class _Joined(_Composed):
    """Measurements, one after the other."""

    def __call__(self, *components: Any, **given: Any) -> Any:
        return tuple(entry for part in self.outputs(components, given) for entry in part)


@attrs.frozen
class _BlockDiagonal(_Composed):
    """Covariances along the diagonal."""

    def __call__(self, *components: Any, **given: Any) -> Any:
        blocks = self.outputs(components, given)
        size, start, rows = sum(map(len, blocks)), 0, []
        for block in blocks:
            after = size - start - len(block)
            rows += [(*(0.0,) * start, *row, *(0.0,) * after) for row in block]
            start += len(block)
        return tuple(rows)


@attrs.frozen
class _Triangulated:
    """Where two lines of sight meet; NaN where they do not, or only behind a sensor."""

    along: tuple[Callable[..., Any], Callable[..., Any]]
    positional: tuple[str, ...]
    keywords: tuple[str, ...]

    def __call__(self, first: Any, second: Any, **pose: Any) -> Any:
        (ax, ay), (bx, by) = self.along[0](first), self.along[1](second)
        x, y, other_x, other_y = (pose[name] for name in self.keywords)
        dx, dy = other_x - x, other_y - y
        across = ax * by - ay * bx
        near, far = (dx * by - dy * bx) / across, (dx * ay - dy * ax) / across
        meets = where(less(0.0, near), where(less(0.0, far), near, math.nan), math.nan)
        return (x + meets * ax, y + meets * ay)


def _triangulation(parts: Sequence[ComponentSensor], suffixes: tuple[str, ...]) -> dict[str, Any]:
    """The inverse of a stack of two azimuths; nothing for any other stack."""
    along = [sight(part) for part in parts]
    if len(parts) != 2 or along[0] is None or along[1] is None:
        return {}
    azimuths = tuple("azimuth" + suffix for suffix in suffixes)
    poses = tuple(name + suffix for suffix in suffixes for name in ("sx", "sy"))
    inverse = _Triangulated((along[0], along[1]), azimuths, poses)
    return {"inverse": inverse, "told": ("x", "y")}


# --------------------------------------------------------------------- some of them opaque
@attrs.frozen(eq=False)
class StackedSensors:
    """A stack of which some sensor cannot be traced; `stack` makes it.

    It holds the sensors themselves and asks each in turn, so each may be anything that fulfils
    `tracker.protocols.SensorModel`.
    """

    sensors: tuple[Any, ...]
    suffixes: tuple[str, ...]
    name: str = "stack"

    @property
    def space(self) -> Space:
        """Measurement space: those of the sensors, end to end."""
        return _suffixed((s.space for s in self.sensors), self.suffixes)

    @property
    def pose_space(self) -> Space:
        """Pose space: those of the sensors, end to end."""
        return _suffixed((s.pose_space for s in self.sensors), self.suffixes)

    @property
    def state(self) -> Space:
        """State space, common to all sensors."""
        own: Space = self.sensors[0].state
        return own

    @property
    def linear(self) -> bool:
        """Whether every sensor is linear."""
        return all(getattr(s, "linear", False) for s in self.sensors)

    @property
    def why_opaque(self) -> str:
        """Why this stack cannot be traced."""
        reasons = (getattr(s, "why_opaque", "not written over components") for s in self.sensors)
        return next(filter(None, reasons), "a sensor has a hand-written derivative")

    @property
    def derivative(self) -> Any:
        """`jacobian`, if every sensor has one though not all can be traced; else None."""
        by_hand = (getattr(s, "derivative", None) is not None for s in self.sensors)
        traced = (not getattr(s, "why_opaque", "opaque") for s in self.sensors)
        every = all(hand or easy for hand, easy in zip(by_hand, traced, strict=True))
        return self.jacobian if every else None

    def h(self, x: ArrayLike, pose: ArrayLike | None = None) -> Any:
        """The noise-free measurement, ``(m, *batch)``."""
        return _joined(s.h(x, p) for s, p in self._with_poses(pose))

    def jacobian(self, x: ArrayLike, pose: ArrayLike | None = None) -> Any:
        """Derivatives of `h` by the state, ``(m, n, *batch)``."""
        return _joined((s.jacobian(x, p) for s, p in self._with_poses(pose)), leading=2)

    def hessian(self, x: ArrayLike, pose: ArrayLike | None = None) -> Any:
        """Second derivatives of `h` by the state, ``(m, n, n, *batch)``."""
        for sensor, suffix in zip(self.sensors, self.suffixes, strict=True):
            if not hasattr(sensor, "hessian"):
                raise CapabilityError(
                    f"sensor {suffix[1:]!r} of the stack has no Hessian. Give it a method "
                    "hessian(x, pose), or use a filter that needs no second derivatives."
                )
        return _joined((s.hessian(x, p) for s, p in self._with_poses(pose)), leading=3)

    def R(self, x: ArrayLike, pose: ArrayLike | None = None) -> Any:
        """Measurement noise, ``(m, m, *batch)``: blocks along the diagonal."""
        blocks = [np.asarray(s.R(x, p)) for s, p in self._with_poses(pose)]
        lanes = np.ndim(x) - 1
        blocks = [b.reshape(*b.shape, *(1,) * (lanes + 2 - b.ndim)) for b in blocks]
        size = sum(len(b) for b in blocks)
        batch = np.broadcast_shapes(*(b.shape[2:] for b in blocks))
        out, start = np.zeros((size, size, *batch)), 0
        for block in blocks:
            end = start + len(block)
            out[start:end, start:end] = block
            start = end
        return out

    def residual(self, z: Any, zhat: Any) -> Any:
        """``z - zhat``, each sensor's part subtracted by that sensor."""
        parts, start = [], 0
        for sensor in self.sensors:
            end = start + len(sensor.space)
            parts.append(sensor.residual(z[start:end], zhat[start:end]))
            start = end
        return _joined(parts)

    def over(self, state: Space) -> StackedSensors:
        """The same stack reading states of another space."""
        return attrs.evolve(self, sensors=tuple(_moved(s, state) for s in self.sensors))

    def lanes(self, index: Any) -> StackedSensors:
        """The same stack with per-lane parameters cut to some lanes."""
        cut = (s.lanes(index) if hasattr(s, "lanes") else s for s in self.sensors)
        return attrs.evolve(self, sensors=tuple(cut))

    def _with_poses(self, pose: ArrayLike | None) -> list[tuple[Any, Any]]:
        size = len(self.pose_space)
        given = np.empty(0) if pose is None else np.asarray(pose)
        if size and given.shape[:1] != (size,):
            raise ShapeError(
                wording(
                    "argument 'pose' of the stack",
                    got="nothing" if pose is None else f"shape {given.shape}",
                    expected=f"({size}, *batch): {self.pose_space}",
                    do="lay the poses of the sensors end to end, leaving out fixed ones",
                )
            )
        out, start = [], 0
        for sensor in self.sensors:
            end = start + len(sensor.pose_space)
            out.append((sensor, given[start:end] if end > start else None))
            start = end
        return out


# ------------------------------------------------------------------------------------- both
def _can_join(sensor: ComponentSensor) -> bool:
    return not sensor.why_opaque and sensor.derivative is None


def _moved(sensor: Any, state: Space) -> Any:
    if sensor.state == state:
        return sensor
    if not hasattr(sensor, "over"):
        raise CapabilityError(
            wording(
                "a sensor of the stack",
                got=f"state space ({sensor.state})",
                expected=f"that of the others ({state})",
                do="make all sensors for the same state space, or give this one a method over(state)",
            )
        )
    return sensor.over(state)


def _suffixes(sensors: Sequence[SensorModel], names: Sequence[str] | None) -> tuple[str, ...]:
    chosen = [str(i + 1) for i in range(len(sensors))] if names is None else list(names)
    if not sensors or len(chosen) != len(sensors) or len(set(chosen)) != len(chosen):
        raise ShapeError(
            wording(
                "arguments 'sensors' and 'names' of stack",
                got=f"{len(sensors)} sensors and names {chosen}",
                expected="at least one sensor, and one distinct name for each",
                do="give one name per sensor, or none",
            )
        )
    return tuple(f"_{name}" for name in chosen)


def _suffixed(spaces: Iterable[Space], suffixes: tuple[str, ...]) -> Space:
    named: dict[str, Axis] = {
        axis.name + suffix: axis
        for space, suffix in zip(spaces, suffixes, strict=True)
        for axis in space
    }
    return Space(tuple(attrs.evolve(axis, name=name) for name, axis in named.items()))


def _joined(parts: Iterable[Any], leading: int = 1) -> Any:
    """Parts end to end on the first axis, with batch axes that some share spread over all."""
    arrays = [np.asarray(part) for part in parts]
    batch = np.broadcast_shapes(*(a.shape[leading:] for a in arrays))
    return np.concatenate([np.broadcast_to(a, a.shape[:leading] + batch) for a in arrays])
