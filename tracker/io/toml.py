"""TOML in which every value knows its line, and refusals that name file, line and path.

What the keys of a file mean belongs to the module that reads it. A file is data: nothing in it is
evaluated, imported or opened here.
"""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from collections.abc import Collection, Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import attrs

from tracker.errors import ConfigError, wording

Place: TypeAlias = tuple[str | int, ...]
"""Where a value is: names of keys, and numbers of list entries counted from 0."""

MOST_BYTES = 64 * 1024
DEEPEST = 16
LARGEST = 1e15
LONGEST = 1000

# Any text is covered: what is no TOML at all becomes words, and strings left open end with their line.
_TOKENS = re.compile(
    r"""
    (?P<string> \"{3}(?:[^\\]|\\.)*?(?:\"{3,5}|\Z) | '{3}.*?(?:'{3,5}|\Z)
              | "(?:[^"\\\n]|\\[^\n])*"? | '[^'\n]*'? )
  | (?P<comment> \#[^\n]* )
  | (?P<newline> \n )
  | (?P<mark> [\[\]{}=,.] )
  | (?P<word> [^\s\[\]{}=,.\#"']+ )
    """,
    re.VERBOSE | re.DOTALL,
)
_AT = re.compile(r"\s*\(at (?:line (?P<line>\d+), column \d+|end of document)\)$")
_BARE = re.compile(r"[A-Za-z0-9_-]+")


@attrs.frozen
class _Token:
    kind: str
    text: str
    line: int


@attrs.frozen(eq=False)
class Table:
    """One table of a file, and the only way to its values: each is asked for by type and range.

    Raises:
        ConfigError: from every method, where the file does not hold what is asked for.

    Example:
    >>> table = parse("sigma = 2.5 # m", "scene.toml")
    >>> table.number("sigma", above=0.0, unit="m")
    2.5
    >>> table.only("sigam")
    Traceback (most recent call last):
    tracker.errors.ConfigError: scene.toml:1: sigma: unknown key; did you mean "sigam"? (this file takes: sigam)
    """

    file: str
    place: Place
    values: Mapping[str, Any]
    lines: Mapping[Place, int]

    def line(self, *within: str | int) -> int:
        """Line of a value, or of the nearest table around it."""
        place = (*self.place, *within)
        while place and place not in self.lines:
            place = place[:-1]
        return self.lines.get(place, 1)

    def where(self, *within: str | int) -> str:
        """``file:line: path``, with which every refusal begins."""
        path = path_text((*self.place, *within))
        return f"{self.file}:{self.line(*within)}" + (f": {path}" if path else "")

    def error(self, *within: str | int, got: str, expected: str, do: str) -> ConfigError:
        """The error to raise about a value of this table."""
        return ConfigError(wording(self.where(*within), got=got, expected=expected, do=do))

    def unknown(
        self, *within: str | int, name: str, kind: str, known: Collection[str]
    ) -> ConfigError:
        """The error to raise about a name that is none of ``known``."""
        near = difflib.get_close_matches(name, known, n=1) if len(name) <= LONGEST else []
        hint = f'; did you mean "{near[0]}"?' if near else ""
        there = f"there are: {', '.join(known)}" if known else "there are none"
        return ConfigError(f"{self.where(*within)}: unknown {kind} {shown(name)}{hint} ({there})")

    def only(self, *known: str, owner: str = "") -> None:
        """Refuse keys other than ``known``; ``owner`` is what takes them."""
        for key in self.values:
            if key not in known:
                near = difflib.get_close_matches(key, known, n=1) if len(key) <= LONGEST else []
                hint = f'; did you mean "{near[0]}"?' if near else ""
                taker = owner or (path_text(self.place) if self.place else "this file")
                takes = f"takes: {', '.join(known)}" if known else "takes no keys"
                raise ConfigError(f"{self.where(key)}: unknown key{hint} ({taker} {takes})")

    def value(self, key: str, expected: str) -> Any:
        """Whatever stands at ``key``, which must be there."""
        if key not in self.values:
            raise self.error(got=f'no "{key}"', expected=expected, do=f'add "{key}"')
        return self.values[key]

    def text(self, key: str, *, expected: str = "a text", default: str | None = None) -> str:
        """A text of one line."""
        if default is not None and key not in self.values:
            return default
        value = self.value(key, expected)
        if not isinstance(value, str):
            raise self.error(key, got=shown(value), expected=expected, do="write it in quotes")
        if not value.strip() or len(value) > LONGEST or not value.isprintable():
            raise self.error(
                key,
                got=shown(value),
                expected=f"{expected}: 1 to {LONGEST} printable characters on one line",
                do="shorten it, or take out what cannot be printed",
            )
        return value

    def number(
        self, key: str, *, above: float = -LARGEST, to: float = LARGEST, unit: str = ""
    ) -> float:
        """A finite number in ``(above, to]``."""
        expected = f"a number{f' [{unit}]' * bool(unit)}{_range(above, to)}"
        value = self.value(key, expected)
        number = as_number(value)
        if number is None or not above < number <= to:
            raise self.error(
                key, got=shown(value), expected=expected, do="check sign, size and unit"
            )
        return number

    def numbers(
        self, key: str, count: int, *, above: float = -LARGEST, of: str = ""
    ) -> tuple[float, ...]:
        """A list of ``count`` finite numbers, each greater than ``above``."""
        expected = f"a list of {count} numbers{_range(above, LARGEST)}{f' ({of})' * bool(of)}"
        values = self.value(key, expected)
        if not isinstance(values, list) or len(values) != count:
            raise self.error(
                key, got=shown(values), expected=expected, do="give one number for each"
            )
        numbers = [as_number(value) for value in values]
        for place, number in enumerate(numbers):
            if number is None or not above < number <= LARGEST:
                raise self.error(
                    key,
                    place,
                    got=shown(values[place]),
                    expected=f"a number{_range(above, LARGEST)}",
                    do="check sign and unit",
                )
        return tuple(number for number in numbers if number is not None)

    def texts(self, key: str, *, expected: str, most: int = 100) -> tuple[str, ...]:
        """A list of distinct texts, at least one."""
        values = self.value(key, expected)
        if not isinstance(values, list) or not 0 < len(values) <= most:
            raise self.error(key, got=shown(values), expected=expected, do="write a list of texts")
        for place, value in enumerate(values):
            if not isinstance(value, str) or value in values[:place]:
                got = shown(value) + (" again" if isinstance(value, str) else "")
                raise self.error(
                    key, place, got=got, expected=expected, do="name each once, in quotes"
                )
        return tuple(values)

    def table(self, key: str, *, expected: str = "a table") -> Table:
        """The table at ``key``."""
        value = self.value(key, expected)
        if not isinstance(value, dict):
            raise self.error(
                key,
                got=shown(value),
                expected=expected,
                do=f"write [{path_text((*self.place, key))}]",
            )
        return attrs.evolve(self, place=(*self.place, key), values=value)

    def tables(self, key: str, *, expected: str, most: int = 20) -> tuple[Table, ...]:
        """The list of tables at ``key``, at least one."""
        values = self.value(key, expected)
        path = path_text((*self.place, key))
        if not isinstance(values, list) or not 0 < len(values) <= most:
            raise self.error(key, got=shown(values), expected=expected, do=f"write [[{path}]]")
        for place, value in enumerate(values):
            if not isinstance(value, dict):
                raise self.error(
                    key, place, got=shown(value), expected="a table", do=f"write [[{path}]]"
                )
        return tuple(
            attrs.evolve(self, place=(*self.place, key, place), values=value)
            for place, value in enumerate(values)
        )


def path_text(place: Sequence[str | int]) -> str:
    """A place as a person writes it.

    Example:
    >>> path_text(("filters", 1, "alpha"))
    'filters[1].alpha'
    """
    text = ""
    for part in place:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            name = part if _BARE.fullmatch(part) and len(part) <= LONGEST else shown(part)
            text += f".{name}" if text else name
    return text


def shown(value: object) -> str:
    """A value in few characters, whatever it is."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int) and value.bit_length() > 64:
        return f"a whole number of {value.bit_length()} bits"
    if isinstance(value, int | float):
        return str(value)
    if isinstance(value, str):
        return repr(value if len(value) <= 60 else f"{value[:57]}...")
    if isinstance(value, list):
        return f"a list of {len(value)}"
    return "a table" if isinstance(value, dict) else f"{value} (a date or time)"


def as_number(value: object) -> float | None:
    """``value`` as a float, or None if it is no finite number of reasonable size."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    if isinstance(value, int) and value.bit_length() > 64:
        return None
    number = float(value)
    return number if math.isfinite(number) and abs(number) <= LARGEST else None


def _range(above: float, to: float) -> str:
    low = f" > {above:g}" if above > -LARGEST else ""
    return low + (f" up to {to:g}" if to < LARGEST else "")


# --------------------------------------------------------------------------------- the reader
def read(file: str | Path) -> Table:
    """Read a file.

    Raises:
        ConfigError: if it is missing, no file, not UTF-8, too large, or not TOML.
    """
    name = str(file)
    expected = f"a TOML file of at most {MOST_BYTES // 1024} KiB"
    try:
        path = Path(name)
        if not path.is_file():
            got = "a folder" if path.is_dir() else "no such file"
            raise ConfigError(wording(name, got=got, expected=expected, do="correct the path"))
        with path.open("rb") as stream:
            content = stream.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(
            wording(repr(name), got=str(error), expected=expected, do="check path and permissions")
        ) from None
    if len(content) > MOST_BYTES:
        raise ConfigError(
            wording(
                name, got="a larger file", expected=expected, do="keep data in files of their own"
            )
        )
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = 1 + content.count(b"\n", 0, error.start)
        raise ConfigError(
            wording(
                f"{name}:{line}",
                got=f"byte 0x{content[error.start]:02x}",
                expected="text in UTF-8",
                do="save the file as UTF-8",
            )
        ) from None
    return parse(text, name)


def parse(text: str, file: str = "config") -> Table:
    """Read a text; ``file`` is how errors call it.

    Raises:
        ConfigError: if the text is not TOML, or nested absurdly.
    """
    text = text.replace("\r\n", "\n")
    tokens = _tokens(text)
    _refuse_depth(tokens, file)
    try:
        values = tomllib.loads(text)
        lines: dict[Place, int] = {}
        for place, line in _located(tokens):
            lines.setdefault(place, line)
    except RecursionError:
        raise _too_deep(file, 1) from None
    except (
        ValueError
    ) as error:  # tomllib's own, and Python's about whole numbers beyond 4300 digits
        message = str(error)
        at = _AT.search(message)
        line = int(at["line"] or tokens[-1].line) if at else _line_of_longest_word(tokens)
        raise ConfigError(
            wording(
                f"{file}:{line}",
                got=f"text that is no TOML ({_AT.sub('', message).partition(';')[0][:200]})",
                expected="key = value or [table]",
                do="see https://toml.io for how it is written",
            )
        ) from None
    return Table(file, (), values, lines)


def _too_deep(file: str, line: int) -> ConfigError:
    return ConfigError(
        wording(
            f"{file}:{line}",
            got="deeper nesting",
            expected=f"at most {DEEPEST} brackets or dots deep",
            do="flatten it",
        )
    )


def _tokens(text: str) -> list[_Token]:
    tokens, line, past = [], 1, 0
    for match in _TOKENS.finditer(text):
        line += text.count("\n", past, match.start())
        past = match.start()
        kind = match.lastgroup or ""
        if kind != "comment":
            tokens.append(_Token(kind, match.group(), line))
    return [*tokens, _Token("newline", "\n", line)]


def _refuse_depth(tokens: Sequence[_Token], file: str) -> None:
    # Before tomllib, which takes minutes over a key of a thousand dots and dies of a thousand brackets.
    depth = dots = 0
    for token in tokens:
        if token.text in {"[", "{"}:
            depth += 1
        elif token.text in {"]", "}"}:
            depth = max(depth - 1, 0)
        if token.text == ".":
            dots += 1
        elif token.kind not in {"word", "string"}:
            dots = 0
        if depth > DEEPEST or dots > DEEPEST:
            raise _too_deep(file, token.line)


def _line_of_longest_word(tokens: Sequence[_Token]) -> int:
    return max(tokens, key=lambda token: len(token.text) * (token.kind == "word")).line


# -------------------------------------------------------------------------------- the locator
def _located(tokens: Sequence[_Token]) -> Iterator[tuple[Place, int]]:
    """Each place with its line, from the tokens of a text that tomllib has accepted."""
    entries: dict[Place, int] = {}
    table: Place = ()
    at = 0
    while at < len(tokens):
        token = tokens[at]
        if token.kind == "newline":
            at += 1
        elif token.text == "[":
            several = tokens[at + 1].text == "["
            parts, at = _key(tokens, at + 1 + several)
            table = _resolved(parts[:-1], entries)
            table = (*table, parts[-1]) if several else _resolved(parts, entries)
            if several:
                entries[table] = entries.get(table, -1) + 1
                if not entries[table]:
                    yield table, token.line
                table = (*table, entries[table])
            yield table, token.line
            at += 1 + several
        else:
            at = yield from _pair(tokens, at, table)


def _resolved(parts: Sequence[str], entries: Mapping[Place, int]) -> Place:
    place: Place = ()
    for part in parts:
        place = (*place, part)
        if place in entries:
            place = (*place, entries[place])
    return place


def _key(tokens: Sequence[_Token], at: int) -> tuple[list[str], int]:
    """The parts of a dotted key, and the index of the token behind it."""
    parts = []
    while True:
        token = tokens[at]
        quoted = token.kind == "string"
        parts.append(next(iter(tomllib.loads(f"{token.text} = 0"))) if quoted else token.text)
        if tokens[at + 1].text != ".":
            return parts, at + 1
        at += 2


def _pair(
    tokens: Sequence[_Token], at: int, table: Place
) -> Generator[tuple[Place, int], None, int]:
    line = tokens[at].line
    parts, at = _key(tokens, at)
    place = table
    for part in parts:
        place = (*place, part)
        yield place, line
    return (yield from _value(tokens, at + 1, place))


def _value(
    tokens: Sequence[_Token], at: int, place: Place
) -> Generator[tuple[Place, int], None, int]:
    opened = tokens[at].text
    if opened not in {"[", "{"}:
        while tokens[at].kind != "newline" and tokens[at].text not in {",", "]", "}"}:
            at += 1
        return at
    at += 1
    entry = 0
    while tokens[at].text not in {"]", "}"}:
        if tokens[at].kind == "newline" or tokens[at].text == ",":
            at += 1
        elif opened == "[":
            yield (*place, entry), tokens[at].line
            at = yield from _value(tokens, at, (*place, entry))
            entry += 1
        else:
            at = yield from _pair(tokens, at, place)
    return at + 1
