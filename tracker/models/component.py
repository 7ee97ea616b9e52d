"""Component functions: an author's plain function of named components, and all that follows from it.

Reading a signature, tracing, deriving and evaluating on floats, lanes and graph nodes belong here;
what the numbers mean (a motion, a sensor) does not.
"""

from __future__ import annotations

import functools
import inspect
import weakref
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from tracker.errors import CapabilityError, ShapeError, TraceError, wording
from tracker.models.emit import array_form, as_float, float_form
from tracker.models.graph import (
    Entry,
    Graph,
    Node,
    evaluate,
    hessian,
    inputs_of,
    is_zero,
    jacobian,
    plain,
    substitute,
)
from tracker.types import Array, Block, Columns

Author = Callable[..., Any]


def signature_of(function: Author) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the positional and of the keyword-only parameters of a component function.

    A function made by composition (`stack`) carries them as attributes ``positional`` and
    ``keywords``, because it takes ``*args, **kwargs``.
    """
    if hasattr(function, "positional"):
        return tuple(function.positional), tuple(function.keywords)  # type: ignore[attr-defined]
    kinds = inspect.Parameter
    parameters = inspect.signature(function).parameters.values()
    if any(p.kind in (kinds.VAR_POSITIONAL, kinds.VAR_KEYWORD) for p in parameters):
        raise TraceError(
            f"{_label(function)}: takes *args or **kwargs; name every state component as a "
            "positional parameter and every pose component and parameter as a keyword-only one"
        )
    return (
        tuple(p.name for p in parameters if p.kind is not kinds.KEYWORD_ONLY),
        tuple(p.name for p in parameters if p.kind is kinds.KEYWORD_ONLY),
    )


def _label(function: Author) -> str:
    name = getattr(function, "__qualname__", type(function).__name__)
    return f"{name} ({getattr(function, '__module__', '?')})"


def _flat(out: Any) -> tuple[list[Any], tuple[int, ...]]:
    """What an author returned, flattened, with its shape: (m,) or (rows, columns)."""
    if not isinstance(out, (tuple, list)) or not out:
        raise TraceError(
            f"must return a tuple with one entry per component; got {type(out).__name__}: "
            "write `return (value,)`"
        )
    if not isinstance(out[0], (tuple, list)):
        return list(out), (len(out),)
    if any(not isinstance(row, (tuple, list)) or len(row) != len(out[0]) for row in out):
        raise TraceError("must return rows of equal length, as a tuple of tuples")
    return [entry for row in out for entry in row], (len(out), len(out[0]))


class Trace:
    """The graph of a component function, with its derivatives and forms made when first asked for.

    ``roots`` holds the outputs, flattened; ``shape`` is ``(m,)`` or ``(rows, columns)``.
    """

    def __init__(self, function: Author) -> None:
        self.positional, self.keywords = signature_of(function)
        self.label = _label(function)
        graph = Graph()
        self.nodes = [graph.input(name) for name in self.positional]
        keywords = {name: graph.input(name) for name in self.keywords}
        try:
            entries, self.shape = _flat(function(*self.nodes, **keywords))
            self.roots: list[Entry] = [plain(graph.const(e)) for e in entries]
        except TraceError as error:
            raise TraceError(f"{self.label}: {error}") from None
        except TypeError as error:
            if "ufunc" in str(error) or "loop of ufunc" in str(error):
                message = "np.* was called on a symbol: import the function from tracker.models"
                raise TraceError(f"{self.label}: {message}") from None
            raise
        self.inputs = (*self.positional, *self.keywords)
        self._forms: dict[Any, Callable[..., Any]] = {}

    @functools.cached_property
    def first(self) -> list[list[Entry]]:
        """Derivatives by the positional inputs, ``[output][input]``."""
        return jacobian(self.roots, self.nodes)

    @functools.cached_property
    def second(self) -> list[list[list[Entry]]]:
        """Second derivatives by the positional inputs."""
        return hessian(self.first, self.nodes)

    @functools.cached_property
    def columns(self) -> tuple[int, ...]:
        """Positional inputs by which some output has a derivative that is not literally zero."""
        return tuple(
            j for j in range(len(self.positional)) if not all(is_zero(row[j]) for row in self.first)
        )

    @functools.cached_property
    def curved(self) -> tuple[int, ...]:
        """Positional inputs by which some output has a second derivative that is not literally zero."""
        count = range(len(self.positional))
        return tuple(
            j for j in count if not all(is_zero(a[i][j]) for a in self.second for i in count)
        )

    @functools.cached_property
    def first_depends_on(self) -> frozenset[str]:
        """Inputs that the first derivatives depend on; no positional one if linear."""
        return inputs_of(e for row in self.first for e in row)

    @functools.cached_property
    def linear(self) -> bool:
        """Whether the first derivatives do not depend on the positional inputs."""
        return self.first_depends_on.isdisjoint(self.positional)

    @functools.cached_property
    def depends_on(self) -> frozenset[str]:
        """Inputs that the outputs depend on."""
        return inputs_of(self.roots)

    def entries(self, what: str, width: int, places: Sequence[int]) -> list[Entry]:
        """Flat list of what is asked for, derivatives by a state of ``width`` components.

        'value', 'first' (dense), 'columns' (used columns only), 'second', 'joint' (value, then
        first) or 'joint columns', and 'expansion' (that, then second where it is curved) or
        'expansion columns'.
        """
        match what:
            case "value":
                return self.roots
            case "columns":
                return [row[j] for row in self.first for j in self.columns]
            case "first":
                return [e for row in self.first for e in _widened(row, width, places)]
            case "second":
                full = [[0.0] * width for _ in range(width)]
                out: list[Entry] = []
                for matrix in self.second:
                    rows = dict(zip(places, matrix, strict=True))
                    for i in range(width):
                        out += _widened(rows[i], width, places) if i in rows else full[i]
                return out
            case "joint":
                return self.roots + self.entries("first", width, places)
            case "expansion" | "expansion columns":
                joint = "joint" + what.removeprefix("expansion")
                second = [a[i][j] for a in self.second for i in self.curved for j in self.curved]
                return self.entries(joint, width, places) + second
        return self.roots + self.entries("columns", width, places)

    def form(self, what: str, kind: str, width: int, places: tuple[int, ...]) -> Callable[..., Any]:
        """Compiled form of `entries`, for 'array' or 'float'; made once."""
        key = (what, kind, width, places)
        found = self._forms.get(key)
        if found is None:
            make = array_form if kind == "array" else float_form
            inputs = {name: f"x[{i}]" for name, i in zip(self.positional, places, strict=True)}
            inputs |= {name: f"k[{i}]" for i, name in enumerate(self.keywords)}
            found = make(self.entries(what, width, places), inputs, f"{self.label}.{what}")
            self._forms[key] = found
        return found


def _widened(row: Sequence[Entry], width: int, places: Sequence[int]) -> list[Entry]:
    out: list[Entry] = [0.0] * width
    for place, entry in zip(places, row, strict=True):
        out[place] = entry
    return out


_traces: weakref.WeakKeyDictionary[Any, Trace | TraceError] = weakref.WeakKeyDictionary()


def _traced(function: Author) -> Trace | TraceError:
    """One trace per function object: constants it closes over are baked in at first use."""
    found = _traces.get(function)
    if found is None:
        try:
            found = Trace(function)
        except TraceError as error:
            found = TraceError(*error.args)
        _traces[function] = found
    return found


class _Bound:
    """Some entries of a trace for one state: shape, forms, and an answer that may be given again."""

    __slots__ = ("arrays", "columns", "depends", "entries", "flat", "floats", "kept", "shape")

    def __init__(self, trace: Trace, what: str, width: int, places: tuple[int, ...]) -> None:
        self.entries = trace.entries(what, width, places)
        m = len(trace.roots)
        self.columns = tuple([places[j] for j in trace.columns])
        self.shape: tuple[int, ...] = {
            "value": trace.shape,
            "first": (m, width),
            "second": (m, width, width),
            "columns": (m, len(self.columns)),
        }.get(what, (len(self.entries),))
        self.flat = len(self.shape) == 1
        self.depends = not inputs_of(self.entries).isdisjoint(trace.positional)
        self.floats = trace.form(what, "float", width, places)
        self.arrays = functools.partial(trace.form, what, "array", width, places)
        # Answers by keyword values, where the state does not matter: mostly Q by dt, and R. Equal
        # time steps differ in their last bits, hence several.
        self.kept: dict[tuple[float, ...], Array] = {}


KEPT = 32
"""Answers that are kept for keyword values that may come again."""

_NOTHING: tuple[Any, list[Any], bool, bool] = (None, [], True, False)


class ComponentFunction:
    """An author's function bound to the components of a state.

    Keyword values come with each call. `evaluate`, `first`, `second` and `linearise` accept one
    run ``(n,)``, arrays of lanes ``(n, *batch)``, or object arrays of graph nodes. A result
    that all lanes share has trailing axes of length 1; one that no state changes is read-only.
    """

    __slots__ = ("_bound", "_last", "_trace", "author", "keywords", "places", "positional", "width")

    def __init__(self, author: Author, state: Sequence[str], owner: str) -> None:
        self.author = author
        self.positional, self.keywords = signature_of(author)
        missing = [name for name in self.positional if name not in state]
        if missing:
            raise CapabilityError(
                f"{owner} needs the state components {', '.join(missing)}, which the state "
                f"({', '.join(state)}) does not have. Use a motion model with these components; "
                "or, if they are no state components but pose or parameters, name them after a "
                "bare * in the function's signature."
            )
        self.width = len(state)
        self.places = tuple(list(state).index(name) for name in self.positional)
        self._trace: Trace | TraceError | None = None
        self._bound: dict[str, _Bound] = {}
        self._last = _NOTHING

    def _attempt(self) -> Trace | TraceError:
        if self._trace is None:
            self._trace = _traced(self.author)
        return self._trace

    def __getstate__(self) -> dict[str, Any]:
        kept = (name for name in self.__slots__ if not name.startswith("_"))
        return {name: getattr(self, name) for name in kept}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            setattr(self, name, value)
        self._trace, self._bound, self._last = None, {}, _NOTHING  # made again where they arrive

    @property
    def traced(self) -> bool:
        """Whether the function ran on graph nodes; if not, `why_opaque` says why."""
        return not isinstance(self._attempt(), TraceError)

    @property
    def why_opaque(self) -> str:
        """Why the function cannot be traced, or ''."""
        found = self._attempt()
        return str(found) if isinstance(found, TraceError) else ""

    @property
    def trace(self) -> Trace:
        """The trace.

        Raises:
            TraceError: if there is none.
        """
        found = self._attempt()
        if isinstance(found, TraceError):
            raise TraceError(*found.args)
        return found

    @property
    def linear(self) -> bool:
        """Whether the derivatives do not depend on the state."""
        found = self._attempt()
        return not isinstance(found, TraceError) and found.linear

    # ------------------------------------------------------------------------- evaluation
    def evaluate(self, x: Any, keywords: Mapping[str, Any]) -> Any:
        """Outputs, ``(*shape, *batch)``."""
        if "value" in self._bound or self.traced:
            return self._run("value", x, keywords)
        return self._opaque(x, keywords)

    def first(self, x: Any, keywords: Mapping[str, Any]) -> Any:
        """Jacobian by the whole state, ``(m, n, *batch)``."""
        return self._run("first", x, keywords)

    def second(self, x: Any, keywords: Mapping[str, Any]) -> Any:
        """Hessians by the whole state, ``(m, n, n, *batch)``."""
        return self._run("second", x, keywords)

    def linearise(self, x: Any, keywords: Mapping[str, Any]) -> tuple[Any, Any]:
        """Outputs and Jacobian, sharing what they have in common; `Columns` for arrays of lanes."""
        trace = self._trace if type(self._trace) is Trace else self.trace
        m = len(trace.roots)
        if x.ndim == 1:
            if trace.linear:
                return self._run("value", x, keywords), self._run("first", x, keywords)
            out = self._run("joint", x, keywords)
            return out[:m], out[m:].reshape(m, self.width)
        if trace.linear:
            value, first = self._run("value", x, keywords), self._run("columns", x, keywords)
            return value, Columns(first, self._bound["columns"].columns, self.width)
        out = self._run("joint columns", x, keywords)
        columns = self._bound["joint columns"].columns
        first = out[m:].reshape((m, len(columns), *out.shape[1:]))
        return out[:m], Columns(first, columns, self.width)

    def expand(self, x: Any, keywords: Mapping[str, Any]) -> tuple[Any, Any, Block]:
        """Outputs, Jacobian as in `linearise`, and Hessians, sharing what they have in common."""
        trace = self.trace
        places = tuple(self.places[j] for j in trace.curved)
        if trace.linear:  # nothing is curved
            value, first = self.linearise(x, keywords)
            empty = np.empty((len(trace.roots), 0, 0, *(1,) * (x.ndim - 1)), dtype=x.dtype)
            return value, first, Block(empty, places, self.width)
        dense = x.ndim == 1
        out = self._run("expansion" if dense else "expansion columns", x, keywords)
        m, k = len(trace.roots), len(places)
        columns = tuple(self.places[j] for j in trace.columns)
        end = m + m * (self.width if dense else len(columns))
        first = out[m:end].reshape((m, -1, *out.shape[1:]))
        second = Block(out[end:].reshape((m, k, k, *out.shape[1:])), places, self.width)
        return out[:m], first if dense else Columns(first, columns, self.width), second

    def _run(self, what: str, x: Any, keywords: Mapping[str, Any]) -> Any:
        """What is asked for, ``(*shape, *batch)``."""
        bound = self._bound.get(what)
        if bound is None:
            bound = self._bound[what] = _Bound(self.trace, what, self.width, self.places)
        known, given, shared, symbolic = self._last
        if keywords is not known:
            given, shared, symbolic = self._given(keywords)
        if symbolic or x.dtype.hasobject:
            if x.ndim == 1:
                return self._on_nodes(bound, x.tolist(), given)
            places = x.reshape(len(x), -1).T.tolist()
            out = np.stack([self._on_nodes(bound, place, given) for place in places], axis=-1)
            return out.reshape(bound.shape + x.shape[1:])
        if shared:
            if not bound.depends:
                return self._kept(bound, given, x.ndim - 1)
            if x.ndim == 1:  # Python floats beat NumPy's scalars several times
                return self._on_floats(bound, x.tolist(), given)
        batch = x.shape[1:]
        if not shared:
            batch = _broadcast(batch, self.keywords, given, self.trace.label)
        out = np.empty((len(bound.entries), *batch))
        with np.errstate(all="ignore"):  # a lane at a singular place is NaN, and harms no neighbour
            bound.arrays()(x, given, out)
        return out if bound.flat else out.reshape(bound.shape + batch)

    def _given(self, keywords: Mapping[str, Any]) -> tuple[list[Any], bool, bool]:
        """The keyword values; whether all lanes share them; whether some are graph nodes."""
        given = [keywords[name] for name in self.keywords]
        shared, symbolic = True, False
        for i, value in enumerate(given):
            if type(value) is not float:
                if isinstance(value, Node):
                    symbolic = True
                elif np.ndim(value):
                    shared = False
                else:
                    given[i] = as_float(value)
        if type(keywords) is MappingProxyType:  # read-only: the same object means the same values
            self._last = (keywords, given, shared, symbolic)
        return given, shared, symbolic

    def _kept(self, bound: _Bound, given: list[float], axes: int) -> Array:
        """What the state does not change, with ``axes`` batch axes of length 1; read-only."""
        key = (axes, *given)
        found = bound.kept.get(key)
        if found is None:
            found = self._on_floats(bound, [0.0] * self.width, given)
            found = found.reshape(bound.shape + (1,) * axes)
            found.setflags(write=False)
            if len(bound.kept) >= KEPT:
                bound.kept.clear()
            bound.kept[key] = found
        return found

    def _on_floats(self, bound: _Bound, x: list[float], given: list[float]) -> Array:
        try:
            out = np.array(bound.floats(x, given))
        except (ValueError, ZeroDivisionError, OverflowError):
            out = _carefully(bound, self._inputs(x, given))
        return out if bound.flat else out.reshape(bound.shape)

    def _inputs(self, x: Sequence[Any], given: Sequence[Any]) -> dict[str, Any]:
        named = {name: x[i] for name, i in zip(self.positional, self.places, strict=True)}
        return named | dict(zip(self.keywords, given, strict=True))

    def _on_nodes(self, bound: _Bound, x: Sequence[Any], given: Sequence[Any]) -> Any:
        values = self._inputs(x, given)
        graph = next((v.graph for v in values.values() if isinstance(v, Node)), None)
        out = np.empty(len(bound.entries), dtype=object)
        if graph is None:
            out[:] = _carefully(bound, values).tolist()
        else:
            nodes = {k: v if isinstance(v, Node) else as_float(v) for k, v in values.items()}
            out[:] = substitute(bound.entries, graph, nodes)
        return out.reshape(bound.shape)

    def _opaque(self, x: Any, keywords: Mapping[str, Any]) -> Any:
        if x.dtype == object:
            raise TraceError(self.why_opaque)
        given = {name: keywords[name] for name in self.keywords}
        try:
            entries, shape = _flat(self.author(*(x[i] for i in self.places), **given))
        except (TypeError, ValueError) as error:
            raise TraceError(f"{self.why_opaque}; on arrays it fails too: {error}") from error
        batch = np.broadcast_shapes(x.shape[1:], *(np.shape(e) for e in entries))
        out = np.empty((len(entries), *batch))
        for k, entry in enumerate(entries):
            out[k] = entry
        return out.reshape(shape + batch)


def _carefully(bound: _Bound, inputs: Mapping[str, Any]) -> Array:
    """The float form where it raises: NumPy's answer, NaN or inf."""
    values = {name: np.float64(value) for name, value in inputs.items()}
    with np.errstate(all="ignore"):
        return np.array(evaluate(bound.entries, values), dtype=np.float64)


def _broadcast(
    batch: tuple[int, ...], names: Sequence[str], given: Sequence[Any], label: str
) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(batch, *(np.shape(v) for v in given))
    except ValueError:
        shapes = {n: np.shape(v) for n, v in zip(names, given, strict=True) if np.ndim(v)}
        raise ShapeError(
            wording(
                label,
                got=f"batch shapes that do not fit together: {shapes}",
                expected=f"scalars or arrays that broadcast to the batch shape {batch}",
                do="give parameters and poses as scalars or with the state's batch shape",
            )
        ) from None
