"""What a config file may say, read into frozen values that are valid throughout; nothing is run.

A file names components by their registry keys, never by import paths. Every value is checked when the
file is read, and every component is made then: whoever holds an `Experiment` can run it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Generic, TypeVar

import attrs

from tracker import registry
from tracker.errors import (
    CapabilityError,
    ConfigError,
    PluginError,
    TrackerError,
    UnknownComponent,
    a_or_an,
    wording,
)
from tracker.io import toml
from tracker.io.detections import SENSOR_KINDS, DetectionLog, read_detection_log
from tracker.pipeline import Pipeline
from tracker.protocols import Associator, Filter, Gate, MotionModel, SensorModel

__all__ = ["Experiment", "Part", "SensorSet", "Start", "parse_experiment", "read_experiment"]

T = TypeVar("T")

_KEYS = ("title", "data", "motion", "sensors", "filter", "gate", "associator", "start", "compare")
_LOG_FILES = ("scans", "detections", "truth")
_LONGEST_TEXT = 200
_LONGEST_LIST = 16
_WIDTHS = {"position": 2, "bearing": 1}
_NUMBER = {"float", "int", "ArrayLike", "Array"}
_LIST = {"ArrayLike", "Array", "tuple", "list", "Sequence", "Iterable"}
_TEXT = {"str", "Literal"}
_FLAG = {"bool"}
_ANYTHING = {"Any", "object"}


@attrs.frozen(eq=False)
class Part(Generic[T]):
    """A component that a file names: its record in the registry, the parameters given, what they made."""

    component: registry.Component
    parameters: Mapping[str, Any]
    made: T

    def __str__(self) -> str:
        given = ", ".join(f"{name}={value!r}" for name, value in self.parameters.items())
        return f"{self.component.name}({given})"


@attrs.frozen
class Start:
    """Tracks start from the truth's first ``seconds``, with these standard deviations.

    Units:
        s; sigma in those of the state.
    """

    seconds: float
    sigma: tuple[float, ...]


@attrs.frozen
class SensorSet:
    """Sensors that are used together, and what a report calls them."""

    name: str
    sensors: tuple[str, ...]


@attrs.frozen(eq=False)
class Experiment:
    """One detection log, the components to track its targets with, and the sensor sets to compare."""

    title: str
    log: Path
    motion: Part[MotionModel]
    sensors: Mapping[str, Part[SensorModel]]
    filter: Part[Filter[Any]]
    gate: Part[Gate]
    associator: Part[Associator]
    start: Start
    compare: tuple[SensorSet, ...]

    @property
    def parts(self) -> Mapping[str, Part[Any]]:
        """Every component by the role it plays."""
        sensors = {f"sensor {name}": part for name, part in self.sensors.items()}
        return {
            "motion": self.motion,
            **sensors,
            "filter": self.filter,
            "gate": self.gate,
            "associator": self.associator,
        }

    def pipeline(self, one: SensorSet) -> Pipeline:
        """The pipeline that uses the sensors of one set."""
        return Pipeline(
            motion=self.motion.made,
            sensors={name: self.sensors[name].made for name in one.sensors},
            filter=self.filter.made,
            gate=self.gate.made,
            associator=self.associator.made,
        )

    def read_log(self) -> DetectionLog:
        """Read the detections of all sensors that some set uses.

        Raises:
            ConfigError: as `read_detection_log`; or the log has no truth to start from.
        """
        used = {name: None for one in self.compare for name in one.sensors}
        log = read_detection_log(self.log, sensors=list(used))
        if not log.truth:
            raise ConfigError(
                wording(
                    str(self.log),
                    got="no truth",
                    expected="a log with truth, from which the tracks start",
                    do="add the _truth.csv file",
                )
            )
        return log


def read_experiment(file: str | Path) -> Experiment:
    """Read an experiment; paths in it are relative to the file.

    Raises:
        ConfigError: naming file, line and path of what is wrong.
        PluginError: a component needs something that is not installed.
    """
    return _experiment(toml.read(file), Path(file).parent)


def parse_experiment(text: str, folder: str | Path, file: str = "config") -> Experiment:
    """Read an experiment from a text; paths in it are relative to ``folder``.

    Raises:
        ConfigError, PluginError: as `read_experiment`.
    """
    return _experiment(toml.parse(text, file), Path(folder))


def _experiment(table: toml.Table, folder: Path) -> Experiment:
    table.only(*_KEYS)
    motion: Part[MotionModel] = _part(table.table("motion"), registry.motions)
    experiment = Experiment(
        title=table.text("title", default="Tracking"),
        log=_log(table.table("data", expected="a table that says where the log is"), folder),
        motion=motion,
        sensors=_sensors(table.table("sensors", expected="a table of sensors by name")),
        filter=_part(table.table("filter"), registry.filters),
        gate=_part(table.table("gate"), registry.gates),
        associator=_part(table.table("associator"), registry.associators),
        start=_start(table.table("start"), motion),
        compare=(),
    )
    experiment = attrs.evolve(experiment, compare=_sets(table, experiment.sensors))
    for name in experiment.sensors:
        try:
            experiment.pipeline(SensorSet(name, (name,)))
        except CapabilityError as error:
            where = table.where("sensors", name)
            raise ConfigError(f"{where}: {' '.join(str(error).split())}") from error
    return experiment


# -------------------------------------------------------------------------------- the tables
def _log(table: toml.Table, folder: Path) -> Path:
    table.only("folder", "scenario")
    where = folder / table.text("folder", expected="the folder of the log, relative to this file")
    name = table.text("scenario", expected="what the names of the log's files begin with")
    if not _exists(where, "is_dir"):
        raise table.error(
            "folder", got=f"{where}, which is no folder", expected="a folder", do="correct the path"
        )
    log = where / name
    for content in _LOG_FILES:
        if not any(
            _exists(Path(f"{log}_{content}.csv{zipped}"), "is_file") for zipped in ("", ".gz")
        ):
            raise table.error(
                "scenario",
                got=f"{toml.shown(name)}, but there is no {log}_{content}.csv or .csv.gz",
                expected="what the names of the log's three files begin with",
                do=f"look into {where}",
            )
    return log


def _exists(path: Path, test: str) -> bool:
    try:
        return bool(getattr(path, test)())
    except (OSError, ValueError):  # too long, forbidden, not a name
        return False


def _sensors(table: toml.Table) -> Mapping[str, Part[SensorModel]]:
    table.only(*SENSOR_KINDS, owner="the log")
    sensors: dict[str, Part[SensorModel]] = {}
    for name in table.values:
        sensors[name] = _part(table.table(name), registry.sensors)
        made, kind = sensors[name].made, SENSOR_KINDS[name]
        if made.space.size != _WIDTHS[kind] or made.pose_space.size not in {0, 2}:
            raise table.error(
                name,
                got=f"a sensor of ({made.space}) at pose ({made.pose_space})",
                expected=f"a sensor of a {kind}, {_WIDTHS[kind]} wide, at ownship's east and north",
                do="see 'tracker list sensor'",
            )
    return MappingProxyType(sensors)


def _start(table: toml.Table, motion: Part[MotionModel]) -> Start:
    table.only("truth_seconds", "sigma")
    space = motion.made.space
    if not {"x", "y", "vx", "vy"} <= set(space.names):
        raise table.error(
            got=f"a motion of ({space})",
            expected="a state with x, y, vx and vy, which the truth tells",
            do="choose another motion",
        )
    return Start(
        seconds=table.number("truth_seconds", above=0.0, to=3600.0, unit="s"),
        sigma=table.numbers("sigma", space.size, above=0.0, of=str(space)),
    )


def _sets(table: toml.Table, sensors: Mapping[str, object]) -> tuple[SensorSet, ...]:
    sets: list[SensorSet] = []
    for one in table.tables("compare", expected="a list of sensor sets"):
        one.only("name", "sensors")
        name = one.text("name", expected="a name for the set")
        if name in [known.name for known in sets]:
            raise one.error("name", got=f"{name!r} again", expected="a new name", do="rename it")
        chosen = one.texts(
            "sensors", expected=f"a list of sensors, each once: {', '.join(sensors)}"
        )
        for place, sensor in enumerate(chosen):
            if sensor not in sensors:
                raise one.unknown("sensors", place, name=sensor, kind="sensor", known=sensors)
        sets.append(SensorSet(name, chosen))
    return tuple(sets)


# ---------------------------------------------------------------------------- the components
def _part(table: toml.Table, catalogue: registry.Catalogue[T]) -> Part[T]:
    """Make the component that a table names, from the table's other keys."""
    name = table.text("name", expected=f"the name of {a_or_an(catalogue.kind)}, as in the registry")
    try:
        component = catalogue[name]
    except UnknownComponent as error:  # it suggests a name, and tells of plugins that failed
        raise ConfigError(f"{table.where('name')}: {error}") from None
    described = registry.describe_parameters(component)
    table.only("name", *(one.name for one in described), owner=name)
    given = {key: value for key, value in table.values.items() if key != "name"}
    for one in described:
        if one.required and one.name not in given:
            raise table.error(
                got=f'no "{one.name}"',
                expected=f"a value{f' [{one.unit}]' * bool(one.unit)} for {name}",
                do=f"add \"{one.name}\"; 'tracker show {name}' lists the parameters",
            )
        if one.name in given:
            _check_kind(table, one, given[one.name])
    try:
        made = catalogue.make(name, **given)
    except Exception as error:
        if isinstance(error, PluginError):
            raise  # not the file's fault: something is not installed
        key = next((key for key in given if f"'{key}'" in str(error)), None)
        said = str(error) if isinstance(error, TrackerError) else f"{type(error).__name__}: {error}"
        where = table.where() if key is None else table.where(key)
        raise ConfigError(f"{where}: {said[: 2 * toml.LONGEST]}") from error
    return Part(component, MappingProxyType(given), made)


def _check_kind(table: toml.Table, parameter: registry.Parameter, value: object) -> None:
    """Refuse a value that is not of a kind the parameter's annotation names.

    Before the component sees it: NumPy would take the text "6" for a number, and true for 1.
    """
    words = set(re.findall(r"[A-Za-z]\w*", re.sub(r"""(["']).*?\1""", "", parameter.annotation)))
    free = not words or bool(words & _ANYTHING)
    kinds = {
        "a number": free or bool(words & _NUMBER),
        "a text": free or bool(words & _TEXT),
        "true or false": free or bool(words & _FLAG),
        f"a list of at most {_LONGEST_LIST} numbers": free or bool(words & _LIST),
    }
    if isinstance(value, bool):
        fits = kinds["true or false"]
    elif isinstance(value, str):
        fits = kinds["a text"] and len(value) <= _LONGEST_TEXT
    elif isinstance(value, list):
        fits = kinds[f"a list of at most {_LONGEST_LIST} numbers"] and _are_numbers(value)
    else:
        number = toml.as_number(value)
        whole = number is not None and math.floor(number) == number
        fits = kinds["a number"] and number is not None and (whole or bool(words - {"int"}) or free)
    if not fits:
        accepted = [kind for kind, ok in kinds.items() if ok]
        raise table.error(
            parameter.name,
            got=toml.shown(value),
            expected=" or ".join(accepted) if accepted else "no value: a file cannot give it",
            do=f"see 'tracker show {table.values['name']}'",
        )


def _are_numbers(values: list[object]) -> bool:
    return 0 < len(values) <= _LONGEST_LIST and all(
        toml.as_number(value) is not None for value in values
    )
