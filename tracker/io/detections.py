"""Multi-sensor detection logs in CSV, read into scans, known paths and ownship; nothing is filtered.

A log is three tables beside each other, plain or gzipped. ``LOG_scans.csv`` holds one row per scan
(``scan, t, sensor, own_n, own_e, n_det``); scans without detections are rows like any other.
``LOG_detections.csv`` holds one row per detection (``scan, sensor, rel_n, rel_e, bearing``).
``LOG_truth.csv`` holds where each target really was (``target, t, n, e``) and may be missing.

The files count north first; the values returned have x = east and y = north. A position detection
stays relative to ownship, as it was measured: the sensor model is position minus pose. A bearing is
azimuth from north towards east.
"""

from __future__ import annotations

import csv
import gzip
import math
import os
import zlib
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, TextIO, TypeVar

import attrs
import numpy as np

from tracker.errors import ConfigError, DomainError, ShapeError, wording
from tracker.types import Array, ArrayLike, Scan, as_array

Kind = Literal["position", "bearing"]
"""What a sensor of a log detects."""

SENSOR_KINDS: Mapping[str, Kind] = MappingProxyType(
    {"radar": "position", "lidar": "position", "ir": "bearing", "eo": "bearing"}
)
"""The sensors a log may name unless the reader is told otherwise."""

_Row = TypeVar("_Row")
_SCANS = ("scan", "t", "sensor", "own_n", "own_e", "n_det")
_DETECTIONS = ("scan", "sensor", "rel_n", "rel_e", "bearing")
_TRUTH = ("target", "t", "n", "e")


# -------------------------------------------------------------------------------------- values
@attrs.frozen(eq=False, init=False)
class TruthTrack:
    """A known path, of a target or of ownship: places at times, straight lines between.

    Shapes:
        t ``(T,)``, increasing; position ``(2, T)``: east, north.

    Units:
        s, m.

    Raises:
        ShapeError: if the shapes do not fit. DomainError: on NaN or inf, or if times do not increase.

    Example:
    >>> track = TruthTrack([0.0, 10.0], [[0.0, 20.0], [5.0, 5.0]])
    >>> track.at([5.0, 11.0]).tolist()
    [[10.0, nan], [5.0, nan]]
    >>> track.velocity_at(5.0).tolist()
    [2.0, 0.0]
    """

    t: Array
    position: Array

    def __init__(self, t: ArrayLike, position: ArrayLike) -> None:
        times, places = as_array(t, "t"), as_array(position, "position")
        if times.ndim != 1 or not times.size or places.shape != (2, times.size):
            raise ShapeError(
                wording(
                    "a TruthTrack",
                    got=f"t of shape {times.shape} and position of shape {places.shape}",
                    expected="shapes (T,) and (2, T), with T at least 1",
                    do="give an east and a north for each time",
                )
            )
        finite = np.isfinite(times).all() and np.isfinite(places).all()
        if not finite or (times[1:] <= times[:-1]).any():
            raise DomainError(
                wording(
                    "a TruthTrack",
                    got="NaN, inf or times that do not increase",
                    expected="finite places at increasing times",
                    do="drop the gaps, sort by time and keep one place per time",
                )
            )
        self.__attrs_init__(times, places)

    def at(self, times: ArrayLike) -> Array:
        """Where it was, ``(2, *times)``; NaN outside the span of the path."""
        when = as_array(times, "times")
        with np.errstate(over="ignore", invalid="ignore"):
            return np.stack(
                [np.interp(when, self.t, line, np.nan, np.nan) for line in self.position]
            )

    def velocity_at(self, times: ArrayLike, *, span: float = 2.0) -> Array:
        """Mean velocity over ``span`` seconds around each time, ``(2, *times)``, in m/s.

        At an end of the path the part of ``span`` that lies on the path counts; NaN outside. A
        mean over seconds, because neighbouring fixes differ by little more than their rounding.
        """
        if not 0.0 < span < math.inf:
            raise DomainError(
                wording("argument 'span'", got=span, expected="seconds > 0", do="pass span=2.0")
            )
        when = as_array(times, "times")
        inside = np.where((when >= self.t[0]) & (when <= self.t[-1]), when, np.nan)
        before = np.maximum(inside - span / 2, self.t[0])
        after = np.minimum(inside + span / 2, self.t[-1])
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return np.where(
                after > before, (self.at(after) - self.at(before)) / (after - before), np.nan
            )


@attrs.frozen(eq=False)
class DetectionLog:
    """What several sensors on one moving platform detected, and what is known of the truth.

    Shapes:
        scans in time order, each with z ``(2, D)`` of relative east and north, or ``(1, D)`` of
        azimuth from north, and pose ``(2,)``: ownship's east and north; truth by target's name.

    Units:
        s, m, rad.
    """

    scans: tuple[Scan, ...]
    sensors: tuple[str, ...]
    truth: Mapping[str, TruthTrack]
    ownship: TruthTrack
    notes: tuple[str, ...] = ()
    """What the reader put right without being asked, for a report to show."""


# --------------------------------------------------------------------------------- the reader
def read_detection_log(
    log: str | Path,
    *,
    sensors: Collection[str] | None = None,
    start: float = -math.inf,
    stop: float = math.inf,
    kinds: Mapping[str, Kind] = SENSOR_KINDS,
) -> DetectionLog:
    """Read a log by what its file names begin with, such as ``"examples/data/autoferry/scenario02"``.

    ``sensors`` picks some of the sensors; ``start`` and ``stop`` pick scans by time, both included.
    Truth and ownship are kept whole. Rows that are not in order of time are sorted, rows of one
    time keep their order, and the log's ``notes`` say so. ``kinds`` names other sensors than the usual.

    Units:
        s.

    Raises:
        ConfigError: if a file is missing, damaged or contradicts itself; the message begins with the
            file and line. Also if ``sensors`` names one that the log lacks.
        DomainError: if ``start`` lies after ``stop``.
    """
    if not start <= stop:
        raise DomainError(
            wording(
                "arguments 'start' and 'stop'",
                got=f"{start} and {stop}",
                expected="start <= stop, in seconds",
                do="exchange them",
            )
        )
    for name, kind in kinds.items():
        if kind not in {"position", "bearing"}:
            raise DomainError(
                wording(
                    f"argument 'kinds', sensor {name!r}",
                    got=repr(kind),
                    expected="'position' or 'bearing'",
                    do="say what the sensor detects",
                )
            )
    notes: list[str] = []
    table = _table(log, "scans")
    rows = _scan_rows(table, kinds)
    if not rows:
        raise _error(table, 1, got="no scans", expected="at least one row", do="check the export")
    found = _detections(_table(log, "detections"), rows, kinds)
    for name, row in rows.items():
        if len(found[name]) != row.detections:
            raise _error(
                table,
                row.line,
                got=f"n_det {row.detections} for scan {name!r}",
                expected=f"{len(found[name])}, the rows that the detections file has for it",
                do="correct n_det or restore the lost detections",
            )
    ordered = _by_time(table, list(rows.items()), [row.t for row in rows.values()], notes)
    present = {row.sensor for row in rows.values()}
    chosen = _chosen(log, [name for name in kinds if name in present], sensors)
    scans = tuple(
        Scan(
            row.t,
            np.reshape(found[name], (row.detections, _size(kinds[row.sensor]))).T,
            pose=row.pose,
            sensor=row.sensor,
        )
        for name, row in ordered
        if row.sensor in chosen and start <= row.t <= stop
    )
    truth_file = _table(log, "truth")
    truth = _truth(truth_file, notes) if truth_file.exists() else {}
    # Scans of one time share one pose: ownship cannot be in two places.
    poses = {row.t: row.pose for _, row in reversed(ordered)}
    ownship = TruthTrack(sorted(poses), np.transpose([poses[t] for t in sorted(poses)]))
    return DetectionLog(scans, chosen, truth, ownship, tuple(notes))


@attrs.frozen
class _ScanRow:
    line: int
    t: float
    sensor: str
    pose: tuple[float, float]
    detections: int


def _scan_rows(file: Path, kinds: Mapping[str, Kind]) -> dict[str, _ScanRow]:
    rows: dict[str, _ScanRow] = {}
    for line, cells in _read(file, _SCANS):
        name, sensor = cells["scan"], cells["sensor"]
        if name in rows:
            raise _error(
                file,
                line,
                got=f"scan {name!r} again",
                expected=f"a new scan, as line {rows[name].line} has it already",
                do="number every scan once",
            )
        if sensor not in kinds:
            raise _error(
                file,
                line,
                got=f"sensor {sensor!r}",
                expected=f"one of {', '.join(kinds)}",
                do="correct the name, or tell the reader with kinds={...}",
            )
        t, north, east = (_number(file, line, cells, column) for column in ("t", "own_n", "own_e"))
        count = _number(file, line, cells, "n_det")
        if count < 0 or count != math.floor(count):
            raise _error(
                file,
                line,
                got=f"n_det {cells['n_det']!r}",
                expected="a whole number that is not negative",
                do="count the detections of the scan",
            )
        rows[name] = _ScanRow(line, t, sensor, (east, north), int(count))
    return rows


def _detections(
    file: Path, rows: Mapping[str, _ScanRow], kinds: Mapping[str, Kind]
) -> defaultdict[str, list[tuple[float, ...]]]:
    found: defaultdict[str, list[tuple[float, ...]]] = defaultdict(list)
    for line, cells in _read(file, _DETECTIONS):
        name, sensor = cells["scan"], cells["sensor"]
        if name not in rows:
            raise _error(
                file,
                line,
                got=f"a detection of scan {name!r}",
                expected="a scan that the scans file has",
                do="add the scan or drop the detection",
            )
        if sensor != rows[name].sensor:
            raise _error(
                file,
                line,
                got=f"sensor {sensor!r}",
                expected=f"{rows[name].sensor!r}, as the scans file has it for scan {name!r}",
                do="correct one of them",
            )
        columns = ("rel_e", "rel_n") if kinds[sensor] == "position" else ("bearing",)
        found[name].append(tuple(_number(file, line, cells, column) for column in columns))
    return found


def _truth(file: Path, notes: list[str]) -> dict[str, TruthTrack]:
    fixes: defaultdict[str, dict[float, tuple[int, float, float]]] = defaultdict(dict)
    for line, cells in _read(file, _TRUTH):
        t, north, east = (_number(file, line, cells, column) for column in ("t", "n", "e"))
        known = fixes[cells["target"]]
        if t in known:
            raise _error(
                file,
                line,
                got=f"target {cells['target']!r} at t = {t} again",
                expected=f"one place at a time, as line {known[t][0]} has it already",
                do="drop one of the rows",
            )
        known[t] = (line, east, north)
    tracks = {}
    for target, known in fixes.items():
        times = _by_time(file, list(known), list(known), notes)
        tracks[target] = TruthTrack(times, np.transpose([known[t][1:] for t in times]))
    return tracks


def _chosen(
    log: str | Path, present: list[str], sensors: Collection[str] | None
) -> tuple[str, ...]:
    chosen = present if sensors is None else [sensors] if isinstance(sensors, str) else sensors
    for name in chosen:
        if name not in present:
            raise ConfigError(
                wording(
                    f"{log}: argument 'sensors'",
                    got=repr(name),
                    expected=f"some of {', '.join(present)}, the sensors of this log",
                    do="correct the name or leave it out",
                )
            )
    return tuple(chosen)


def _by_time(file: Path, rows: list[_Row], times: list[float], notes: list[str]) -> list[_Row]:
    late = next((i for i in range(1, len(times)) if times[i] < times[i - 1]), None)
    if late is None:
        return rows
    notes.append(
        f"{file}: t = {times[late]} comes after t = {times[late - 1]}; the rows were sorted by time"
    )
    return [rows[i] for i in sorted(range(len(rows)), key=times.__getitem__)]


def _size(kind: Kind) -> int:
    return 2 if kind == "position" else 1


# ------------------------------------------------------------------------------------- tables
def _table(log: str | Path, name: str) -> Path:
    plain = f"{log}_{name}.csv"
    return Path(plain if os.path.isfile(plain) else plain + ".gz")  # noqa: PTH113 (never raises)


def _read(file: Path, columns: tuple[str, ...]) -> Iterator[tuple[int, dict[str, str]]]:
    """Line number and wanted cells of each row."""
    line = 0
    try:
        with _open(file) as stream:
            reader = csv.reader(stream, strict=True)
            header = [cell.strip() for cell in next(reader, [])]
            for column in columns:
                if header.count(column) != 1:
                    raise _error(
                        file,
                        1,
                        got=f"columns {', '.join(header)[:200] or 'none'}",
                        expected=f"column {column!r} once, of {', '.join(columns)}",
                        do="correct the header",
                    )
            places = {column: header.index(column) for column in columns}
            for row in reader:
                line = reader.line_num
                if not row:
                    continue
                if len(row) != len(header):
                    raise _error(
                        file,
                        line,
                        got=f"{len(row)} cells",
                        expected=f"{len(header)}, one per column of the header",
                        do="complete the row; the file may have been cut off here",
                    )
                yield line, {column: row[place].strip() for column, place in places.items()}
    except FileNotFoundError:
        plain = str(file).removesuffix(".gz")
        raise ConfigError(
            wording(
                plain,
                got="no such file",
                expected=f"{plain} or {plain}.gz",
                do="give what the names of the log's files have in common, as 'data/scenario02'",
            )
        ) from None
    except (OSError, EOFError, UnicodeError, zlib.error, csv.Error) as error:
        raise _error(
            file,
            line + 1,
            got=f"unreadable content ({error})",
            expected="CSV in UTF-8, plain or gzipped",
            do="fetch the file again",
        ) from None


def _open(file: Path) -> TextIO:
    if not os.path.isfile(file):  # noqa: PTH113 (as above)
        raise FileNotFoundError
    if file.suffix == ".gz":
        return gzip.open(file, "rt", encoding="utf-8-sig", newline="")
    return file.open(encoding="utf-8-sig", newline="")


def _number(file: Path, line: int, cells: Mapping[str, str], column: str) -> float:
    text = cells[column]
    try:
        value = math.nan if "_" in text else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise _error(
            file,
            line,
            got=f"{text[:40]!r} in column {column!r}",
            expected="a finite number",
            do="correct the cell or drop the row",
        )
    return value


def _error(file: Path, line: int, *, got: str, expected: str, do: str) -> ConfigError:
    return ConfigError(wording(f"{file}:{line}", got=got, expected=expected, do=do))


# --------------------------------------------------------------------------------- the writer
def write_detection_log(log: DetectionLog, to: str | Path) -> None:
    """Write a log as the three plain CSV files whose names begin with ``to``.

    Raises:
        ShapeError: if a scan has batch axes, no pose, or neither one nor two components.

    Laws:
        Reading gives back the same scans and truth, bit for bit (tests/io/test_detections.py).
    """
    scans: list[tuple[Any, ...]] = []
    detections: list[tuple[Any, ...]] = []
    for number, scan in enumerate(log.scans):
        pose = np.empty(0) if scan.pose is None else scan.pose
        if scan.z.ndim != 2 or scan.z.shape[0] not in {1, 2} or pose.shape != (2,):
            raise ShapeError(
                wording(
                    f"scan {number} of the log",
                    got=f"z of shape {scan.z.shape} and pose of shape {pose.shape}",
                    expected="z (2, D) or (1, D) and pose (2,)",
                    do="pick one lane of a batch before writing",
                )
            )
        east, north = pose.tolist()
        seen = scan.z[:, scan.mask].T.tolist()
        scans.append((number, scan.t, scan.sensor, north, east, len(seen)))
        for z in seen:
            cells = (z[1], z[0], "") if len(z) == 2 else ("", "", z[0])
            detections.append((number, scan.sensor, *cells))
    truth: list[tuple[Any, ...]] = [
        (target, t, north, east)
        for target, track in log.truth.items()
        for t, east, north in zip(track.t.tolist(), *track.position.tolist(), strict=True)
    ]
    for name, columns, rows in (
        ("scans", _SCANS, scans),
        ("detections", _DETECTIONS, detections),
        ("truth", _TRUTH, truth),
    ):
        with Path(f"{to}_{name}.csv").open("w", encoding="utf-8", newline="") as stream:
            csv.writer(stream).writerows([columns, *rows])
