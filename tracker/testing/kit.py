"""How a component is checked against the laws of its kind, and the report of it; no law lives here."""

from __future__ import annotations

import ast
import functools
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import attrs
from hypothesis import strategies as st

from tracker.errors import CapabilityError, DomainError, TrackerError, wording
from tracker.testing.law import KINDS, Law, Regions, laws
from tracker.types import Space

if TYPE_CHECKING:
    import pytest

    from tracker.registry import Component

FLOOR: Mapping[str, int] = MappingProxyType(
    {
        "motion": 10,
        "sensor": 8,
        "filter": 11,
        "smoother": 9,
        "adapter": 14,
        "gate": 8,
        "associator": 10,
        "optimiser": 15,
        "path": 7,
        "metric": 7,
    }
)
"""How many laws must at least have run: what a component without any optional ability meets."""

ENOUGH = "enough laws ran"

_METHODS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "motion": ("space", "f", "Q"),
        "sensor": ("space", "pose_space", "h", "R", "residual"),
        "filter": ("predict", "project", "update"),
        "smoother": ("smooth",),
        "adapter": ("tunes", "begin", "tuned", "adapt"),
        "gate": ("threshold", "admits"),
        "associator": ("associate",),
        "optimiser": ("begin", "ask", "tell"),
        "path": ("pose",),
        "metric": ("score",),
    }
)


def _absent(component: Any, kind: str) -> list[str]:
    return [name for name in _METHODS[kind] if not hasattr(component, name)]


def kind_of(component: Any) -> str:
    """The kind whose protocol a component fulfils.

    Raises:
        DomainError: if it fulfils none, or several.
    """
    kinds = [kind for kind in KINDS if not _absent(component, kind)]
    if len(kinds) != 1:
        raise DomainError(
            wording(
                f"a component of type {type(component).__name__}",
                got=f"the methods of {' and '.join(kinds) or 'no kind that has laws'}",
                expected="; ".join(f"{k}: {', '.join(_METHODS[k])}" for k in kinds or KINDS),
                do="implement one protocol, or say which is meant by kind=...",
            )
        )
    return kinds[0]


@attrs.frozen
class Outcome:
    """What became of one law: 'passed', 'failed', 'expected failure' or 'not applicable', and why."""

    law: str
    status: str
    reason: str = ""


@attrs.frozen
class Report:
    """What the laws say about one component.

    Example:
    >>> from tracker.testing import check_component
    >>> from tracker.testing.textbook import POSITION
    >>> report = check_component(POSITION)
    >>> report.ok, "jacobian" in report.ran, report.failed
    (True, True, ())
    """

    component: str
    kind: str
    outcomes: tuple[Outcome, ...]

    def _laws(self, *statuses: str) -> tuple[str, ...]:
        return tuple(one.law for one in self.outcomes if one.status in statuses)

    @property
    def ok(self) -> bool:
        """Whether nothing failed that was not expected to."""
        return not self.failed

    @property
    def passed(self) -> tuple[str, ...]:
        """Laws that hold."""
        return self._laws("passed")

    @property
    def ran(self) -> tuple[str, ...]:
        """Laws that were tried, whatever came of it."""
        tried = self._laws("passed", "failed", "expected failure")
        return tuple(law for law in tried if law != ENOUGH)

    @property
    def failed(self) -> tuple[str, ...]:
        """Laws that are broken; also those that hold although they were expected not to."""
        return self._laws("failed")

    @property
    def expected_failures(self) -> tuple[str, ...]:
        """Laws that are broken, as was said they would be."""
        return self._laws("expected failure")

    @property
    def not_applicable(self) -> tuple[str, ...]:
        """Laws that ask for what the component does not offer."""
        return self._laws("not applicable")

    def __str__(self) -> str:
        head = (
            f"{self.kind} {self.component}: {len(self.passed)} of {len(self.ran)} laws hold, "
            f"{len(self.failed)} broken, {len(self.expected_failures)} broken as expected, "
            f"{len(self.not_applicable)} not applicable"
        )
        rest = [one for one in self.outcomes if one.status != "passed"]
        return "\n".join([head, *(f"  {one.law}: {one.status}: {one.reason}" for one in rest)])


@attrs.frozen
class Check:
    """One law as a test calls it: ``check(component)``."""

    law: str
    regions: Regions = attrs.field(repr=False)
    kind: str = ""

    def __call__(self, component: Any) -> None:
        """Raise AssertionError if the component breaks the law."""
        kind = self.kind or kind_of(component)
        if self.law == ENOUGH:
            _enough(kind, [one for one in laws(kind) if not one.why_not(component)])
            return
        found = next(one for one in laws(kind) if one.name == self.law)
        found.examine(component, self.regions)


def _enough(kind: str, ran: list[Law]) -> None:
    assert len(ran) >= FLOOR[kind], (
        f"only {len(ran)} laws of kind {kind!r} ran, at least {FLOOR[kind]} must: laws that are "
        "skipped prove nothing"
    )


def _known(expected: Mapping[str, str], kinds: Iterable[str]) -> None:
    names = {law.name for kind in kinds for law in laws(kind)}
    for name, reason in expected.items():
        if name not in names or not reason.strip():
            raise DomainError(
                wording(
                    "expected_failures",
                    got=f"{name!r}: {reason!r}",
                    expected=f"a reason for a law among {', '.join(sorted(names))}",
                    do="correct the name of the law, or say why it cannot hold",
                )
            )


def check_component(
    component: Any,
    kind: str | None = None,
    expected_failures: Mapping[str, str] | None = None,
    *,
    states: st.SearchStrategy[Any] | None = None,
    poses: st.SearchStrategy[Any] | None = None,
) -> Report:
    """Try every law of the component's kind and report what became of each.

    ``expected_failures`` maps laws that cannot hold to the reason; one that holds nevertheless, or
    does not apply, counts as failed: the excuse is out of date. ``states`` and ``poses`` draw
    single states ``(n,)`` and poses ``(p,)`` where the component is at home, if that is not within
    a few kilometres and some tens of metres per second.

    Raises:
        DomainError: if the kind cannot be told, or an expected failure names no law.

    Example:
    >>> from tracker.testing.textbook import MOTION
    >>> print(str(check_component(MOTION)).splitlines()[0])
    motion constant velocity: ... laws hold, 0 broken, 0 broken as expected, 1 not applicable
    """
    kind = kind or kind_of(component)
    excuses = dict(expected_failures or {})
    _known(excuses, [kind])
    if _absent(component, kind):
        raise DomainError(
            wording(
                f"{kind} {_label(component)!r}",
                got=f"nothing called {', '.join(_absent(component, kind))}",
                expected=f"the protocol of kind {kind!r} in tracker/protocols.py",
                do="implement it, or name the right kind",
            )
        )
    regions, ran, outcomes = Regions(states, poses), [], []
    for law in laws(kind):
        why = law.why_not(component)
        if not why:
            ran.append(law)
        outcomes.append(_outcome(law, component, regions, why, excuses.get(law.name, "")))
    try:
        _enough(kind, ran)
    except AssertionError as error:
        outcomes.append(Outcome(ENOUGH, "failed", str(error)))
    return Report(_label(component), kind, tuple(outcomes))


def _outcome(law: Law, component: Any, regions: Regions, why: str, excuse: str) -> Outcome:
    if why:
        if excuse:
            told = (
                f"expected to fail ({excuse}), but does not even apply ({why}): take the excuse out"
            )
            return Outcome(law.name, "failed", told)
        return Outcome(law.name, "not applicable", why)
    try:
        law.examine(component, regions)
    except AssertionError as error:
        return Outcome(law.name, "expected failure", excuse) if excuse else Outcome(
            law.name, "failed", str(error)
        )  # fmt: skip
    if excuse:
        told = f"expected to fail ({excuse}), but holds: take the excuse out"
        return Outcome(law.name, "failed", told)
    return Outcome(law.name, "passed")


def _label(component: Any) -> str:
    name = getattr(component, "name", None)
    return name if isinstance(name, str) else type(component).__name__


def parametrize_checks(
    components: Iterable[Any],
    expected_failures: Mapping[str, str] | None = None,
    *,
    kind: str | None = None,
    states: st.SearchStrategy[Any] | None = None,
    poses: st.SearchStrategy[Any] | None = None,
) -> pytest.MarkDecorator:
    """One test per component and law, and one that enough laws ran; arguments as `check_component`.

    Laws that do not apply make no test; an expected failure is a strict xfail.

    Example:
    >>> from tracker.testing.textbook import POSITION
    >>> @parametrize_checks([POSITION])
    ... def test_conforms(component, check):
    ...     check(component)
    """
    import pytest

    components = list(components)
    excuses = dict(expected_failures or {})
    _known(excuses, [kind or kind_of(one) for one in components])
    regions, rows = Regions(states, poses), []
    for one in components:
        its = kind or kind_of(one)
        names = [law.name for law in laws(its) if law.name in excuses or not law.why_not(one)]
        for name in (*names, ENOUGH):
            marks = (
                [pytest.mark.xfail(reason=excuses[name], strict=True)] if name in excuses else []
            )
            check = Check(name, regions, its)
            rows.append(pytest.param(one, check, id=f"{_label(one)}: {name}", marks=marks))
    return pytest.mark.parametrize(("component", "check"), rows)


# ------------------------------------------------------------------------------- registry
def from_record(record: Component) -> Any:
    """The component that a registry's record describes, made from its defaults or its first example.

    An example reads ``name(parameter=value, ...)`` with numbers, texts, lists, ``Space.of(...)`` and
    other components of the registry as values; it is read so, and never evaluated.

    Raises:
        CapabilityError: if neither makes one.
    """
    from tracker.registry import describe_parameters

    if not any(parameter.required for parameter in describe_parameters(record)):
        return _made(record, record.make)
    for example in record.examples:
        try:
            call = ast.parse(example, mode="eval").body
        except SyntaxError:
            continue
        return _made(record, functools.partial(_value, call, record))
    raise CapabilityError(
        wording(
            str(record),
            got="parameters without defaults, and no example",
            expected=f"an example such as '{record.name}(sigma=0.01)' in its record",
            do="add one, or check it in Python: tracker.testing.check_component(component)",
        )
    )


def _made(record: Component, make: Callable[[], Any]) -> Any:
    try:
        return make()
    except TrackerError:
        raise
    except Exception as error:
        told = f"{record} cannot be made: {type(error).__name__}: {error}"
        raise CapabilityError(told) from error


def _value(node: ast.expr, record: Component) -> Any:
    """What a part of an example stands for, in the little language of `from_record`."""
    if isinstance(node, (ast.List, ast.Tuple)):
        return [_value(element, record) for element in node.elts]
    if not isinstance(node, ast.Call):
        return ast.literal_eval(node)
    positional = [_value(one, record) for one in node.args]
    keywords = {str(one.arg): _value(one.value, record) for one in node.keywords}
    name = ast.unparse(node.func)
    if name == "Space.of":
        return Space.of(*positional)
    if name == record.name:
        return record.load()(*positional, **keywords)
    from tracker.registry import default_registry

    (other,) = default_registry().find(name)
    return other.load()(*positional, **keywords)


def check_record(record: Component) -> Report:
    """Check the component that a registry's record describes, with the deviations it declares.

    Raises:
        CapabilityError: if its kind has no laws yet, or it cannot be made from its record.
    """
    if record.kind not in KINDS:
        raise CapabilityError(
            wording(
                f"{record.kind} {record.name!r}",
                got=f"kind {record.kind!r}, for which there are no laws yet",
                expected=f"one of {', '.join(KINDS)}",
                do="test it by hand",
            )
        )
    return check_component(from_record(record), record.kind, dict(record.deviations))


def outcomes(record: Component) -> list[tuple[str, str, str]]:
    """Law, status and reason of each law for a registry's record, as commands print them."""
    return [(one.law, one.status, one.reason) for one in check_record(record).outcomes]
