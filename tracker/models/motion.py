"""The motion model that follows from an author's component functions; no particular one lives here."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import attrs
import numpy as np

from tracker.errors import CapabilityError, ShapeError, TraceError, wording
from tracker.models.component import KEPT, Author, ComponentFunction
from tracker.models.parameters import checked_parameters, filled, lanes_of, shaped, shown
from tracker.types import EMPTY_SPACE, ArrayLike, Block, Space

RESERVED = ("dt", "t")


def _function(author: str) -> Any:
    def build(self: ComponentMotion) -> ComponentFunction:
        return ComponentFunction(getattr(self, author), self.space.names, f"motion {self.name!r}")

    return attrs.Factory(build, takes_self=True)


@attrs.frozen(eq=False, kw_only=True)
class ComponentMotion:
    """A motion model written as two plain functions of named components.

    ``advance(x, y, ..., *, dt, ...)`` returns the state after ``dt`` seconds, one entry per
    component of ``space``. ``noise(..., *, dt, ...)`` returns the covariance Q of what is added to
    it, as rows. Positional parameters name components of ``space``; keyword-only ones are ``dt`` or
    entries of ``parameters`` and, of ``advance`` alone, ``t`` (the time at the start of the step) or
    components of ``input_space``. ``parts`` names the registered motions that this one was made of.

    Shapes:
        x ``(n, *batch)``; dt scalar or ``(*batch)``; u ``(q,)`` or ``(q, *batch)``; parameters
        scalars or ``(*batch)``.
    Laws:
        those of kind "motion" in `tracker.testing`.
    """

    name: str
    advance: Author = attrs.field(repr=False)
    noise: Author = attrs.field(repr=False)
    space: Space = attrs.field(repr=str)
    input_space: Space = attrs.field(default=EMPTY_SPACE, repr=str)
    parameters: MappingProxyType[str, Any] = attrs.field(
        factory=dict, converter=checked_parameters, repr=shown
    )
    parts: tuple[str, ...] = attrs.field(default=(), repr=False)
    _advance: ComponentFunction = attrs.field(init=False, repr=False, default=_function("advance"))
    _noise: ComponentFunction = attrs.field(init=False, repr=False, default=_function("noise"))
    # With neither inputs nor time, keyword values change with dt alone: those of a few dt are
    # kept, so that what follows from them (F, Q) is recognised and not computed again.
    _steady: bool = attrs.field(init=False, repr=False)
    _recent: dict[float, MappingProxyType[str, Any]] = attrs.field(
        init=False, repr=False, factory=dict
    )

    @_steady.default
    def _changes_with_dt_alone(self) -> bool:
        return not self.reads_time and not self.input_space.axes

    def __attrs_post_init__(self) -> None:
        known = {*RESERVED, *self.input_space.names, *self.parameters}
        asked = {*self._advance.keywords, *self._noise.keywords}
        if asked - known:
            raise CapabilityError(
                wording(
                    f"motion {self.name!r}",
                    got=f"functions that ask for {', '.join(sorted(asked - known))}",
                    expected=f"names among {', '.join(sorted(known))}",
                    do="add them to input_space or to parameters",
                )
            )
        unknown_to_noise = {"t", *self.input_space.names}.intersection(self._noise.keywords)
        if unknown_to_noise:
            raise CapabilityError(
                wording(
                    f"motion {self.name!r}: noise",
                    got=f"a function that asks for {', '.join(sorted(unknown_to_noise))}",
                    expected="components of the state, dt and parameters: Q(x, dt) is given no more",
                    do="make it a parameter, or a component of the state",
                )
            )
        if self._advance.traced and len(self._advance.trace.roots) != self.space.size:
            raise ShapeError(
                wording(
                    f"motion {self.name!r}: advance",
                    got=f"{len(self._advance.trace.roots)} components",
                    expected=f"{self.space.size}, as space is ({self.space})",
                    do="return one entry per component of space",
                )
            )
        n = self.space.size
        if self._noise.traced and self._noise.trace.shape != (n, n):
            raise ShapeError(
                wording(
                    f"motion {self.name!r}: noise",
                    got=f"shape {self._noise.trace.shape}",
                    expected=f"({n}, {n}), as space is ({self.space})",
                    do="return Q as a tuple of rows",
                )
            )

    # ------------------------------------------------------------------ the protocol
    @property
    def reads_time(self) -> bool:
        """Whether the step depends on the time at which it begins."""
        return "t" in self._advance.keywords

    def f(self, x: ArrayLike, dt: Any, u: ArrayLike | None = None, t: Any = None) -> Any:
        """The state after ``dt`` seconds without noise, ``(n, *batch)``."""
        state = shaped(x, self.space, "x", self.name)
        value = self._advance.evaluate(state, self._keywords(dt, u, t))
        return filled(value, 1, state.shape[1:])

    def jacobian(self, x: ArrayLike, dt: Any, u: ArrayLike | None = None, t: Any = None) -> Any:
        """Derivatives of `f` by the state, ``(n, n, *batch)``."""
        state = shaped(x, self.space, "x", self.name)
        self._need_trace("a Jacobian")
        return filled(self._advance.first(state, self._keywords(dt, u, t)), 2, state.shape[1:])

    def hessian(self, x: ArrayLike, dt: Any, u: ArrayLike | None = None, t: Any = None) -> Any:
        """Second derivatives of `f` by the state, ``(n, n, n, *batch)``."""
        state = shaped(x, self.space, "x", self.name)
        self._need_trace("a Hessian")
        second = self._advance.second(state, self._keywords(dt, u, t))
        return filled(second, 3, state.shape[1:])

    def linearise(
        self, x: ArrayLike, dt: Any, u: ArrayLike | None = None, t: Any = None
    ) -> tuple[Any, Any]:
        """`f` and its Jacobian together; a Jacobian that all lanes share has trailing axes of 1."""
        state = shaped(x, self.space, "x", self.name)
        try:
            return self._advance.linearise(state, self._keywords(dt, u, t))
        except TraceError:
            self._need_trace("a Jacobian")
            raise

    def expand(
        self, x: ArrayLike, dt: Any, u: ArrayLike | None = None, t: Any = None
    ) -> tuple[Any, Any, Block]:
        """`f`, its Jacobian as in `linearise`, and its Hessians together."""
        state = shaped(x, self.space, "x", self.name)
        self._need_trace("a Hessian")
        return self._advance.expand(state, self._keywords(dt, u, t))

    def Q(self, x: ArrayLike, dt: Any) -> Any:
        """Process noise of a step, ``(n, n, *batch)``; axes of length 1 where all lanes share it."""
        state = shaped(x, self.space, "x", self.name)
        return self._noise.evaluate(state, self._keywords(dt, None, None))

    # -------------------------------------------------------------- another one like it
    def with_parameters(self, **parameters: Any) -> ComponentMotion:
        """The same motion with other parameter values, scalars or ``(*batch)``."""
        for name in parameters:
            if name not in self.parameters:
                raise CapabilityError(
                    f"motion {self.name!r} has no parameter {name!r}; it has "
                    f"{', '.join(self.parameters) or 'none'}."
                )
        return attrs.evolve(self, parameters={**self.parameters, **parameters})

    def lanes(self, index: Any) -> ComponentMotion:
        """The same motion with per-lane parameters cut to some lanes."""
        cut = lanes_of(self.parameters, index)
        return self if cut is self.parameters else attrs.evolve(self, parameters=cut)

    @property
    def linear(self) -> bool:
        """Whether the derivative of `f` does not depend on the state."""
        return self._advance.linear

    @property
    def why_opaque(self) -> str:
        """Why this motion cannot be traced, or ''."""
        return self._advance.why_opaque or self._noise.why_opaque

    # ---------------------------------------------------------------------- inside
    def _keywords(self, dt: Any, u: Any, t: Any) -> Mapping[str, Any]:
        if self._steady and isinstance(dt, float):
            found = self._recent.get(dt)
            if found is None:
                found = MappingProxyType(self.parameters | {"dt": float(dt), "t": 0.0})
                if len(self._recent) >= KEPT:
                    self._recent.clear()
                self._recent[dt] = found
            return found
        out: dict[str, Any] = {**self.parameters, "dt": dt, "t": 0.0 if t is None else t}
        names = self.input_space.names
        if not names:
            return out
        values: Any = [0.0] * len(names) if u is None else u
        if len(values) != len(names):
            raise ShapeError(
                wording(
                    f"argument 'u' of motion {self.name!r}",
                    got=f"shape {np.shape(values)}",
                    expected=f"({len(names)}, *batch): {self.input_space}",
                    do="give one row per input component",
                )
            )
        return out | dict(zip(names, values, strict=True))

    def _need_trace(self, what: str) -> None:
        if not self._advance.traced:
            raise CapabilityError(
                f"motion {self.name!r} has no {what.rsplit(maxsplit=1)[-1]}: its function cannot be traced "
                f"({self._advance.why_opaque}). Write it with functions from tracker.models, "
                "or use a filter that needs no derivatives."
            )
