"""The frozen values that travel between components; what acts on them lives elsewhere.

Shapes are written with ``n`` state components, ``m`` measurement components, ``p`` pose components
and ``*batch`` for any number of trailing axes, possibly none. Components come first, batch axes
last: ``mean[0]`` is the first coordinate of one target and of ten thousand. Histories have time as
their leading axis. Units are SI; angles are radians.

Values are checked once, when a user builds them. Code that has just computed a value from checked
ones uses ``Gaussian.trusted`` and pays nothing.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

import attrs
import numpy as np
import numpy.typing as npt

from tracker.errors import DomainError, ShapeError, wording

Array = npt.NDArray[np.float64]
ArrayLike = npt.ArrayLike

_AXIS = re.compile(
    r"^\s*(?P<name>[A-Za-z_]\w*)\s*(\[(?P<unit>[^\]]*)\])?\s*(?P<circular>circular)?\s*$"
)


def _kept(value: ArrayLike, name: str) -> Array:
    """A read-only copy: what was checked once stays as it was."""
    array = as_array(value, name).copy()
    array.setflags(write=False)
    return array


_NOT_NUMBERS = {
    "M": "dates: pass seconds, (t - t[0]) / np.timedelta64(1, 's')",
    "m": "durations: pass seconds, t / np.timedelta64(1, 's')",
    "c": "complex numbers: pass real and imaginary parts as components",
    "U": "texts: convert them with float()",
    "S": "bytes: convert them with float()",
}


def brief(value: Any) -> str:
    """An array as a person wants to see it inside another value: small ones whole, else the shape."""
    if isinstance(value, np.ndarray) and value.size > 16:
        return f"<{'x'.join(map(str, value.shape))} numbers>"
    return repr(value)


def as_array(value: ArrayLike, name: str) -> Array:
    """``value`` as float64, refusing what is not a real number.

    Raises:
        DomainError: if ``value`` holds something that is not a real number.
    """
    if isinstance(value, np.ma.MaskedArray):  # what is masked was not measured
        value = np.ma.filled(value.astype(np.float64), np.nan)
    try:
        raw = np.asarray(value)
        reason = _NOT_NUMBERS.get(raw.dtype.kind, "")
        if not reason:
            return raw.astype(np.float64, copy=False)
    except (TypeError, ValueError) as error:
        reason = str(error)
    raise DomainError(
        wording(
            f"argument {name!r}",
            got=repr(value)[:80],
            expected="real numbers in a regular array, NaN where nothing is known",
            do=f"pass floats or a float64 array ({reason})",
        )
    )


# ------------------------------------------------------------------------------------ spaces
@attrs.frozen
class Axis:
    """One named component of a state, a measurement or a pose, with its unit."""

    name: str
    unit: str = ""
    circular: bool = False


def _axes(axes: Iterable[Axis]) -> tuple[Axis, ...]:
    return tuple(axes)


@attrs.frozen
class Space:
    """The named components of a vector: their order, units, and which of them live on a circle.

    Example:
    >>> space = Space.of("x [m]", "y [m]", "heading [rad] circular")
    >>> space.names, space.index("heading"), space.circular
    (('x', 'y', 'heading'), 2, (False, False, True))
    """

    axes: tuple[Axis, ...] = attrs.field(converter=_axes)

    @axes.validator
    def _unique(self, _attribute: object, axes: tuple[Axis, ...]) -> None:
        names = [axis.name for axis in axes]
        if len(set(names)) != len(names):
            twice = sorted({name for name in names if names.count(name) > 1})
            raise DomainError(
                wording(
                    "argument 'axes'",
                    got=f"{twice} more than once",
                    expected="distinct names",
                    do="rename one of them",
                )
            )

    @classmethod
    def of(cls, *components: str) -> Space:
        """Space from texts such as ``"x [m]"`` or ``"azimuth [rad] circular"``.

        Raises:
            DomainError: if a text is not of that form.
        """
        axes = []
        for text in components:
            match = _AXIS.match(text)
            if match is None:
                raise DomainError(
                    wording(
                        "a component of Space.of",
                        got=repr(text),
                        expected="'name [unit]' or 'name [rad] circular'",
                        do="write for example 'x [m]'",
                    )
                )
            axes.append(Axis(match["name"], match["unit"] or "", match["circular"] is not None))
        return cls(tuple(axes))

    @property
    def names(self) -> tuple[str, ...]:
        """Names in order."""
        return tuple(axis.name for axis in self.axes)

    @property
    def units(self) -> tuple[str, ...]:
        """Units in order."""
        return tuple(axis.unit for axis in self.axes)

    @property
    def circular(self) -> tuple[bool, ...]:
        """For each component, whether it lives on a circle of 2 pi."""
        return tuple(axis.circular for axis in self.axes)

    @property
    def size(self) -> int:
        """Number of components."""
        return len(self.axes)

    def __len__(self) -> int:
        return len(self.axes)

    def __iter__(self) -> Iterator[Axis]:
        return iter(self.axes)

    def __add__(self, other: Space) -> Space:
        return Space(self.axes + other.axes)

    def index(self, name: str) -> int:
        """Place of the component called ``name``.

        Raises:
            DomainError: if there is none.
        """
        try:
            return self.names.index(name)
        except ValueError:
            raise DomainError(
                wording(
                    "component name",
                    got=repr(name),
                    expected=f"one of {', '.join(self.names) or '(no components)'}",
                    do="use a name of this space",
                )
            ) from None

    def indices(self, *names: str) -> tuple[int, ...]:
        """Places of several components."""
        return tuple(self.index(name) for name in names)

    @property
    def position(self) -> tuple[int, ...]:
        """Places of the Cartesian position components x, y, z that exist."""
        return tuple(i for i, name in enumerate(self.names) if name in ("x", "y", "z"))

    @property
    def velocity(self) -> tuple[int, ...]:
        """Places of the Cartesian velocity components vx, vy, vz that exist."""
        return tuple(i for i, name in enumerate(self.names) if name in ("vx", "vy", "vz"))

    def __str__(self) -> str:
        return ", ".join(
            f"{a.name} [{a.unit}]{' circular' if a.circular else ''}" if a.unit else a.name
            for a in self.axes
        )


EMPTY_SPACE = Space(())
PLANAR = Space.of("x [m]", "y [m]", "vx [m/s]", "vy [m/s]")
SPATIAL = Space.of("x [m]", "y [m]", "z [m]", "vx [m/s]", "vy [m/s]", "vz [m/s]")


# ----------------------------------------------------------------------------------- Gaussians
def _either(one: tuple[int, ...], other: tuple[int, ...]) -> str:
    return f"{one}" if one == other else f"{one} or {other}"


def checked_covariance(cov: Array, mean: Array, name: str = "cov") -> Array:
    """A covariance for each state of a batch; lanes that are not finite are left as they are.

    Shapes:
        cov ``(n, n)`` or ``(n, n, *batch)``; mean ``(n, *batch)``; result ``(n, n, *batch)``.

    Raises:
        ShapeError, DomainError: as `Gaussian`.
    """
    n, batch = mean.shape[0], mean.shape[1:]
    shapes = _either((n, n), (n, n, *batch))
    expected = f"shape {shapes}, to match mean of shape {mean.shape}"
    if cov.shape == (n, n) and batch:
        cov = np.broadcast_to(cov.reshape(n, n, *(1,) * len(batch)), (n, n, *batch))
    if cov.shape != (n, n, *batch):
        raise ShapeError(
            wording(
                f"argument {name!r}",
                got=f"shape {cov.shape}",
                expected=expected,
                do="put the two matrix axes first and the batch axes last",
            )
        )
    finite = np.isfinite(cov).all(axis=(0, 1))
    if not batch and not finite:
        raise DomainError(
            wording(
                f"argument {name!r}",
                got="NaN or inf",
                expected="finite numbers in a single state",
                do="check how the covariance was computed",
            )
        )
    cov = np.array(cov)
    stacked = np.moveaxis(cov.reshape(n, n, -1), -1, 0)[finite.reshape(-1)]
    if stacked.size:
        scale = np.abs(stacked).max(axis=(1, 2), initial=0.0)
        asymmetry = np.abs(stacked - stacked.swapaxes(1, 2)).max(axis=(1, 2), initial=0.0)
        if (asymmetry > 1e-9 * scale).any():
            raise DomainError(
                wording(
                    f"argument {name!r}",
                    got=f"an asymmetry of {float(asymmetry.max()):.3g}",
                    expected="a symmetric matrix (to 1e-9 of its largest entry)",
                    do="pass (cov + cov.swapaxes(0, 1)) / 2 if rounding made it so",
                )
            )
        lowest = np.linalg.eigvalsh(stacked)[:, 0]
        if (lowest < -1e-9 * scale).any():
            raise DomainError(
                wording(
                    f"argument {name!r}",
                    got=f"a smallest eigenvalue of {float(lowest.min()):.3g}",
                    expected="a positive semi-definite matrix",
                    do="check signs and that sigmas were squared",
                )
            )
    for column in range(n - 1):  # exact symmetry: the upper triangle is the truth
        cov[column + 1 :, column] = cov[column, column + 1 :]
    return cov


SYMMETRIC: Mapping[str, str] = MappingProxyType({"form": "symmetric"})
"""Metadata of a belief's field that holds symmetric matrices: a compiled step carries one triangle."""

LOWER: Mapping[str, str] = MappingProxyType({"form": "lower"})
"""Metadata of a belief's field that holds lower triangular matrices."""

PARAMETER: Mapping[str, str] = MappingProxyType({"form": "parameter"})
"""Metadata of a filter's or adapter's number that may differ per lane, ``(*batch)``.

It enters a compiled step as an input, so that another value needs no other step.
"""


@attrs.frozen(eq=False, init=False)
class Gaussian:
    """A normal distribution, or a batch of them.

    Shapes:
        mean ``(n, *batch)``; cov ``(n, n, *batch)``, or ``(n, n)`` for one shared by the batch.

    Raises:
        ShapeError: if the shapes do not fit together.
        DomainError: if cov is not symmetric positive semi-definite, or if a single state (no batch
            axes) holds NaN or inf. In a batch a lane of NaN is allowed: it is one that diverged.

    Example:
    >>> state = Gaussian([0.0, 0.0], [[1.0, 0.0], [0.0, 4.0]])
    >>> state.n, state.batch, state.sigma.tolist()
    (2, (), [1.0, 2.0])
    """

    mean: Array = attrs.field(repr=brief)
    cov: Array = attrs.field(repr=brief, metadata=SYMMETRIC)

    def __init__(self, mean: ArrayLike, cov: ArrayLike) -> None:
        if isinstance(mean, np.ndarray) and mean.dtype.hasobject:  # components of a traced step
            self.__attrs_init__(mean, np.asarray(cov))
            return
        mean = np.array(as_array(mean, "mean"))
        if mean.ndim == 0:
            raise ShapeError(
                wording(
                    "argument 'mean'",
                    got="a scalar",
                    expected="shape (n, *batch)",
                    do="pass a vector, [value] for one component",
                )
            )
        if mean.ndim == 1 and not np.isfinite(mean).all():
            raise DomainError(
                wording(
                    "argument 'mean'",
                    got=f"{mean}",
                    expected="finite numbers in a single state",
                    do="check how the mean was computed",
                )
            )
        self.__attrs_init__(mean, checked_covariance(as_array(cov, "cov"), mean))

    @classmethod
    def trusted(cls, mean: Array, cov: Array) -> Gaussian:
        """A Gaussian from arrays that are known to be right; nothing is checked or copied."""
        value = object.__new__(cls)
        object.__setattr__(value, "mean", mean)
        object.__setattr__(value, "cov", cov)
        return value

    @property
    def n(self) -> int:
        """Number of components."""
        return int(self.mean.shape[0])

    @property
    def batch(self) -> tuple[int, ...]:
        """Shape of the batch axes."""
        return self.mean.shape[1:]

    @property
    def sigma(self) -> Array:
        """Standard deviations, ``(n, *batch)``."""
        diagonal = np.einsum("ii...->i...", self.cov)
        return np.sqrt(np.maximum(diagonal, 0.0))  # type: ignore[no-any-return]

    def moments(self) -> Gaussian:
        """Itself: the mean and covariance that every state of a filter can report."""
        return self

    def __getitem__(self, lane: Any) -> Gaussian:
        """Lanes picked by an index over the batch axes."""
        key = lane if isinstance(lane, tuple) else (lane,)
        every = slice(None)
        return Gaussian.trusted(self.mean[(every, *key)], self.cov[(every, every, *key)])

    def sample(self, count: int | None = None, *, rng: np.random.Generator) -> Array:
        """Draws, ``(n, *batch)``, or ``(n, count, *batch)`` when ``count`` is given."""
        shape = self.batch if count is None else (count, *self.batch)
        root = square_root(self.cov)
        normals = rng.standard_normal((self.n, *shape))
        if count is None:
            return self.mean + np.einsum("ij...,j...->i...", root, normals)  # type: ignore[no-any-return]
        return self.mean[:, None] + np.einsum("ij...,js...->is...", root, normals)  # type: ignore[no-any-return]

    def _repr_html_(self) -> str:
        if self.batch:
            return f"<p><b>Gaussian</b>: n = {self.n}, batch {self.batch}</p>"
        rows = "".join(
            f"<tr><td>{i}</td><td>{m:.6g}</td><td>{s:.3g}</td></tr>"
            for i, (m, s) in enumerate(zip(self.mean, self.sigma, strict=True))
        )
        return f"<table><tr><th>component</th><th>mean</th><th>sigma</th></tr>{rows}</table>"


def square_root(cov: Array) -> Array:
    """A root A with ``A A' = cov``, ``(n, n, *batch)``, for singular matrices too."""
    values, vectors = np.linalg.eigh(np.moveaxis(cov, (0, 1), (-2, -1)))
    root = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return np.moveaxis(root, (-2, -1), (0, 1))


@attrs.frozen(eq=False)
class Columns:
    """A Jacobian of which only some columns can be other than zero: the arrays' form of sparsity.

    Shapes:
        entries ``(m, k, *batch)``; columns, the k places in the state; the whole matrix has
        ``width`` columns. Trailing axes of length 1 are shared by all lanes.
    """

    entries: Array = attrs.field(repr=brief)
    columns: tuple[int, ...]
    width: int

    def dense(self) -> Array:
        """The whole matrix, ``(m, n, *batch)``."""
        if self.columns == tuple(range(self.width)):
            return self.entries
        m, _, *batch = self.entries.shape
        full = np.zeros((m, self.width, *batch))
        full[:, self.columns] = self.entries
        return full


@attrs.frozen(eq=False)
class Block:
    """Hessians of which only some rows and columns can be other than zero.

    Shapes:
        entries ``(m, k, k, *batch)``: a symmetric matrix for each output; columns, the k places in
        the state; a whole matrix is ``(width, width)``. Trailing axes of length 1 are shared by
        all lanes.
    """

    entries: Array = attrs.field(repr=brief)
    columns: tuple[int, ...]
    width: int

    def dense(self) -> Array:
        """The whole matrices, ``(m, n, n, *batch)``."""
        if self.columns == tuple(range(self.width)):
            return self.entries
        m, _, _, *batch = self.entries.shape
        full = np.zeros((m, self.width, self.width, *batch), dtype=self.entries.dtype)
        places = np.array(self.columns, dtype=np.intp)
        full[:, places[:, None], places] = self.entries
        return full


# ------------------------------------------------------------------------------- measurements
def _forwards(times: Array) -> None:
    """Refuse times that are not finite or run backwards."""
    lanes = tuple(range(1, times.ndim))
    unknown = ~np.isfinite(times).all(axis=lanes)
    back = np.zeros(len(times), dtype=np.bool_)
    back[1:] = (np.diff(times, axis=0) < 0).any(axis=lanes)
    for bad, got, do in (
        (unknown, "NaN or inf", "leave out rows without a time"),
        (back, "a time before that of the row above", "sort the record by time"),
    ):
        if bad.any():
            raise DomainError(
                wording(
                    "argument 't'",
                    got=f"{got} in row {int(bad.argmax())}",
                    expected="finite seconds that never decrease",
                    do=do,
                )
            )


def _no_infinity(z: Array, name: str) -> None:
    if np.isinf(z).any():
        raise DomainError(
            wording(
                f"argument {name!r}",
                got=f"an infinite value at index {np.argwhere(np.isinf(z))[0].tolist()}",
                expected="finite numbers, or NaN where nothing was measured",
                do="replace inf by NaN if the measurement is missing",
            )
        )


@attrs.frozen(eq=False, init=False)
class Record:
    """Measurements of one target per lane over time; association is known.

    Shapes:
        t ``(T,)`` or ``(T, *batch)``, not decreasing; z ``(T, m, *batch)`` with NaN where a
        component was not measured, padded to the largest m when sensors differ; u
        ``(T, q, *batch)`` or None; pose ``(T, p, *batch)`` or None; sensor ``(T,)``, which sensor
        of a list measured at each step, or None when there is one.
    Units:
        seconds, and those of the sensor's spaces.

    Raises:
        ShapeError: if shapes do not fit. DomainError: on inf, or when time runs backwards.
    """

    t: Array = attrs.field(repr=brief)
    z: Array = attrs.field(repr=brief)
    u: Array | None = attrs.field(default=None, repr=brief)
    pose: Array | None = attrs.field(default=None, repr=brief)
    sensor: npt.NDArray[np.intp] | None = attrs.field(default=None, repr=brief)

    def __init__(
        self,
        t: ArrayLike,
        z: ArrayLike,
        u: ArrayLike | None = None,
        pose: ArrayLike | None = None,
        sensor: npt.ArrayLike | None = None,
    ) -> None:
        times, values = _kept(t, "t"), _kept(z, "z")
        if values.ndim < 2:
            raise ShapeError(
                wording(
                    "argument 'z'",
                    got=f"shape {values.shape}",
                    expected="(T, m, *batch)",
                    do="add an axis for the measurement components: z[:, None]",
                )
            )
        steps, batch = values.shape[0], values.shape[2:]
        if times.shape not in ((steps,), (steps, *batch)):
            raise ShapeError(
                wording(
                    "argument 't'",
                    got=f"shape {times.shape}",
                    expected=_either((steps,), (steps, *batch))
                    + f", as z has shape {values.shape}",
                    do="give one time per measurement row; z has time first, components second",
                )
            )
        _forwards(times)
        _no_infinity(values, "z")
        arrays: dict[str, Array] = {}
        for name, extra in (("u", u), ("pose", pose)):
            if extra is None:
                continue
            array = _kept(extra, name)
            fits = array.ndim >= 2 and array.shape[0] == steps
            if not fits or array.shape[2:] not in ((), batch):
                raise ShapeError(
                    wording(
                        f"argument {name!r}",
                        got=f"shape {array.shape}",
                        expected=f"({steps}, k)" + (f" or ({steps}, k, *{batch})" if batch else ""),
                        do="give one row per measurement row",
                    )
                )
            if not np.isfinite(array).all():
                raise DomainError(
                    wording(
                        f"argument {name!r}",
                        got="NaN or inf",
                        expected="finite numbers",
                        do="fill the gaps before filtering",
                    )
                )
            arrays[name] = array
        which = None
        if sensor is not None:
            which = np.asarray(sensor)
            if which.shape != (steps,) or not np.issubdtype(which.dtype, np.integer):
                raise ShapeError(
                    wording(
                        "argument 'sensor'",
                        got=f"{which.dtype} of shape {which.shape}",
                        expected=f"integers of shape ({steps},)",
                        do="give the sensor's place in the list for each row",
                    )
                )
            which = which.astype(np.intp)
        self.__attrs_init__(times, values, arrays.get("u"), arrays.get("pose"), which)

    @property
    def batch(self) -> tuple[int, ...]:
        """Shape of the batch axes."""
        return self.z.shape[2:]

    def __len__(self) -> int:
        return int(self.z.shape[0])


@attrs.frozen(eq=False, init=False)
class Scan:
    """The detections of one sensor at one time, before association.

    Shapes:
        z ``(m, D, *batch)``: D detection slots; mask ``(D, *batch)``: which slots hold a detection;
        pose ``(p, *batch)`` or None. ``sensor`` names the sensor. A scan without detections is a
        value like any other: it says that everything was missed.

    Raises:
        ShapeError, DomainError: on shapes that do not fit and on inf.
    """

    t: float
    z: Array = attrs.field(repr=brief)
    mask: npt.NDArray[np.bool_] = attrs.field(repr=brief)
    pose: Array | None = attrs.field(default=None, repr=brief)
    sensor: str = ""

    def __init__(
        self,
        t: float,
        z: ArrayLike,
        mask: npt.ArrayLike | None = None,
        pose: ArrayLike | None = None,
        sensor: str = "",
    ) -> None:
        values = _kept(z, "z")
        if values.ndim < 2:
            raise ShapeError(
                wording(
                    "argument 'z'",
                    got=f"shape {values.shape}",
                    expected="(m, D, *batch)",
                    do="give components first, then detections",
                )
            )
        _no_infinity(values, "z")
        seen = ~np.isnan(values).all(axis=0)
        given = seen if mask is None else np.asarray(mask, dtype=np.bool_)
        if given.shape != values.shape[1:]:
            raise ShapeError(
                wording(
                    "argument 'mask'",
                    got=f"shape {given.shape}",
                    expected=f"{values.shape[1:]}",
                    do="give one flag per detection slot",
                )
            )
        present: npt.NDArray[np.bool_] = np.logical_and(given, seen)
        where = None if pose is None else _kept(pose, "pose")
        if where is not None and not np.isfinite(where).all():
            raise DomainError(
                wording(
                    "argument 'pose'",
                    got="NaN or inf",
                    expected="finite numbers",
                    do="leave out the scan, or interpolate where the sensor was",
                )
            )
        self.__attrs_init__(float(t), values, present, where, sensor)

    @property
    def detections(self) -> int:
        """Number of detection slots D."""
        return int(self.z.shape[1])


# ----------------------------------------------------------------------- what a filter produces
@attrs.frozen(eq=False)
class Projection:
    """A state seen through a sensor, computed once and shared by gate, associator and update.

    Shapes:
        z ``(m, *batch)`` predicted measurement; S ``(m, m, *batch)`` innovation covariance; cross
        ``(n, m, *batch)`` covariance of state and measurement.
    """

    z: Array = attrs.field(repr=brief)
    S: Array = attrs.field(repr=brief)
    cross: Array = attrs.field(repr=brief)


@attrs.frozen(eq=False)
class Innovation:
    """What a measurement said that the prediction did not, and how surprising that was.

    Shapes:
        residual ``(m, *batch)``, NaN for a component that was not measured; S ``(m, m, *batch)``;
        nis, loglik, count, ok ``(*batch)``. ``count`` is the number of measured components: the
        degrees of freedom of ``nis``. ``ok`` is False in a lane that is no longer finite, because it
        diverged or because an update lost its digits; it stays so. Inside a History each has a
        leading time axis.
    """

    residual: Array = attrs.field(repr=brief)
    S: Array = attrs.field(repr=brief)
    nis: Array = attrs.field(repr=brief)
    loglik: Array = attrs.field(repr=brief)
    count: Array = attrs.field(repr=brief)
    ok: npt.NDArray[np.bool_] = attrs.field(repr=brief)


@attrs.frozen(eq=False)
class Step:
    """One prediction and update, as a noise adapter sees it afterwards.

    Shapes:
        dt scalar or ``(*batch)``; pose ``(p, *batch)`` or None; predicted and filtered: moments
        before and after the measurement; the innovation between them.
    """

    dt: Any
    pose: Any
    predicted: Gaussian
    filtered: Gaussian
    innovation: Innovation


@attrs.frozen(eq=False)
class Association:
    """How likely each track owns each detection.

    Shapes:
        weights ``(tracks, D + 1, *batch)``; rows sum to one; the last slot means "missed". A hard
        association is one-hot.
    """

    weights: Array = attrs.field(repr=brief)

    @property
    def hard(self) -> npt.NDArray[np.intp]:
        """The likeliest slot of each track, ``(tracks, *batch)``; D means missed."""
        return np.asarray(self.weights.argmax(axis=1), dtype=np.intp)


@attrs.frozen(eq=False)
class Tracks:
    """The targets being followed at one time.

    Shapes:
        state ``(n, tracks, *batch)``; ids, one label per track.
    """

    t: float
    state: Any
    ids: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.ids)


@attrs.frozen(eq=False)
class Trajectory:
    """Estimates over time.

    Shapes:
        mean ``(T, n, *batch)``; cov ``(T, n, n, *batch)``.
    """

    mean: Array = attrs.field(repr=brief)
    cov: Array = attrs.field(repr=brief)

    def at(self, step: int) -> Gaussian:
        """The estimate of one step."""
        return Gaussian.trusted(self.mean[step], self.cov[step])

    def __len__(self) -> int:
        return int(self.mean.shape[0])

    @property
    def batch(self) -> tuple[int, ...]:
        """Shape of the batch axes."""
        return self.mean.shape[2:]


@attrs.frozen(eq=False)
class Beliefs:
    """What a filter believed at each step, where that is more than mean and covariance.

    Shapes:
        predicted, filtered: one belief per step, each over the whole batch; smoothed alike, where a
        smoother found more than moments (`imm_smoother`: how likely each mode was), else None.
    """

    predicted: tuple[Any, ...] = attrs.field(repr=False)
    filtered: tuple[Any, ...] = attrs.field(repr=False)
    smoothed: tuple[Any, ...] | None = attrs.field(default=None, repr=False)


@attrs.frozen(eq=False)
class Run:
    """What a history came from: an estimator, a record, the prior and its time, or None for t[0]."""

    estimator: Any
    record: Record
    prior: Any
    start: float | None


@attrs.frozen(eq=False)
class History:
    """What a run leaves behind: everything a smoother needs, and where it came from.

    Shapes:
        t ``(T,)`` or ``(T, *batch)``; predicted, filtered, smoothed: trajectories; innovation with
        a leading time axis; u ``(T, q, *batch)`` the inputs that were used, or None; beliefs, where
        the estimator's smoother needs them ("beliefs"); run, what it came from, or None.
    """

    t: Array = attrs.field(repr=brief)
    predicted: Trajectory
    filtered: Trajectory
    innovation: Innovation
    smoothed: Trajectory | None = None
    u: Array | None = attrs.field(default=None, repr=brief)
    beliefs: Beliefs | None = attrs.field(default=None, repr=False)
    run: Run | None = attrs.field(default=None, repr=False)

    @property
    def estimate(self) -> Trajectory:
        """The smoothed trajectory where there is one, else the filtered one."""
        return self.filtered if self.smoothed is None else self.smoothed

    def summary(self) -> str:
        """Consistency, whiteness and observability, and what a person should conclude from them."""
        from tracker.metrics.health import summary

        return summary(self)

    def measurement_noise(self) -> Array:
        """R as each update used it, ``(T, m, m, *batch)``: what an adapter has made of the sensor's own.

        See `tracker.metrics.noise.measurement_noise`.
        """
        from tracker.metrics.noise import measurement_noise

        return measurement_noise(self)

    def warnings(self) -> list[str]:
        """What a person should be told before trusting this run; empty if nothing."""
        from tracker.metrics.health import warnings

        return warnings(self)

    def __len__(self) -> int:
        return len(self.filtered)

    def _repr_html_(self) -> str:
        kind = "filtered" if self.smoothed is None else "filtered and smoothed"
        good = float(np.mean(self.innovation.ok)) if self.innovation.ok.size else 1.0
        return (
            f"<p><b>History</b>: {len(self)} steps, n = {self.filtered.mean.shape[1]}, batch "
            f"{self.filtered.batch}, {kind}; {good:.1%} of the steps finite</p>"
        )
