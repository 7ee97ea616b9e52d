"""Step programs: what one time step does to every lane, as a graph with inputs, states and outputs.

A program says nothing about filters: whoever composes one runs ordinary methods on its nodes. It
is run by `interpret` (NumPy, slow, plainly right) or by the machine code of `tracker.compile.llvm`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntFlag
from typing import Any

import numpy as np

from tracker.compile.elementary import EXPANSIONS
from tracker.errors import ShapeError, wording
from tracker.models.functions import absolute, wrap
from tracker.models.graph import NUMPY, Entry, Graph, Node, needed, plain
from tracker.types import Array

WIDTH = 8
"""Lanes per group: one vector of doubles on the widest machines, two on most."""

BLOCK = 4
"""Groups whose contributions to a curve are added up together."""


class Rate(IntFlag):
    """How often a value changes; it decides where it is computed."""

    CALL = 0
    STEP = 1
    LANE = 2
    BOTH = 3


_OFTEN = {
    Rate.CALL: "once a call",
    Rate.STEP: "once a step",
    Rate.LANE: "once a lane",
    Rate.BOTH: "each step and lane",
}


class Program:
    """Inputs by rate, states carried from step to step, delay lines, totals, curves and histories.

    A program may have several ``variants`` of its step, of which a per-step input selects one (the
    sensor that measured): everything that only one of them needs is computed only then.
    """

    def __init__(self, *, backward: bool = False, variants: int = 1) -> None:
        self.graph = Graph()
        self.backward = backward
        self.variants = variants
        self.inputs: dict[str, tuple[int, Rate]] = {}
        self.states: dict[str, list[Node]] = {}
        self.next: list[dict[str, list[Node]]] = [{} for _ in range(variants)]
        self.histories: list[dict[str, list[Node]]] = [{} for _ in range(variants)]
        self.curves: list[dict[str, list[Node]]] = [{} for _ in range(variants)]
        self.delays: dict[str, tuple[list[Node], int]] = {}
        self.fed: list[dict[str, list[Node]]] = [{} for _ in range(variants)]
        self.place: dict[str, tuple[str, int]] = {}

    # ---------------------------------------------------------------- composing
    def input(self, name: str, count: int, rate: Rate) -> list[Node]:
        """Read-only values: ``(count,)``, ``(T, count)``, ``(lanes)`` or both, by rate."""
        self.inputs[name] = (count, rate)
        return self._named(name, count)

    def state(self, name: str, count: int) -> list[Node]:
        """Values carried from step to step, per lane; read at the start, written at the end."""
        self.states[name] = self._named(name, count)
        return self.states[name]

    def set(self, name: str, entries: Sequence[Entry], variant: int = 0) -> None:
        """The values of a state after the step."""
        self.next[variant][name] = [self.graph.const(e) for e in entries]

    def total(self, name: str, entries: Sequence[Entry], variant: int = 0) -> None:
        """Sums over time, per lane: a state that accumulates."""
        olds = self.states.get(name) or self.state(name, len(entries))
        self.set(name, [a + b for a, b in zip(olds, entries, strict=True)], variant)

    def history(self, name: str, entries: Sequence[Entry], variant: int = 0) -> None:
        """Values kept for every step and lane."""
        self.histories[variant][name] = [self.graph.const(e) for e in entries]

    def curve(self, name: str, entries: Sequence[Entry], variant: int = 0) -> None:
        """Values added up over the lanes of a block, for every step."""
        self.curves[variant][name] = [self.graph.const(e) for e in entries]

    def delay(self, name: str, count: int, steps: int) -> list[Node]:
        """What was fed to the line ``steps`` steps ago, per lane; what its array held, before that.

        The array is a ring: step k reads, then writes, the slot ``k % steps``. A window sum, for
        instance, adds what is new and takes away what comes out of the line.
        """
        self.delays[name] = (self._named(name, count), steps)
        return self.delays[name][0]

    def feed(self, name: str, entries: Sequence[Entry], variant: int = 0) -> None:
        """What goes into a delay line at this step."""
        self.fed[variant][name] = [self.graph.const(e) for e in entries]

    def _named(self, name: str, count: int) -> list[Node]:
        for i in range(count):
            self.place[f"{name}.{i}"] = (name, i)
        return [self.graph.input(f"{name}.{i}") for i in range(count)]

    # ------------------------------------------------------------------- reading
    def roots(self, variant: int) -> list[Node]:
        """Everything that a variant of the step computes, in a fixed order."""
        groups = (
            self.next[variant],
            self.histories[variant],
            self.curves[variant],
            self.fed[variant],
        )
        return [n for group in groups for nodes in group.values() for n in nodes]

    def finished(self) -> None:
        """Check that all variants compute the same things, and that all states are set.

        Raises:
            ShapeError: if not; a program that is wrong here is a mistake of its composer.
        """
        for kind, groups in (
            ("states", self.next),
            ("histories", self.histories),
            ("curves", self.curves),
            ("delay lines", self.fed),
        ):
            sizes = [{k: len(v) for k, v in group.items()} for group in groups]
            expected = sizes[0]
            if kind == "states":
                expected = {k: len(v) for k, v in self.states.items()}
            elif kind == "delay lines":
                expected = {k: len(nodes) for k, (nodes, _) in self.delays.items()}
            for found in sizes:
                if found != expected:
                    raise ShapeError(
                        wording(
                            f"{kind} of a program", got=found, expected=str(expected), do="set all"
                        )
                    )

    def rates(self, order: Sequence[Node]) -> dict[int, Rate]:
        """Rate of each node, by index."""
        out: dict[int, Rate] = {}
        for node in order:
            if node.op == "input":
                name = self.place[node.value][0]
                carried = name in self.states or name in self.delays
                out[node.index] = Rate.BOTH if carried else self.inputs[name][1]
            else:
                rate = Rate.CALL
                for a in node.args:
                    rate |= out[a.index]
                out[node.index] = rate
        return out

    def shapes(self, groups: int, steps: int) -> dict[str, tuple[int, ...]]:
        """Array shapes by name, in the order of a kernel's arguments."""
        out: dict[str, tuple[int, ...]] = {}
        for name, (count, rate) in self.inputs.items():
            lead = (groups,) if rate & Rate.LANE else ()
            time = (steps,) if rate & Rate.STEP else ()
            out[name] = (*lead, *time, count, *((WIDTH,) if lead else ()))
        out |= {name: (groups, len(nodes), WIDTH) for name, nodes in self.states.items()}
        for name, (nodes, length) in self.delays.items():
            out[name] = (groups, length, len(nodes), WIDTH)
        for name, nodes in self.histories[0].items():
            out[name] = (groups, steps, len(nodes), WIDTH)
        for name, nodes in self.curves[0].items():
            out[name] = (-(-groups // BLOCK), steps, len(nodes), WIDTH)
        return out

    def lowered(self) -> Program:
        """The same program in primitive operations: elementary functions are expanded."""
        low = Program(backward=self.backward, variants=self.variants)
        low.inputs, low.place = self.inputs, self.place
        low.states = {k: low._named(k, len(v)) for k, v in self.states.items()}
        low.delays = {
            k: (low._named(k, len(nodes)), steps) for k, (nodes, steps) in self.delays.items()
        }
        copied: dict[int, Node] = {}
        for variant in range(self.variants):
            for node in needed(self.roots(variant)):
                if node.index not in copied:
                    copied[node.index] = _copied(node, low.graph, copied)
            for mine, theirs in (
                (low.next, self.next),
                (low.histories, self.histories),
                (low.curves, self.curves),
                (low.fed, self.fed),
            ):
                mine[variant] = {
                    k: [copied[n.index] for n in nodes] for k, nodes in theirs[variant].items()
                }
        return low

    def describe(self) -> str:
        """The program in words and formulas, for a person."""
        lines = [
            f"step program: {'backward' if self.backward else 'forward'}, {WIDTH} lanes a group"
        ]
        wide = max(map(len, (*self.inputs, *self.states, *self.delays)), default=0)
        for name, (count, rate) in self.inputs.items():
            lines.append(f"input   {name:{wide}s} {count:3d} {_OFTEN[rate]}")
        lines += [f"state   {name:{wide}s} {len(nodes):3d}" for name, nodes in self.states.items()]
        lines += [
            f"delay   {name:{wide}s} {len(nodes):3d} by {steps} steps"
            for name, (nodes, steps) in self.delays.items()
        ]
        for variant in range(self.variants):
            order = needed(self.roots(variant))
            work = sum(n.op not in ("input", "const") for n in order)
            lines.append(f"variant {variant}: {work} operations")
            for node in order:
                if node.op == "input":
                    lines.append(f"  v{node.index} = {node.value}")
                elif node.op == "const":
                    lines.append(f"  v{node.index} = {node.value!r}")
                else:
                    arguments = ", ".join(f"v{a.index}" for a in node.args)
                    lines.append(f"  v{node.index} = {node.op}({arguments})")
            for kind, group in (
                ("next", self.next[variant]),
                ("history", self.histories[variant]),
                ("curve", self.curves[variant]),
                ("feed", self.fed[variant]),
            ):
                for name, nodes in group.items():
                    lines.append(f"  {kind} {name}: {', '.join(f'v{n.index}' for n in nodes)}")
        return "\n".join(lines)


def _copied(node: Node, graph: Graph, copied: Mapping[int, Node]) -> Node:
    if node.op == "const":
        return graph.const(node.value)
    if node.op == "input":
        return graph.input(node.value)
    if node.op == "isnan":
        angle = _unwrapped(node.args[0])
        if angle is not None:
            return graph.make("isnan", _telling(angle, copied))
    arguments = [copied[a.index] for a in node.args]
    if node.op in EXPANSIONS and any(a.op != "const" for a in arguments):
        return graph.const(plain(EXPANSIONS[node.op](*arguments)))
    return graph.make(node.op, *arguments)


def _unwrapped(node: Node) -> Node | None:
    """The angle of which a node is the `wrap`, or None."""
    if node.op == "max" and node.args[0].op == "min" and node.args[0].args[0].op == "add":
        for angle in node.args[0].args[0].args:
            if angle.op != "const" and wrap(angle) is node:  # equal expressions are one node
                return angle
    return None


def _telling(node: Node, copied: Mapping[int, Node]) -> Any:
    """What is NaN where an angle is, and known long before it: what the angle is made of.

    Whether a component was measured decides about covariances, which need no angle otherwise.
    An infinite angle is not told of: it is refused where measurements enter.
    """
    angle = _unwrapped(node)
    if angle is not None:
        return _telling(angle, copied)
    if node.op in ("add", "sub"):
        return _telling(node.args[0], copied) + _telling(node.args[1], copied)
    if node.op == "neg":  # lest it cancel something
        return _telling(node.args[0], copied)
    if node.op == "atan2":  # of infinite coordinates, too: neither may cancel the other
        return absolute(copied[node.args[0].index]) + absolute(copied[node.args[1].index])
    return 0.0 if node.op == "const" else copied[node.index]


# ------------------------------------------------------------------------------ running it
def tile(values: Array) -> Array:
    """``(..., lanes)`` as ``(groups, ..., WIDTH)``; the last group is filled with the last lane."""
    lanes = values.shape[-1]
    groups = -(-lanes // WIDTH)
    if groups * WIDTH != lanes:
        pad = np.repeat(values[..., -1:], groups * WIDTH - lanes, axis=-1)
        values = np.concatenate([values, pad], axis=-1)
    return np.moveaxis(values.reshape(*values.shape[:-1], groups, WIDTH), -2, 0)


def tile_into(out: Array, values: Array) -> None:
    """``out[:] = tile(values)``, in fewer and larger pieces where lanes fill whole groups."""
    lanes = values.shape[-1]
    if lanes % WIDTH or values.dtype != np.float64 or values.strides[-1] != values.itemsize:
        out[:] = tile(values)
        return
    line = np.dtype(f"V{WIDTH * values.itemsize}")  # a group's lanes, moved as one element
    source = values.reshape(*values.shape[:-1], lanes // WIDTH, WIDTH).view(line)[..., 0]
    out.view(line)[..., 0] = np.moveaxis(source, -1, 0)


def untile(values: Array, lanes: int) -> Array:
    """``(groups, ..., WIDTH)`` as ``(..., lanes)``."""
    moved = np.moveaxis(values, 0, -2)
    return moved.reshape(*moved.shape[:-2], -1)[..., :lanes]


def allocate(shape: tuple[int, ...]) -> Array:
    """A zeroed array whose first element lies on a cache line."""
    size = int(np.prod(shape))
    raw = np.zeros(size + 8)
    offset = (-raw.ctypes.data // 8) % 8
    return raw[offset : offset + size].reshape(shape)


def interpret(program: Program, arrays: Mapping[str, Array], steps: int) -> None:
    """Run a program on its arrays with NumPy, all lanes at once, reading and writing as a kernel does.

    Shapes:
        arrays as in `Program.shapes`; a per-step input "variant" ``(T, 1)`` selects the variant.
    """
    state = {
        name: [arrays[name][:, i] for i in range(len(v))] for name, v in program.states.items()
    }
    for step in range(steps):
        k = steps - 1 - step if program.backward else step
        variant = int(arrays["variant"][k, 0]) if program.variants > 1 else 0
        worth: dict[int, Any] = {}
        for node in needed(program.roots(variant)):
            if node.op == "const":
                worth[node.index] = node.value
            elif node.op == "input":
                worth[node.index] = _value(program, arrays, state, node.value, k, step)
            else:
                with np.errstate(all="ignore"):
                    worth[node.index] = NUMPY[node.op](*(worth[a.index] for a in node.args))
        for name, nodes in program.histories[variant].items():
            for i, node in enumerate(nodes):
                arrays[name][:, k, i] = worth[node.index]
        for name, nodes in program.curves[variant].items():
            for i, node in enumerate(nodes):
                groups = arrays[next(iter(program.states))].shape[0]
                full = np.broadcast_to(worth[node.index], (groups, WIDTH))
                for g in range(groups):
                    arrays[name][g // BLOCK, k, i] += full[g]
        for name, nodes in program.fed[variant].items():
            slot = step % program.delays[name][1]
            for i, node in enumerate(nodes):
                arrays[name][:, slot, i] = worth[node.index]
        state = {
            name: [worth[node.index] for node in nodes]
            for name, nodes in program.next[variant].items()
        }
    for name, values in state.items():
        for i, value in enumerate(values):
            arrays[name][:, i] = value


def _value(
    program: Program,
    arrays: Mapping[str, Array],
    state: Mapping[str, Any],
    key: str,
    k: int,
    step: int,
) -> Any:
    name, i = program.place[key]
    if name in state:
        return state[name][i]
    if name in program.delays:
        # a copy: the slot is written at the end of this step
        return arrays[name][:, step % program.delays[name][1], i].copy()
    array, rate = arrays[name], program.inputs[name][1]
    if rate is Rate.CALL:
        return array[i]
    if rate is Rate.STEP:
        return array[k, i]
    return array[:, i] if rate is Rate.LANE else array[:, k, i]
