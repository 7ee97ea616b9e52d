"""Calls of a component as data, so that laws about any call are written once; no law lives here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import attrs
import numpy as np

from tracker.testing.law import Case
from tracker.types import Array

Maker = Callable[[Any, Case, tuple[int, ...]], "list[Call]"]


@attrs.frozen(eq=False)
class Given:
    """One argument of a call: ``lead`` axes before the batch, or None if all lanes share it.

    An argument may be None, where a component takes none.
    """

    name: str
    value: Any
    lead: int | None

    def lane(self, index: tuple[slice | int, ...]) -> Any:
        """The argument of some lanes."""
        if self.lead is None or self.value is None:
            return self.value
        return np.ascontiguousarray(self.value[(slice(None),) * self.lead + index])


@attrs.frozen(eq=False)
class Call:
    """A call of a component with all its arguments, ready to be made again in other ways.

    ``function`` takes the component and the arguments and returns a tuple of arrays; ``leads`` are
    their axes before the batch. Where ``shared`` is set an answer that all lanes share may have
    batch axes of length 1.
    """

    name: str
    function: Callable[..., tuple[Any, ...]]
    given: tuple[Given, ...]
    leads: tuple[int, ...]
    batch: tuple[int, ...]
    shared: bool = False

    def make(self, component: Any, arguments: list[Any] | None = None) -> list[Array]:
        """Its answers, as arrays."""
        chosen = [g.value for g in self.given] if arguments is None else arguments
        return [np.asarray(answer) for answer in self.function(component, *chosen)]

    def full(self, component: Any) -> list[Array]:
        """Its answers with the whole batch, after a check of their shapes."""
        out = []
        for answer, lead in zip(self.make(component), self.leads, strict=True):
            own, batch = answer.shape[:lead], answer.shape[lead:]
            fits = len(batch) == len(self.batch) and all(
                a == b or (self.shared and a == 1) for a, b in zip(batch, self.batch, strict=True)
            )
            assert fits, (
                f"{self.name} answers with shape {answer.shape} to the batch {self.batch}: "
                f"after {lead} leading axes must come {self.batch}"
                + (", or axes of length 1 where all lanes share the value" if self.shared else "")
            )
            out.append(np.broadcast_to(answer, own + self.batch))
        return out


_MAKERS: dict[str, Maker] = {}


def calls_of(kind: str) -> Callable[[Maker], Maker]:
    """Declare how a component of a kind is called on an example with a given batch shape."""

    def declared(maker: Maker) -> Maker:
        _MAKERS[kind] = maker
        return maker

    return declared


def calls(kind: str, component: Any, case: Case, batch: tuple[int, ...]) -> list[Call]:
    """The calls of a component on an example."""
    return _MAKERS[kind](component, case, batch)
