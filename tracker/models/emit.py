"""Graphs written out as Python source: one form for arrays of lanes, one for single floats.

Only the writing of source text and its compilation belong here; what is computed is decided by the
graph. The text is kept in `linecache`, so a traceback or a debugger shows it.
"""

from __future__ import annotations

import itertools
import linecache
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from tracker.models.graph import NUMPY, Entry, Node, needed

_INFIX = {"add": "+", "sub": "-", "mul": "*"}
_ARRAY_NAMES: dict[str, Any] = {f"_{op}": f for op, f in NUMPY.items()}
_FLOAT_NAMES: dict[str, Any] = {f"_{op}": getattr(math, op) for op in ("sqrt", "sin", "cos", "exp")}
_FLOAT_NAMES |= {"_log": math.log, "_atan2": math.atan2, "_abs": abs, "_floor": math.floor}
_counter = itertools.count()


def _constant(value: float) -> str:
    if value != value or value in (math.inf, -math.inf):  # noqa: PLR0124 - the test for NaN
        return f"float({str(value)!r})"
    return repr(value)


def _compiled(source: str, function: str, names: dict[str, Any], label: str) -> Callable[..., Any]:
    filename = f"<tracker {label} #{next(_counter)}>"
    linecache.cache[filename] = (len(source), None, source.splitlines(keepends=True), filename)
    scope = dict(names)
    # The text was written by this module from operations it knows: no name in it is foreign.
    exec(compile(source, filename, "exec"), scope)  # noqa: S102 - see above
    made: Callable[..., Any] = scope[function]
    return made


def _unpacking(nodes: Sequence[Node], inputs: Mapping[str, str]) -> list[str]:
    """Lines that fetch the inputs that are used."""
    return [f"    v{n.index} = {inputs[n.value]}" for n in nodes if n.op == "input"]


def array_form(
    roots: Sequence[Entry], inputs: Mapping[str, str], label: str
) -> Callable[..., None]:
    """A function ``f(x, k, o)`` that writes ``roots`` into ``o[0], o[1], ...``.

    ``inputs`` says where each input is found: ``x[3]``, a component of the state, or ``k[0]``, a
    keyword value.

    Shapes:
        x ``(n, *batch)``; k, floats or arrays of lanes; o ``(len(roots), *batch)``, at least one
        batch axis. Literal zeros and ones are written too, so ``o`` may be uninitialised.
    """
    nodes = needed(roots)
    target = {r.index: k for k, r in reversed(list(enumerate(roots))) if isinstance(r, Node)}
    body = _unpacking(nodes, inputs)
    for n in nodes:
        if n.op == "input":
            continue
        if n.op == "const":
            body.append(f"    v{n.index} = {_constant(n.value)}")
            continue
        arguments = ", ".join(f"v{a.index}" for a in n.args)
        if n.index in target and n.op != "where":
            body.append(f"    v{n.index} = _{n.op}({arguments}, out=o[{target[n.index]}])")
        elif n.op in _INFIX:
            body.append(f"    v{n.index} = v{n.args[0].index} {_INFIX[n.op]} v{n.args[1].index}")
        elif n.op == "recip":
            body.append(f"    v{n.index} = 1.0 / v{n.args[0].index}")
        else:
            body.append(f"    v{n.index} = _{n.op}({arguments})")
    for k, r in enumerate(roots):
        if not isinstance(r, Node):
            body.append(f"    o[{k}] = {_constant(r)}")
        elif target[r.index] != k or r.op in ("where", "input", "const"):
            body.append(f"    o[{k}] = v{r.index}")
    source = "def form(x, k, o):\n" + "\n".join(body or ["    pass"]) + "\n"
    return _compiled(source, "form", _ARRAY_NAMES, label)


def float_form(
    roots: Sequence[Entry], inputs: Mapping[str, str], label: str
) -> Callable[[Sequence[float], Sequence[float]], tuple[float, ...]]:
    """A function ``f(x, k)`` that gives ``roots`` as a tuple of floats, far faster than on arrays.

    ``inputs`` is that of `array_form`.

    Raises (when called):
        ValueError, ZeroDivisionError, OverflowError where NumPy would answer NaN or inf: the caller
        falls back on `tracker.models.graph.evaluate`.
    """
    nodes = needed(roots)
    body = _unpacking(nodes, inputs)
    for n in nodes:
        v = [f"v{a.index}" for a in n.args]
        match n.op:
            case "input":
                continue
            case "const":
                text = _constant(n.value)
            case "add" | "sub" | "mul":
                text = f"{v[0]} {_INFIX[n.op]} {v[1]}"
            case "neg":
                text = f"-{v[0]}"
            case "recip":
                text = f"1.0 / {v[0]}"
            case "less":
                text = f"{v[0]} < {v[1]}"
            case "isnan":
                text = f"{v[0]} != {v[0]}"
            case "where":
                text = f"{v[1]} if {v[0]} else {v[2]}"
            case "min":
                text = f"{v[0]} if {v[0]} < {v[1]} or {v[0]} != {v[0]} else {v[1]}"
            case "max":
                text = f"{v[0]} if {v[0]} > {v[1]} or {v[0]} != {v[0]} else {v[1]}"
            case _:
                text = f"_{n.op}({', '.join(v)})"
        body.append(f"    v{n.index} = {text}")
    results = [f"v{r.index}" if isinstance(r, Node) else _constant(r) for r in roots]
    answer = "".join(f"{result}, " for result in results)  # none at all is a tuple too
    source = "def form(x, k):\n" + "\n".join([*body, f"    return ({answer})"]) + "\n"
    return _compiled(source, "form", _FLOAT_NAMES, label)


def as_float(value: Any) -> float:
    """A float from a scalar of any kind; NumPy scalars would slow the float form down threefold."""
    return value if type(value) is float else float(np.asarray(value).item())
