"""What a law is, how it is declared and how it is tried; the laws themselves are in `laws`.

A law is a small function of a component and a `Case`, from which it draws what it needs. Its
docstring states it in one sentence; its assertions say what a person should conclude.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import attrs
import numpy as np
from hypothesis import HealthCheck, Phase, Verbosity, given, settings
from hypothesis import strategies as st
from hypothesis.errors import HypothesisException

from tracker.errors import DomainError, wording
from tracker.testing import strategies
from tracker.types import Array, Space

KINDS = (
    "motion", "sensor", "filter", "smoother", "adapter", "gate", "associator", "optimiser", "path",
    "metric",
)  # fmt: skip

T = TypeVar("T")
Body = Callable[[Any, "Case"], None]
Reason = Callable[[Any], str]


@attrs.frozen
class Regions:
    """Where a component should be tried, if not where the default strategies lead.

    ``states`` draws ``(n,)``, ``poses`` draws ``(p,)``.
    """

    states: st.SearchStrategy[Any] | None = None
    poses: st.SearchStrategy[Any] | None = None


class Case:
    """One example of a law: everything drawn for it, repeatable from what hypothesis reports."""

    def __init__(self, kind: str, component: Any, data: st.DataObject, regions: Regions) -> None:
        self.kind, self.component, self._data, self._regions = kind, component, data, regions

    def draw(self, strategy: st.SearchStrategy[T]) -> T:
        """An example of any strategy."""
        return self._data.draw(strategy)

    @functools.cached_property
    def rng(self) -> np.random.Generator:
        """A generator of this example's own."""
        return self.draw(strategies.generators())

    def state(self, batch: tuple[int, ...] = ()) -> Array:
        """States of the component, ``(n, *batch)``."""
        mine = self._regions.states
        if mine is None:
            return self.draw(strategies.states(self.component, batch))
        n = state_space(self.component).size
        return self._lanes(mine, n, batch)

    def pose(self, batch: tuple[int, ...] = ()) -> Array | None:
        """Poses of the component, ``(p, *batch)``, or None where it takes none."""
        space = getattr(self.component, "pose_space", None)
        mine = self._regions.poses
        if mine is None or not space:
            return self.draw(strategies.poses(self.component, batch))
        return self._lanes(mine, space.size, batch)

    def inputs(self, batch: tuple[int, ...] = ()) -> Array | None:
        """Inputs of a motion, ``(q, *batch)``, or None where it takes none."""
        space = getattr(self.component, "input_space", None)
        return self.draw(strategies.states(space, batch)) if space else None

    def dt(self, *, zero: bool = False) -> float:
        """A time step."""
        return self.draw(strategies.time_steps(zero=zero))

    def _lanes(self, strategy: st.SearchStrategy[Any], n: int, batch: tuple[int, ...]) -> Array:
        lanes = int(np.prod(batch, dtype=int))
        columns = [np.asarray(self.draw(strategy), dtype=np.float64) for _ in range(lanes)]
        return np.stack(columns, -1).reshape(n, *batch) if lanes else np.empty((n, *batch))


def state_space(component: Any) -> Space:
    """The state space of a sensor or a motion."""
    space: Space = getattr(component, "state", None) or component.space
    return space


def _always(_component: Any) -> str:
    return ""


@attrs.frozen
class Law:
    """A named law of a kind of component.

    ``unless`` gives the reason why the law does not apply to a component, or ''. ``examples`` is
    how often it is tried.
    """

    kind: str
    name: str
    body: Body
    examples: int
    unless: Reason = _always

    @property
    def statement(self) -> str:
        """The law in a sentence."""
        return " ".join((self.body.__doc__ or "").split("\n\n", maxsplit=1)[0].split())

    @property
    def always(self) -> bool:
        """Whether the law applies to every component of its kind."""
        return self.unless is _always

    def why_not(self, component: Any) -> str:
        """Why the law does not apply to the component, or ''."""
        return self.unless(component)

    def examine(self, component: Any, regions: Regions) -> None:
        """Try the law on examples that are the same in every run.

        Raises:
            AssertionError: naming law and conclusion, if the component breaks it.
        """
        failures: list[Exception] = []
        finished = 0

        @settings(
            max_examples=self.examples,
            derandomize=True,
            database=None,
            deadline=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
            verbosity=Verbosity.quiet,
        )
        @given(st.data())
        def tried(data: st.DataObject) -> None:
            nonlocal finished
            try:
                with np.errstate(all="ignore"):
                    self.body(component, Case(self.kind, component, data, regions))
            except HypothesisException:
                raise
            except Exception as error:
                failures.append(error)
                raise
            finished += 1

        try:
            tried()
        except Exception as error:  # noqa: BLE001 - a stranger's component may raise anything
            self._report(failures[0] if failures else error)
        if not finished:
            raise AssertionError(f"law {self.name!r}: no example ran, so nothing is known.")

    def _report(self, error: BaseException) -> None:
        said = str(error).strip() or "an assertion without a message"
        if not isinstance(error, AssertionError):
            said = f"it raised {type(error).__name__}: {said}"
        raise AssertionError(
            f"law {self.name!r} is broken: {said}\n  The law: {self.statement}"
        ) from error


_LAWS: dict[str, list[Law]] = {kind: [] for kind in KINDS}


def law(
    *kinds: str, name: str, examples: int = 8, unless: Reason = _always
) -> Callable[[Body], Body]:
    """Declare a function as a law of one or more kinds; laws are tried in the order declared."""

    def declared(body: Body) -> Body:
        for kind in kinds:
            _LAWS[kind].append(Law(kind, name, body, examples, unless))
        return body

    return declared


def laws(kind: str) -> tuple[Law, ...]:
    """The laws of a kind, in order.

    Raises:
        DomainError: if there are none for that kind.
    """
    import tracker.testing.laws  # noqa: F401 - importing declares them

    if kind not in _LAWS:
        raise DomainError(
            wording("kind of component", got=repr(kind), expected=f"one of {', '.join(KINDS)}",
                    do="name a kind that has laws")
        )  # fmt: skip
    return tuple(_LAWS[kind])


def lacks(name: str, *arguments: Any) -> Reason:
    """A reason, for ``unless``: the component has no such method, or says that it cannot."""
    from tracker.errors import CapabilityError

    def reason(component: Any) -> str:
        method = getattr(component, name, None)
        if method is None:
            return f"it has no {name}"
        state = np.linspace(110.0, 70.0, state_space(component).size)
        try:
            with np.errstate(all="ignore"):
                method(state, *arguments)
        except CapabilityError as error:
            return str(error)
        except Exception:  # noqa: BLE001 - that it fails is for the law to find
            return ""
        return ""

    return reason


def untraceable(component: Any) -> str:
    """A reason, for ``unless``: the component cannot run on graph nodes."""
    why = getattr(component, "why_opaque", "it is not written over components (no why_opaque)")
    return f"it cannot be traced: {why}" if why else ""


# --------------------------------------------------------------------------------- comparing
def agree(actual: Any, expected: Any, tolerance: float, conclusion: str, scale: Any = None) -> None:
    """Assert that two arrays agree to ``tolerance`` times the scale (of ``expected``, by default)."""
    got, want = np.asarray(actual, dtype=np.float64), np.asarray(expected, dtype=np.float64)
    assert got.shape == want.shape, f"{conclusion} (shape {got.shape} instead of {want.shape})"
    if not want.size:
        return
    finite = np.abs(want[np.isfinite(want)])
    size = np.asarray(finite.max(initial=0.0) if scale is None else scale)
    gap = np.where(np.isnan(got) & np.isnan(want) | (got == want), 0.0, np.abs(got - want))
    bad = ~(gap <= tolerance * size)
    if bad.any():
        at = tuple(int(i) for i in np.argwhere(bad)[0])
        raise AssertionError(f"{conclusion} (entry {at}: {got[at]:.9g} instead of {want[at]:.9g})")


def over_lanes(value: Any, shape: tuple[int, ...], what: str) -> Array:
    """``value`` over all lanes, the last axis of ``shape``; it may have length 1 where lanes share it."""
    array = np.asarray(value, dtype=np.float64)
    *own, count = shape
    assert array.shape in {shape, (*own, 1)}, (
        f"{what} answers with shape {array.shape} to {count} lanes: expected {shape}, or "
        f"{(*own, 1)} where all lanes share the value"
    )
    return np.broadcast_to(array, shape)


def symmetric(A: Any, conclusion: str, tolerance: float = 0.0) -> None:
    """Assert that matrices are finite and symmetric: exactly, unless a relative tolerance is given."""
    matrix = np.asarray(A)
    assert np.isfinite(matrix).all(), f"{conclusion} (an entry is not finite)"
    gap = np.abs(matrix - matrix.swapaxes(0, 1)).max(initial=0.0)
    limit = tolerance * np.abs(matrix).max(initial=0.0)
    assert gap <= limit, f"{conclusion} (asymmetric by {gap:.3g})"


def not_negative(A: Array, conclusion: str, scale: Any = None, tolerance: float = 1e-12) -> None:
    """Assert that symmetric matrices have no eigenvalue below minus rounding."""
    if not A.size:
        return
    n = len(A)
    stacked = np.moveaxis(A.reshape(n, n, -1), -1, 0)
    size = np.abs(A).max() if scale is None else scale
    lowest = float(np.linalg.eigvalsh(0.5 * (stacked + stacked.swapaxes(1, 2))).min())
    assert lowest >= -tolerance * size, f"{conclusion} (an eigenvalue of {lowest:.3g})"


def lanes(batch: Sequence[int]) -> list[tuple[int, ...]]:
    """Indices of the lanes of a batch."""
    return list(np.ndindex(*batch))
