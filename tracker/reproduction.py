"""What reproducing a paper comes to: its numbers beside ours, its claims, its errata, by stated rules.

A plugin offers a `Study` under the kind "reproduction"; the command `tracker reproduce` runs it and
writes what it found. The values and the rules of verdicts belong here; the mathematics of a paper
belongs in its plugin, the page in `tracker.report.reproduction`.
"""

from __future__ import annotations

import itertools
import math
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, Protocol

import attrs

from tracker.errors import ConfigError, wording
from tracker.metrics.consistency import Interval

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Verdict = Literal["reproduced", "not reproduced", "not comparable"]
Judgement = Literal["confirmed", "refuted", "undecided"]

VERDICTS: tuple[Verdict, ...] = ("reproduced", "not reproduced", "not comparable")
JUDGEMENTS: tuple[Judgement, ...] = ("confirmed", "refuted", "undecided")


# --------------------------------------------------------------------------- what was published
_DIGITS = re.compile(r"(\[\d+\])")


@attrs.frozen
class Published:
    """One number of a paper: ``text`` as printed, in which table or figure, and which cell of it.

    ``runs`` is the number of runs it is a mean of, None where it is not one. A digit that cannot be
    read is written as all it may be in brackets, ``1[25].3``: the number then is one of `values`.

    Example:
    >>> Published("table1/a", "Table 1", "row A", "0.250").rounding
    0.0005
    >>> Published("table1/b", "Table 1", "row B", "1[25].3").values
    (12.3, 15.3)
    """

    id: str
    table: str
    cell: str
    text: str
    runs: int | None = None

    @property
    def values(self) -> tuple[float, ...]:
        """All numbers that it may be, rising; one where every digit can be read."""
        parts = [
            tuple(part[1:-1]) if part.startswith("[") else (part,)
            for part in _DIGITS.split(self.text)
        ]
        return tuple(sorted({float("".join(digits)) for digits in itertools.product(*parts)}))

    @property
    def value(self) -> float:
        """The number; the one in the middle, where it may be several."""
        return self.values[(len(self.values) - 1) // 2]

    def nearest(self, to: float) -> float:
        """Of all numbers that it may be, the one nearest to another; `value` if that is NaN.

        Example:
        >>> Published("table1/b", "Table 1", "row B", "1[25].3").nearest(16.0)
        15.3
        """
        if math.isnan(to):
            return self.value
        return min(self.values, key=lambda value: abs(value - to))

    @property
    def uncertain(self) -> str:
        """In words, that not every digit can be read; '' if every one can."""
        if len(self.values) == 1:
            return ""
        low, high = self.values[0], self.values[-1]
        return (
            f"Printed {self.text}: one of {len(self.values)} numbers from {low:g} to {high:g}, of which "
            "the nearest to ours is given."
        )

    @property
    def rounding(self) -> float:
        """Half a unit of the last digit printed: what the number may be off by rounding alone."""
        plain = _DIGITS.sub("0", self.text)
        mantissa, _, exponent = plain.lower().partition("e")
        return 0.5 * 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


@attrs.frozen
class Erratum:
    """Something misprinted: where, what stands there, what is right, and the test that shows it.

    ``shown_by`` names tests as pytest does, ``tests/file.py::test_name``, several by blanks.
    """

    id: str
    printed: str
    corrected: str
    shown_by: str


@attrs.frozen
class Paper:
    """A paper as data: its published numbers, the words of its claims with the rules, its errata.

    ``claims`` maps an id to (text, rule).
    """

    number: str
    title: str
    published: tuple[Published, ...]
    claims: Mapping[str, tuple[str, str]]
    errata: tuple[Erratum, ...]


def paper_from_toml(text: str, file: str = "paper.toml") -> Paper:
    """The data of a paper, as a TOML file holds them.

    Top level ``paper`` and ``title``; tables ``[[published]]`` (id, table, cell, value as a string
    with all its digits, runs), ``[[claim]]`` (id, text, rule), ``[[erratum]]`` (id, printed,
    corrected, shown_by).

    Raises:
        ConfigError: if something is missing or unknown, or an id is given twice.
    """
    try:
        data = tomllib.loads(text)
        claims = [dict(one) for one in data.get("claim", [])]
        paper = Paper(
            data["paper"],
            data["title"],
            tuple(
                Published(text=one.pop("value"), **one)
                for one in [dict(one) for one in data.get("published", [])]
            ),
            {one["id"]: (one["text"], one["rule"]) for one in claims},
            tuple(Erratum(**one) for one in data.get("erratum", [])),
        )
        for one in paper.published:
            _ = one.value, one.rounding
    except (tomllib.TOMLDecodeError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise ConfigError(
            wording(
                file,
                got=f"{type(error).__name__}: {error}",
                expected="paper, title and the tables published, claim and erratum",
                do="correct the entry; see tracker.reproduction.paper_from_toml",
            )
        ) from error
    ids = [*(p.id for p in paper.published), *(c["id"] for c in claims)]
    for several in (ids, [e.id for e in paper.errata]):
        twice = sorted({one for one in several if several.count(one) > 1})
        if twice:
            raise ConfigError(
                wording(file, got=f"the id {twice[0]!r} twice", expected="one", do="rename one")
            )
    return paper


# ------------------------------------------------------------------------------------ verdicts
@attrs.frozen
class Reading:
    """What one documented reading of an ambiguous paper gives for a number: from ``low`` to ``high``.

    For a number published as a mean of some runs this is where a mean of so many runs lies with
    95 % probability; for a deterministic number it is the number itself, or the ends of a range.
    """

    name: str
    low: float
    high: float

    def gives(self, published: Published) -> bool:
        """Whether the published number, or one that it may be, lies in the range give or take rounding."""
        low, high = self.low - published.rounding, self.high + published.rounding
        return any(low <= value <= high for value in published.values)


@attrs.frozen
class ResultRow:
    """A published number, ours with its interval, and the verdict with its reason.

    ``given_by``: "ours" if the number lies in our interval, else the names of the readings that give it.
    """

    id: str
    published: float
    ours: float
    ci95: tuple[float, float]
    runs: int
    verdict: Verdict
    why: str
    given_by: tuple[str, ...] = ()


def row(
    published: Published,
    ours: Interval,
    runs: int,
    readings: Sequence[Reading] = (),
    *,
    not_comparable: str = "",
    note: str = "",
) -> ResultRow:
    """A row whose verdict follows from the rule of `verdict`; ``note`` is added to the reason."""
    word, why = verdict(published, ours, readings, not_comparable=not_comparable)
    return ResultRow(
        published.id,
        published.nearest(ours.value),
        ours.value,
        (ours.low, ours.high),
        runs,
        word,
        " ".join(part for part in (why, published.uncertain, note) if part),
        _givers(published, ours, readings) if word == "reproduced" else (),
    )


def _givers(published: Published, ours: Interval, readings: Sequence[Reading]) -> tuple[str, ...]:
    if _inside(published, ours):
        return ("ours",)
    return tuple(one.name for one in readings if one.gives(published))


def _inside(published: Published, ours: Interval) -> bool:
    """Whether our interval tells something, being no wider than our value, and holds the number."""
    return _telling(ours) and Reading("ours", ours.low, ours.high).gives(published)


def _telling(ours: Interval) -> bool:
    return ours.high - ours.low <= abs(ours.value)


def verdict(
    published: Published,
    ours: Interval,
    readings: Sequence[Reading] = (),
    *,
    not_comparable: str = "",
) -> tuple[Verdict, str]:
    """The one rule by which a published number is reproduced or not, and the reason in words.

    "reproduced": the number, give or take its own rounding, lies inside the 95 % interval of ours,
    or inside the range that one documented reading of the paper gives. "not comparable": a reason
    why is given, or ours is not a number. "not reproduced": otherwise. An interval of ours that is
    wider than our value itself (a few runs carry the mean) decides nothing; the readings then do.

    Example:
    >>> number = Published("table1/a", "Table 1", "row A", "0.25")
    >>> verdict(number, Interval(0.26, 0.24, 0.28))[0]
    'reproduced'
    >>> verdict(number, Interval(0.36, 0.34, 0.38), [Reading("slow", 0.2, 0.3)])[0]
    'reproduced'
    """
    if not_comparable:
        return "not comparable", not_comparable
    if not math.isfinite(ours.value):
        return "not comparable", "No run of ours gave a finite number."
    interval = f"the 95 % interval of ours, {ours.low:.4g} to {ours.high:.4g}"
    if _inside(published, ours):
        return "reproduced", f"Inside {interval}."
    telling = _telling(ours)
    inside = [one for one in readings if one.gives(published)]
    silent = (
        "" if telling else f"{interval[0].upper()}{interval[1:]}, is too wide to decide anything. "
    )
    if inside:
        named = ", ".join(f"{one.name} ({one.low:.4g} to {one.high:.4g})" for one in inside)
        return "reproduced", f"{silent}Inside the range of reading {named}."
    all_of_them = ", ".join(f"{one.name} {one.low:.4g} to {one.high:.4g}" for one in readings)
    outside = "" if not telling else f"Outside {interval}"
    if not all_of_them:
        if telling:
            return "not reproduced", f"{outside}."
        return "not comparable", silent.rstrip()
    joined = "; outside every reading: " if telling else "Outside every reading: "
    return "not reproduced", f"{silent}{outside}{joined}{all_of_them}."


@attrs.frozen
class Claim:
    """A claim of a paper, the rule it was judged by, what each condition voted, and the evidence.

    ``votes`` maps a condition under which the rule was tried to True, False, or None where the
    runs cannot tell.
    """

    id: str
    text: str
    rule: str
    votes: Mapping[str, bool | None]
    evidence: str

    @property
    def verdict(self) -> Judgement:
        """See `judged`."""
        return judged(self.votes.values())

    @property
    def tally(self) -> str:
        """In words, under which condition the rule holds.

        Example:
        >>> Claim("1", "All is well.", "x < 1", {"A": True, "B": None}, "x = 0.9").tally
        'A: holds; B: cannot be told.'
        """
        said = {True: "holds", False: "does not hold", None: "cannot be told"}
        return "; ".join(f"{name}: {said[vote]}" for name, vote in self.votes.items()) + "."


def judged(votes: Any) -> Judgement:
    """Return "confirmed" if every vote is True, "refuted" if one is False, else "undecided".

    A rule must hold under every condition it names: one under which it does not refutes it, whatever
    the others vote.

    Example:
    >>> judged([True, True]), judged([True, None]), judged([True, False]), judged([])
    ('confirmed', 'undecided', 'refuted', 'undecided')
    """
    words: dict[bool | None, Judgement] = {True: "confirmed", False: "refuted", None: "undecided"}
    return words[all_of(votes)]


def all_of(votes: Any) -> bool | None:
    """Whether every part of a claim holds: False if one does not, None if one cannot be told.

    Example:
    >>> all_of([True, True]), all_of([True, None]), all_of([None, False])
    (True, None, False)
    """
    cast = list(votes)
    if any(vote is False for vote in cast):
        return False
    return True if cast and all(vote is True for vote in cast) else None


def within(interval: Interval, low: float, high: float) -> bool | None:
    """Whether a value lies between two bounds: None where its interval straddles one of them.

    Example:
    >>> within(Interval(2.0, 1.9, 2.1), 1.0, 3.0), within(Interval(2.0, 1.9, 2.1), 2.05, 3.0)
    (True, None)
    """
    if not math.isfinite(interval.low) or not math.isfinite(interval.high):
        return None
    if low <= interval.low and interval.high <= high:
        return True
    return False if interval.high < low or interval.low > high else None


# --------------------------------------------------------------------------------- all together
@attrs.frozen
class Table:
    """A table for the report, beyond the rows that have verdicts."""

    id: str
    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""


@attrs.frozen(eq=False)
class Picture:
    """A figure to be drawn: ``id`` names its file, ``number`` the paper's figure that it remakes.

    ``alternative`` says what it shows to those who cannot see it.
    """

    id: str
    title: str
    caption: str
    alternative: str
    draw: Callable[[], Figure] = attrs.field(repr=False)
    number: str = ""


@attrs.frozen(eq=False, kw_only=True)
class Reproduction:
    """Everything that came out of reproducing a paper; `results` is what ``results.json`` holds.

    ``together`` says in words whether one reading gives every number, or how many at most.
    """

    paper: str
    title: str
    seed: int
    runs: int
    rows: tuple[ResultRow, ...]
    claims: tuple[Claim, ...]
    errata: tuple[Erratum, ...]
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()
    notes: tuple[str, ...] = ()
    together: str = ""

    def results(self, versions: Mapping[str, str]) -> dict[str, Any]:
        """JSON-ready; null where a number is undefined.

        Laws:
            `check_results` accepts it (tests/papers/test_reproduction.py).
        """
        return {
            "paper": self.paper,
            "seed": self.seed,
            "runs": self.runs,
            "versions": dict(versions),
            "rows": [
                {
                    "id": one.id,
                    "published": one.published,
                    "ours": _finite(one.ours),
                    "ci95": [_finite(bound) for bound in one.ci95],
                    "runs": one.runs,
                    "verdict": one.verdict,
                    "why": one.why,
                }
                for one in self.rows
            ],
            "claims": [
                {
                    "id": one.id,
                    "text": one.text,
                    "verdict": one.verdict,
                    "evidence": f"Rule: {one.rule} Found: {one.tally} {one.evidence}",
                }
                for one in self.claims
            ],
            "errata": [
                {
                    "id": one.id,
                    "printed": one.printed,
                    "corrected": one.corrected,
                    "shown_by": one.shown_by,
                }
                for one in self.errata
            ],
        }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


class Study(Protocol):
    """What a component of kind "reproduction" is: the reproduction of one paper.

    Laws: the same runs and seed give the same results; every published number has a row, every
    claim a verdict, every erratum a test.
    """

    @property
    def paper(self) -> Paper:
        """What was published."""
        ...

    @property
    def runs(self) -> int:
        """Runs of a full reproduction."""
        ...

    @property
    def quick_runs(self) -> int:
        """Runs of a quick one, which takes a minute at most."""
        ...

    def run(
        self, *, runs: int, seed: int, quick: bool, progress: Callable[[int, int | None], None]
    ) -> Reproduction:
        """Remake tables, figures and claims; ``progress`` is told how many parts are done."""
        ...


# --------------------------------------------------------------------------------- the schema
_TEXT, _NUMBER = (str,), (int, float)
_SCHEMA: dict[str, dict[str, tuple[type, ...]]] = {
    "rows": {
        "id": _TEXT, "published": _NUMBER, "ours": (*_NUMBER, type(None)), "ci95": (list,),
        "runs": (int,), "verdict": _TEXT, "why": _TEXT,
    },
    "claims": {"id": _TEXT, "text": _TEXT, "verdict": _TEXT, "evidence": _TEXT},
    "errata": {"id": _TEXT, "printed": _TEXT, "corrected": _TEXT, "shown_by": _TEXT},
}  # fmt: skip
_TOP: dict[str, tuple[type, ...]] = {
    "paper": _TEXT, "seed": (int,), "runs": (int,), "versions": (dict,),
    "rows": (list,), "claims": (list,), "errata": (list,),
}  # fmt: skip
_WORDS: dict[str, tuple[str, ...]] = {"rows": VERDICTS, "claims": JUDGEMENTS}


def check_results(results: Any) -> None:
    """Whether something read from a ``results.json`` is what a reproduction writes.

    Raises:
        ConfigError: naming the first place that is not.
    """
    _fields("results", results, _TOP)
    for part, fields in _SCHEMA.items():
        for place, entry in enumerate(results[part]):
            label = f"{part}[{place}]"
            _fields(label, entry, fields)
            if not entry["id"]:
                _wrong(f"{label}.id", "nothing", "a name")
            if part in _WORDS and entry["verdict"] not in _WORDS[part]:
                _wrong(f"{label}.verdict", repr(entry["verdict"]), ", ".join(_WORDS[part]))
    for place, entry in enumerate(results["rows"]):
        bounds = entry["ci95"]
        if len(bounds) != 2 or not all(b is None or isinstance(b, _NUMBER) for b in bounds):
            _wrong(f"rows[{place}].ci95", repr(bounds), "[low, high]")


def _fields(label: str, value: Any, fields: Mapping[str, tuple[type, ...]]) -> None:
    if not isinstance(value, dict) or set(value) != set(fields):
        got = sorted(value) if isinstance(value, dict) else type(value).__name__
        _wrong(label, str(got), f"exactly {', '.join(fields)}")
    for name, types in fields.items():
        if not isinstance(value[name], types) or isinstance(value[name], bool):
            _wrong(
                f"{label}.{name}", repr(value[name])[:60], " or ".join(t.__name__ for t in types)
            )


def _wrong(label: str, got: str, expected: str) -> None:
    raise ConfigError(
        wording(label, got=got, expected=expected, do="write it by Reproduction.results")
    )
