"""Beliefs and memories as flat lists of numbers, and back: what programs carry and keep.

What a value is made of is found by looking at one of its kind; nothing is computed here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import attrs
import numpy as np

from tracker.adaptation import Window
from tracker.errors import TraceError
from tracker.models.graph import Node
from tracker.types import Gaussian

__all__ = [
    "Form",
    "Leaf",
    "Tree",
    "arrays_of",
    "built",
    "entries",
    "form_of",
    "leaves",
    "pack",
    "triangle",
    "unpack",
]


def triangle(n: int) -> int:
    """Entries of an upper triangle."""
    return n * (n + 1) // 2


def pack(matrix: Any) -> list[Any]:
    """Upper triangle, row by row."""
    n = len(matrix)
    return [matrix[i, j] for i in range(n) for j in range(i, n)]


def unpack(entries_: Sequence[Any], n: int) -> Any:
    """The symmetric matrix with that upper triangle, as an object array."""
    out = np.empty((n, n), dtype=object)
    flat = iter(entries_)
    for i in range(n):
        for j in range(i, n):
            out[i, j] = out[j, i] = next(flat)
    return out


# -------------------------------------------------------------------------------------- forms
@attrs.frozen
class Leaf:
    """An array ``(*shape, *batch)`` in a value; ``length`` is that of a window, 0 for others."""

    name: str
    shape: tuple[int, ...]
    form: str = "full"
    length: int = 0

    def places(self) -> list[tuple[int, ...]]:
        """Indices of the entries that are carried."""
        rest = list(np.ndindex(*self.shape[2:]))  # members of a set, each with such a matrix
        if self.form == "symmetric":
            pairs = ((i, j) for i in range(self.shape[0]) for j in range(i, self.shape[1]))
            return [(*pair, *r) for pair in pairs for r in rest]
        if self.form == "lower":
            return [(i, j, *r) for i in range(self.shape[0]) for j in range(i + 1) for r in rest]
        return list(np.ndindex(*self.shape))

    def mirrored(self, place: tuple[int, ...]) -> tuple[int, ...]:
        """Where else the entry at a place belongs: across the diagonal of a symmetric matrix."""
        return (place[1], place[0], *place[2:]) if self.form == "symmetric" else place

    @property
    def count(self) -> int:
        """How many entries are carried."""
        return len(self.places())


@attrs.frozen
class Tree:
    """A value of a class with fields, or a tuple (``kind`` None)."""

    kind: type | None
    parts: tuple[tuple[str, Form], ...]


@attrs.frozen
class Static:
    """A setting: the same in every step."""

    value: Any


Form = Leaf | Tree | Static

_SHORT = {"mean": "x", "cov": "P"}


def form_of(value: Any, axes: int, name: str = "") -> Form:
    """What a value over ``axes`` batch axes is made of; leaves are named by their path.

    Raises:
        TraceError: for a field that is neither numbers nor a setting.
    """
    if type(value) is Gaussian and not name:  # the usual belief has the usual letters
        parts = tuple((f, _leaf(getattr(value, f), axes, s)) for f, s in _SHORT.items())
        return Tree(Gaussian, (parts[0], ("cov", attrs.evolve(parts[1][1], form="symmetric"))))
    if isinstance(value, Window):
        shape = value.values.shape[1 : value.values.ndim - axes]
        return Leaf(name, shape, "window", len(value.values))
    if isinstance(value, (np.ndarray, float)):
        return _leaf(value, axes, name)
    if value is None or isinstance(value, (bool, int, str)):
        return Static(value)
    if isinstance(value, tuple):
        return Tree(
            None, tuple((str(i), form_of(v, axes, _in(name, i))) for i, v in enumerate(value))
        )
    if not attrs.has(type(value)):
        raise TraceError(
            f"it carries {type(value).__name__} from step to step (not a frozen attrs value)"
        )
    parts_: list[tuple[str, Form]] = []
    for field in attrs.fields(type(value)):
        part = form_of(getattr(value, field.name), axes, _in(name, field.name))
        structure = field.metadata.get("form", "full")
        if isinstance(part, Leaf) and structure in {"symmetric", "lower"}:
            part = attrs.evolve(part, form=structure)
        parts_.append((field.name, part))
    return Tree(type(value), tuple(parts_))


def _in(name: str, part: object) -> str:
    return f"{name}.{part}" if name else f"carried.{part}"


def _leaf(value: Any, axes: int, name: str) -> Leaf:
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        raise TraceError(f"it carries an array of {array.dtype} from step to step")
    return Leaf(name, array.shape[: max(array.ndim - axes, 0)])


def leaves(form: Form) -> Iterator[Leaf]:
    """The arrays of a value, in a fixed order."""
    if isinstance(form, Leaf):
        yield form
    elif isinstance(form, Tree):
        for _, part in form.parts:
            yield from leaves(part)


# ------------------------------------------------------------------------------ there and back
def entries(form: Form, value: Any) -> dict[str, list[Any]]:
    """What is carried of a value, by the names of its leaves: nodes, or arrays over the batch.

    Raises:
        TraceError: if the value is not of that form.
    """
    if isinstance(form, Leaf):
        if form.length:
            return {form.name: list(value.new if isinstance(value, _Line) else value.values)}
        array = value if isinstance(value, np.ndarray) else np.asarray(value, dtype=object)
        if array.shape[: len(form.shape)] != form.shape:
            raise TraceError(
                f"{form.name} has shape {array.shape} after a step, {form.shape} before"
            )
        return {form.name: [array[place] if place else value for place in form.places()]}
    out: dict[str, list[Any]] = {}
    if isinstance(form, Tree):
        if form.kind is not None and not isinstance(value, form.kind):
            raise TraceError(
                f"it carries {type(value).__name__}, and began with {form.kind.__name__}"
            )
        for name, part in form.parts:
            out |= entries(part, value[int(name)] if form.kind is None else getattr(value, name))
    return out


def arrays_of(form: Form, value: Any) -> dict[str, Any]:
    """The arrays of a value of that form, whole, by the names of its leaves."""
    if isinstance(form, Leaf):
        return {form.name: value}
    out: dict[str, Any] = {}
    if isinstance(form, Tree):
        for name, part in form.parts:
            out |= arrays_of(part, value[int(name)] if form.kind is None else getattr(value, name))
    return out


def built(form: Form, get: Callable[[Leaf], Any]) -> Any:
    """A value of that form from its leaves' arrays; nothing is checked again."""
    if isinstance(form, Leaf):
        return get(form)
    if isinstance(form, Static):
        return form.value
    parts = [built(part, get) for _, part in form.parts]
    if form.kind is None:
        return tuple(parts)
    made: Any = object.__new__(form.kind)
    for (name, _), part in zip(form.parts, parts, strict=True):
        object.__setattr__(made, name, part)
    return made


def of_nodes(leaf: Leaf, nodes: Sequence[Node]) -> Any:
    """A leaf's array with these nodes where they belong; a window as a delay line."""
    if leaf.length:
        return _Line(_array(nodes, leaf.shape), None)
    if not leaf.shape:
        return nodes[0]
    if leaf.form in {"symmetric", "lower"}:
        out = np.zeros(leaf.shape, dtype=object)
        for place, node in zip(leaf.places(), nodes, strict=True):
            out[place] = out[leaf.mirrored(place)] = node
        return out
    return _array(nodes, leaf.shape)


def _array(nodes: Sequence[Node], shape: tuple[int, ...]) -> Any:
    out = np.empty(len(nodes), dtype=object)
    out[:] = list(nodes)
    return out.reshape(shape)


@attrs.frozen(eq=False)
class _Line:
    """A `tracker.adaptation.Window` while a step is traced."""

    oldest: Any
    _new: Any

    @property
    def new(self) -> Any:
        """What was put in at this step."""
        if self._new is None:
            raise TraceError("a window must be given a value at every step, with pushed()")
        return self._new.ravel()

    def pushed(self, new: Any) -> _Line:
        """As `Window.pushed`."""
        return _Line(self.oldest, np.asarray(new, dtype=object))
