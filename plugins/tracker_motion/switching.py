"""A motion that switches between several modes by a Markov chain; a single mode is another module."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Any

import attrs
import numpy as np

from tracker.errors import CapabilityError, DomainError, ShapeError, wording
from tracker.models import less, where
from tracker.models.parameters import checked_parameters, lanes_of, shaped, shown
from tracker.protocols import MotionModel
from tracker.types import EMPTY_SPACE, ArrayLike, Axis, Space, as_array

HALVINGS = 20
"""The exponential of a generator is squared this often: good for steps of 10,000 mean sojourns."""


def switching(
    modes: Sequence[MotionModel],
    transition: Annotated[ArrayLike | None, "1"] = None,
    *,
    rates: Annotated[ArrayLike | None, "1/s"] = None,
    initial: Annotated[ArrayLike | None, "1"] = None,
) -> SwitchingMotion:
    """A target that moves in one of several modes at a time and switches between them at random.

    ``transition[i][j]`` is the probability that mode i is followed by mode j *at each prediction*,
    however long that is (a prediction over no time switches nothing). If steps differ in length,
    give ``rates`` instead: ``rates[i][j]`` switches from i to j a second (the diagonal is not read);
    the matrix of a step is then ``expm(G dt)``, so that two half steps equal one step.
    ``initial`` holds the probabilities of the modes at the time of the prior, by default equal.

    Only filters that know of modes (`imm`) keep them apart. To every other filter, ekf1 and ukf say, this
    is one motion: the average of the modes with their *initial* probabilities, whatever the
    measurements say, and with a covariance wide enough for all of them.

    Modes may have different states. Components with the same name are the same; the state of the
    whole is the union, in the order in which names first appear. What a component that a mode lacks
    means there is for the filter to say (`tracker_kalman.InteractingMultipleModels`).

    Shapes:
        transition, rates ``(modes, modes)``; initial ``(modes,)``.
    Units:
        rates 1/s.

    Raises:
        ShapeError: if there is no mode, or a matrix or vector does not fit.
        DomainError: if rows of the matrix, or the initial probabilities, do not sum to one, or an
        entry is negative; if a name means two different components.
        CapabilityError: if not exactly one of transition and rates is given.
    Reference:
        Blom and Bar-Shalom (1988), IEEE Trans. Automatic Control 33 (8), pp. 780-783; for rates, Norris,
        Markov Chains (1997), section 2.1.
    Laws:
        those of kind "motion", as far as its record says.

    Example:
    >>> from tracker_motion import constant_acceleration, constant_velocity
    >>> motion = switching(
    ...     [constant_velocity(0.01), constant_acceleration(1.0)], [[0.98, 0.02], [0.02, 0.98]])
    >>> motion.space.names, [len(mode.space) for mode in motion.modes]
    (('x', 'y', 'vx', 'vy', 'ax', 'ay'), [4, 6])
    >>> [[round(p, 2) for p in row] for row in motion.transition(0.1)]
    [[0.98, 0.02], [0.02, 0.98]]
    """
    count = len(modes)
    if not count:
        raise ShapeError(
            wording("argument 'modes'", got="none", expected="at least one motion", do="give some")
        )
    if (transition is None) == (rates is None) and count > 1:
        raise CapabilityError(
            wording(
                "arguments 'transition' and 'rates'",
                got="neither" if rates is None else "both",
                expected="one of them",
                do="give the matrix of a step, or rates where steps differ in length",
            )
        )
    kind, given = ("rate", rates) if rates is not None else ("switch", transition)
    matrix = as_array(np.eye(count) if given is None else given, kind)
    _chain(matrix, count, rows_sum_to_one=kind == "switch")
    first = np.full(count, 1.0 / count) if initial is None else as_array(initial, "initial")
    if first.shape != (count,) or (first < 0).any() or abs(first.sum() - 1.0) > 1e-9:
        raise DomainError(
            wording(
                "argument 'initial'",
                got=f"{first}",
                expected=f"{count} probabilities that sum to one",
                do="give one for each mode",
            )
        )
    values = {
        f"{name}_{k + 1}": value
        for k, mode in enumerate(modes)
        for name, value in getattr(mode, "parameters", {}).items()
    }
    values |= {f"initial_{k + 1}": float(p) for k, p in enumerate(first)}
    values |= {
        f"{kind}_{i + 1}_{j + 1}": float(matrix[i, j])
        for i in range(count)
        for j in range(count)
        if i != j
    }
    return SwitchingMotion(prototypes=tuple(modes), kind=kind, parameters=values)


def _chain(matrix: Any, count: int, *, rows_sum_to_one: bool) -> None:
    if matrix.shape != (count, count):
        raise ShapeError(
            wording(
                "the matrix of a switching motion",
                got=f"shape {matrix.shape}",
                expected=f"({count}, {count}): a row and a column for each mode",
                do="row i says where mode i goes",
            )
        )
    beside = matrix[~np.eye(count, dtype=np.bool_)]
    sums = matrix.sum(axis=1)
    bad = (beside < 0).any() or not np.isfinite(matrix).all()
    if bad or (rows_sum_to_one and ((matrix < 0).any() or np.abs(sums - 1.0).max() > 1e-9)):
        raise DomainError(
            wording(
                "the matrix of a switching motion",
                got=f"{matrix.tolist()}",
                expected="rows of probabilities that sum to one"
                if rows_sum_to_one
                else "rates that are not negative beside the diagonal",
                do="row i says where mode i goes",
            )
        )


def _of_mode(parameters: Mapping[str, Any], names: Sequence[str], k: int) -> dict[str, Any]:
    return {name: parameters[f"{name}_{k + 1}"] for name in names}


def _union(spaces: Sequence[Space]) -> Space:
    axes: dict[str, Axis] = {}
    for space in spaces:
        for axis in space:
            if axes.setdefault(axis.name, axis) != axis:
                raise DomainError(
                    wording(
                        f"component {axis.name!r} of a switching motion",
                        got=f"{axis} in one mode and {axes[axis.name]} in another",
                        expected="the same unit, circular or not, under the same name",
                        do="rename one of them",
                    )
                )
    return Space(tuple(axes.values()))


@attrs.frozen(eq=False, kw_only=True)
class SwitchingMotion:
    """Several motions of which one holds at a time; `switching` makes it.

    Filters that know of modes read ``modes``, ``places``, ``initial`` and `transition`. To all others
    it is one motion: the average of its modes with the initial probabilities, the moments of a
    single step of unknown mode; components that a mode lacks stay there as they are.

    ``parameters`` are those of the modes, with suffixes ``_1``, ``_2``, ... of their mode, then
    ``initial_i``, and ``switch_i_j`` (or ``rate_i_j``) for i other than j. Each may differ per lane.

    Shapes:
        x ``(n, *batch)`` of the union; dt scalar or ``(*batch)``; parameters scalars or ``(*batch)``.
    """

    prototypes: tuple[Any, ...] = attrs.field(repr=lambda modes: str([m.name for m in modes]))
    kind: str
    parameters: MappingProxyType[str, Any] = attrs.field(converter=checked_parameters, repr=shown)
    name: str = "switching"
    modes: tuple[Any, ...] = attrs.field(init=False, repr=False)
    space: Space = attrs.field(init=False, repr=False)
    input_space: Space = attrs.field(init=False, repr=False)

    @modes.default
    def _modes_with_their_parameters(self) -> tuple[Any, ...]:
        out = []
        for k, mode in enumerate(self.prototypes):
            names = tuple(getattr(mode, "parameters", ()))
            values = _of_mode(self.parameters, names, k)
            # unlike an equal number, another object would be another key wherever it is remembered
            same = all(values[name] is mode.parameters[name] for name in names)
            out.append(mode if same else mode.with_parameters(**values))
        return tuple(out)

    @space.default
    def _union_of_the_modes(self) -> Space:
        return _union([mode.space for mode in self.prototypes])

    @input_space.default
    def _input_of_the_modes(self) -> Space:
        given = [getattr(mode, "input_space", EMPTY_SPACE) for mode in self.prototypes]
        return _union(given)

    # ------------------------------------------------------------------- what filters ask
    @property
    def places(self) -> tuple[tuple[int, ...], ...]:
        """Where the components of each mode lie in the state of the whole."""
        return tuple(self.space.indices(*mode.space.names) for mode in self.prototypes)

    @property
    def initial(self) -> tuple[Any, ...]:
        """Probabilities of the modes at the time of the prior."""
        return tuple(self.parameters[f"initial_{k + 1}"] for k in range(len(self.prototypes)))

    def transition(self, dt: Any) -> list[list[Any]]:
        """Rows of the matrix of a step of ``dt`` seconds: entry [i][j] leads from mode i to mode j.

        Entries are floats, lanes ``(*batch)`` or graph nodes, as dt and the parameters are.
        """
        count = len(self.prototypes)
        beside = [
            [
                0.0 if i == j else self.parameters[f"{self.kind}_{i + 1}_{j + 1}"]
                for j in range(count)
            ]
            for i in range(count)
        ]
        if self.kind == "rate":
            return _exponential(beside, dt)
        after: list[list[Any]] = []
        for i, row in enumerate(beside):
            stay: Any = 1.0
            for p in row:
                stay = stay - p
            moved = less(0.0, dt)
            after.append(
                [
                    where(moved, stay if i == j else row[j], 1.0 if i == j else 0.0)
                    for j in range(count)
                ]
            )
        return after

    def inputs(self, k: int, u: Any) -> Any:
        """Of the input of the whole, the part of mode k; None if it has none."""
        names = getattr(self.prototypes[k], "input_space", EMPTY_SPACE).names
        if u is None or not names:
            return None
        given = u if isinstance(u, np.ndarray) else np.asarray(u)
        return given[list(self.input_space.indices(*names))]

    # ------------------------------------------------------------- as a motion like others
    def f(self, x: ArrayLike, dt: Any, u: ArrayLike | None = None, t: Any = None) -> Any:
        """The mean over the modes of the state after ``dt`` seconds, ``(n, *batch)``."""
        state = shaped(x, self.space, "x", self.name)
        out: Any = 0.0
        for p, ahead in zip(self.initial, self._ahead(state, dt, u, t), strict=True):
            out = out + p * ahead
        return out

    def jacobian(self, x: ArrayLike, dt: Any, u: ArrayLike | None = None, t: Any = None) -> Any:
        """Derivatives of `f` by the state, ``(n, n, *batch)``."""
        state = shaped(x, self.space, "x", self.name)
        n, batch = len(self.space), state.shape[1:]
        total = np.zeros((n, n, *batch), dtype=state.dtype)
        for k, (mode, places) in enumerate(zip(self.modes, self.places, strict=True)):
            whole = np.zeros((n, n, *batch), dtype=state.dtype)
            for i in set(range(n)).difference(places):
                whole[i, i] = 1.0
            part = mode.jacobian(state[list(places)], dt, self.inputs(k, u), t)
            whole[np.ix_(places, places)] = part
            total = total + self.initial[k] * whole
        return total

    def hessian(self, x: ArrayLike, dt: Any, u: ArrayLike | None = None, t: Any = None) -> Any:
        """Second derivatives of `f` by the state, ``(n, n, n, *batch)``."""
        state = shaped(x, self.space, "x", self.name)
        n, batch = len(self.space), state.shape[1:]
        total = np.zeros((n, n, n, *batch), dtype=state.dtype)
        for k, (mode, places) in enumerate(zip(self.modes, self.places, strict=True)):
            whole = np.zeros((n, n, n, *batch), dtype=state.dtype)
            part = mode.hessian(state[list(places)], dt, self.inputs(k, u), t)
            whole[np.ix_(places, places, places)] = part
            total = total + self.initial[k] * whole
        return total

    def Q(self, x: ArrayLike, dt: Any) -> Any:
        """The covariance over the modes of the state after ``dt`` seconds, ``(n, n, *batch)``."""
        state = shaped(x, self.space, "x", self.name)
        n, batch = len(self.space), state.shape[1:]
        ahead = self._ahead(state, dt, None, None)
        mean: Any = 0.0
        for p, one in zip(self.initial, ahead, strict=True):
            mean = mean + p * one
        total = np.zeros((n, n, *batch), dtype=state.dtype)
        for k, (mode, places) in enumerate(zip(self.modes, self.places, strict=True)):
            whole = np.zeros((n, n, *batch), dtype=state.dtype)
            whole[np.ix_(places, places)] = mode.Q(state[list(places)], dt)
            apart = ahead[k] - mean
            total = total + self.initial[k] * (whole + apart[:, None] * apart)
        return total

    def _ahead(self, state: Any, dt: Any, u: Any, t: Any) -> list[Any]:
        out = []
        for k, (mode, places) in enumerate(zip(self.modes, self.places, strict=True)):
            ahead = np.array(state)
            ahead[list(places)] = mode.f(state[list(places)], dt, self.inputs(k, u), t)
            out.append(ahead)
        return out

    # -------------------------------------------------------------- another one like it
    def with_parameters(self, **parameters: Any) -> SwitchingMotion:
        """The same motion with other parameter values, scalars or ``(*batch)``."""
        for name in parameters:
            if name not in self.parameters:
                raise CapabilityError(
                    f"motion {self.name!r} has no parameter {name!r}; it has "
                    f"{', '.join(self.parameters)}."
                )
        return attrs.evolve(self, parameters={**self.parameters, **parameters})

    def lanes(self, index: Any) -> SwitchingMotion:
        """The same motion with per-lane parameters cut to some lanes."""
        cut = lanes_of(self.parameters, index)
        # what a mode does not offer as a parameter it cuts itself
        modes = tuple(
            m.lanes(index) if hasattr(m, "lanes") and not hasattr(m, "parameters") else m
            for m in self.prototypes
        )
        same = all(a is b for a, b in zip(modes, self.prototypes, strict=True))
        if cut is self.parameters and same:
            return self
        return attrs.evolve(self, parameters=cut, prototypes=modes)

    @property
    def structure(self) -> tuple[Any, ...]:
        """What a compiled step bakes in: everything but the parameters' values."""
        return (self.kind, *(_baked(mode) for mode in self.prototypes))

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the registered motions that it is made of, for `Estimator.cite`."""
        return tuple(dict.fromkeys(getattr(mode, "name", "") for mode in self.prototypes))

    @property
    def linear(self) -> bool:
        """Whether every mode is linear."""
        return all(getattr(mode, "linear", False) for mode in self.prototypes)

    @property
    def why_opaque(self) -> str:
        """Why some mode cannot be traced, or ''."""
        reasons = (
            getattr(mode, "why_opaque", "a mode is not written over components")
            for mode in self.prototypes
        )
        return next(filter(None, reasons), "")


def _baked(mode: Any) -> Any:
    if not attrs.has(type(mode)) or not hasattr(mode, "parameters"):
        return mode
    fields = (f.name for f in attrs.fields(type(mode)) if f.init and f.name != "parameters")
    return (type(mode), *(getattr(mode, name) for name in fields), *mode.parameters)


def _exponential(rates: list[list[Any]], dt: Any) -> list[list[Any]]:
    """``expm(G dt)`` by scaling and squaring, for floats, lanes and graph nodes.

    What is squared is the difference from the identity, ``E <- 2 E + E E``, which loses no digits
    however small the first step was; the diagonal follows from rows that sum to one.
    """
    count = len(rates)
    scale = math.ldexp(1.0, -HALVINGS)
    step = [[row[j] * dt * scale for j in range(count)] for row in rates]
    _close(step)
    E: list[list[Any]] = [[0.0] * count for _ in range(count)]
    for power in (4.0, 3.0, 2.0, 1.0):  # Horner's rule for the series up to the fourth power
        E = [
            [(step[i][j] + _entry(step, E, i, j)) / power for j in range(count)]
            for i in range(count)
        ]
    for _ in range(HALVINGS):
        E = [[2.0 * E[i][j] + _entry(E, E, i, j) for j in range(count)] for i in range(count)]
        _close(E)
    return [[E[i][j] + (1.0 if i == j else 0.0) for j in range(count)] for i in range(count)]


def _entry(A: list[list[Any]], B: list[list[Any]], i: int, j: int) -> Any:
    total: Any = 0.0
    for k in range(len(A)):
        total = total + A[i][k] * B[k][j]
    return total


def _close(E: list[list[Any]]) -> None:
    """Make rows sum to zero."""
    for i, row in enumerate(E):
        total: Any = 0.0
        for j, e in enumerate(row):
            if i != j:
                total = total + e
        row[i] = -total
