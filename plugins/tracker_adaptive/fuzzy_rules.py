"""What a fuzzy rule says, and how it is written and read as text; what it is worth lives elsewhere."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

import attrs

from tracker.errors import DomainError, wording


@attrs.frozen
class Is:
    """``variable is term``."""

    variable: str
    term: str

    def __str__(self) -> str:
        return f"{self.variable} is {self.term}"


@attrs.frozen
class Not:
    """The opposite of a part."""

    part: Antecedent

    def __str__(self) -> str:
        return f"not {_bracketed(self.part)}"


@attrs.frozen
class And:
    """Both parts."""

    left: Antecedent
    right: Antecedent

    def __str__(self) -> str:
        sides = (self.left, self.right)
        return " and ".join(f"({s})" if isinstance(s, Or) else str(s) for s in sides)


@attrs.frozen
class Or:
    """One of the parts, or both."""

    left: Antecedent
    right: Antecedent

    def __str__(self) -> str:
        return f"{self.left} or {self.right}"


Antecedent: TypeAlias = Is | Not | And | Or


def _bracketed(part: Antecedent) -> str:
    return f"({part})" if isinstance(part, (And, Or)) else str(part)


@attrs.frozen
class Rule:
    """``if`` an antecedent holds ``then`` the output is a term, with a weight.

    Example:
    >>> str(Rule(antecedent("quality is poor or service is poor"), "low"))
    'if quality is poor or service is poor then low'
    """

    antecedent: Antecedent
    term: str
    weight: float = 1.0

    def __str__(self) -> str:
        return f"if {self.antecedent} then {self.term}"


def claims(part: Antecedent) -> Iterator[Is]:
    """Every ``variable is term`` of an antecedent."""
    if isinstance(part, Is):
        yield part
    elif isinstance(part, Not):
        yield from claims(part.part)
    else:
        yield from claims(part.left)
        yield from claims(part.right)


def plain(part: Antecedent) -> bool:
    """Whether an antecedent is made with ``and`` alone."""
    if isinstance(part, And):
        return plain(part.left) and plain(part.right)
    return isinstance(part, Is)


def worth(
    part: Antecedent,
    of: Callable[[Is], Any],
    both: Callable[[Any, Any], Any],
    either: Callable[[Any, Any], Any],
) -> Any:
    """What an antecedent is worth, given what its claims are worth and how two combine."""
    if isinstance(part, Is):
        return of(part)
    if isinstance(part, Not):
        return 1.0 - worth(part.part, of, both, either)
    combined = both if isinstance(part, And) else either
    return combined(worth(part.left, of, both, either), worth(part.right, of, both, either))


_WORD = re.compile(r"\(|\)|[^\s()]+")
_KEYWORDS = ("and", "or", "not", "is")


def antecedent(text: str) -> Antecedent:
    """An antecedent from a text such as ``"dom is PS and not (rate is high or rate is low)"``.

    ``not`` binds closest, then ``and``, then ``or``.

    Raises:
        DomainError: if it cannot be read.

    Example:
    >>> str(antecedent("a is low and (b is low or not c is high)"))
    'a is low and (b is low or not c is high)'
    """
    words = _WORD.findall(text)
    at = 0

    def wrong(got: str, expected: str) -> DomainError:
        return DomainError(
            wording(
                f"rule {text!r}",
                got=got,
                expected=expected,
                do='write for example "dom is PS and not rate is high"',
            )
        )

    def peek() -> str:
        return words[at] if at < len(words) else ""

    def take(expected: str) -> str:
        nonlocal at
        word = peek()
        if not word:
            raise wrong("the end of the rule", expected)
        at += 1
        return word

    def name(expected: str) -> str:
        word = take(expected)
        if word in _KEYWORDS or word in {"(", ")"}:
            raise wrong(repr(word), expected)
        return word

    def claim() -> Antecedent:
        if peek() == "not":
            take("not")
            return Not(claim())
        if peek() == "(":
            take("(")
            inner = either()
            closing = take("a closing bracket")
            if closing != ")":
                raise wrong(repr(closing), "'and', 'or' or ')'")
            return inner
        variable = name("the name of an input")
        verb = take("'is'")
        if verb != "is":
            raise wrong(repr(verb), f"'is' after {variable!r}")
        return Is(variable, name(f"a term of {variable!r}"))

    def both() -> Antecedent:
        out = claim()
        while peek() == "and":
            take("and")
            out = And(out, claim())
        return out

    def either() -> Antecedent:
        out = both()
        while peek() == "or":
            take("or")
            out = Or(out, both())
        return out

    found = either()
    if peek():
        raise wrong(repr(peek()), "'and', 'or' or the end of the rule")
    return found
