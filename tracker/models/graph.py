"""A small expression graph: run a component function on its nodes and it records itself.

Equal expressions are one node (so common subexpressions vanish), literal zeros and ones vanish (so
sparsity is exploited without patterns), and derivatives are exact. What a node is worth, in which
language, is not decided here: see `tracker.models.emit`.
"""

from __future__ import annotations

import numbers
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from tracker.errors import TraceError

Entry = Any
"""A graph node or a float: what an entry of a traced vector or matrix can be."""

# min and max are missing on purpose: which operand survives a NaN depends on their order.
_COMMUTATIVE = frozenset({"add", "mul"})
_BRANCH = (
    "the function branches on a value (if, and, or, while, min, max); it is run once on symbols "
    "for all lanes: use where(condition, a, b), minimum or maximum from tracker.models"
)


def _quiet(function: Callable[..., Any]) -> Callable[..., float]:
    def evaluated(*args: float) -> float:
        with np.errstate(all="ignore"):
            return float(function(*map(np.float64, args)))

    return evaluated


NUMPY: Mapping[str, Callable[..., Any]] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "neg": np.negative,
    "recip": np.reciprocal, "sqrt": np.sqrt, "sin": np.sin, "cos": np.cos, "exp": np.exp,
    "log": np.log, "atan2": np.arctan2, "floor": np.floor, "abs": np.abs, "min": np.minimum,
    "max": np.maximum, "less": np.less, "isnan": np.isnan, "where": np.where,
}  # fmt: skip
"""What each operation means; every other interpretation is checked against this one."""

_FOLD = {op: _quiet(f) for op, f in NUMPY.items()}


def _entrywise(op: str, a: Any, b: Any) -> Any:
    """A node and an array of components: an array."""
    entry = operator.truediv if op == "div" else getattr(operator, op)
    return np.frompyfunc(entry, 2, 1)(*(alone(v) if isinstance(v, Node) else v for v in (a, b)))


def alone(node: Node) -> Any:
    """A node as an array without axes, which NumPy may combine with others."""
    out = np.empty((), dtype=object)
    out[()] = node
    return out


class Node:
    """One operation, input or constant of a graph; made by `Graph`, never directly."""

    __slots__ = ("args", "graph", "index", "op", "value")

    graph: Graph
    op: str
    args: tuple[Node, ...]
    value: Any
    index: int

    # A NumPy scalar or array on the left must hand the operation over to the node.
    __array_ufunc__ = None
    __hash__ = object.__hash__

    def __add__(self, other: Entry) -> Any:
        if type(other) is np.ndarray and other.dtype.hasobject:
            return _entrywise("add", self, other)
        return self.graph.make("add", self, other)

    def __radd__(self, other: Entry) -> Any:
        if type(other) is np.ndarray and other.dtype.hasobject:
            return _entrywise("add", other, self)
        return self.graph.make("add", other, self)

    def __sub__(self, other: Entry) -> Any:
        if type(other) is np.ndarray and other.dtype.hasobject:
            return _entrywise("sub", self, other)
        return self.graph.make("sub", self, other)

    def __rsub__(self, other: Entry) -> Any:
        if type(other) is np.ndarray and other.dtype.hasobject:
            return _entrywise("sub", other, self)
        return self.graph.make("sub", other, self)

    def __mul__(self, other: Entry) -> Any:
        if type(other) is np.ndarray and other.dtype.hasobject:
            return _entrywise("mul", self, other)
        return self.graph.make("mul", self, other)

    def __rmul__(self, other: Entry) -> Any:
        if type(other) is np.ndarray and other.dtype.hasobject:
            return _entrywise("mul", other, self)
        return self.graph.make("mul", other, self)

    def __truediv__(self, other: Entry) -> Any:
        if type(other) is np.ndarray and other.dtype.hasobject:
            return _entrywise("div", self, other)
        return self.graph.make("div", self, other)

    def __rtruediv__(self, other: Entry) -> Any:
        if type(other) is np.ndarray and other.dtype.hasobject:
            return _entrywise("div", other, self)
        return self.graph.make("div", other, self)

    def __neg__(self) -> Node:
        return self.graph.make("neg", self)

    def __pos__(self) -> Node:
        return self

    def __abs__(self) -> Node:
        return self.graph.make("abs", self)

    def __lt__(self, other: Entry) -> Node:
        return self.graph.make("less", self, other)

    def __gt__(self, other: Entry) -> Node:
        return self.graph.make("less", other, self)

    def __le__(self, _other: object) -> Node:
        raise TraceError("the function uses <= or >= on a symbol: use <, > or less(a, b)")

    __ge__ = __le__

    def __eq__(self, _other: object) -> bool:  # the default would silently answer False
        raise TraceError(
            "the function compares symbols with == or !=: use where(absolute(a - b) < tolerance, ...)"
        )

    def __ne__(self, other: object) -> bool:
        return self.__eq__(other)

    def __pow__(self, power: object) -> Entry:
        if not isinstance(power, numbers.Real) or 2 * float(power) != int(2 * float(power)):
            raise TraceError(
                f"power {power!r}: only integers and halves are traced; write exp(p * log(x))"
            )
        exponent = float(power)
        if exponent < 0:
            return 1.0 / self.__pow__(-exponent)
        out: Entry = 1.0
        if exponent != int(exponent):
            out = self.graph.make("sqrt", self)
        for _ in range(int(exponent)):
            out = out * self
        return out

    def __rpow__(self, base: object) -> Entry:
        raise TraceError(
            f"{base!r} to the power of a symbol: write exp(p * log(x)) with tracker.models"
        )

    def __mod__(self, _other: object) -> Entry:
        raise TraceError("% and // are not traced: use wrap(angle) or floor(a)")

    __rmod__ = __floordiv__ = __rfloordiv__ = __mod__

    def __bool__(self) -> bool:
        raise TraceError(_BRANCH)

    def __float__(self) -> float:
        raise TraceError(
            "math.* or float() was called on a symbol: import the function from tracker.models"
        )

    __int__ = __index__ = __float__

    def __repr__(self) -> str:
        return f"<{self.op} #{self.index}>"


class Graph:
    """A set of distinct nodes, in an order in which they can be computed."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._table: dict[tuple[Any, ...], Node] = {}

    def _node(self, op: str, args: tuple[Node, ...], value: Any = None) -> Node:
        key = (op, *(a.index for a in args), value)
        if op == "const":  # 0.0 and -0.0 are equal keys, NaN is not equal to itself
            key = (op, float(value).hex())
        found = self._table.get(key)
        if found is None:
            found = Node()
            found.graph, found.op, found.args, found.value = self, op, args, value
            found.index = len(self.nodes)
            self.nodes.append(found)
            self._table[key] = found
        return found

    def const(self, value: Entry) -> Node:
        """``value`` as a node of this graph."""
        if isinstance(value, Node):
            if value.graph is not self:
                raise TraceError("nodes of two different graphs were mixed in one expression")
            return value
        try:
            return self._node("const", (), float(value))
        except (TypeError, ValueError):
            raise TraceError(
                f"a {type(value).__name__} met a symbol: constants must be plain numbers; "
                "index arrays down to one entry, or make them parameters"
            ) from None

    def input(self, name: str) -> Node:
        """The input called ``name``."""
        return self._node("input", (), name)

    def make(self, op: str, *raw: Entry) -> Node:
        """``op`` of the arguments, simplified, shared with an equal one that exists."""
        a = [self.const(r) for r in raw]
        if op == "div":  # reciprocals are shared
            if a[1].op == "const" and a[1].value != 0.0 and a[0].op == "const":
                return self.const(a[0].value / a[1].value)
            return self.make("mul", a[0], self.make("recip", a[1]))
        if op in _FOLD and all(x.op == "const" for x in a):
            return self.const(_FOLD[op](*(x.value for x in a)))
        simpler = self._simplified(op, a)
        if simpler is not None:
            return simpler
        if op in _COMMUTATIVE:
            a.sort(key=lambda n: n.index)
        return self._node(op, tuple(a))

    def _simplified(self, op: str, a: list[Node]) -> Node | None:
        """The algebra of 0, 1 and signs."""
        value = [x.value if x.op == "const" else None for x in a]
        if op == "add":
            if value[0] == 0:
                return a[1]
            if value[1] == 0:
                return a[0]
            if a[1].op == "neg":
                return self.make("sub", a[0], a[1].args[0])
            if a[0].op == "neg":
                return self.make("sub", a[1], a[0].args[0])
        elif op == "sub":
            if value[1] == 0:
                return a[0]
            if value[0] == 0:
                return self.make("neg", a[1])
            if a[0] is a[1]:
                return self.const(0.0)
            if a[1].op == "neg":
                return self.make("add", a[0], a[1].args[0])
        elif op == "mul":
            if 0 in value:
                return self.const(0.0)
            for i in (0, 1):
                if value[i] == 1:
                    return a[1 - i]
                if value[i] == -1:
                    return self.make("neg", a[1 - i])
                if a[i].op == "neg":
                    return self.make("neg", self.make("mul", a[i].args[0], a[1 - i]))
        elif op == "neg" and a[0].op == "neg":
            return a[0].args[0]
        elif op == "where":
            if value[0] is not None:
                return a[1] if value[0] else a[2]
            if a[1] is a[2]:
                return a[1]
        return None


# ----------------------------------------------------------------------------------- reading
def plain(entry: Entry) -> Entry:
    """A constant node as its float, anything else as it is."""
    return entry.value if isinstance(entry, Node) and entry.op == "const" else entry


def is_zero(entry: Entry) -> bool:
    """Whether an entry is the literal zero (of either sign)."""
    value = plain(entry)
    return isinstance(value, (int, float)) and value == 0


def needed(roots: Iterable[Entry]) -> list[Node]:
    """The nodes that ``roots`` depend on, in an order in which they can be computed."""
    found: dict[int, Node] = {}
    stack = [r for r in roots if isinstance(r, Node)]
    while stack:
        node = stack.pop()
        if node.index not in found:
            found[node.index] = node
            stack.extend(node.args)
    return [found[i] for i in sorted(found)]


def inputs_of(roots: Iterable[Entry]) -> frozenset[str]:
    """Names of the inputs that ``roots`` depend on."""
    return frozenset(n.value for n in needed(roots) if n.op == "input")


def evaluate(roots: Sequence[Entry], values: Mapping[str, Any]) -> list[Any]:
    """What ``roots`` are worth for the given inputs, node by node with NumPy: slow, plainly right."""
    worth: dict[int, Any] = {}
    for node in needed(roots):
        if node.op == "const":
            worth[node.index] = node.value
        elif node.op == "input":
            worth[node.index] = values[node.value]
        else:
            # At a singular place the answer is NaN or inf, as in every other form.
            with np.errstate(all="ignore"):
                worth[node.index] = NUMPY[node.op](*(worth[a.index] for a in node.args))
    return [worth[r.index] if isinstance(r, Node) else r for r in roots]


def substitute(roots: Sequence[Entry], graph: Graph, values: Mapping[str, Entry]) -> list[Entry]:
    """``roots`` copied into ``graph`` with its inputs replaced; simplification runs again."""
    copied: dict[int, Node] = {}
    for node in needed(roots):
        if node.op == "const":
            copied[node.index] = graph.const(node.value)
        elif node.op == "input":
            copied[node.index] = graph.const(values[node.value])
        else:
            copied[node.index] = graph.make(node.op, *(copied[a.index] for a in node.args))
    return [plain(copied[r.index]) if isinstance(r, Node) else r for r in roots]


# ------------------------------------------------------------------------------- derivatives
def derivative(y: Entry, x: Node) -> Entry:
    """The partial derivative of ``y`` by the input ``x``, as a node or a float.

    ``x`` must be an input: deriving by an expression would differentiate through one component
    into another.
    """
    if not isinstance(y, Node):
        return 0.0
    d: dict[int, Entry] = {}
    for node in needed([y]):
        d[node.index] = _local(node, x, d)
    return plain(d[y.index])


def _local(y: Node, x: Node, d: Mapping[int, Entry]) -> Entry:
    if y is x:
        return 1.0
    g, a = y.graph, y.args
    da = [d[u.index] for u in a]
    if y.op in ("const", "input", "floor", "less", "isnan"):
        return 0.0
    if y.op == "where":
        return 0.0 if is_zero(da[1]) and is_zero(da[2]) else g.make("where", a[0], da[1], da[2])
    if all(is_zero(u) for u in da):
        return 0.0
    match y.op:
        case "add":
            return da[0] + da[1]
        case "sub":
            return da[0] - da[1]
        case "neg":
            return -da[0]
        case "mul":
            left = 0.0 if is_zero(da[0]) else da[0] * a[1]
            right = 0.0 if is_zero(da[1]) else a[0] * da[1]
            return left + right
        case "recip":
            return -(da[0] * (y * y))
        case "sqrt":
            return da[0] * (0.5 / y)
        case "sin":
            return da[0] * g.make("cos", a[0])
        case "cos":
            return -(da[0] * g.make("sin", a[0]))
        case "exp":
            return da[0] * y
        case "log":
            return da[0] / a[0]
        case "abs":
            return da[0] * g.make("where", g.make("less", a[0], 0.0), -1.0, 1.0)
        case "atan2":
            inverse = 1.0 / (a[0] * a[0] + a[1] * a[1])
            first = 0.0 if is_zero(da[0]) else da[0] * (a[1] * inverse)
            second = 0.0 if is_zero(da[1]) else da[1] * (a[0] * inverse)
            return first - second
        case "min":
            return g.make("where", g.make("less", a[1], a[0]), da[1], da[0])
        case "max":
            return g.make("where", g.make("less", a[0], a[1]), da[1], da[0])
    raise TraceError(f"no derivative is known for operation {y.op!r}")  # pragma: no cover


def jacobian(outputs: Sequence[Entry], inputs: Sequence[Node]) -> list[list[Entry]]:
    """First derivatives, ``[output][input]``."""
    return [[derivative(y, x) for x in inputs] for y in outputs]


def hessian(first: Sequence[Sequence[Entry]], inputs: Sequence[Node]) -> list[list[list[Entry]]]:
    """Second derivatives, ``[output][input][input]``, from the first ones; symmetric by sharing."""
    n = len(inputs)
    out = [[[0.0] * n for _ in inputs] for _ in first]
    for a, row in enumerate(first):
        for i, entry in enumerate(row):
            for j in range(i, n):
                out[a][i][j] = out[a][j][i] = derivative(entry, inputs[j])
    return out
