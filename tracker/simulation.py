"""Scenarios and what is simulated from them: truth, measurements, and the prior of each run.

Randomness is keyed, never sequential: component ``c`` of run ``r`` under condition ``k`` draws from
its own generator, so run 8123 can be remade alone and any grouping of runs gives the same bits.
Estimating and scoring do not belong here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from tracker.algebra import at_once
from tracker.errors import DomainError, ShapeError, wording
from tracker.models.parameters import one_of
from tracker.protocols import Filter, MotionModel, NoiseAdapter, SensorModel, Smoother
from tracker.types import Array, ArrayLike, Gaussian, Record, as_array, brief, square_root

if TYPE_CHECKING:
    from tracker.estimation import Estimator

STREAMS = {
    "initial": 0,
    "process": 1,
    "measurement": 2,
    "detection": 3,
    "prior": 4,
    "filter": 5,
}
"""Components of randomness and their places in the key; never renumbered."""

INITIAL = ("truth from prior", "prior around truth", "fixed")


def stream(seed: int, run: int, component: str, condition: int = 0) -> np.random.Generator:
    """The generator of one component of randomness in one run.

    Example:
    >>> a = stream(7, run=8123, component="process").standard_normal()
    >>> a == stream(7, run=8123, component="process").standard_normal()
    True
    """
    key = (condition, run, STREAMS[component])
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=key)))


def normals(
    seed: int, runs: Sequence[int], component: str, shape: tuple[int, ...], condition: int = 0
) -> Array:
    """Standard normals, ``(*shape, runs)``, each run from its own generator."""
    return _drawn(np.random.Generator.standard_normal, seed, runs, component, shape, condition)


def _drawn(
    draw: Callable[..., Array],
    seed: int,
    runs: Sequence[int],
    component: str,
    shape: tuple[int, ...],
    condition: int,
) -> Array:
    out = np.empty((int(np.prod(shape)), len(runs)))
    rows = np.empty((min(_ROWS, len(runs)), len(out)))
    for first in range(0, len(runs), _ROWS):  # turned about while still in the cache
        some = runs[first : first + _ROWS]
        for row, run in zip(rows, some, strict=False):
            draw(stream(seed, run, component, condition), out=row)
        out[:, first : first + len(some)] = rows[: len(some)].T
    return out.reshape(*shape, len(runs))


_ROWS = 32
_TOGETHER = 4096


def _few(runs: tuple[int, ...]) -> str:
    return f"<{len(runs)} runs>" if len(runs) > 8 else repr(runs)


@attrs.frozen(eq=False)
class Simulation:
    """Runs of a scenario.

    Shapes:
        truth ``(T, n, runs)`` at the times of the record; record with batch ``(runs,)``; prior with
        batch ``(runs,)``, at time ``start``.
    """

    truth: Array = attrs.field(repr=brief)
    record: Record
    prior: Gaussian
    start: float
    runs: tuple[int, ...] = attrs.field(repr=_few)


def _times_of(value: ArrayLike) -> Array:
    return as_array(value, "t")


@attrs.frozen(eq=False, kw_only=True)
class Scenario:
    """A problem with a known answer: how truth arises, who measures it, what an estimator is told.

    ``initial`` says how truth and prior are drawn: "truth from prior" (the estimator's belief is
    calibrated: the honest test of consistency), "prior around truth" (the true start is ``start``, or
    drawn around it with covariance ``start_cov``; the prior mean is drawn around that), or "fixed"
    (neither is drawn). The truth then follows ``path``, or is simulated from ``truth_motion``, and is
    measured by ``truth_sensor`` (by default the estimator's own models): what an estimator believes
    of the noise need not be so.

    ``detection_probability`` is that of each measured component by itself, as in a stack of
    sensors: a component that is missed is NaN.

    Shapes:
        t ``(T,)`` measurement times; pose ``(T, p)``, a `tracker.protocols.ObserverPath`, or None;
        path ``(T, n)`` or None; start ``(n,)`` or None; start_cov ``(n, n)`` or None.

    Raises:
        ShapeError, DomainError: when these do not fit together.
    """

    name: str
    motion: MotionModel
    sensor: SensorModel
    prior: Gaussian
    t: Array = attrs.field(converter=_times_of, repr=brief)
    prior_time: float = 0.0
    pose: Any = attrs.field(default=None, repr=brief)
    path: Array | None = attrs.field(default=None, repr=brief)
    truth_motion: MotionModel | None = None
    truth_sensor: SensorModel | None = None
    start: Array | None = None
    start_cov: Array | None = attrs.field(default=None, repr=brief)
    initial: str = attrs.field(default=INITIAL[0])
    detection_probability: float = 1.0
    summary: str = ""

    def __attrs_post_init__(self) -> None:
        one_of("initial", self.initial, INITIAL)
        for role in ("sensor", "truth_sensor"):
            bind = getattr(getattr(self, role), "over", None)
            if bind is not None:  # as an estimator does: components of the state are found by name
                object.__setattr__(self, role, bind(self.motion.space))
        if hasattr(self.pose, "pose"):
            object.__setattr__(self, "pose", np.ascontiguousarray(self.pose.pose(self.t).T))
        n, steps = self.motion.space.size, len(self.t)
        if self.prior.mean.shape != (n,):
            raise ShapeError(
                wording(
                    "argument 'prior'",
                    got=f"mean of shape {self.prior.mean.shape}",
                    expected=f"({n},): {self.motion.space}",
                    do="give one prior for the motion model's space",
                )
            )
        for label, value, shape in (
            ("path", self.path, (steps, n)),
            ("start", self.start, (n,)),
            ("start_cov", self.start_cov, (n, n)),
            ("pose", self.pose, (steps, self.sensor.pose_space.size)),
        ):
            if value is not None and np.shape(value) != shape:
                raise ShapeError(
                    wording(
                        f"argument {label!r}",
                        got=f"shape {np.shape(value)}",
                        expected=f"{shape}",
                        do="give one row per measurement time, and a start like the prior",
                    )
                )
        first = float(self.t[0]) if steps else self.prior_time
        if self.prior_time > first:
            raise DomainError(
                wording(
                    "argument 'prior_time'",
                    got=f"{self.prior_time} s, after the first measurement at {first} s",
                    expected="a time that is not after t[0]",
                    do="pass prior_time=t[0], or an earlier one",
                )
            )
        if self.truth_sensor is not None and not _alike(self.truth_sensor, self.sensor):
            raise ShapeError(
                wording(
                    "argument 'truth_sensor'",
                    got=f"measurements ({self.truth_sensor.space}), pose ({self.truth_sensor.pose_space})",
                    expected=f"({self.sensor.space}), pose ({self.sensor.pose_space}), as of 'sensor'",
                    do="give a sensor that measures the same with other noise or parameters",
                )
            )
        if self.initial == INITIAL[1] and self.start is None and self.prior_time != first:
            raise DomainError(
                wording(
                    "argument 'start'",
                    got="a path, which begins at t[0], and a prior at another time",
                    expected="the true state at prior_time",
                    do="pass start, or prior_time=t[0]",
                )
            )
        if self.initial != INITIAL[0] and self.start is None and self.path is None:
            raise DomainError(
                wording(
                    "argument 'start'",
                    got="nothing",
                    expected=f"the true initial state, as initial is {self.initial!r}",
                    do="give start, or use initial='truth from prior'",
                )
            )
        if not 0.0 <= self.detection_probability <= 1.0:
            raise DomainError(
                wording(
                    "argument 'detection_probability'",
                    got=self.detection_probability,
                    expected="a probability",
                    do="pass a number from 0 to 1",
                )
            )

    @property
    def true_motion(self) -> MotionModel:
        """The motion that the truth follows."""
        return self.motion if self.truth_motion is None else self.truth_motion

    @property
    def true_sensor(self) -> SensorModel:
        """The sensor that measured."""
        return self.sensor if self.truth_sensor is None else self.truth_sensor

    def estimator(
        self,
        filter: str | Filter[Any] = "ekf1",  # noqa: A002 - the field's word
        *,
        smoother: str | Smoother | None = None,
        adapter: str | NoiseAdapter[Any] | None = None,
    ) -> Estimator:
        """`tracker.estimator` on the models that the scenario tells, which need not be the true ones.

        Example:
        >>> import tracker as tk
        >>> scene = tk.scenario("line", axes=1)
        >>> print(scene.estimator("kf", adapter="sage_husa").motion is scene.motion)
        True
        """
        from tracker.estimation import estimator

        return estimator(
            filter, motion=self.motion, sensor=self.sensor, smoother=smoother, adapter=adapter
        )

    def simulate(
        self, seed: int, runs: int | Sequence[int] = 1, *, condition: int = 0
    ) -> Simulation:
        """Truth, measurements and priors of some runs, all at once.

        ``runs`` is a count or the numbers of the runs wanted. The same seed, run and condition give
        the same bits in any company.
        """
        numbers = tuple(range(runs)) if isinstance(runs, (int, np.integer)) else tuple(runs)
        n, steps = self.motion.space.size, len(self.t)
        truth = np.empty((steps, n, len(numbers)))
        z = np.empty((steps, self.sensor.space.size, len(numbers)))
        # Products over lanes take other code paths for one lane: never simulate one alone.
        wide = numbers if len(numbers) != 1 else numbers * 2
        with at_once():
            begin, prior = self._begin(seed, wide, condition)
            self._truth(truth, begin, seed, wide, condition)
            self._measure(z, truth, seed, wide, condition)
        return Simulation(
            truth,
            Record(self.t, z, pose=self.pose),
            prior[..., : len(numbers)],
            self.prior_time,
            numbers,
        )

    def _begin(self, seed: int, runs: Sequence[int], condition: int) -> tuple[Array, Gaussian]:
        n, count = self.prior.n, len(runs)
        root = square_root(self.prior.cov)
        mean = np.repeat(self.prior.mean[:, None], count, axis=1)
        cov = np.repeat(self.prior.cov[..., None], count, axis=2)
        known = (
            self.start
            if self.start is not None
            else self.path[0]
            if self.path is not None
            else None
        )
        if self.initial == INITIAL[0]:
            begin = mean + _times(root, normals(seed, runs, "initial", (n,), condition))
        else:
            begin = np.repeat(np.asarray(known, dtype=np.float64)[:, None], count, axis=1)
            if self.start_cov is not None:
                drawn = normals(seed, runs, "initial", (n,), condition)
                begin = begin + _times(square_root(as_array(self.start_cov, "start_cov")), drawn)
        if self.initial == INITIAL[1]:
            mean = begin + _times(root, normals(seed, runs, "prior", (n,), condition))
        return begin, Gaussian.trusted(mean, cov)

    def _truth(
        self, truth: Array, begin: Array, seed: int, runs: Sequence[int], condition: int
    ) -> None:
        if self.path is not None:
            truth[:] = np.asarray(self.path)[..., None]
            return
        motion = self.true_motion
        noise = normals(seed, runs, "process", truth.shape[:2], condition)
        x, before, known, root = begin, self.prior_time, b"", begin
        for k, now in enumerate(self.t.tolist()):
            dt = now - before
            Q = motion.Q(x, dt)
            if Q.tobytes() != known:  # most often it is the one of the step before
                known, root = Q.tobytes(), square_root(Q)
            x = motion.f(x, dt, None, before) + _times(root, noise[k])
            truth[k] = x[..., : truth.shape[-1]]
            before = now

    def _measure(
        self, z: Array, truth: Array, seed: int, runs: Sequence[int], condition: int
    ) -> None:
        steps, m, count = z.shape
        noise = normals(seed, runs, "measurement", (steps, m), condition)
        sensor, zero = self.true_sensor, np.zeros((m, 1))
        size = max(1, _TOGETHER // count)  # steps at a time, as lanes: few runs, few calls
        for k in range(0, steps, size):
            now = slice(k, min(k + size, steps))
            x = np.repeat(truth[now], len(runs) // count, axis=-1)
            lanes = x.shape[0] * x.shape[2]
            x, drawn = (np.moveaxis(a, 0, 1).reshape(-1, lanes) for a in (x, noise[now]))
            pose = None
            if self.pose is not None:
                pose = np.repeat(np.asarray(self.pose)[now].T, len(runs), axis=1)
            value = sensor.h(x, pose) + _times(square_root(sensor.R(x, pose)), drawn)
            wrapped = sensor.residual(value, zero).reshape(m, -1, len(runs))
            z[now] = np.moveaxis(wrapped, 0, 1)[..., :count]
        if self.detection_probability < 1.0:
            draw = np.random.Generator.random
            chance = _drawn(draw, seed, runs[:count], "detection", (steps, m), condition)
            z[chance >= self.detection_probability] = np.nan


def _alike(one: SensorModel, other: SensorModel) -> bool:
    """Whether two sensors measure the same kind of thing and are placed by the same pose."""
    same = [(a.unit, a.circular) for a in one.space] == [(a.unit, a.circular) for a in other.space]
    return same and one.pose_space.size == other.pose_space.size


def _times(root: Array, vector: Array) -> Array:
    """Root times vector, lane by lane; a root without lanes, or with one, serves them all."""
    matrix = root[..., None] if root.ndim == 2 else root
    total: Any = matrix[:, 0] * vector[0]
    for j in range(1, len(vector)):
        total = total + matrix[:, j] * vector[j]
    return np.asarray(total)


def scenario(name: str, **parameters: Any) -> Scenario:
    """The registered scenario called ``name``.

    Raises:
        UnknownComponent: with the nearest names, if there is none.
    """
    from tracker.registry import scenarios

    return scenarios.make(name, **parameters)  # type: ignore[return-value]
