"""Filtering and smoothing a record of one target per lane: the loop that everyone reads.

Association, several targets and campaigns live elsewhere. An `Estimator` is a filter with the
models it works on; `filter` and `smooth` run it over a `Record`; `Estimator.step` runs it on line.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import attrs
import numpy as np

from tracker.algebra import at_once
from tracker.algebra.lanes import BUFFER
from tracker.compile import mixed
from tracker.compile import run as compiled
from tracker.compile.online import Steps
from tracker.errors import CapabilityError, DomainError, ShapeError, wording
from tracker.models.parameters import lanes_of_component
from tracker.protocols import (
    Filter,
    MotionModel,
    NoiseAdapter,
    SensorModel,
    Smoother,
    WorksRecords,
)
from tracker.recursion import (
    Adapted,
    advance,
    begin,
    is_random,
    joined,
    lanes_of,
    unseen,
    why_unsmoothable,
    why_untunable,
)
from tracker.registry import Component
from tracker.threads import each
from tracker.types import (
    ArrayLike,
    Beliefs,
    Gaussian,
    History,
    Innovation,
    Record,
    Run,
    Trajectory,
    as_array,
)

LANE_BYTES = 128_000
"""Temporaries above this size page-fault: lanes are worked in tiles of this many bytes of P."""

MEMBER_BYTES = 1_000_000
"""The same for filters that keep several members of each lane: fewer, longer operations pay off
(measured: 1,000 runs of 32 EKFs take 1.2 s of CPU time, 3.1 s untiled, 2.3 s with `LANE_BYTES`)."""

PAIR = [0, 0]
"""A batch of one lane is worked as two: products over a single lane take other code paths, and a
lane's bits must not depend on its company."""


# ------------------------------------------------------------------------------ capabilities
def missing_capabilities(component: Any, needs: Sequence[str]) -> list[str]:
    """Which of the named capabilities a model lacks: 'jacobian', 'hessian', 'linear'."""
    absent = []
    for need in needs:
        if need == "linear":
            has = bool(getattr(component, "linear", False))
        elif need in ("jacobian", "hessian"):
            opaque = bool(getattr(component, "why_opaque", ""))
            linear = bool(getattr(component, "linear", False))
            by_hand = getattr(component, "derivative", None) is not None and need == "jacobian"
            has = hasattr(component, need) and (not opaque or by_hand or linear)
            has = has or (linear and need == "hessian")  # zero: nobody asks for it
        else:
            has = hasattr(component, need)
        if not has:
            absent.append(need)
    return absent


_MEANS = {
    "jacobian": "a Jacobian",
    "hessian": "a Hessian",
    "linear": "a linear model",
}


def lacking(user: str, needs: Sequence[str], role: str, component: Any) -> str:
    """In words, what a model lacks of what a filter or smoother needs, and the way out; '' if nothing."""
    absent = missing_capabilities(component, needs)
    if not absent:
        return ""
    name = getattr(component, "name", type(component).__name__)
    reason = getattr(component, "why_opaque", "")
    way = (
        "Use a filter for nonlinear models, such as 'ekf1'."
        if absent == ["linear"] and not reason
        else "Write the model over components so that derivatives follow, give them by hand, or use a "
        "filter that does not need them (`tracker list filter`)."
    )
    return (
        f"{user} needs {' and '.join(_MEANS.get(a, a) for a in absent)}, which {role} {name!r} does "
        f"not provide{f' ({reason})' if reason else ''}. {way}"
    )


def check_capabilities(user: str, needs: Sequence[str], role: str, component: Any) -> None:
    """Refuse a model that lacks what a filter or smoother needs.

    Raises:
        CapabilityError: naming both sides and the ways out.
    """
    words = lacking(user, needs, role, component)
    if words:
        raise CapabilityError(words)


# --------------------------------------------------------------------------------- estimator
@attrs.frozen(eq=False, kw_only=True)
class Estimator:
    """A filter, the models it works on, and the smoother that may follow it.

    Build one with `tracker.estimator`, which also accepts registered names.

    Raises:
        CapabilityError: when a model lacks what filter or smoother needs.
    """

    filter: Filter[Any]
    motion: MotionModel
    sensors: tuple[SensorModel, ...]
    smoother: Smoother | None = None
    adapter: NoiseAdapter[Any] | None = None
    sources: tuple[Component, ...] = ()
    _compiled: Steps = attrs.field(init=False, repr=False, factory=Steps)

    def __attrs_post_init__(self) -> None:
        _play_their_parts(self)
        label = f"filter {type(self.filter).__name__}"
        needs = tuple(self.filter.needs)
        check_capabilities(label, needs, "motion", self.motion)
        for sensor in self.sensors:
            check_capabilities(label, needs, "sensor", sensor)
            state = getattr(sensor, "state", self.motion.space)
            if state.names != self.motion.space.names:
                raise CapabilityError(
                    wording(
                        f"sensor {getattr(sensor, 'name', type(sensor).__name__)!r}",
                        got=f"a sensor that reads states ({state})",
                        expected=f"states of the motion model ({self.motion.space})",
                        do="build it with state=motion.space, or give it a method over(space)",
                    )
                )
        if self.smoother is not None:
            check_capabilities(
                f"smoother {type(self.smoother).__name__}",
                tuple(n for n in self.smoother.needs if n != "beliefs"),
                "motion",
                self.motion,
            )
        why = why_untunable(self.adapter, self.sensors)
        if self.smoother is not None:
            why = why or why_unsmoothable(self.filter, self.motion, self.smoother)
        if why:
            raise CapabilityError(why)

    def begin(
        self,
        prior: Gaussian,
        *,
        pose: ArrayLike | None = None,
        rng: np.random.Generator | Sequence[np.random.Generator] | None = None,
    ) -> Any:
        """What `step` is first given, where a Gaussian is not all: for filters that draw random numbers.

        Shapes:
            prior of any batch shape; pose as in the first step; rng a generator, or one per lane.

        Raises:
            CapabilityError: if the filter draws random numbers and none was given.
        """
        return begin(
            self.filter,
            self.adapter,
            self.motion,
            self.sensors,
            prior,
            pose,
            _each_lane(rng, prior),
        )

    def step(
        self,
        state: Any,
        z: ArrayLike,
        dt: Any,
        *,
        pose: ArrayLike | None = None,
        u: ArrayLike | None = None,
        t: Any = None,
        sensor: int = 0,
    ) -> tuple[Any, Innovation]:
        """One prediction and one update, on line, for one target or a batch.

        Shapes:
            state: what the last step returned, or a `Gaussian`; z ``(m, *batch)``, NaN where not
            measured; dt scalar or ``(*batch)`` seconds, not negative.

        Raises:
            ShapeError, DomainError: on a measurement of the wrong shape, inf, a negative dt, or a
            sensor that is not there.
        """
        done = self._compiled.step(self, state, z, dt, pose, u, t, sensor)
        if done is not None:
            return done
        if not 0 <= sensor < len(self.sensors):
            raise DomainError(
                wording(
                    "argument 'sensor'",
                    got=sensor,
                    expected=f"0 to {len(self.sensors) - 1}",
                    do="give the sensor's place among those of the estimator",
                )
            )
        _known_belief(self, state)
        model = self.sensors[sensor]
        values = as_array(z, "z")
        if values.shape[:1] != (model.space.size,):
            raise ShapeError(
                wording(
                    "argument 'z'",
                    got=f"shape {values.shape}",
                    expected=f"({model.space.size}, *batch): {model.space}",
                    do="give one row per component of the sensor's space",
                )
            )
        lanes = state.moments().mean.shape[1:]
        if values.shape[1:] != lanes:
            raise ShapeError(
                wording(
                    "argument 'z'",
                    got=f"shape {values.shape} for states of batch shape {lanes}",
                    expected=f"{(model.space.size, *lanes)}",
                    do="give one measurement per lane, NaN where there is none",
                )
            )
        if _infinite(values):
            raise DomainError(
                wording(
                    "argument 'z'",
                    got="an infinite value",
                    expected="finite numbers, or NaN where nothing was measured",
                    do="replace inf by NaN if the measurement is missing",
                )
            )
        if not (0.0 <= dt < math.inf if isinstance(dt, float) else _seconds(dt, lanes)):
            raise DomainError(
                wording(
                    "argument 'dt'",
                    got=f"{dt}",
                    expected="finite seconds that are not negative",
                    do="give late measurements in time order, or let tk.FixedLag do it",
                )
            )
        if t is None and getattr(self.motion, "reads_time", False):
            raise DomainError(
                wording(
                    "argument 't'",
                    got="nothing",
                    expected=f"the time at the start of the step, which motion "
                    f"{getattr(self.motion, 'name', type(self.motion).__name__)!r} reads",
                    do="pass t=, the time of the last step",
                )
            )
        pose = _given("pose", pose, model.pose_space, lanes)
        u = _given("u", u, getattr(self.motion, "input_space", None), lanes)
        if isinstance(state, Gaussian) and (self.adapter or hasattr(self.filter, "begin")):
            state = self.begin(state, pose=pose)
        return self._step(state, values, dt, pose, u, t, sensor)

    @np.errstate(all="ignore")  # as a decorator it costs half of what a block costs
    def _step(
        self, state: Any, z: Any, dt: Any, pose: Any, u: Any, t: Any, which: int
    ) -> tuple[Any, Innovation]:
        if z.ndim > 1:
            np.setbufsize(BUFFER)  # until the decorator leaves
        if self.adapter is not None:
            sensor = self.sensors[which]
            carried, _, _, innovation = advance(
                self.filter, self.adapter, state, self.motion, sensor, which, z, dt, u, t, pose
            )
            return carried, innovation
        predicted = self.filter.predict(state, self.motion, dt, u, t)
        return self.filter.update(predicted, self.sensors[which], z, pose)

    def lanes(self, index: Any) -> Estimator:
        """The same estimator with per-lane parameters of its models cut to some lanes."""
        whole = (self.motion, self.filter, self.adapter, *self.sensors)
        cut = [lanes_of_component(part, index) for part in whole]
        if all(a is b for a, b in zip(cut, whole, strict=True)):
            return self
        motion, rule, adapter, *sensors = cut
        return attrs.evolve(
            self, motion=motion, filter=rule, adapter=adapter, sensors=tuple(sensors)
        )

    def cite(self) -> str:
        """The sources of its components, one line each, then the works that they name by number."""
        if not self.sources:
            return "(made of objects that are not in the registry)"
        lines = [
            f"{c.kind} {c.name}: {c.summary.rstrip('.')}. Source: {c.source}." for c in self.sources
        ]
        works = dict.fromkeys(work for c in self.sources for work in c.works)
        return "\n".join([*lines, *sorted(works)])

    def explain(self) -> str:
        """In words: whether it is compiled, which of its models can be traced, and why not."""
        why = compiled.reason(self)
        lines = [f"runs on arrays: {why}" if why else "runs as one compiled step"]
        if why and not mixed.reason(self):
            lines = [f"runs as compiled steps around a sensor on arrays: {why}"]
        elif why and isinstance(self.filter, WorksRecords):
            stepwise = why_not_whole(self)
            lines = [
                f"runs step by step: {stepwise}" if stepwise else "runs compiled, whole records"
            ]
        for role, model in (("motion", self.motion), *(("sensor", s) for s in self.sensors)):
            name = getattr(model, "name", type(model).__name__)
            reason = getattr(model, "why_opaque", "it is not written over components")
            lines.append(f"{role} {name}: {'opaque, ' + reason if reason else 'traced'}")
        if self.smoother is not None:
            why = compiled.why_not_backwards(self)
            how = f"goes back on arrays: {why}" if why else "goes back in compiled steps"
            lines.append(f"smoother {type(self.smoother).__name__}: {how}")
            blind = unseen(self.filter, self.motion, self.smoother)
            lines += [blind] if blind else []
        if self.adapter is not None:
            tuned = " and ".join(self.adapter.tunes)
            lines.append(f"adapter {type(self.adapter).__name__}: re-tunes {tuned}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td>{role}</td><td>{value}</td></tr>"
            for role, value in (
                ("filter", type(self.filter).__name__),
                ("motion", getattr(self.motion, "name", type(self.motion).__name__)),
                ("sensor", ", ".join(getattr(s, "name", type(s).__name__) for s in self.sensors)),
                ("smoother", "none" if self.smoother is None else type(self.smoother).__name__),
                ("adapter", "none" if self.adapter is None else type(self.adapter).__name__),
            )
        )
        return f"<table><caption>Estimator</caption>{rows}</table>"


def _known_belief(estimator: Estimator, state: Any) -> None:
    """Refuse a state that the filter cannot have returned."""
    begins = hasattr(estimator.filter, "begin")
    if isinstance(state, Gaussian):
        if not is_random(estimator.filter):
            return
        raise CapabilityError(
            f"filter {type(estimator.filter).__name__} draws random numbers: got a Gaussian as state. "
            "Do this: begin with estimator.begin(prior, rng=np.random.default_rng(seed))."
        )
    adapted = isinstance(state, Adapted)
    belief = state.belief if adapted else state
    fits = adapted == (estimator.adapter is not None) and hasattr(belief, "moments")
    if fits and (begins or isinstance(belief, Gaussian)):
        return
    raise CapabilityError(
        wording(
            "argument 'state'",
            got=type(state).__name__,
            expected="a Gaussian, or what the last step of this estimator returned",
            do="pass tk.Gaussian(mean, cov) at first",
        )
    )


def _seconds(dt: Any, lanes: tuple[int, ...]) -> bool:
    values = as_array(dt, "dt")
    if values.shape not in {(), lanes}:
        raise ShapeError(
            wording(
                "argument 'dt'",
                got=f"shape {values.shape} for states of batch shape {lanes}",
                expected=f"() or {lanes}",
                do="give one number, or one per lane",
            )
        )
    return bool(((values >= 0.0) & (values < math.inf)).all())


def _given(name: str, value: Any, space: Any, lanes: tuple[int, ...]) -> Any:
    """A pose or an input of one step, as what the model takes."""
    if value is None:
        return None
    values = as_array(value, name)
    size = 0 if space is None else space.size
    if space is not None and values.shape not in {(size,), (size, *lanes)}:
        raise ShapeError(
            wording(
                f"argument {name!r}",
                got=f"shape {values.shape}",
                expected=f"({size}, *batch): {space}" if size else f"no {name}: the model has none",
                do=f"give one number for each component of the {name}" if size else "leave it out",
            )
        )
    if not np.isfinite(values).all():
        raise DomainError(
            wording(
                f"argument {name!r}",
                got="NaN or an infinite value",
                expected="finite numbers",
                do="give NaN in z where a measurement is missing, and nowhere else",
            )
        )
    return values


def _infinite(values: Any) -> bool:
    if values.ndim == 1:  # one run: a list of few numbers is searched faster than an array
        few = values.tolist()
        return math.inf in few or -math.inf in few
    return bool(np.isinf(values).any())


_PARTS = {
    "filter": ("predict", "update"),
    "motion": ("f", "Q"),
    "sensor": ("h", "R"),
    "smoother": ("smooth",),
    "adapter": ("begin", "tuned", "adapt"),
}


def _play_their_parts(estimator: Estimator) -> None:
    """Refuse what cannot play its part, before anything asks it for more."""
    if not estimator.sensors:
        raise CapabilityError("an estimator needs a sensor: got none. Do this: pass sensor=....")
    given = [("filter", estimator.filter), ("motion", estimator.motion)]
    optional = (("smoother", estimator.smoother), ("adapter", estimator.adapter))
    given += [(role, value) for role, value in optional if value is not None]
    for role, value in given + [("sensor", sensor) for sensor in estimator.sensors]:
        absent = [name for name in _PARTS[role] if not callable(getattr(value, name, None))]
        if absent or isinstance(value, type):
            lacks = f"which has no method {absent[0]!r}" if absent else "a class"
            raise CapabilityError(
                wording(
                    f"argument {role!r}",
                    got=f"{getattr(value, 'name', None) or repr(value)[:60]}, {lacks}",
                    expected=f"a {role}, or the name of one",
                    do=f"see `tracker list {role}`" if absent else "make one of it: call the class",
                )
            )


def estimator(
    filter: str | Filter[Any] = "ekf1",  # noqa: A002 - the field's word
    *,
    motion: str | MotionModel,
    sensor: str | SensorModel | Sequence[SensorModel],
    smoother: str | Smoother | None = None,
    adapter: str | NoiseAdapter[Any] | None = None,
) -> Estimator:
    """An estimator from components or their registered names.

    Sensors that can (`over`) are bound to the motion's state space, so an azimuth sensor serves
    any state that has x and y.

    Raises:
        UnknownComponent: for a name that is not registered, with the nearest ones.
        CapabilityError: when the parts do not fit together.
    """
    sources: list[Component] = []

    def made(kind: str, value: Any) -> Any:
        from tracker.registry import default_registry, describe_parameters

        if isinstance(value, str):
            component = default_registry().get(kind, value)
            sources.append(component)
            if any(p.required for p in describe_parameters(component)):
                raise CapabilityError(
                    f"{kind} {value!r} has parameters that only you can choose: pass "
                    f"{kind}=tracker.{kind}s.make({value!r}, ...), see `tracker show {value}`."
                )
            return component.make()
        # An object made from a registered component still knows its name, so it can be cited.
        names = dict.fromkeys((getattr(value, "name", None), *getattr(value, "parts", ())))
        known = {c.name: c for c in default_registry().search(kind=kind)}
        sources.extend(known[name] for name in names if name in known)
        return value

    model = made("motion", motion)
    given = [sensor] if isinstance(sensor, str) or not isinstance(sensor, Sequence) else sensor
    sensors = [made("sensor", s) for s in given]
    return Estimator(
        filter=made("filter", filter),
        motion=model,
        sensors=tuple(s.over(model.space) if hasattr(s, "over") else s for s in sensors),
        smoother=None if smoother is None else made("smoother", smoother),
        adapter=None if adapter is None else made("adapter", adapter),
        sources=tuple(sources),
    )


# ------------------------------------------------------------------------------------- running
def filter(  # noqa: A001 - the field's word
    estimator: Estimator,
    record: Record,
    prior: Gaussian,
    *,
    start: float | None = None,
    workers: int = 1,
    rng: np.random.Generator | Sequence[np.random.Generator] | None = None,
) -> History:
    """Filter a record: predict to each row's time, then update with it.

    ``workers`` threads share the lanes; they change no bit. ``rng`` is for filters that draw random
    numbers: a generator, or one per lane.

    Shapes:
        record and prior of any batch shape; a prior without batch axes serves all lanes.
        ``start`` is the time of the prior, by default that of the first row, which then is not
        preceded by a prediction.

    Raises:
        ShapeError, DomainError: when record and prior do not fit the models.
    Laws:
        bit-equal results for any batch of lanes; NaN components are not measured.
    """
    prior = fitting(estimator, record, prior, start)
    history = _filtered(estimator, record, prior, start, workers, rng)
    return attrs.evolve(history, run=Run(estimator, record, prior, start))


def _filtered(
    estimator: Estimator,
    record: Record,
    prior: Gaussian,
    start: float | None,
    workers: int,
    rng: Any,
) -> History:
    if record.z.size and not compiled.reason(estimator):
        return compiled.filtered(estimator, record, prior, start, workers)
    if record.z.size and not mixed.reason(estimator):
        return mixed.filtered(estimator, record, prior, start)
    random = is_random(estimator.filter)
    if record.batch and int(np.prod(record.batch)) == 1 and not random:
        pair = record_lanes(record, PAIR)
        wide = _filtered(estimator, pair, prior[..., PAIR], start, workers, rng)
        return _history_lanes(wide, slice(0, 1))
    history = _allocated(estimator, record, prior)
    generators = _each_lane(rng, prior)
    kept: list[tuple[Any, Any]] | None = [] if _keeps_beliefs(estimator) else None

    def work(tile: slice) -> None:
        part, some, whole = _tile(estimator, record, prior, history, tile)
        draws = generators[tile] if isinstance(generators, list) else generators
        with at_once():
            begun = some[1]
            if kept is None and record.z.size and not why_not_whole(part):
                begun = begin(part.filter, None, part.motion, part.sensors, begun, None, draws)
                if part.filter.whole(begun, part.motion, part.sensors, some[0], start, whole):  # type: ignore[attr-defined]
                    return
            for k, _, predicted, state, innovation in steps(part, some[0], begun, start, draws):
                _store(whole, k, predicted, state, innovation)
                if kept is not None:
                    kept.append((predicted, state))

    each(work, [slice(None)] if kept is not None else _tiles_of(estimator, record), workers)
    if kept is None:
        return history
    beliefs = Beliefs(tuple(p for p, _ in kept), tuple(s for _, s in kept))
    return attrs.evolve(history, beliefs=beliefs)


def why_not_whole(estimator: Estimator) -> str:
    """In words, why the filter itself does not work whole records (`WorksRecords`), or ''."""
    if not isinstance(estimator.filter, WorksRecords):
        return f"filter {type(estimator.filter).__name__} works step by step"
    if estimator.adapter is not None:
        return f"adapter {type(estimator.adapter).__name__} works step by step"
    return estimator.filter.why_not_whole(estimator.motion, estimator.sensors)


def _keeps_beliefs(estimator: Estimator) -> bool:
    return estimator.smoother is not None and "beliefs" in estimator.smoother.needs


def _each_lane(rng: Any, prior: Any) -> Any:
    """One generator per lane, or the one of a single run.

    They are spawned, which the given one remembers: used again, it gives others.
    """
    batch = prior.moments().batch
    if isinstance(rng, np.random.Generator):
        return rng.spawn(int(np.prod(batch))) if batch else rng
    if rng is None:
        return None
    each = list(rng) if isinstance(rng, Sequence) else []
    good = bool(each) and all(isinstance(g, np.random.Generator) for g in each)
    if not good or len(each) != int(np.prod(batch)):
        raise CapabilityError(
            wording(
                "argument 'rng'",
                got=f"{len(each)} generators" if good else repr(rng)[:60],
                expected=f"a numpy.random.Generator, or {int(np.prod(batch))} of them: one per lane",
                do="pass np.random.default_rng(seed)",
            )
        )
    return each


def smooth(
    estimator: Estimator,
    record: Record,
    prior: Gaussian,
    *,
    start: float | None = None,
    workers: int = 1,
    rng: np.random.Generator | Sequence[np.random.Generator] | None = None,
) -> History:
    """Filter a record forwards, then smooth it backwards with the estimator's smoother.

    Raises:
        CapabilityError: if the estimator has no smoother.
    """
    if estimator.smoother is None:
        raise CapabilityError(
            "smooth() needs an estimator with a smoother: got one without. "
            "Build it with smoother='rts'."
        )
    history = filter(estimator, record, prior, start=start, workers=workers, rng=rng)
    return smoothed(estimator, history, workers)


def smoothed(estimator: Estimator, history: History, workers: int = 1) -> History:
    """A filtered history with its smoothed trajectory, tile by tile."""
    smoother = estimator.smoother
    assert smoother is not None  # noqa: S101 - callers checked
    fused = history.filtered.mean.size and not compiled.why_not_backwards(estimator)
    if fused and compiled.told_enough(estimator, history):
        return compiled.smoothed(estimator, history, workers)
    batch, n = history.filtered.batch, history.filtered.mean.shape[1]
    if batch and int(np.prod(batch)) == 1:
        wide = smoothed(estimator, _history_lanes(history, PAIR))
        return attrs.evolve(_history_lanes(wide, slice(0, 1)), run=history.run)
    parts = tiles(batch, n)
    if len(parts) == 1:
        with at_once():
            return smoother.smooth(history, estimator.motion)
    mean, cov = np.empty_like(history.filtered.mean), np.empty_like(history.filtered.cov)

    def work(tile: slice) -> None:
        with at_once():
            part = _history_lanes(history, tile)
            whole = smoother.smooth(part, lanes_of_component(estimator.motion, tile))
        done = whole.smoothed
        assert done is not None  # noqa: S101 - a smoother fills it in
        mean[..., tile], cov[..., tile] = done.mean, done.cov
        kept[tile.start] = None if whole.beliefs is None else whole.beliefs.smoothed

    kept: dict[int, Any] = {}
    each(work, parts, workers)
    beliefs, found = history.beliefs, [kept[tile.start] for tile in parts]
    if beliefs is not None and found[0] is not None:
        beliefs = attrs.evolve(beliefs, smoothed=joined(found))
    return attrs.evolve(history, smoothed=Trajectory(mean, cov), beliefs=beliefs)


def steps(
    estimator: Estimator,
    record: Record,
    prior: Gaussian,
    start: float | None,
    rng: Any = None,
) -> Iterator[tuple[int, int, Any, Any, Innovation]]:
    """The recursion itself: step, sensor, predicted state, filtered state, innovation.

    Run it inside `tracker.algebra.at_once`: a diverged lane is no reason for a warning.
    """
    rule, motion, sensors = estimator.filter, estimator.motion, estimator.sensors
    adapter = estimator.adapter
    t, z, u, pose = record.t, record.z, record.u, record.pose
    sizes = [s.space.size for s in sensors]
    poses = [s.pose_space.size for s in sensors]
    which = [0] * len(record) if record.sensor is None else record.sensor.tolist()
    scalar = t.ndim == 1
    times = t.tolist() if scalar else t
    before: Any = (times[0] if start is None else start) if len(record) else 0.0
    first = None if pose is None or not len(record) else pose[0]
    carried = begin(rule, adapter, motion, sensors, prior, first, rng)
    for k in range(len(record)):
        i = which[k]
        where = None if pose is None or not poses[i] else pose[k, : poses[i]]
        given = None if u is None else u[k]
        carried, predicted, state, innovation = advance(
            rule,
            adapter,
            carried,
            motion,
            sensors[i],
            i,
            z[k, : sizes[i]],
            times[k] - before,
            given,
            before,
            where,
        )
        before = times[k]
        yield k, i, predicted, state, innovation


def together(n: int, width: int = 1) -> int:
    """So many lanes are few enough for their temporaries to stay in cache.

    ``width``: members that a filter keeps of each lane.
    """
    return max(2, (LANE_BYTES if width == 1 else MEMBER_BYTES) // (8 * n * n * width))


def tiles(batch: tuple[int, ...], n: int, width: int = 1) -> list[Any]:
    """Groups of lanes small enough for their temporaries to stay in cache; never one lane alone."""
    most = together(n, width)
    if len(batch) != 1 or batch[0] <= most:
        return [slice(None)]
    count = min(-(-batch[0] // most), batch[0] // 2)
    return [slice(batch[0] * i // count, batch[0] * (i + 1) // count) for i in range(count)]


# ------------------------------------------------------------------------------------- inside
def fitting(estimator: Estimator, record: Record, prior: Gaussian, start: float | None) -> Gaussian:
    """The prior over the record's lanes, after everything was checked that can be checked.

    Raises:
        ShapeError, DomainError: when record, prior and models do not fit together.
    """
    for label, value, kind in (("record", record, Record), ("prior", prior, Gaussian)):
        if not isinstance(value, kind):
            raise CapabilityError(
                wording(
                    f"argument {label!r}",
                    got=type(value).__name__,
                    expected=f"a {kind.__name__}",
                    do="pass tk.Record(t, z)" if kind is Record else "pass tk.Gaussian(mean, cov)",
                )
            )
    space, batch = estimator.motion.space, record.batch
    if prior.n != space.size:
        raise ShapeError(
            wording(
                "argument 'prior'",
                got=f"{prior.n} components",
                expected=f"{space.size}: {space}",
                do="build the prior for the motion model's space",
            )
        )
    if prior.batch not in ((), batch):
        raise ShapeError(
            wording(
                "argument 'prior'",
                got=f"batch shape {prior.batch}",
                expected=f"() or {batch}, as in the record",
                do="give one prior for all lanes or one per lane",
            )
        )
    if prior.batch != batch:
        lead = (1,) * len(batch)
        prior = Gaussian.trusted(
            np.broadcast_to(prior.mean.reshape(-1, *lead), (prior.n, *batch)).copy(),
            np.broadcast_to(
                prior.cov.reshape(prior.n, prior.n, *lead), (prior.n,) * 2 + batch
            ).copy(),
        )
    if start is not None and len(record) and not (record.t[0] >= start).all():
        raise DomainError(
            wording(
                "argument 'start'",
                got=f"{start} s, after the first measurement at {float(np.min(record.t[0]))} s",
                expected="a time that is not after the first row",
                do="cut the record or move the prior",
            )
        )
    widest = max(s.space.size for s in estimator.sensors)
    if record.sensor is None and len(estimator.sensors) > 1:
        raise DomainError(
            wording(
                "argument 'record.sensor'",
                got="nothing",
                expected=f"which of the {len(estimator.sensors)} sensors measured at each step",
                do="give the record a sensor index, or the estimator one stack of sensors",
            )
        )
    if record.sensor is not None and len(record):
        last = int(record.sensor.max())
        if last >= len(estimator.sensors) or int(record.sensor.min()) < 0:
            raise DomainError(
                wording(
                    "argument 'record.sensor'",
                    got=f"sensor {last}",
                    expected=f"0 to {len(estimator.sensors) - 1}",
                    do="give the estimator as many sensors as the record names",
                )
            )
    if record.z.shape[1] < widest or not np.isnan(record.z[:, widest:]).all():
        several = " (the widest of the sensors)" if len(estimator.sensors) > 1 else ""
        raise ShapeError(
            wording(
                "argument 'record.z'",
                got=f"{record.z.shape[1]} measurement components",
                expected=f"{widest}{several}: {max(estimator.sensors, key=_size).space}",
                do="pad rows of narrower sensors with NaN"
                if several
                else "give what the sensor measures, one column per component",
            )
        )
    most = max(s.pose_space.size for s in estimator.sensors)
    if record.pose is not None and record.pose.shape[1] > most:
        raise ShapeError(
            wording(
                "argument 'record.pose'",
                got=f"{record.pose.shape[1]} components",
                expected=f"{most}, the most that a sensor asks for" if most else "no pose",
                do="leave out what no sensor uses",
            )
        )
    inputs = getattr(estimator.motion, "input_space", None)
    if record.u is not None and inputs is not None and record.u.shape[1] != inputs.size:
        raise ShapeError(
            wording(
                "argument 'record.u'",
                got=f"{record.u.shape[1]} components",
                expected=f"{inputs.size}: {inputs}" if inputs.size else "no input",
                do="give one column per input component of the motion model",
            )
        )
    for sensor in estimator.sensors:
        size = sensor.pose_space.size
        if size and (record.pose is None or record.pose.shape[1] < size):
            got = "nothing" if record.pose is None else f"shape {record.pose.shape}"
            raise ShapeError(
                wording(
                    "argument 'record.pose'",
                    got=got,
                    expected=f"(T, {size}, *batch): {sensor.pose_space}",
                    do="give the sensor's pose for every row, or fix it with sensor.at(...)",
                )
            )
    _refuse_silent_broadcasts(estimator, record, prior)
    return prior


def _size(sensor: SensorModel) -> int:
    return sensor.space.size


def _refuse_silent_broadcasts(estimator: Estimator, record: Record, prior: Gaussian) -> None:
    """A matrix without batch axes beside lanes would broadcast over the wrong axes, unnoticed.

    So would one that is not symmetric go unnoticed: filters read either triangle.
    """
    axes = 2 + len(record.batch)
    if not len(record) or not prior.mean.size:
        return
    with np.errstate(all="ignore"):
        found: list[tuple[str, Any, str, Any]] = [
            ("motion", estimator.motion, "Q", estimator.motion.Q(prior.mean, 1.0))
        ]
        for sensor in estimator.sensors:
            size = sensor.pose_space.size
            pose = None if record.pose is None or not size else record.pose[0, :size]
            found.append(("sensor", sensor, "R", sensor.R(prior.mean, pose)))
    for role, component, name, value in found:
        if not np.allclose(value, value.swapaxes(0, 1), rtol=1e-9, atol=0.0, equal_nan=True):
            raise DomainError(
                wording(
                    f"{role} {getattr(component, 'name', type(component).__name__)!r}: {name}",
                    got="a matrix that is not symmetric",
                    expected="a covariance",
                    do="correct its noise: entry (i, j) is entry (j, i)",
                )
            )
        if value.ndim != axes:
            raise ShapeError(
                wording(
                    f"{role} {getattr(component, 'name', type(component).__name__)!r}: {name}",
                    got=f"shape {value.shape} for states of batch shape {record.batch}",
                    expected=f"{axes} axes; those of the batch may have length 1",
                    do=f"return {name}.reshape({', '.join(map(str, value.shape[:2]))}, 1, ...)",
                )
            )


def _allocated(estimator: Estimator, record: Record, prior: Gaussian) -> History:
    steps_, batch, n = len(record), record.batch, prior.n
    m = max(s.space.size for s in estimator.sensors)

    def trajectory() -> Trajectory:
        return Trajectory(np.empty((steps_, n, *batch)), np.empty((steps_, n, n, *batch)))

    innovation = Innovation(
        residual=np.full((steps_, m, *batch), np.nan),
        S=np.zeros((steps_, m, m, *batch)),
        nis=np.empty((steps_, *batch)),
        loglik=np.empty((steps_, *batch)),
        count=np.empty((steps_, *batch)),
        ok=np.empty((steps_, *batch), dtype=np.bool_),
    )
    return History(record.t, trajectory(), trajectory(), innovation, u=record.u)


def _tiles_of(estimator: Estimator, record: Record) -> list[Any]:
    width = getattr(estimator.filter, "width", 1)
    return tiles(record.batch, estimator.motion.space.size, width)


def _tile(
    estimator: Estimator, record: Record, prior: Gaussian, history: History, tile: slice
) -> tuple[Estimator, tuple[Record, Gaussian], History]:
    if tile == slice(None):
        return estimator, (record, prior), history
    cut = record_lanes(record, tile)
    state = Gaussian.trusted(prior.mean[..., tile].copy(), prior.cov[..., tile].copy())
    return estimator.lanes(tile), (cut, state), _history_lanes(history, tile)


def record_lanes(record: Record, index: Any) -> Record:
    """Some lanes of a record, picked on its last batch axis."""
    per_lane = {"t": record.t, "u": record.u, "pose": record.pose}
    base = {"t": 1, "u": 2, "pose": 2}
    cut = {k: v if v is None or v.ndim == base[k] else v[..., index] for k, v in per_lane.items()}
    made = object.__new__(Record)
    for name, value in (*cut.items(), ("z", record.z[..., index]), ("sensor", record.sensor)):
        object.__setattr__(made, name, value)
    return made


def in_a_row(record: Record, prior: Gaussian) -> tuple[Record, Gaussian, int]:
    """Record and prior with one batch axis, and its length."""
    n, runs = prior.n, int(np.prod(record.batch, dtype=np.intp))
    flat = Gaussian.trusted(prior.mean.reshape(n, runs), prior.cov.reshape(n, n, runs))
    made = object.__new__(Record)
    for name, lead in (("t", 1), ("z", 2), ("u", 2), ("pose", 2)):
        value = getattr(record, name)
        if value is not None and (value.ndim > lead or name == "z"):
            value = value.reshape(*value.shape[:lead], runs)
        object.__setattr__(made, name, value)
    object.__setattr__(made, "sensor", record.sensor)
    return made, flat, runs


def _history_lanes(history: History, index: Any) -> History:
    """Some lanes; a slice gives views: what is written into them is written into the whole."""

    def of(trajectory: Trajectory) -> Trajectory:
        return Trajectory(trajectory.mean[..., index], trajectory.cov[..., index])

    values = attrs.asdict(history.innovation, recurse=False)
    return History(
        history.t if history.t.ndim == 1 else history.t[..., index],
        of(history.predicted),
        of(history.filtered),
        Innovation(**{k: v[..., index] for k, v in values.items()}),
        None if history.smoothed is None else of(history.smoothed),
        history.u if history.u is None or history.u.ndim == 2 else history.u[..., index],
        lanes_of(history.beliefs, index),
    )


def _store(history: History, k: int, predicted: Any, state: Any, innovation: Innovation) -> None:
    before, after, out = predicted.moments(), state.moments(), history.innovation
    history.predicted.mean[k], history.predicted.cov[k] = before.mean, before.cov
    history.filtered.mean[k], history.filtered.cov[k] = after.mean, after.cov
    m = len(innovation.residual)
    out.residual[k, :m], out.S[k, :m, :m] = innovation.residual, innovation.S
    out.nis[k], out.loglik[k] = innovation.nis, innovation.loglik
    out.count[k], out.ok[k] = innovation.count, innovation.ok


__all__ = [
    "Estimator",
    "check_capabilities",
    "estimator",
    "filter",
    "fitting",
    "in_a_row",
    "lacking",
    "missing_capabilities",
    "record_lanes",
    "smooth",
    "smoothed",
    "steps",
    "tiles",
    "together",
    "why_not_whole",
]
