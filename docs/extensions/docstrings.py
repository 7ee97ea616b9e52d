"""Reads the house docstrings: sections such as "Shapes:" and "Raises:", examples as doctests."""

import re
from typing import Any

_SECTION = re.compile(
    r"^(?P<title>Args|Numbers|Shapes|Units|Raises|Returns|References?|Laws?|Examples?|Notes?):\s*(?P<rest>.*)$"
)
_ENTRIES = {
    "Raises": re.compile(r"[A-Z]\w+(, [A-Z]\w+)*: "),
    "Args": re.compile(r"[a-z_]\w*(, [a-z_]\w*)*: "),
    "Numbers": re.compile(r"[a-z_]\w*(, [a-z_]\w*)*: "),
}
"""How an entry of these sections begins."""
_CODE = re.compile(r"(``.*?``|`[^`]*`)")


def escaped(line: str) -> str:
    """The line with stray mark-up made plain outside of code: (T, *batch) holds no emphasis."""
    bullet = re.match(r"\s*\* ", line)
    head = bullet.group() if bullet else ""
    parts = _CODE.split(line[len(head) :])
    for i in range(0, len(parts), 2):
        parts[i] = re.sub(r"([*|])", r"\\\1", parts[i])
        parts[i] = re.sub(r"(\w)_(?=\W|$)", r"\1\\_", parts[i])
    return head + "".join(parts)


def translated(lines: list[str]) -> list[str]:
    """House docstring to reStructuredText: a section becomes a term with its definition."""
    out: list[str] = []
    inside = False  # a section, which ends at the next blank line
    literal = False  # an indented block after "::"
    title = ""
    for line in lines:
        text = line.strip()
        section = _SECTION.match(line)
        if section:
            inside, literal, title = True, False, section["title"]
            out += ["", title]
            if section["rest"]:
                out.append("    " + escaped(section["rest"]))
        elif not text:
            inside = False
            out.append("")
        elif inside:
            if title in _ENTRIES and _ENTRIES[title].match(text):
                out.append("")  # each is a paragraph
            out.append("    " + (line if title.startswith("Example") else escaped(text)))
        else:
            literal = literal and line.startswith(" ")
            out.append(line if literal or text.startswith(">>>") else escaped(line))
            literal = literal or text.endswith("::")
    return [*out, ""]


def _process(_app: Any, _what: str, _name: str, _it: Any, _options: Any, lines: list[str]) -> None:
    lines[:] = translated(lines)


# Sphinx knows some aliases only by what they stand for.
_ALIASES = (
    (re.compile(r"TypeAliasForwardRef\('(\w+)'\)"), r"\1"),
    (re.compile(r"(?:\w+\.)*ndarray\[tuple\[(?:\w+\.)*Any, \.\.\.\], (?:\w+\.)*dtype\[(?:\w+\.)*float64\]\]"), "Array"),
)  # fmt: skip


def short(signature: str | None) -> str | None:
    """The signature with arrays called Array, as in the source."""
    for pattern, name in _ALIASES:
        signature = pattern.sub(name, signature) if signature else signature
    return signature


def _process_signature(
    _app: Any, _what: str, _name: str, _it: Any, _options: Any, arguments: str | None, result: str | None
) -> tuple[str | None, str | None]:  # fmt: skip
    return short(arguments), short(result)


def setup(app: Any) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", _process)
    app.connect("autodoc-process-signature", _process_signature)
    return {"parallel_read_safe": True}
