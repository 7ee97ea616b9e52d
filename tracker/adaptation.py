"""What noise adapters are written with: windows of the past, and models with other noise.

Adapters themselves are plugins; running one beside a filter is `tracker.recursion`.
"""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.errors import DomainError, TraceError, wording
from tracker.models.functions import less, sqrt, where
from tracker.models.parameters import lanes_of_component
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Array, brief

__all__ = [
    "Window",
    "untuned",
    "with_noise",
    "with_process_noise",
    "with_relative_noise",
    "with_scaled_noise",
    "with_scaled_process_noise",
]


@attrs.frozen(eq=False)
class Window:
    """The last so many values of something: what falls out when a new one is put in.

    A sum over a window is kept by adding what goes in and taking away `oldest`. In a compiled step
    the window is a delay line in memory, not a state in registers, so that long ones cost no more.

    Shapes:
        values ``(length, k, *batch)``, a ring; ``place`` is the slot of the oldest.

    Example:
    >>> window = Window.of(2, np.zeros(1)).pushed(np.array([1.0])).pushed(np.array([2.0]))
    >>> window.oldest.tolist()
    [1.0]
    """

    values: Array = attrs.field(repr=brief)
    place: int = 0

    @classmethod
    def of(cls, length: int, like: Array) -> Window:
        """A window of zeros for values ``(k, *batch)``.

        Raises:
            DomainError: if the length is not at least one.
        """
        if length < 1:
            raise DomainError(
                wording(
                    "argument 'length'", got=length, expected="at least 1", do="pass a larger one"
                )
            )
        return cls(np.zeros((length, *np.shape(like))))

    @property
    def oldest(self) -> Array:
        """What falls out next, ``(k, *batch)``; zero until as many were put in as it is long."""
        return self.values[self.place]  # type: ignore[no-any-return]

    def pushed(self, new: Array) -> Window:
        """The window with ``new`` in the place of the oldest."""
        values = self.values.copy()
        values[self.place] = new
        return Window(values, (self.place + 1) % len(values))


@attrs.frozen(eq=False)
class _OtherNoise:
    """A model of which one covariance was replaced; everything else is the model's own."""

    _model: Any
    _name: str
    _noise: Any
    _relative: bool = False

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # copying and pickling ask for these before there is a model
            raise AttributeError(name)
        return _of_another(self, name)

    def Q(self, x: Array, dt: Any) -> Array:
        """Covariance of the process noise."""
        if self._name != "Q":
            return self._model.Q(x, dt)  # type: ignore[no-any-return]
        return _beside(self._noise, x) * where(less(0.0, dt), 1.0, 0.0)  # type: ignore[no-any-return]

    def R(self, x: Array, pose: Any = None) -> Array:
        """Covariance of the measurement noise."""
        if self._name != "R":
            return self._model.R(x, pose)  # type: ignore[no-any-return]
        noise = _beside(self._noise, x)
        if not self._relative:
            return noise  # type: ignore[no-any-return]
        own = self._model.R(x, pose)
        return _scaled(noise, np.stack([own[i, i] for i in range(len(own))]))  # type: ignore[no-any-return]

    def lanes(self, index: Any) -> _OtherNoise:
        """The same model cut to some lanes."""
        noise = self._noise
        if noise.ndim > 2 and noise.shape[-1] > 1:
            noise = noise[..., index]
        return attrs.evolve(self, model=lanes_of_component(self._model, index), noise=noise)


def _of_another(model: Any, name: str) -> Any:
    """What the model within has; if that makes another model, that one gets the other noise, too."""
    found = getattr(model._model, name)  # noqa: SLF001 - its own
    if name in {"with_parameters", "over", "at"}:
        return lambda *given, **named: attrs.evolve(model, model=found(*given, **named))
    return found


def _beside(noise: Any, x: Any, axes: int = 2) -> Any:
    """A covariance with as many batch axes as the state ``x``: those that are missing are shared.

    They are put first, since what a filter keeps several of for each lane stands before the lanes:
    without them it would broadcast over the wrong axes. ``axes``: 1 for a vector.
    """
    lead = np.ndim(x) - 1
    missing = lead - (noise.ndim - axes)
    if missing > 0:
        return noise.reshape(*noise.shape[:axes], *(1,) * missing, *noise.shape[axes:])
    if missing == 0:
        return noise
    if not lead and noise.shape[axes:] == (1,):
        return noise[..., 0]
    if x.dtype.hasobject and not lead:
        raise TraceError("a covariance that differs between lanes was given as a matrix")
    return noise


def with_noise(sensor: SensorModel, R: Any) -> SensorModel:
    """The sensor with another covariance of the measurement noise, ``(m, m)`` or ``(m, m, *batch)``."""
    return _OtherNoise(sensor, "R", R)


def with_relative_noise(sensor: SensorModel, R: Any) -> SensorModel:
    """The sensor with another covariance, in its own standard deviations, ``(m, m)`` or ``(m, m, *batch)``.

    Entry (i, j) is times sigma_i sigma_j of the sensor: what remains its own is how they depend on
    state and pose. Its correlations in place of R make it as it was.
    """
    return _OtherNoise(sensor, "R", R, relative=True)


def with_process_noise(motion: MotionModel, Q: Any) -> MotionModel:
    """The motion with another covariance of the process noise, ``(n, n)`` or ``(n, n, *batch)``.

    It is that of every step, whatever dt; a step of no time has none.
    """
    return _OtherNoise(motion, "Q", Q)


@attrs.frozen(eq=False)
class _ScaledNoise:
    """A model of which one covariance was scaled; everything else is the model's own."""

    _model: Any
    _name: str
    _scale: Any

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # as above
            raise AttributeError(name)
        return _of_another(self, name)

    def Q(self, x: Array, dt: Any) -> Array:
        """Covariance of the process noise."""
        own = self._model.Q(x, dt)
        return _scaled(own, _beside(self._scale, x, 1)) if self._name == "Q" else own  # type: ignore[no-any-return]

    def R(self, x: Array, pose: Any = None) -> Array:
        """Covariance of the measurement noise."""
        own = self._model.R(x, pose)
        return _scaled(own, _beside(self._scale, x, 1)) if self._name == "R" else own  # type: ignore[no-any-return]

    def lanes(self, index: Any) -> _ScaledNoise:
        """The same model cut to some lanes."""
        scale = self._scale
        if scale.ndim > 1 and scale.shape[-1] > 1:
            scale = scale[..., index]
        return attrs.evolve(self, model=lanes_of_component(self._model, index), scale=scale)


def _scaled(cov: Any, scale: Any) -> Any:
    """Every row and column times the root of its scale: variances are scaled, correlations stay."""
    root = sqrt(scale)
    out = cov * (root[:, None] * root[None])
    for i in range(len(scale)):
        out[i, i] = cov[i, i] * scale[i]
    return out


def with_scaled_noise(sensor: SensorModel, scale: Any) -> SensorModel:
    """The sensor with each variance of its noise times a scale ``(m, *batch)``; correlations stay.

    What remains the sensor's own is how its noise depends on state and pose.
    """
    return _ScaledNoise(sensor, "R", scale)


def with_scaled_process_noise(motion: MotionModel, scale: Any) -> MotionModel:
    """The motion with each variance of its noise times a scale ``(n, *batch)``; correlations stay.

    What remains the motion's own is how its noise depends on state and time step: a step of no time
    has none.
    """
    return _ScaledNoise(motion, "Q", scale)


def untuned(model: Any) -> Any:
    """The model that was given to one of the functions above; any other model as it is."""
    return model._model if isinstance(model, (_OtherNoise, _ScaledNoise)) else model  # noqa: SLF001 - their maker asks
