"""Step programs as LLVM text with explicit vectors of eight lanes, and as machine code through llvmlite.

No auto-vectoriser and no optimiser passes: every operation on lanes is written as a vector
operation, one instruction a node, in three nested blocks (groups of lanes, steps, straight line).
What is computed, and why, is decided elsewhere. ctypes releases the interpreter's lock during a
call, so threads over groups use several cores.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import heapq
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tracker.compile import elementary, objects
from tracker.compile import program as program_
from tracker.compile.program import BLOCK, WIDTH, Program, Rate
from tracker.errors import ShapeError, wording
from tracker.models import functions, graph
from tracker.models.graph import Node, needed
from tracker.types import Array

# Fused multiply-add and shared reciprocals; never nnan or ninf: a diverged lane must stay NaN.
FLAGS = "contract nsz arcp"
_BINARY = {"add": "fadd", "sub": "fsub", "mul": "fmul"}
_INTRINSIC = {"sqrt": "sqrt", "floor": "floor", "abs": "fabs"}
_BOOLEAN = frozenset({"less", "isnan"})
_ROOT_OF_HALF = 0x3FE6A09E667F3BCD
"""Bits of the double that is the square root of 1/2."""

_V, _I, _M = f"<{WIDTH} x double>", f"<{WIDTH} x i64>", f"<{WIDTH} x i1>"


def _literal(value: float) -> str:
    return f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}"


def _repeated(text: str, kind: str) -> str:
    return "<" + ", ".join(f"{kind} {text}" for _ in range(WIDTH)) + ">"


class _Writer:
    """Lines of one function, and the names of the values that nodes have become."""

    def __init__(
        self, rates: Mapping[int, Rate], program: Program, divisors: frozenset[int]
    ) -> None:
        self.program, self.divisors = program, divisors
        self.lanes = frozenset(i for i, rate in rates.items() if rate & Rate.LANE)
        self.lines: list[str] = []
        self.names: dict[int, str] = {}
        self.splats: dict[int, str] = {}
        self.count = 0

    def emit(self, text: str, name: str | None = None) -> str:
        if name is None:
            self.count += 1
            name = f"%v{self.count}"
        self.lines.append(f"  {name} = {text}")
        return name

    def label(self, *lines: str) -> None:
        self.lines += lines

    def per_lane(self, node: Node) -> bool:
        return node.index in self.lanes

    def operand(self, node: Node, vector: bool) -> str:
        if node.op == "const":
            text = _literal(node.value)
            return _repeated(text, "double") if vector else text
        if vector and not self.per_lane(node):
            return self.splats[node.index]
        return self.names[node.index]

    def splat(self, node: Node) -> None:
        kind, vector = ("i1", _M) if node.op in _BOOLEAN else ("double", _V)
        one = self.emit(f"insertelement {vector} poison, {kind} {self.names[node.index]}, i32 0")
        mask = f"<{WIDTH} x i32> zeroinitializer"
        self.splats[node.index] = self.emit(
            f"shufflevector {vector} {one}, {vector} poison, {mask}"
        )

    def operation(self, node: Node) -> None:
        vector = self.per_lane(node)
        t, i, b = (_V, _I, _M) if vector else ("double", "i64", "i1")
        if node.index in self.divisors:
            return
        if node.op == "mul" and any(x.index in self.divisors for x in node.args):
            below, above = sorted(node.args, key=lambda x: x.index not in self.divisors)
            over, under = self.operand(above, vector), self.operand(below.args[0], vector)
            self.names[node.index] = self.emit(f"fdiv {FLAGS} {t} {over}, {under}")
            return
        a = [self.operand(x, vector) for x in node.args]

        def const(value: Any, kind: str = "i64") -> str:
            return _repeated(str(value), kind) if vector else str(value)

        match node.op:
            case "add" | "sub" | "mul":
                r = self.emit(f"{_BINARY[node.op]} {FLAGS} {t} {a[0]}, {a[1]}")
            case "neg":
                r = self.emit(f"fneg {FLAGS} {t} {a[0]}")
            case "recip":
                r = self.emit(f"fdiv {FLAGS} {t} {const('1.0', 'double')}, {a[0]}")
            case "sqrt" | "floor" | "abs":
                suffix = f"v{WIDTH}f64" if vector else "f64"
                r = self.emit(f"call {FLAGS} {t} @llvm.{_INTRINSIC[node.op]}.{suffix}({t} {a[0]})")
            case "less":
                r = self.emit(f"fcmp olt {t} {a[0]}, {a[1]}")
            case "isnan":
                r = self.emit(f"fcmp uno {t} {a[0]}, {a[0]}")
            case "where":
                r = self.emit(f"select {b} {a[0]}, {t} {a[1]}, {t} {a[2]}")
            case "min" | "max":
                # NumPy's rule: a NaN in either operand survives. A comparison with it is false.
                if node.args[0].op == "const":
                    a.reverse()
                order = self.emit(f"fcmp {'olt' if node.op == 'min' else 'ogt'} {t} {a[1]}, {a[0]}")
                r = self.emit(f"select {b} {order}, {t} {a[1]}, {t} {a[0]}")
                if all(x.op != "const" for x in node.args):
                    unordered = self.emit(f"fcmp uno {t} {a[1]}, {a[1]}")
                    r = self.emit(f"select {b} {unordered}, {t} {a[1]}, {t} {r}")
            case "pow2":
                k = self.emit(f"fptosi {t} {a[0]} to {i}")
                k = self.emit(f"add {i} {k}, {const(1023)}")
                k = self.emit(f"shl {i} {k}, {const(52)}")
                r = self.emit(f"bitcast {i} {k} to {t}")
            case "exponent" | "mantissa":
                # Of a positive number, so that the mantissa lies between the roots of 1/2 and 2.
                bits = self.emit(f"bitcast {t} {a[0]} to {i}")
                k = self.emit(f"sub {i} {bits}, {const(_ROOT_OF_HALF)}")
                k = self.emit(f"ashr {i} {k}, {const(52)}")
                if node.op == "exponent":
                    r = self.emit(f"sitofp {i} {k} to {t}")
                else:
                    k = self.emit(f"shl {i} {k}, {const(52)}")
                    k = self.emit(f"sub {i} {bits}, {k}")
                    r = self.emit(f"bitcast {i} {k} to {t}")
            case _:
                raise NotImplementedError(node.op)  # pragma: no cover - every primitive is above
        self.names[node.index] = r

    def address(self, array: str, index: str) -> str:
        return self.emit(f"getelementptr inbounds double, ptr %array.{array}, i64 {index}")

    def load(self, array: str, index: str, vector: bool) -> str:
        kind = _V if vector else "double"
        return self.emit(f"load {kind}, ptr {self.address(array, index)}, align 8")

    def store(self, value: str, array: str, index: str) -> None:
        self.lines.append(f"  store {_V} {value}, ptr {self.address(array, index)}, align 8")

    def offset(self, base: str, i: int) -> str:
        return self.emit(f"add i64 {base}, {i}") if i else base

    def section(
        self, nodes: Iterable[Node], base: Mapping[str, str], splat: frozenset[int]
    ) -> None:
        """Emit nodes in order; ``base`` is where each input's values of this place begin."""
        for node in nodes:
            if node.op == "input":
                if node.index in self.names:
                    continue
                name, i = self.program.place[node.value]
                vector = self.per_lane(node)
                at = self.offset(base[name], i * WIDTH if vector else i)
                self.names[node.index] = self.load(name, at, vector)
            else:
                self.operation(node)
            if node.index in splat:
                self.splat(node)


# Cycles until a result can be used, roughly; what is not named takes four.
_WAIT = {
    "recip": 23, "sqrt": 23, "floor": 8, "exponent": 8, "pow2": 6, "input": 6, "less": 3, "isnan": 3,
    "where": 2, "abs": 1, "neg": 1,
}  # fmt: skip
_AT_ONCE = 2.5
"""Nodes that begin in a cycle: two vector operations, of which some are a product and a sum."""


def _interleaved(nodes: Sequence[Node]) -> list[Node]:
    """Nodes in an order in which nothing stands long before it can begin; the longest chain leads.

    A processor looks only some hundred operations ahead, so what waits must not stand in a row.
    """
    users: dict[int, list[int]] = {n.index: [] for n in nodes}
    missing: dict[int, int] = {}
    for node in nodes:
        before = {a.index for a in node.args if a.index in users}
        missing[node.index] = len(before)
        for index in before:
            users[index].append(node.index)
    wait = {n.index: _WAIT.get(n.op, 4) for n in nodes}
    left: dict[int, int] = {}  # cycles from here to the end of the step
    for node in reversed(nodes):
        left[node.index] = wait[node.index] + max((left[u] for u in users[node.index]), default=0)
    ready = dict.fromkeys(users, 0.0)
    coming = [(0.0, i) for i in users if not missing[i]]
    able: list[tuple[int, int]] = []
    order: list[int] = []
    now = 0.0
    while coming or able:
        if not able:
            now = max(now, coming[0][0])
        while coming and coming[0][0] <= now:
            index = heapq.heappop(coming)[1]
            heapq.heappush(able, (-left[index], index))
        index = heapq.heappop(able)[1]
        order.append(index)
        for user in users[index]:
            missing[user] -= 1
            ready[user] = max(ready[user], now + wait[index])
            if not missing[user]:
                heapq.heappush(coming, (ready[user], user))
        now += 1 / _AT_ONCE
    by_index = {n.index: n for n in nodes}
    return [by_index[i] for i in order]


def _divisors(low: Program, order: Sequence[Node], rates: Mapping[int, Rate]) -> frozenset[int]:
    """Reciprocals of which one product is all that becomes: a division is as fast, and exact."""
    users: dict[int, list[Node]] = {}
    for node in order:
        for a in node.args:
            users.setdefault(a.index, []).append(node)
    kept = {n.index for v in range(low.variants) for n in low.roots(v)}
    out: set[int] = set()
    for node in order:
        mine = users.get(node.index, [])
        if node.op == "recip" and node.index not in kept and len(mine) == 1:
            product = mine[0]
            if (
                product.op == "mul"
                and rates[product.index] == rates[node.index]
                and not any(a.index in out for a in product.args)
            ):
                out.add(node.index)
    return frozenset(out)


def emit(program: Program) -> str:
    """LLVM text of ``void run(i64 first, i64 last, i64 T, arrays...)`` over groups first..last-1."""
    program.finished()
    low = program.lowered()
    variants = range(low.variants)
    needs = [needed(low.roots(v)) for v in variants]
    order = sorted({n.index: n for nodes in needs for n in nodes}.values(), key=lambda n: n.index)
    rates = low.rates(order)
    w = _Writer(rates, low, _divisors(low, order, rates))
    users = [{n.index for n in nodes} for nodes in needs]

    def shared(node: Node) -> bool:
        """Computed before the branch: whatever is not per step, or serves several variants."""
        return low.variants == 1 or sum(node.index in own for own in users) > 1

    computed = [n for n in order if n.op != "const"]
    roots = [n for v in variants for n in low.roots(v)]
    splat = frozenset(
        {
            a.index
            for n in computed
            if w.per_lane(n)
            for a in n.args
            if a.op != "const" and not w.per_lane(a)
        }
        | {n.index for n in roots if n.op != "const" and not w.per_lane(n)}
    )
    arguments = list(low.shapes(1, 1))
    counts = {name: count for name, (count, _) in low.inputs.items()}

    # ---- once per call
    once = [n for n in computed if rates[n.index] == Rate.CALL]
    w.section(once, dict.fromkeys(counts, "0"), splat)
    w.label(
        "  br label %groups",
        "groups:",
        "  %g = phi i64 [%first, %entry], [%g.next, %group.end]",
        "  %more = icmp slt i64 %g, %last",
        "  br i1 %more, label %group, label %exit",
        "group:",
    )
    # ---- once per group of lanes
    per_group = {
        name: w.emit(f"mul i64 %g, {count * WIDTH}")
        for name, count in counts.items()
        if low.inputs[name][1] == Rate.LANE
    }
    w.section([n for n in computed if rates[n.index] == Rate.LANE], per_group, splat)
    state_base, first = {}, {}
    for name, olds in low.states.items():
        state_base[name] = w.emit(f"mul i64 %g, {len(olds) * WIDTH}")
        first[name] = [
            w.load(name, w.offset(state_base[name], i * WIDTH), True) for i in range(len(olds))
        ]
    w.emit("mul i64 %g, %T", "%gT")
    w.emit(f"udiv i64 %g, {BLOCK}", "%block")
    w.emit("mul i64 %block, %T", "%bT")
    w.emit("sub i64 %T, 1", "%t.last")
    w.label("  br label %steps", "steps:", "  %k = phi i64 [0, %group], [%k.next, %step.end]")
    holes = []
    for name, olds in low.states.items():
        for i, old in enumerate(olds):
            holes.append((len(w.lines), name, i))
            w.label("")
            w.names[old.index] = f"%s.{name}.{i}"
    # ---- once per step
    w.emit("sub i64 %t.last, %k", "%t.back")
    w.emit("add i64 %t.back, 0" if low.backward else "add i64 %k, 0", "%t")
    w.emit("add i64 %gT, %t", "%gt")
    w.emit("add i64 %bT, %t", "%bt")
    per_step = {}
    for name, count in counts.items():
        rate = low.inputs[name][1]
        if rate == Rate.BOTH:
            per_step[name] = w.emit(f"mul i64 %gt, {count * WIDTH}")
        elif rate == Rate.STEP:
            per_step[name] = w.emit(f"mul i64 %t, {count}")
    for name, (olds, length) in low.delays.items():
        slot = w.emit(f"urem i64 %k, {length}")
        row = w.emit(f"add i64 {w.emit(f'mul i64 %g, {length}')}, {slot}")
        per_step[name] = w.emit(f"mul i64 {row}, {len(olds) * WIDTH}")
    now = [n for n in computed if rates[n.index] & Rate.STEP]
    common = [n for n in now if shared(n)]
    scalars = [n for n in common if rates[n.index] == Rate.STEP]
    w.section(scalars, per_step, splat)
    w.section(_interleaved([n for n in common if rates[n.index] == Rate.BOTH]), per_step, splat)

    def outputs(variant: int) -> list[str]:
        for name, nodes in low.histories[variant].items():
            base = w.emit(f"mul i64 %gt, {len(nodes) * WIDTH}")
            for i, node in enumerate(nodes):
                w.store(w.operand(node, True), name, w.offset(base, i * WIDTH))
        for name, nodes in low.curves[variant].items():
            base = w.emit(f"mul i64 %bt, {len(nodes) * WIDTH}")
            for i, node in enumerate(nodes):
                at = w.offset(base, i * WIDTH)
                value = w.emit(f"fadd {_V} {w.load(name, at, True)}, {w.operand(node, True)}")
                w.store(value, name, at)
        for name, nodes in low.fed[variant].items():
            for i, node in enumerate(nodes):
                w.store(w.operand(node, True), name, w.offset(per_step[name], i * WIDTH))
        return [w.operand(n, True) for name in low.states for n in low.next[variant][name]]

    if low.variants == 1:
        after = outputs(0)
        w.label("  br label %step.end", "step.end:")
    else:
        index = w.load("variant", "%t", False)
        which = w.emit(f"fptosi double {index} to i64")
        cases = " ".join(f"i64 {v}, label %variant.{v}" for v in variants)
        w.label(f"  switch i64 {which}, label %variant.0 [ {cases} ]")
        ends = []
        for v in variants:
            w.label(f"variant.{v}:")
            own = [n for n in now if not shared(n) and n.index in users[v]]
            w.section([n for n in own if rates[n.index] == Rate.STEP], per_step, splat)
            w.section(
                _interleaved([n for n in own if rates[n.index] == Rate.BOTH]), per_step, splat
            )
            ends.append(outputs(v))
            w.label("  br label %step.end")
        w.label("step.end:")
        after = [
            w.emit(
                f"phi {_V} " + ", ".join(f"[{end[i]}, %variant.{v}]" for v, end in enumerate(ends))
            )
            for i in range(len(ends[0]))
        ]
    flat = iter(after)
    last = {name: [next(flat) for _ in olds] for name, olds in low.states.items()}
    for line, name, i in holes:
        w.lines[line] = (
            f"  %s.{name}.{i} = phi {_V} [{first[name][i]}, %group], [{last[name][i]}, %step.end]"
        )
    w.label(
        "  %k.next = add i64 %k, 1",
        "  %done = icmp sge i64 %k.next, %T",
        "  br i1 %done, label %group.end, label %steps",
        "group.end:",
    )
    for name in low.states:
        for i, value in enumerate(last[name]):
            w.store(value, name, w.offset(state_base[name], i * WIDTH))
    w.label("  %g.next = add i64 %g, 1", "  br label %groups", "exit:", "  ret void", "}")
    declared = [
        f"declare {t} @llvm.{f}.{s}({t})"
        for f in _INTRINSIC.values()
        for t, s in ((_V, f"v{WIDTH}f64"), ("double", "f64"))
    ]
    signature = ", ".join([
        "i64 %first", "i64 %last", "i64 %T", *(f"ptr noalias %array.{a}" for a in arguments)
    ])  # fmt: skip
    # What does not fit in registers lies on cache lines: across two of them it costs twice as much.
    head = [*declared, f"define void @run({signature}) alignstack(64) {{", "entry:"]
    return "\n".join([*head, *w.lines]) + "\n"


def fingerprint(program: Program) -> str:
    """A hash of all that the text of a program follows from, known without emitting it.

    The emitter is part of it, by its sources; where they cannot be read, the answer is ''.
    """
    emitter = _emitter()
    if not emitter:
        return ""
    kinds = program.next, program.histories, program.curves, program.fed
    outputs = [
        [(name, [n.index for n in nodes]) for name, nodes in group.items()]
        for kind in kinds
        for group in kind
    ]
    delays = [(name, len(nodes), steps) for name, (nodes, steps) in program.delays.items()]
    carried = [(name, len(nodes)) for name, nodes in program.states.items()]
    given = [(name, count, int(rate)) for name, (count, rate) in program.inputs.items()]
    parts = [emitter, repr((program.backward, program.variants, given, carried, delays, outputs))]
    nodes = needed([n for v in range(program.variants) for n in program.roots(v)])
    parts += [f"{n.index} {n.op} {n.value!r} {[a.index for a in n.args]}" for n in nodes]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


@functools.cache
def _emitter() -> str:
    """A hash of the sources that turn a program into text, or ''."""
    digest = hashlib.sha256(np.__version__.encode())  # it folds constants
    try:
        for source in (__file__, *(m.__file__ for m in (program_, elementary, graph, functions))):
            digest.update(Path(str(source)).read_bytes())
    except OSError:
        return ""
    return digest.hexdigest()


def _fits(name: str, array: Array | None, shape: tuple[int, ...]) -> None:
    """Refuse an array that the code would address wrongly."""
    good = array is not None and array.shape == shape and array.dtype == np.float64
    if array is None or not good or not array.flags.c_contiguous:
        got = "nothing" if array is None else f"{array.dtype} of shape {array.shape}"
        raise ShapeError(
            wording(
                f"kernel array {name!r}",
                got=got,
                expected=f"contiguous float64 of shape {shape}",
                do="allocate it as Program.shapes says",
            )
        )


class Kernel:
    """A compiled program. ``bind`` checks arrays once and returns the call.

    Raises:
        PluginError: if llvmlite is not installed.
    """

    def __init__(self, program: Program) -> None:
        self.program = program
        self._machine = objects.compiled(lambda: emit(program), fingerprint(program))
        self._arguments = list(program.shapes(1, 1))
        prototype = ctypes.CFUNCTYPE(
            None, *[ctypes.c_int64] * 3, *[ctypes.c_void_p] * len(self._arguments)
        )
        self._call = prototype(self._machine.address)

    def bind(
        self, arrays: Mapping[str, Array], groups: int, steps: int
    ) -> Callable[[int, int], None]:
        """A call ``run(first, last)`` over groups of these arrays.

        Raises:
            ShapeError: on an array whose shape, type or layout is not what the code will address.
        """
        for name, shape in self.program.shapes(groups, steps).items():
            _fits(name, arrays.get(name), shape)
        owners = [arrays[a] for a in self._arguments]
        addresses = [a.ctypes.data for a in owners]
        return functools.partial(self._run, owners, addresses, groups, steps)

    def bind_steps(self, arrays: Mapping[str, Array], groups: int) -> Callable[[int], None]:
        """A call ``run(k)`` of step k alone, over all groups, on arrays with time as first axis.

        Shapes:
            those of `Program.shapes` for one step; before them, for histories and for what changes
            in time, an axis of ``count`` steps: step k is at ``k % count``.

        Raises:
            ShapeError: on an array whose shape, type or layout is not what the code will address.
        """
        program = self.program
        timed = {name for name, (_, rate) in program.inputs.items() if rate & Rate.STEP}
        timed |= {*program.histories[0], *program.curves[0]}
        starts, strides, counts = [], [], []
        for name, shape in program.shapes(groups, 1).items():
            lead = arrays[name].shape[:1] if name in timed else ()
            _fits(name, arrays[name], (*lead, *shape))
            starts.append(arrays[name].ctypes.data)
            strides.append(arrays[name].strides[0] if lead else 0)
            counts.append(lead[0] if lead else 1)
        places = np.array(starts), np.array(strides), np.array(counts)
        return functools.partial(self._run_step, dict(arrays), groups, places)

    def _run_step(self, _owners: Any, groups: int, places: tuple[Array, ...], k: int) -> None:
        starts, strides, counts = places
        self._call(0, groups, 1, *(starts + k % counts * strides).tolist())

    def _run(
        self,
        _owners: list[Array],
        addresses: list[int],
        groups: int,
        steps: int,
        first: int,
        last: int,
    ) -> None:
        # The owners are held by the partial: the code below has bare pointers.
        if not 0 <= first <= last <= groups:
            raise ShapeError(f"groups {first} to {last} are outside 0 to {groups}")
        if steps and first < last:
            self._call(first, last, steps, *addresses)
