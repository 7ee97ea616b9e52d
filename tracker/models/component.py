"""Component functions: an author's plain function of named components, and all that follows from it.

Reading a signature, tracing, deriving and evaluating on floats, lanes and graph nodes belong here;
what the numbers mean (a motion, a sensor) does not.
"""

from __future__ import annotations

import functools
import inspect
import weakref
from collections.abc import Callable, Mapping, Sequence
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
from tracker.types import Array, Columns

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
            j
            for j in range(len(self.positional))
            if not all(is_zero(row[j]) for row in self.first)
        )

    @functools.cached_property
    def first_depends_on(self) -> frozenset[str]:
        """Inputs that the first derivatives depend on; no positional one if linear."""
        return inputs_of(e for row in self.first for e in row)

    @functools.cached_property
    def depends_on(self) -> frozenset[str]:
        """Inputs that the outputs depend on."""
        return inputs_of(self.roots)

    def entries(self, what: str, width: int, places: Sequence[int]) -> list[Entry]:
        """Flat list of what is asked for, derivatives by a state of ``width`` components.

        'value', 'first' (dense), 'columns' (used columns only), 'second', and 'joint' (value,
        then first) or 'joint columns'.
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
        return self.roots + self.entries("columns", width, places)

    def form(self, what: str, kind: str, width: int, places: tuple[int, ...]) -> Callable[..., Any]:
        """Compiled form of `entries`, for 'array' or 'float'; made once."""
        key = (what, kind, width, places)
        found = self._forms.get(key)
        if found is None:
            make = array_form if kind == "array" else float_form
            found = make(self.entries(what, width, places), self.inputs, f"{self.label}.{what}")
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


class ComponentFunction:
    """An author's function bound to the components of a state.

    Keyword values come with each call. `evaluate`, `first`, `second` and `linearise` accept one
    run ``(n,)``, arrays of lanes ``(n, *batch)``, or object arrays ``(n,)`` of graph nodes. A result
    that all lanes share has trailing axes of length 1.
    """

    __slots__ = ("_forms", "_trace", "author", "keywords", "places", "positional", "width")

    def __init__(self, author: Author, state: Sequence[str], owner: str) -> None:
        self.author = author
        self.positional, self.keywords = signature_of(author)
        missing = [name for name in self.positional if name not in state]
        if missing:
            raise CapabilityError(
                f"{owner} needs the state components {', '.join(missing)}, which the state "
                f"({', '.join(state)}) does not have. Use a motion model with these components, "
                f"or a sensor that needs only {', '.join(state)}."
            )
        self.width = len(state)
        self.places = tuple(list(state).index(name) for name in self.positional)
        self._trace: Trace | TraceError | None = None
        self._forms: dict[str, Any] = {}

    def _attempt(self) -> Trace | TraceError:
        if self._trace is None:
            self._trace = _traced(self.author)
        return self._trace

    def __getstate__(self) -> dict[str, Any]:
        kept = (name for name in self.__slots__ if name not in ("_forms", "_trace"))
        return {name: getattr(self, name) for name in kept}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            setattr(self, name, value)
        self._trace, self._forms = None, {}  # made again where they arrive

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
        return self.traced and self.trace.first_depends_on.isdisjoint(self.positional)

    # ------------------------------------------------------------------------- evaluation
    def evaluate(self, x: Any, keywords: Mapping[str, Any]) -> Any:
        """Outputs, ``(*shape, *batch)``."""
        if not self.traced:
            return self._opaque(x, keywords)
        out = self._run("value", x, keywords)
        return out.reshape(self.trace.shape + out.shape[1:])

    def first(self, x: Any, keywords: Mapping[str, Any]) -> Any:
        """Jacobian by the whole state, ``(m, n, *batch)``."""
        out = self._run("first", x, keywords)
        return out.reshape((len(out) // self.width, self.width, *out.shape[1:]))

    def second(self, x: Any, keywords: Mapping[str, Any]) -> Any:
        """Hessians by the whole state, ``(m, n, n, *batch)``."""
        out = self._run("second", x, keywords)
        m = len(out) // self.width**2  # not -1: a batch may be empty
        return out.reshape((m, self.width, self.width, *out.shape[1:]))

    def linearise(self, x: Any, keywords: Mapping[str, Any]) -> tuple[Any, Any]:
        """Outputs and Jacobian, sharing what they have in common; `Columns` for arrays of lanes."""
        if x.ndim == 1:
            out = self._run("joint", x, keywords)
            m = len(out) // (1 + self.width)
            return out[:m], out[m:].reshape((m, self.width, *out.shape[1:]))
        trace = self.trace
        m, k = len(trace.roots), len(trace.columns)
        columns = tuple([self.places[j] for j in trace.columns])
        if self.linear:
            value, first = self._run("value", x, keywords), self._run("columns", x, keywords)
        else:
            out = self._run("joint columns", x, keywords)
            value, first = out[:m], out[m:]
        return value, Columns(first.reshape((m, k, *first.shape[1:])), columns, self.width)

    def _form(self, what: str, kind: str) -> Any:
        key = what + kind
        found = self._forms.get(key)
        if found is None:
            trace = self.trace
            form = trace.form(what, kind, self.width, self.places)
            entries = trace.entries(what, self.width, self.places)
            depends = not inputs_of(entries).isdisjoint(trace.positional)
            found = self._forms[key] = (form, len(entries), depends)
        return found

    def _run(self, what: str, x: Any, keywords: Mapping[str, Any]) -> Any:
        """The flat entries, ``(count, *batch)``."""
        given = [keywords[name] for name in self.keywords]
        if x.dtype == object:
            return self._on_nodes(what, [*(x[i] for i in self.places), *given])
        shared = True
        for i, value in enumerate(given):
            if type(value) is not float:
                if isinstance(value, Node):
                    return self._on_nodes(what, [*(x[i].item() for i in self.places), *given])
                if np.ndim(value):
                    shared = False
                else:
                    given[i] = as_float(value)
        batch = x.shape[1:]
        form, count, depends = self._form(what, "float")
        if shared and not (depends and batch):
            # One run, or the same in all lanes: Python floats beat NumPy's scalars several times.
            values = x.tolist() if depends else [0.0] * len(x)
            a = [values[i] for i in self.places] + given
            try:
                out = np.array(form(a))
            except (ValueError, ZeroDivisionError, OverflowError):
                out = self._carefully(what, a)
            return out.reshape((count,) + (1,) * len(batch)) if batch else out
        a = [x[i] for i in self.places] + given
        if not shared:
            batch = _broadcast(batch, a, self.trace)
        out = np.empty((count, *batch))
        with np.errstate(all="ignore"):  # a lane at a singular place is NaN, and harms no neighbour
            self._form(what, "array")[0](a, out)
        return out

    def _carefully(self, what: str, a: Sequence[float]) -> Array:
        """The float form where it raises: NumPy's answer, NaN or inf."""
        trace = self.trace
        given = dict(zip(trace.inputs, map(np.float64, a), strict=True))
        with np.errstate(all="ignore"):
            return np.array(
                evaluate(trace.entries(what, self.width, self.places), given), dtype=np.float64
            )

    def _on_nodes(self, what: str, a: Sequence[Any]) -> Any:
        trace = self.trace
        entries = trace.entries(what, self.width, self.places)
        graph = next((v.graph for v in a if isinstance(v, Node)), None)
        out = np.empty(len(entries), dtype=object)
        if graph is None:
            out[:] = self._carefully(what, [as_float(v) for v in a]).tolist()
        else:
            values = [v if isinstance(v, Node) else as_float(v) for v in a]
            out[:] = substitute(entries, graph, dict(zip(trace.inputs, values, strict=True)))
        return out

    def _opaque(self, x: Any, keywords: Mapping[str, Any]) -> Any:
        if x.dtype == object:
            raise TraceError(self.why_opaque)
        given = {name: keywords[name] for name in self.keywords}
        entries, shape = _flat(self.author(*(x[i] for i in self.places), **given))
        batch = np.broadcast_shapes(x.shape[1:], *(np.shape(e) for e in entries))
        out = np.empty((len(entries), *batch))
        for k, entry in enumerate(entries):
            out[k] = entry
        return out.reshape(shape + batch)


def _broadcast(batch: tuple[int, ...], a: Sequence[Any], trace: Trace) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(batch, *(np.shape(v) for v in a))
    except ValueError:
        shapes = {n: np.shape(v) for n, v in zip(trace.inputs, a, strict=True) if np.ndim(v)}
        raise ShapeError(
            wording(
                trace.label,
                got=f"batch shapes that do not fit together: {shapes}",
                expected=f"scalars or arrays that broadcast to the batch shape {batch}",
                do="give parameters and poses as scalars or with the state's batch shape",
            )
        ) from None
