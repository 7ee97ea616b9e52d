"""Who offers which component: records, discovery of plugins, look-up by kind and name.

What a component does belongs in a plugin, and how a registry is printed belongs in ``tracker.cli``.
Nothing is imported from a component's package until it is loaded or made, so that listing every
component of every plugin costs milliseconds.
"""

from __future__ import annotations

import contextlib
import difflib
import functools
import html
import importlib
import os
import re
import shlex
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib.util import find_spec
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar, cast

import attrs
import pluggy

from tracker import hookspecs
from tracker.errors import (
    ConfigError,
    PluginError,
    TrackerError,
    UnknownComponent,
    a_or_an,
    wording,
)
from tracker.parameters import Parameter, declared_parameters, parameters_of

if TYPE_CHECKING:
    from importlib.metadata import Distribution, EntryPoint

    from tracker.protocols import (
        Associator,
        Deleter,
        Filter,
        Gate,
        Initiator,
        Metric,
        MotionModel,
        NoiseAdapter,
        ObserverPath,
        Optimiser,
        Planner,
        Scenario,
        SensorModel,
        Smoother,
    )
    from tracker.reproduction import Study

__all__ = [
    "KINDS",
    "MEANINGS",
    "Catalogue",
    "Component",
    "Origin",
    "Parameter",
    "PluginReport",
    "Registry",
    "adapters",
    "associators",
    "default_registry",
    "deleters",
    "describe_parameters",
    "filters",
    "functions",
    "gates",
    "initiators",
    "metrics",
    "motions",
    "optimisers",
    "paths",
    "planners",
    "reproductions",
    "scenarios",
    "sensors",
    "smoothers",
]

GROUP = "tracker.plugins"
OWN_DISTRIBUTION = "tracker-lab"

MEANINGS: Mapping[str, str] = MappingProxyType(
    {
        "motion": "how a target moves between two instants, and how uncertain that is",
        "sensor": "what is measured of a state from a pose, and with which noise",
        "filter": "carries a belief forward in time and through measurements",
        "smoother": "improves past beliefs with what was measured later",
        "adapter": "re-tunes the noise of motion and sensor from the innovations",
        "optimiser": "searches parameters that make a cost small",
        "gate": "decides which measurements may belong to a track",
        "associator": "shares the measurements of a scan out among the tracks",
        "initiator": "starts tracks from measurements that belong to none",
        "deleter": "ends tracks that are no longer fed",
        "path": "how an observer moves, on a course known beforehand",
        "planner": "chooses where the observer goes",
        "scenario": "targets, sensors and observers of a reproducible situation",
        "metric": "judges estimates against the truth",
        "function": "computes what models and studies are made of; it is called, not set up",
        "reproduction": "remakes the tables and figures of a paper and judges each of its numbers",
    }
)
KINDS: tuple[str, ...] = tuple(MEANINGS)

PAPERS: Mapping[str, str] = MappingProxyType(
    {
        "0": "M. H. Ashtari, H. Ghanbarpour Asl, M. Haghparast: Using Observation Angle Data for "
        "Position Determination of Objects. Accepted 2013.",
        "1": "A. Marvian Mashhad, A. Aminian, A. Karsaz: Estimation of the manoeuvre of several "
        "underwater robots by a two-stage Kalman filter and neural network.",
        "2": "S. E. Razavi, P. Poursoltani, N. Pariz: Optimal observer path in tracking two targets "
        "using bearing measurements. Journal of Intelligent Procedures in Electrical Technology "
        "10 (38), 2019, pp. 33-42.",
        "3": "Y. Norouzi, N. Bayat: Navigation Quality Improvement Using Passive Angle of Arrival "
        "Measurement. Accepted 2017.",
        "4": "A. H. Naseri Salahdar: Passive tracking of a single underwater target using the "
        "extended Kalman filter. MSc thesis, Shahrood University of Technology.",
    }
)
"""The works that "paper 0" to "paper 4" stand for."""

_NAME = re.compile(r"[a-z][a-z0-9_]*")
_TARGET = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")
_TRACEBACK_LINES = 12
_NAMES_SHOWN = 30

T = TypeVar("T")


def _did_you_mean(wrong: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(wrong, list(known), n=1)
    return f"{wrong!r} (did you mean {near[0]!r}?)" if near else repr(wrong)


def _listed(names: Iterable[str]) -> str:
    shown = list(names)
    more = f", ... ({len(shown)} in all)" if len(shown) > _NAMES_SHOWN else ""
    return ", ".join(shown[:_NAMES_SHOWN]) + more if shown else "none at all"


def _check_kind(kind: str, error: type[TrackerError]) -> None:
    if kind not in MEANINGS:
        raise error(
            wording(
                "kind of component",
                got=_did_you_mean(kind, KINDS),
                expected=f"one of {_listed(KINDS)}",
                do="correct the kind",
            )
        )


def _strings(value: Iterable[str]) -> tuple[str, ...]:
    # A bare string is a forgotten comma, and would silently become a tuple of letters.
    if isinstance(value, str):
        raise PluginError(
            wording(
                "several strings",
                got=f"the string {value!r}",
                expected="a tuple of strings",
                do=f"write ({value!r},)",
            )
        )
    return tuple(value)


def _tags(value: Iterable[str]) -> tuple[str, ...]:
    return tuple(sorted(set(_strings(value))))


def _requirements(
    value: Mapping[str, str] | Iterable[str | tuple[str, str]],
) -> tuple[tuple[str, str], ...]:
    if isinstance(value, Mapping):
        return tuple(value.items())
    return tuple((one, one) if isinstance(one, str) else one for one in value)


def _deviations(value: Mapping[str, str]) -> tuple[tuple[str, str], ...]:
    return tuple(dict(value).items())


@attrs.frozen
class Origin:
    """The distribution that a component came with; the version is empty for run-time additions."""

    distribution: str
    version: str = ""

    def __str__(self) -> str:
        return f"{self.distribution} {self.version}".rstrip()


_RUN_TIME = Origin("added at run time")


@attrs.frozen
class Component:
    """One component that a plugin offers: what it is, where it comes from, where its code lives.

    ``target`` is "package.module:attribute", imported when the component is first loaded; ``paper`` is
    the number of one of the project's papers or a citation; ``equations`` says where in it.
    ``requires`` names modules beyond the base dependencies, each with what to ``pip install`` for it.
    ``deviations`` names laws of `tracker.testing` that cannot hold, each with the reason; ``origin`` is
    filled in by the registry.

    Raises:
        PluginError: a field is malformed (unknown kind, a name not in lower_case, ...).

    Example:
    >>> Component(kind="filter", name="half", target="fractions:Fraction", summary="s", paper="0",
    ...           requires={"llvmlite": "tracker-lab[fast]"}).requires
    (('llvmlite', 'tracker-lab[fast]'),)
    """

    kind: str = attrs.field()
    name: str = attrs.field()
    target: str = attrs.field()
    summary: str = attrs.field()
    paper: str = attrs.field()
    equations: tuple[str, ...] = attrs.field(default=(), converter=_strings)
    tags: tuple[str, ...] = attrs.field(default=(), converter=_tags)
    requires: tuple[tuple[str, str], ...] = attrs.field(default=(), converter=_requirements)
    examples: tuple[str, ...] = attrs.field(default=(), converter=_strings)
    deviations: tuple[tuple[str, str], ...] = attrs.field(default=(), converter=_deviations)
    origin: Origin = _RUN_TIME

    def __attrs_post_init__(self) -> None:
        _check_kind(self.kind, PluginError)
        for field, ok, expected in (
            ("name", _NAME.fullmatch(self.name), "lower-case letters, digits and _"),
            ("target", _TARGET.fullmatch(self.target), "'package.module:attribute'"),
            ("summary", self.summary.strip(), "one line that says what it does"),
            ("paper", self.paper.strip(), "a paper's number or a citation"),
        ):
            if not ok:
                raise PluginError(
                    wording(
                        f"{field} of {self}",
                        got=repr(getattr(self, field)),
                        expected=expected,
                        do=f"correct the {field} where the component is registered",
                    )
                )

    def __str__(self) -> str:
        return f"{self.kind} {self.name!r}"

    @property
    def source(self) -> str:
        """Paper and equations, as a person cites them."""
        paper = f"paper {self.paper}" if self.paper.isdigit() else self.paper
        if not self.equations:
            return paper
        numbered = self.equations[0][0] in "(0123456789"  # else it says itself what it is
        return f"{paper}, {'eq. ' if numbered else ''}{', '.join(self.equations)}"

    @property
    def works(self) -> tuple[str, ...]:
        """The papers that `source` names by number, in full."""
        named = dict.fromkeys(re.findall(r"paper (\d)", self.source))
        return tuple(f"paper {number}: {PAPERS[number]}" for number in named if number in PAPERS)

    def missing(self) -> tuple[tuple[str, str], ...]:
        """Those of ``requires`` that cannot be imported here."""
        return tuple(one for one in self.requires if not _importable(one[0]))

    def load(self) -> Any:
        """Import the target and return it, uncalled.

        Raises:
            PluginError: something in ``requires`` is not installed, or the target does not import.
        """
        missing = self.missing()
        if missing:
            installs = " ".join(dict.fromkeys(shlex.quote(install) for _, install in missing))
            modules = ", ".join(module for module, _ in missing)
            message = f"{self} is unavailable: pip install {installs} (it needs {modules})"
            raise PluginError(message)
        module, _, path = self.target.partition(":")
        try:
            found: Any = importlib.import_module(module)
            for attribute in path.split("."):
                found = getattr(found, attribute)
        except Exception as error:  # importing runs arbitrary code of a stranger
            raise PluginError(
                wording(
                    f"{self} of {self.origin}",
                    got=f"{type(error).__name__}: {error}",
                    expected=f"{self.target!r} to be importable",
                    do="repair the plugin, or correct the target where it is registered",
                )
            ) from error
        return found

    def make(self, /, **parameters: object) -> Any:
        """Import the target and call it with the parameters.

        Raises:
            PluginError: as ``load``, or the target cannot be called.
            ConfigError: a parameter is unknown or missing; values are checked by the target.

        Example:
        >>> half = Component(kind="metric", name="half", target="fractions:Fraction", summary="s", paper="0")
        >>> half.make(numerator=1, denominator=2)
        Fraction(1, 2)
        """
        target = self.load()
        if not callable(target):
            raise PluginError(
                wording(
                    f"{self} of {self.origin}",
                    got=f"a {type(target).__name__} at {self.target!r}",
                    expected="a class or a function that makes the component",
                    do="name a callable as target",
                )
            )
        self._check_parameters(target, parameters)
        return target(**parameters)

    def _check_parameters(self, target: Callable[..., object], given: Mapping[str, object]) -> None:
        declared = declared_parameters(target)
        if declared is None:
            return
        accepted = [p.name for p in declared if p.kind is not p.VAR_KEYWORD]
        open_ended = len(accepted) < len(declared)
        unknown = [] if open_ended else [name for name in given if name not in accepted]
        missing = [
            p.name
            for p in declared
            if p.default is p.empty and p.kind is not p.VAR_KEYWORD and p.name not in given
        ]
        if unknown or missing:
            got = (
                "unknown parameter " + ", ".join(_did_you_mean(name, accepted) for name in unknown)
                if unknown
                else "no value for " + ", ".join(missing)
            )
            raise ConfigError(
                wording(
                    str(self),
                    got=got,
                    expected=f"parameters among {_listed(accepted)}"
                    if accepted
                    else "no parameters",
                    do=f"see 'tracker show {self.name}'",
                )
            )


def _importable(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except (ImportError, ValueError):
        return False


@attrs.frozen(kw_only=True)
class PluginReport:
    """What became of one plugin in discovery; ``tracker doctor`` prints these."""

    name: str
    distribution: str
    version: str
    target: str
    status: Literal["loaded", "failed", "blocked", "not pinned"]
    seconds: float = 0.0
    components: int = 0
    cause: str = ""
    traceback: str = ""

    def __str__(self) -> str:
        origin = Origin(self.distribution, self.version)
        return f"{self.name} of {origin}: {self.status}" + (f", {self.cause}" if self.cause else "")


class Registry:
    """Components by kind and name, and what became of the plugins that were to bring them.

    Safe to share between threads: a reader sees all components of a plugin or none.

    Example:
    >>> registry = Registry()
    >>> registry.add(Component(kind="filter", name="kf", target="m:KF", summary="linear", paper="0"))
    >>> [str(component) for component in registry.search(kind="filter", text="LIN")]
    ["filter 'kf'"]
    """

    def __init__(self, origin: Origin = _RUN_TIME) -> None:
        """Start empty; ``origin`` is written into every component added."""
        self._origin = origin
        self._components: dict[tuple[str, str], Component] = {}
        self._reports: dict[tuple[str, str], PluginReport] = {}
        self._lock = threading.RLock()
        self._discovering = False
        self._discovered = False

    def __iter__(self) -> Iterator[Component]:
        return iter(self.search())

    def __len__(self) -> int:
        return len(self._components)

    def __repr__(self) -> str:
        return f"<Registry of {len(self)} components from {len(self._reports)} plugins>"

    @property
    def plugins(self) -> tuple[PluginReport, ...]:
        """What became of each plugin, in the order of discovery."""
        return tuple(self._reports.values())

    def add(self, component: Component) -> None:
        """Make a component known, from a plugin's hook or at run time.

        Raises:
            PluginError: kind and name are taken; adding an equal record again changes nothing.
        """
        self._merge([attrs.evolve(component, origin=self._origin)])

    def register(self, plugin: object, *, origin: Origin | None = None) -> int:
        """Call the hook of a plugin module; add all it offers, or nothing if it raises.

        Returns the number of components added.

        Raises:
            PluginError: the plugin implements no hook, or offers a kind and name that are taken.
            pluggy.PluginValidationError: it implements a hook that does not exist.
        """
        name = getattr(plugin, "__name__", type(plugin).__name__)
        staged = Registry(origin or Origin(name))
        # One manager per plugin: a misspelt hook is then the failure of its own plugin alone.
        manager = pluggy.PluginManager("tracker")
        manager.add_hookspecs(hookspecs)
        manager.register(plugin, name)
        manager.check_pending()
        if not manager.get_hookcallers(plugin):
            raise PluginError(
                wording(
                    f"plugin {name!r}",
                    got="no hook implementation",
                    expected="a function tracker_components(registry) marked @hookimpl",
                    do="see tracker.hookspecs",
                )
            )
        manager.hook.tracker_components(registry=staged)
        self._merge(staged._components.values())
        return len(staged)

    def _merge(self, components: Iterable[Component]) -> None:
        with self._lock:
            merged = dict(self._components)
            for component in components:
                holder = merged.setdefault((component.kind, component.name), component)
                if holder != component:  # equal: a notebook cell run again
                    raise PluginError(
                        wording(
                            f"{component} of {component.origin} ({component.target})",
                            got=f"a name taken by {holder.origin} ({holder.target})",
                            expected=f"one {component.kind} of that name",
                            do="rename one, or block one plugin with TRACKER_PLUGINS_BLOCK",
                        )
                    )
            self._components = merged

    def get(self, kind: str, name: str) -> Component:
        """Return the component of that kind and name.

        Raises:
            UnknownComponent: there is none; suggests the nearest, and names plugins not loaded.
        """
        _check_kind(kind, UnknownComponent)
        try:
            return self._components[kind, name]
        except KeyError:
            raise self._unknown(name, kind) from None

    def find(self, name: str) -> tuple[Component, ...]:
        """Return the components of that name, whatever their kind; at least one.

        Raises:
            UnknownComponent: there is none; suggests the nearest, and names plugins not loaded.
        """
        found = tuple(component for component in self if component.name == name)
        if not found:
            raise self._unknown(name)
        return found

    def _unknown(self, name: str, kind: str | None = None) -> UnknownComponent:
        names = sorted({component.name for component in self.search(kind=kind)})
        elsewhere = [component.kind for component in self if component.name == name]
        message = wording(
            f"name of {a_or_an(kind or 'component')}",
            got=f"{name!r}, which is {' and '.join(map(a_or_an, elsewhere))}"
            if elsewhere
            else _did_you_mean(name, names),
            expected=f"one of {_listed(names)}",
            do=f"correct the name; 'tracker list {kind or ''}".rstrip() + "' shows all",
        )
        absent = "; ".join(str(report) for report in self.plugins if report.status != "loaded")
        return UnknownComponent(message + (f" Plugins not loaded: {absent}." if absent else ""))

    def search(
        self, *, kind: str | None = None, tag: str | None = None, text: str | None = None
    ) -> tuple[Component, ...]:
        """Return the components that match everything given, by kind (as in ``KINDS``) and name.

        ``text`` is looked for in name, summary, paper and tags, without regard to case.

        Raises:
            UnknownComponent: there is no such kind.
        """
        if kind is not None:
            _check_kind(kind, UnknownComponent)
        found = (
            component
            for component in self._components.values()
            if kind in {None, component.kind}
            and (tag is None or tag in component.tags)
            and (text is None or text.casefold() in _text(component))
        )
        return tuple(sorted(found, key=lambda one: (KINDS.index(one.kind), one.name)))

    def discover(
        self,
        *,
        strict: bool | None = None,
        only: Iterable[str] | None = None,
        block: Iterable[str] | None = None,
    ) -> None:
        """Load the installed plugins, each on its own: one that fails is recorded and harms no other.

        Arguments left out come from the environment: ``TRACKER_STRICT_PLUGINS=1`` raises on the first
        failure, ``TRACKER_PLUGINS=a,b`` pins the set, ``TRACKER_PLUGINS_BLOCK=c`` leaves plugins out;
        the names are those of the entry points. Plugins already loaded are kept, so that a second
        call picks up what was installed or repaired since the first.

        Raises:
            PluginError: a pinned or blocked name is not installed, or, if strict, a plugin failed.
        """
        if strict is None:
            strict = os.environ.get("TRACKER_STRICT_PLUGINS", "") not in {"", "0"}
        entry_points = _entry_points()
        pinned = _chosen("TRACKER_PLUGINS", only, entry_points)
        blocked = _chosen("TRACKER_PLUGINS_BLOCK", block, entry_points) or frozenset()
        with self._lock:
            self._discovering = True
            try:
                for entry_point in entry_points:
                    self._load(entry_point, pinned=pinned, blocked=blocked, strict=strict)
            finally:
                self._discovering = False
            self._discovered = True

    def _load(
        self,
        entry_point: EntryPoint,
        *,
        pinned: frozenset[str] | None,
        blocked: frozenset[str],
        strict: bool,
    ) -> None:
        origin = _origin(entry_point.dist)
        key = (entry_point.name, origin.distribution)
        if key in self._reports and self._reports[key].status == "loaded":
            return
        report = PluginReport(
            name=entry_point.name,
            distribution=origin.distribution,
            version=origin.version,
            target=entry_point.value,
            status="loaded",
        )
        if entry_point.name in blocked:
            self._reports[key] = attrs.evolve(report, status="blocked")
            return
        if pinned is not None and entry_point.name not in pinned:
            self._reports[key] = attrs.evolve(report, status="not pinned")
            return
        start = time.perf_counter()
        try:
            added = self.register(entry_point.load(), origin=origin)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # SystemExit in a plugin must not end the program
            cause = f"{type(error).__name__}: {error}"
            tail = "".join(traceback.format_exception(error)).splitlines()[-_TRACEBACK_LINES:]
            failed = attrs.evolve(
                report,
                status="failed",
                seconds=time.perf_counter() - start,
                cause=cause,
                traceback="\n".join(tail),
            )
            self._reports[key] = failed
            if strict:
                raise PluginError(
                    wording(
                        f"plugin {entry_point.name!r} of {origin}",
                        got=cause,
                        expected=f"{entry_point.value!r} to load (strict mode)",
                        do="repair it, block it with TRACKER_PLUGINS_BLOCK, or unset TRACKER_STRICT_PLUGINS",
                    )
                ) from error
        else:
            self._reports[key] = attrs.evolve(
                report, seconds=time.perf_counter() - start, components=added
            )

    def _discover_once(self) -> None:
        # Other threads wait here; a plugin that asks while it is being loaded gets what there is.
        with self._lock:
            if not (self._discovered or self._discovering):
                self.discover()


def _text(component: Component) -> str:
    words = (component.name, component.summary, component.paper, *component.tags)
    return "\n".join(words).casefold()


@functools.cache  # one distribution has many entry points, and reading its metadata is slow
def _origin(distribution: Distribution | None) -> Origin:
    # A damaged installation may lack either (Python 3.15 then raises a FileNotFoundError where it
    # used to answer nothing); that must not stop the other plugins.
    metadata: Any = {}
    with contextlib.suppress(FileNotFoundError):
        metadata = {} if distribution is None else distribution.metadata
    return Origin(metadata.get("Name") or "unknown distribution", metadata.get("Version") or "")


def _entry_points() -> list[EntryPoint]:
    from importlib.metadata import entry_points  # costs 30 ms: only here

    def own_first(entry_point: EntryPoint) -> tuple[bool, str, str]:
        # Of two plugins that claim a name the first keeps it: never let a stranger displace ours.
        distribution = _origin(entry_point.dist).distribution
        return (distribution != OWN_DISTRIBUTION, distribution, entry_point.name)

    return sorted(entry_points(group=GROUP), key=own_first)


def _chosen(
    variable: str, given: Iterable[str] | None, entry_points: Iterable[EntryPoint]
) -> frozenset[str] | None:
    if given is None:
        text = os.environ.get(variable, "")
        if not text.strip():
            return None
        given = (name.strip() for name in text.split(",") if name.strip())
    names = frozenset(_strings(given))
    installed = sorted({entry_point.name for entry_point in entry_points})
    unknown = sorted(names.difference(installed))
    if unknown:
        raise PluginError(
            wording(
                f"plugins named by {variable} or the caller",
                got=", ".join(_did_you_mean(name, installed) for name in unknown),
                expected=f"installed plugins: {_listed(installed)}",
                do="correct the name, or install the plugin",
            )
        )
    return names


_default = Registry()


def default_registry() -> Registry:
    """Return the registry that the facade, the catalogues and the commands use.

    Plugins are discovered on first use, once, whichever thread comes first.

    Raises:
        PluginError: as ``Registry.discover``; the next call tries again.
    """
    _default._discover_once()  # noqa: SLF001 - the module's own
    return _default


def describe_parameters(component: Component) -> tuple[Parameter, ...]:
    """Return name, default, unit and type of each parameter that ``component.make`` takes.

    Raises:
        PluginError: as ``Component.load``.
    """
    return parameters_of(component.load())


@attrs.frozen
class Catalogue(Generic[T]):
    """The components of one kind, typed: ``filters.make("ekf1")`` is a Filter to a type checker too.

    Example:
    >>> gates = Catalogue("gate", Registry)
    >>> gates.names(), "chi_square" in gates
    ((), False)
    """

    kind: str
    registry: Callable[[], Registry] = default_registry

    def make(self, name: str, /, **parameters: object) -> T:
        """Make the component of that name; see ``Component.make``.

        Raises:
            UnknownComponent, PluginError, ConfigError: as ``Registry.get`` and ``Component.make``.
        """
        return cast("T", self[name].make(**parameters))

    def names(self) -> tuple[str, ...]:
        """Return the names that ``make`` accepts, sorted."""
        return tuple(component.name for component in self)

    def __iter__(self) -> Iterator[Component]:
        return iter(self.registry().search(kind=self.kind))

    def __len__(self) -> int:
        return len(self.names())

    def __getitem__(self, name: str) -> Component:
        return self.registry().get(self.kind, name)

    def __contains__(self, name: object) -> bool:
        return name in self.names()

    def __repr__(self) -> str:
        return f"<{self.kind}s: {_listed(self.names())}>"

    def _repr_html_(self) -> str:
        rows = "".join(
            "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>"
            for cells in (
                (one.name, one.summary, " ".join((one.paper, *one.equations)), str(one.origin))
                for one in self
            )
        )
        head = "<tr><th>name</th><th>summary</th><th>source</th><th>origin</th></tr>"
        caption = f"<caption>{self.kind}: {MEANINGS[self.kind]}</caption>"
        return f"<table>{caption}{head}{rows}</table>"


motions: Catalogue[MotionModel] = Catalogue("motion")
sensors: Catalogue[SensorModel] = Catalogue("sensor")
filters: Catalogue[Filter[Any]] = Catalogue("filter")
smoothers: Catalogue[Smoother] = Catalogue("smoother")
adapters: Catalogue[NoiseAdapter[Any]] = Catalogue("adapter")
optimisers: Catalogue[Optimiser[Any]] = Catalogue("optimiser")
gates: Catalogue[Gate] = Catalogue("gate")
associators: Catalogue[Associator] = Catalogue("associator")
initiators: Catalogue[Initiator] = Catalogue("initiator")
deleters: Catalogue[Deleter] = Catalogue("deleter")
paths: Catalogue[ObserverPath] = Catalogue("path")
planners: Catalogue[Planner] = Catalogue("planner")
scenarios: Catalogue[Scenario] = Catalogue("scenario")
metrics: Catalogue[Metric] = Catalogue("metric")
functions: Catalogue[Any] = Catalogue("function")
reproductions: Catalogue[Study] = Catalogue("reproduction")
