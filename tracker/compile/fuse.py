"""Estimators composed into step programs: motion, sensors, filter, smoother, scores in one graph.

The composing runs the components' ordinary methods on graph nodes, so nothing here repeats an
algorithm, and nothing in a plugin mentions compilation. Running the programs is `tracker.compile.run`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, ClassVar

import attrs
import numpy as np

from tracker.algebra import mahalanobis, residual
from tracker.compile.program import Program, Rate
from tracker.compile.values import (
    Form,
    Tree,
    built,
    entries,
    leaves,
    of_nodes,
    pack,
    triangle,
    unpack,
)
from tracker.errors import TraceError
from tracker.models.functions import absolute, isnan, less, maximum, where
from tracker.models.graph import Node
from tracker.models.parameters import numbers_of, with_numbers
from tracker.recursion import Adapted, advance, is_random
from tracker.types import EMPTY_SPACE, Gaussian, Space

INFINITY = float("inf")

TOTALS = ("squared_error", "nees", "nis", "count", "loglik", "mismatch")
"""What may be summed over time per lane, and nothing else; the first two need the truth."""

WINDOW = 25
"""Steps in the mean of squares of a mismatch (paper 4, eq. 3-5)."""


@attrs.frozen
class Layout:
    """Everything about a problem that is baked into its program; numbers are inputs, not layout."""

    structure: tuple[Any, ...]
    rates: tuple[tuple[str, Rate], ...]
    inputs: int
    keep: tuple[str, ...]
    filter: Any = attrs.field(eq=False)
    motion: Any = attrs.field(eq=False)
    sensors: tuple[Any, ...] = attrs.field(eq=False)
    smoother: Any = attrs.field(eq=False)
    adapter: Any = attrs.field(eq=False)
    carried: Form = attrs.field(eq=False)
    told: Form | None = None
    """What a smoother is told of each step: moments, or what the filter believed."""

    @property
    def belief(self) -> Form:
        """What the filter believes, of what is carried."""
        if isinstance(self.carried, Tree) and self.carried.kind is Adapted:
            return dict(self.carried.parts)["belief"]
        return self.carried

    def rate(self, name: str) -> Rate:
        """How often an input changes."""
        return dict(self.rates)[name]


def structure(component: Any) -> Any:
    """What a component bakes into a program: everything but the values of the numbers it offers.

    A component of parts whose numbers it offers as its own says so by a ``structure``, a key without
    them.
    """
    if isinstance(component, Linearised) or not attrs.has(type(component)):
        return component
    numbers = numbers_of(component)
    own = getattr(component, "structure", None)
    if own is not None:
        return (type(component), own, *numbers)
    return (*_fields(component, {"parameters", *numbers}), *numbers)


def _fields(component: Any, but: Collection[str] = ()) -> tuple[Any, ...]:
    kept = [f.name for f in attrs.fields(type(component)) if f.init and f.name not in but]
    return (type(component), *(_key(getattr(component, name)) for name in kept))


def _key(value: Any) -> Any:
    """A hashable stand-in that is equal for equal values, where the value is not one itself."""
    if isinstance(value, np.ndarray):
        return (value.shape, value.dtype.str, value.tobytes())
    if isinstance(value, tuple):
        return tuple(_key(v) for v in value)
    if isinstance(value, Mapping):
        return tuple((k, _key(v)) for k, v in value.items())
    kind: Any = type(value)
    if attrs.has(kind) and kind.__hash__ is object.__hash__:  # equal only to itself
        return _fields(value)
    return value


def vector(entries: Sequence[Any]) -> Any:
    """Nodes as an object array."""
    out = np.empty(len(entries), dtype=object)
    out[:] = list(entries)
    return out


def why_not(filter_: Any, motion: Any, sensors: Sequence[Any]) -> str:
    """In words, why these cannot be fused, or ''. Only a trial composition tells for sure."""
    for role, model in (("motion", motion), *(("sensor", s) for s in sensors)):
        name = getattr(model, "name", type(model).__name__)
        reason = getattr(model, "why_opaque", "it is not written over components")
        if reason:
            return f"{role} {name!r} is opaque: {reason}"
        if not hasattr(model, "with_parameters") or not hasattr(model, "parameters"):
            return f"{role} {name!r} does not offer its parameters (with_parameters)"
    reason = getattr(filter_, "why_opaque", "")
    if reason or "opaque" in getattr(filter_, "tags", ()):
        return f"filter {type(filter_).__name__} is opaque: {reason or 'it says so'}"
    if is_random(filter_):
        return f"filter {type(filter_).__name__} draws random numbers"
    return ""


@attrs.frozen
class Linearised:
    """Stands for a sensor of which only value, Jacobian and noise at the predicted mean are known.

    ``columns`` are those in which the Jacobian is not zero. Equal ones share a program: ``residual``
    follows from ``key``.
    """

    key: Any
    columns: tuple[int, ...]
    width: int
    space: Any = attrs.field(eq=False)
    residual: Any = attrs.field(eq=False)
    entries: tuple[Any, ...] = ()

    parameters: ClassVar[Mapping[str, Any]] = {}
    pose_space: ClassVar[Space] = EMPTY_SPACE

    @property
    def size(self) -> int:
        """How many numbers are known: of the value, the Jacobian and the triangle of the noise."""
        m = self.space.size
        return int(m + m * len(self.columns) + triangle(m))

    def worth(self, entries: Sequence[Any]) -> Linearised:
        """The same sensor with those numbers."""
        return attrs.evolve(self, entries=tuple(entries))

    def linearise(self, x: Any, pose: Any = None) -> tuple[Any, Any]:
        """Value and Jacobian."""
        self._only_at_the_mean(x)
        m = self.space.size
        H = np.zeros((m, self.width), dtype=object)
        for j, column in enumerate(self.columns):
            H[:, column] = [self.entries[m + i * len(self.columns) + j] for i in range(m)]
        return self.h(x, pose), H

    def h(self, x: Any, _pose: Any = None) -> Any:
        """Value."""
        self._only_at_the_mean(x)
        return vector(self.entries[: self.space.size])

    def jacobian(self, x: Any, pose: Any = None) -> Any:
        """Jacobian."""
        return self.linearise(x, pose)[1]

    def R(self, x: Any, _pose: Any = None) -> Any:
        """Noise."""
        self._only_at_the_mean(x)
        m = self.space.size
        return unpack(self.entries[m + m * len(self.columns) :], m)

    def _only_at_the_mean(self, x: Any) -> None:
        if any(not isinstance(e, Node) or e.value != f"x.{i}" for i, e in enumerate(x)):
            raise TraceError("it asks for the sensor elsewhere than at the predicted mean")


class _Composer:
    """The inputs of a program, as what the components' methods take."""

    def __init__(self, program: Program, layout: Layout) -> None:
        self.program, self.layout = program, layout
        n = layout.motion.space.size
        self.n = n
        dt = program.input("dt", 1, layout.rate("dt"))[0]
        t = program.input("t", 1, layout.rate("dt"))[0]
        self.dt, self.t = dt, t
        u = program.input("u", layout.inputs, layout.rate("u")) if layout.inputs else None
        self.u = None if u is None else vector(u)
        self.motion = self._with_numbers("motion", layout.motion)
        self.filter = self._with_numbers("filter", layout.filter)
        self.adapter = self._with_numbers("adapter", layout.adapter)

    def _with_numbers(self, owner: str, component: Any) -> Any:
        nodes = {
            name: self.program.input(f"{owner}.{name}", 1, self.layout.rate(f"{owner}.{name}"))[0]
            for name in numbers_of(component)
        }
        return with_numbers(component, nodes)

    def carried(self, prefix: str = "") -> Any:
        """What the step begins with: the belief and the adapter's memories, as states."""
        nodes = {
            leaf.name: self.program.delay(prefix + leaf.name, leaf.count, leaf.length)
            if leaf.length
            else self.program.state(prefix + leaf.name, leaf.count)
            for leaf in leaves(self.layout.carried)
        }
        return built(self.layout.carried, lambda leaf: of_nodes(leaf, nodes[leaf.name]))

    def carry(self, value: Any, variant: int, prefix: str = "") -> None:
        """What the next step begins with."""
        lines = {leaf.name for leaf in leaves(self.layout.carried) if leaf.length}
        for name, found in entries(self.layout.carried, value).items():
            _symbolic(self.layout.filter or self.layout.smoother, found)
            put = self.program.feed if name in lines else self.program.set
            put(prefix + name, found, variant)

    def sensor(self, i: int) -> tuple[Any, Any]:
        """Sensor i, and its pose."""
        sensor = self._with_numbers(f"sensor{i}", self.layout.sensors[i])
        if isinstance(sensor, Linearised):
            return sensor.worth(self.program.input(f"seen{i}", sensor.size, Rate.BOTH)), None
        size = sensor.pose_space.size
        if not size:
            return sensor, None
        pose = self.program.input(f"pose{i}", size, self.layout.rate(f"pose{i}"))
        return sensor, vector(pose)


def forward(layout: Layout) -> Program:
    """Predict and update, with the histories or scores that ``layout.keep`` names.

    Keep: "predicted", "filtered", "innovation" and "beliefs" (histories); "scores" (against the input
    "truth"), or "total nees" and the like, for each of `TOTALS`.
    """
    count = len(layout.sensors)
    program = Program(variants=count)
    if count > 1:
        program.input("variant", 1, Rate.STEP)
    if count > 1 and any(leaf.length for leaf in leaves(layout.carried)):
        # A delay line moves on at every step; a sensor's window only when it measured.
        raise TraceError("it keeps a window for each of several sensors")
    c = _Composer(program, layout)
    carried = c.carried()
    z = program.input("z", max(s.space.size for s in layout.sensors), Rate.BOTH)
    scored = "scores" in layout.keep
    summed = [name for name in TOTALS if f"total {name}" in layout.keep]
    told = scored or not {"squared_error", "nees"}.isdisjoint(summed)
    truth = vector(program.input("truth", c.n, Rate.BOTH)) if told else None
    if count > 1 and "mismatch" in summed:
        raise TraceError("a mismatch is that of one sensor")
    counted = program.input("counted", 1, Rate.LANE)[0] if scored else 1.0
    for i in range(count):
        sensor, pose = c.sensor(i)
        measured = vector(z[: sensor.space.size])
        after, predicted, belief, innovation = advance(
            c.filter, c.adapter, carried, c.motion, sensor, i, measured, c.dt, c.u, c.t, pose
        )
        c.carry(after, i)
        estimate = belief.moments()
        _symbolic(layout.filter, estimate.mean)
        _histories(program, i, layout, predicted.moments(), estimate, innovation)
        if "beliefs" in layout.keep:
            for when, value in (("predicted", predicted), ("filtered", belief)):
                for name, found in entries(layout.belief, value).items():
                    program.history(f"{when}.{name}", found, i)
        if summed:
            totals(program, i, layout.motion, estimate, innovation, truth, summed)
        if scored:
            more = [innovation.nis, innovation.count, innovation.loglik]
            scores(program, i, layout.motion, estimate, truth, counted, more)
    return program


def around(layout: Layout) -> Program:
    """Update, then predict to the next row: the carried moments are predicted ones.

    Between two such steps someone else may evaluate a sensor at the predicted mean (`Linearised`).
    """
    count = len(layout.sensors)
    program = Program(variants=count)
    if count > 1:
        program.input("variant", 1, Rate.STEP)
    c = _Composer(program, layout)
    predicted = Gaussian.trusted(
        vector(program.state("x", c.n)), unpack(program.state("P", triangle(c.n)), c.n)
    )
    z = program.input("z", max(s.space.size for s in layout.sensors), Rate.BOTH)
    for i in range(count):
        sensor, pose = c.sensor(i)
        measured = vector(z[: sensor.space.size])
        updated, innovation = layout.filter.update(predicted, sensor, measured, pose)
        ahead = layout.filter.predict(updated, c.motion, c.dt, c.u, c.t)
        _symbolic(layout.filter, updated.mean)
        _symbolic(layout.filter, ahead.mean)
        program.set("x", list(ahead.mean), i)
        program.set("P", pack(ahead.cov), i)
        _histories(program, i, layout, predicted, updated, innovation)
    return program


def _histories(
    program: Program,
    variant: int,
    layout: Layout,
    predicted: Gaussian,
    updated: Gaussian,
    innovation: Any,
) -> None:
    """The histories that ``layout.keep`` names; residuals are padded to the largest sensor."""
    if "predicted" in layout.keep:
        program.history("predicted.x", list(predicted.mean), variant)
        program.history("predicted.P", pack(predicted.cov), variant)
    if "filtered" in layout.keep:
        program.history("filtered.x", list(updated.mean), variant)
        program.history("filtered.P", pack(updated.cov), variant)
    if "innovation" in layout.keep:
        m, most = len(innovation.residual), max(s.space.size for s in layout.sensors)
        pad = [float("nan")] * (most - m)
        program.history("residual", [*innovation.residual, *pad], variant)
        full = np.zeros((most, most), dtype=object)
        full[:m, :m] = innovation.S
        program.history("S", pack(full), variant)
        program.history("score", [innovation.nis, innovation.loglik, innovation.count], variant)


def backward(layout: Layout) -> Program:
    """The smoother's recursion over stored filtered and predicted moments, or beliefs.

    What was predicted at step k + 1 is carried as a state beside the smoother's belief, and so are
    its dt, t and u. The last step, at which a belief begins, is a variant of its own.
    """
    program = Program(backward=True, variants=2)
    program.input("variant", 1, Rate.STEP)
    c, form = _Composer(program, layout), layout.told
    assert form is not None  # noqa: S101 - every backward layout has one

    def belief_of(make: Any, when: str, *more: Any) -> Any:
        each = {leaf.name: make(f"{when}.{leaf.name}", leaf.count, *more) for leaf in leaves(form)}
        return built(form, lambda leaf: of_nodes(leaf, each[leaf.name]))

    later, ahead = c.carried("smoothed."), belief_of(program.state, "ahead")
    filtered = belief_of(program.input, "filtered", Rate.BOTH)
    predicted = belief_of(program.input, "predicted", Rate.BOTH)
    told = "scores" in layout.keep
    truth = vector(program.input("truth", c.n, Rate.BOTH)) if told else None
    counted = program.input("counted", 1, Rate.LANE)[0] if told else 1.0
    step = program.state("step", 2 + layout.inputs)
    u = vector(step[2:]) if layout.inputs else None
    smoother, known = layout.smoother, (c.motion, step[0], u, step[1])
    for variant in (LAST, EARLIER):
        if variant == LAST:
            belief = smoother.begin(filtered) if hasattr(smoother, "begin") else filtered
            out = filtered.moments()
        else:
            belief = smoother.step(filtered, ahead, later, *known)
            out = belief.moments()
        _symbolic(smoother, out.mean)
        c.carry(belief, variant, "smoothed.")
        for name, found in entries(form, predicted).items():
            program.set(f"ahead.{name}", found, variant)
        program.set("step", [c.dt, c.t, *([] if c.u is None else c.u)], variant)
        if "smoothed" in layout.keep:
            program.history("out.x", list(out.mean), variant)
            program.history("out.P", pack(out.cov), variant)
        if "beliefs" in layout.keep:
            for name, found in entries(layout.carried, belief).items():
                program.history(f"known.{name}", found, variant)
        if told:
            scores(program, variant, layout.motion, out, truth, counted, [])
    return program


LAST, EARLIER = 0, 1
"""Variants of a backward step."""


def totals(
    program: Program,
    variant: int,
    motion: Any,
    estimate: Gaussian,
    innovation: Any,
    truth: Any,
    names: Sequence[str],
) -> None:
    """Sums over time per lane of what is named, in the order of `TOTALS`."""
    found = summands(motion.space, estimate, innovation, truth, names)
    if "mismatch" in names:
        v = list(innovation.residual)
        kept = program.state("mismatch", 2 * len(v) + 1)
        oldest = program.delay("mismatch.window", 2 * len(v), WINDOW)
        found["mismatch"], kept, new = mismatched(kept, oldest, v, innovation.S)
        program.set("mismatch", kept, variant)
        program.feed("mismatch.window", new, variant)
    program.total("totals", [entry for name in names for entry in found[name]], variant)


def summands(
    space: Space, estimate: Gaussian, innovation: Any, truth: Any, names: Collection[str]
) -> dict[str, list[Any]]:
    """What one step adds to the totals that need no memory, by name; arrays of lanes or nodes."""
    found = {
        "nis": [innovation.nis],
        "count": [innovation.count],
        "loglik": [innovation.loglik],
    }
    if {"squared_error", "nees"}.isdisjoint(names):
        return found
    errors = residual(estimate.mean, truth, space.circular)
    squared: Any = 0.0
    for i in space.position:
        squared = squared + errors[i] * errors[i]
    found["squared_error"] = [squared]
    if "nees" in names:
        found["nees"] = [mahalanobis(errors, estimate.cov)]
    return found


def mismatched(
    kept: Sequence[Any], oldest: Sequence[Any], v: Sequence[Any], S: Any
) -> tuple[list[Any], list[Any], list[Any]]:
    """Squared degrees of mismatch ``S - C`` of each component, C the mean square of the last residuals.

    C is 0 until a window has passed, and of what was measured in it (paper 4, eq. 3-5, 3-6).

    Shapes:
        kept: sums of squares, how many, and the steps so far, ``2 m + 1``; oldest, what falls out of the
        window, ``2 m``. Returned: ``m`` squares, what is kept, and what enters the window.
    """
    m = len(v)
    missing = [isnan(e) for e in v]
    new = [where(no, 0.0, e * e) for no, e in zip(missing, v, strict=True)]
    new += [where(no, 0.0, 1.0) for no in missing]
    sums = [a + b - c for a, b, c in zip(kept, new, oldest, strict=False)]
    steps = kept[2 * m] + where(less(kept[2 * m], WINDOW + 0.5), 1.0, 0.0)
    squares = []
    for i in range(m):
        mean = sums[i] / maximum(sums[m + i], 1.0)
        dom = S[i, i] - where(less(steps, WINDOW - 0.5), 0.0, mean)
        squares.append(dom * dom)
    return squares, [*sums, steps], new


def scores(
    program: Program,
    variant: int,
    motion: Any,
    estimate: Gaussian,
    truth: Any,
    counted: Any,
    more: Sequence[Any],
) -> None:
    """Squared position error, NEES and more, summed over time per lane and over lanes per step.

    Of the last step are kept, per lane: squared position error, NEES, and the position's claimed variance.

    A lane that is not finite is left out of the sums over lanes, not out of its own; so is one that
    only fills up a group (``counted`` is 0 there).
    """
    errors = residual(estimate.mean, truth, motion.space.circular)
    squared: Any = 0.0
    claimed: Any = 0.0
    for i in motion.space.position:
        squared, claimed = squared + errors[i] * errors[i], claimed + estimate.cov[i, i]
    nees = mahalanobis(errors, estimate.cov)
    program.total("totals", [squared, nees, *more], variant)
    if "final" not in program.states:
        program.state("final", 3)
    # Forwards the last step is the last computed; backwards it is the first, and is kept.
    last = [squared, nees, claimed]
    if program.backward:
        kept = program.states["final"]
        last = [where(isnan(was), now, was) for was, now in zip(kept, last, strict=True)]
    program.set("final", last, variant)
    counts = less(absolute(squared + nees), where(less(0.0, counted), INFINITY, 0.0))
    # An update that is not ok says nothing of NIS, whatever estimate it left.
    surprise = [where(isnan(more[0]), 0.0, e) for e in more[:2]]
    values = [where(counts, e, 0.0) for e in (squared, nees, *surprise, 1.0)]
    program.curve("curves", values, variant)


def _symbolic(owner: Any, entries: Any) -> None:
    if not all(isinstance(e, (Node, float, int)) for e in entries):
        kinds: Mapping[str, None] = dict.fromkeys(type(e).__name__ for e in entries)
        raise TraceError(f"{type(owner).__name__} computed {', '.join(kinds)} from graph nodes")
