"""The sensor that follows from an author's component functions; no particular sensor lives here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import attrs
import numpy as np

from tracker.algebra import residual
from tracker.errors import CapabilityError, DomainError, ShapeError, TraceError, wording
from tracker.models.component import Author, ComponentFunction
from tracker.models.parameters import checked_parameters, filled, lanes_of, shaped, shown
from tracker.types import EMPTY_SPACE, PLANAR, Array, ArrayLike, Block, Columns, Gaussian, Space


def _function(author: str) -> Any:
    def build(self: ComponentSensor) -> ComponentFunction | None:
        function = getattr(self, author)
        if function is None:
            return None
        names = self.space.names if author == "inverse" else self.state.names
        return ComponentFunction(function, names, f"sensor {self.name!r}")

    return attrs.Factory(build, takes_self=True)


@attrs.frozen(eq=False, kw_only=True)
class ComponentSensor:
    """A sensor written as two plain functions of named components.

    ``measure(x, y, ..., *, pose and parameters)`` returns the noise-free measurement, one entry
    per component of ``space``. ``noise(..., *, pose and parameters)`` returns the covariance R as
    rows. Positional parameters name components of ``state``; keyword-only ones name components of
    ``pose_space`` or entries of ``parameters``. Functions from `tracker.models` make it traceable;
    one that cannot be traced still measures, but has no derivatives unless ``derivative``, a
    function with the signature of ``measure`` that returns rows, gives them. ``parts`` names the
    registered sensors that this one was made of, for `Estimator.cite`. A ``planar`` sensor, whose
    measurement would be wrong where targets have a height, cannot be moved to states with z.
    ``inverse``, a function of the measured components, returns the components ``told`` of the state
    that measured so; a sensor that has one has a `prior`.

    Shapes:
        x ``(n, *batch)``; pose ``(p,)`` or ``(p, *batch)``; parameters scalars or ``(*batch)``.

    Raises:
        CapabilityError: when ``state`` lacks a component that ``measure`` names.
    Laws:
        those of kind "sensor" in `tracker.testing`.

    Example:
    >>> from tracker.models import atan2
    >>> def measure(x, y, *, sx, sy):
    ...     return (atan2(y - sy, x - sx),)
    >>> def noise(*, sigma):
    ...     return ((sigma**2,),)
    >>> sensor = ComponentSensor(
    ...     name="azimuth", measure=measure, noise=noise, parameters={"sigma": 0.1},
    ...     space=Space.of("azimuth [rad] circular"), pose_space=Space.of("sx [m]", "sy [m]"))
    >>> sensor.h([3.0, 4.0, 0.0, 0.0], pose=[3.0, 0.0]).round(4)
    array([1.5708])
    """

    name: str
    measure: Author = attrs.field(repr=False)
    noise: Author = attrs.field(repr=False)
    space: Space = attrs.field(repr=str)
    pose_space: Space = attrs.field(default=EMPTY_SPACE, repr=str)
    state: Space = attrs.field(default=PLANAR, repr=str)
    parameters: MappingProxyType[str, Any] = attrs.field(
        factory=dict, converter=checked_parameters, repr=shown
    )
    derivative: Author | None = attrs.field(default=None, repr=False)
    parts: tuple[str, ...] = attrs.field(default=(), repr=False)
    planar: bool = attrs.field(default=False, repr=False)
    inverse: Author | None = attrs.field(default=None, repr=False)
    told: tuple[str, ...] = attrs.field(default=(), repr=False)
    _measure: ComponentFunction = attrs.field(init=False, repr=False, default=_function("measure"))
    _noise: ComponentFunction = attrs.field(init=False, repr=False, default=_function("noise"))
    _by_hand: ComponentFunction | None = attrs.field(
        init=False, repr=False, default=_function("derivative")
    )
    _inverse: ComponentFunction | None = attrs.field(
        init=False, repr=False, default=_function("inverse")
    )
    _circular: bool | tuple[bool, ...] = attrs.field(init=False, repr=False)

    @_circular.default
    def _all_or_some(self) -> bool | tuple[bool, ...]:
        flags = self.space.circular
        return all(flags) if len(set(flags)) < 2 else flags

    def __attrs_post_init__(self) -> None:
        known = {*self.pose_space.names, *self.parameters}
        asked = {*self._measure.keywords, *self._noise.keywords}
        if asked - known:
            raise CapabilityError(
                wording(
                    f"sensor {self.name!r}",
                    got=f"functions that ask for {', '.join(sorted(asked - known))}",
                    expected=f"names among pose and parameters ({', '.join(sorted(known))})",
                    do="add them to pose_space or to parameters",
                )
            )
        if self._measure.traced and len(self._measure.trace.roots) != self.space.size:
            raise ShapeError(
                wording(
                    f"sensor {self.name!r}: measure",
                    got=f"{len(self._measure.trace.roots)} components",
                    expected=f"{self.space.size}, as space is ({self.space})",
                    do="return one entry per component of space",
                )
            )
        m = self.space.size
        if self._noise.traced and self._noise.trace.shape != (m, m):
            raise ShapeError(
                wording(
                    f"sensor {self.name!r}: noise",
                    got=f"shape {self._noise.trace.shape}",
                    expected=f"({m}, {m}), as space is ({self.space})",
                    do="return R as a tuple of rows: ((sigma**2,),), or diagonal(a, b)",
                )
            )

    # ------------------------------------------------------------------ the protocol
    def h(self, x: ArrayLike, pose: ArrayLike | None = None) -> Any:
        """The noise-free measurement of ``x``, ``(m, *batch)``."""
        state = shaped(x, self.state, "x", self.name)
        return filled(self._measure.evaluate(state, self._keywords(pose)), 1, state.shape[1:])

    def jacobian(self, x: ArrayLike, pose: ArrayLike | None = None) -> Any:
        """Derivatives of `h` by the state, ``(m, n, *batch)``."""
        state = shaped(x, self.state, "x", self.name)
        return filled(self._first(state, self._keywords(pose)), 2, state.shape[1:])

    def hessian(self, x: ArrayLike, pose: ArrayLike | None = None) -> Any:
        """Second derivatives of `h` by the state, ``(m, n, n, *batch)``."""
        state = shaped(x, self.state, "x", self.name)
        self._need_trace("a Hessian")
        second = self._measure.second(state, self._keywords(pose))
        return filled(second, 3, state.shape[1:])

    def linearise(self, x: ArrayLike, pose: ArrayLike | None = None) -> tuple[Any, Any]:
        """`h` and its Jacobian together; the Jacobian in the sparse form that the algebra takes."""
        state = shaped(x, self.state, "x", self.name)
        keywords = self._keywords(pose)
        if self._by_hand is not None:
            value, first = self._measure.evaluate(state, keywords), self._by_hand
            if state.ndim == 1:
                return value, self._first(state, keywords)
            entries = first.evaluate(state, keywords)
            return value, Columns(entries, first.places, self.state.size)
        try:
            return self._measure.linearise(state, keywords)
        except TraceError:
            self._need_trace("a Jacobian")
            raise

    def expand(self, x: ArrayLike, pose: ArrayLike | None = None) -> tuple[Any, Any, Block]:
        """`h`, its Jacobian as in `linearise`, and its Hessians together."""
        state = shaped(x, self.state, "x", self.name)
        self._need_trace("a Hessian")
        value, first, second = self._measure.expand(state, self._keywords(pose))
        if self._by_hand is not None:
            first = self.linearise(state, pose)[1]
        return value, first, second

    def R(self, x: ArrayLike, pose: ArrayLike | None = None) -> Any:
        """Measurement noise, ``(m, m, *batch)``; axes of length 1 where all lanes share it."""
        return self._noise.evaluate(shaped(x, self.state, "x", self.name), self._keywords(pose))

    def residual(self, z: Array, zhat: Array) -> Any:
        """``z - zhat``, wrapped where the measurement lives on a circle."""
        return residual(z, zhat, self._circular)

    @property
    def prior(self) -> Callable[..., Gaussian]:
        """``prior(z, pose, rest)``: a Gaussian over the state from one measurement.

        The components that were measured get the place that measured so, with R seen through the
        derivatives of the inverse (first order: a converted range and azimuth is biased outwards by
        a share of ``sigma_azimuth**2 / 2``); the others are as in ``rest``, uncorrelated with them.

        Shapes:
            z ``(m, *batch)``; pose ``(p,)`` or ``(p, *batch)``; rest ``(n, *batch)`` or ``(n,)``,
            needed where the measurement does not tell all of the state. A lane whose measurement
            misses a component, or fits no state, is NaN.

        Raises:
            AttributeError: when looked for on a sensor whose measurement does not tell a place.
            CapabilityError: without ``rest`` where something is left to be told.
            DomainError: if a single measurement, not in a batch, fits no state.
        """
        if self._inverse is None:
            raise AttributeError(f"sensor {self.name!r} cannot tell a state from one measurement")
        return self._prior

    # -------------------------------------------------------------- another one like it
    def over(self, state: Space) -> ComponentSensor:
        """The same sensor reading states of another space; components are found by name.

        Raises:
            CapabilityError: if ``state`` lacks a component, or a planar sensor would see a height.
        """
        if self.planar and "z" in state.names and "z" not in self.state.names:
            raise CapabilityError(
                wording(
                    f"sensor {self.name!r}",
                    got=f"states with a height ({state})",
                    expected="states in the plane: it was made with axes=2",
                    do="make it with axes=3, or with state=... if horizontal distances are meant",
                )
            )
        return self if state == self.state else attrs.evolve(self, state=state)

    def at(self, **pose: Any) -> ComponentSensor:
        """The same sensor standing still: the named pose components become parameters."""
        for name in pose:
            self.pose_space.index(name)
        rest = Space(tuple(axis for axis in self.pose_space if axis.name not in pose))
        return attrs.evolve(self, pose_space=rest, parameters={**self.parameters, **pose})

    def with_parameters(self, **parameters: Any) -> ComponentSensor:
        """The same sensor with other parameter values, scalars or ``(*batch)``."""
        for name in parameters:
            if name not in self.parameters:
                raise CapabilityError(
                    f"sensor {self.name!r} has no parameter {name!r}; it has "
                    f"{', '.join(self.parameters) or 'none'}."
                )
        return attrs.evolve(self, parameters={**self.parameters, **parameters})

    def lanes(self, index: Any) -> ComponentSensor:
        """The same sensor with per-lane parameters cut to some lanes."""
        cut = lanes_of(self.parameters, index)
        return self if cut is self.parameters else attrs.evolve(self, parameters=cut)

    @property
    def linear(self) -> bool:
        """Whether the derivative of `h` does not depend on the state."""
        return self._measure.linear

    @property
    def why_opaque(self) -> str:
        """Why this sensor cannot be traced, or ''."""
        return self._measure.why_opaque or self._noise.why_opaque

    # ---------------------------------------------------------------------- inside
    def _prior(
        self, z: ArrayLike, pose: ArrayLike | None = None, rest: Gaussian | None = None
    ) -> Gaussian:
        assert self._inverse is not None  # noqa: S101 - prior checked
        measured = shaped(z, self.space, "z", self.name)
        batch, n = measured.shape[1:], self.state.size
        left = [name for name in self.state.names if name not in self.told]
        if rest is None and left:
            raise CapabilityError(
                wording(
                    f"prior of sensor {self.name!r}",
                    got="nothing about " + ", ".join(left),
                    expected="what is known of the components that one measurement does not tell",
                    do="pass rest=Gaussian(...) over the whole state",
                )
            )
        mean, cov = np.zeros((n, *batch)), np.zeros((n, n, *batch))
        if rest is not None:
            lead = (1,) * len(batch) if not rest.batch else ()
            mean[:] = rest.mean.reshape(*rest.mean.shape, *lead)
            cov[:] = rest.cov.reshape(*rest.cov.shape, *lead)
        places, keywords = list(self.state.indices(*self.told)), self._keywords(pose)
        mean[places] = self._inverse.evaluate(measured, keywords)
        if not batch and not np.isfinite(mean).all():
            raise DomainError(
                wording(
                    f"argument 'z' of sensor {self.name!r}",
                    got=f"{measured}",
                    expected="a complete measurement that some state fits",
                    do="wait for another one",
                )
            )
        J = filled(self._inverse.first(measured, keywords), 2, batch)
        R = filled(self.R(mean, pose), 2, batch)
        cov[places], cov[:, places] = 0.0, 0.0
        spread = np.einsum("ik...,kl...,jl...->ij...", J, R, J)
        cov[np.ix_(places, places)] = 0.5 * (spread + spread.swapaxes(0, 1))
        return Gaussian.trusted(mean, cov)

    def _keywords(self, pose: Any) -> Mapping[str, Any]:
        if not self.pose_space.axes:
            return self.parameters
        names = self.pose_space.names
        if pose is None or np.shape(pose)[:1] != (len(names),):
            raise ShapeError(
                wording(
                    f"argument 'pose' of sensor {self.name!r}",
                    got="nothing" if pose is None else f"shape {np.shape(pose)}",
                    expected=f"({len(names)}, *batch): {self.pose_space}",
                    do="pass the pose, or fix it once with .at("
                    + ", ".join(f"{n}=..." for n in names)
                    + ")",
                )
            )
        values = pose.tolist() if isinstance(pose, np.ndarray) and pose.ndim == 1 else pose
        return {**self.parameters, **dict(zip(names, values, strict=True))}

    def _first(self, state: Any, keywords: Mapping[str, Any]) -> Any:
        if self._by_hand is not None:
            places, small = self._by_hand.places, self._by_hand.evaluate(state, keywords)
            if places == tuple(range(self.state.size)):
                return small
            dense = np.zeros((small.shape[0], self.state.size, *small.shape[2:]), dtype=small.dtype)
            dense[:, places] = small
            return dense
        self._need_trace("a Jacobian")
        return self._measure.first(state, keywords)

    def _need_trace(self, what: str) -> None:
        if not self._measure.traced:
            raise CapabilityError(
                f"sensor {self.name!r} has no {what.rsplit(maxsplit=1)[-1]}: its function cannot be traced "
                f"({self._measure.why_opaque}). Write it with functions from tracker.models, "
                "pass derivative=..., or use a filter that needs no derivatives."
            )
