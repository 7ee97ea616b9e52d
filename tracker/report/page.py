"""One HTML page from tables, paragraphs and pictures, all of it escaped; no subject's words belong here.

A page loads nothing: its content policy forbids the network, scripts and every style but its own. What
is not yet HTML is ``str`` and is escaped by whoever takes it; what is HTML already is ``Markup``.
"""

from __future__ import annotations

import base64
import hashlib
import html
import re
from collections.abc import Iterable, Sequence
from typing import NewType

Markup = NewType("Markup", str)
"""A piece of HTML made by a function of this module: the only thing that is not escaped again."""

_STYLE = """
:root { color-scheme: light dark; --ink: #1b2530; --paper: #ffffff; --quiet: #5b6875; --rule: #d5dbe1;
  --head: #f1f4f7; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e9ee; --paper: #12181f; --quiet: #9aa7b4; --rule: #35414d; --head: #1c252e; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 62rem; padding: 1.2rem clamp(0.8rem, 3vw, 2rem) 4rem;
  font: 16px/1.55 system-ui, "Segoe UI", Roboto, "Helvetica Neue", "DejaVu Sans", sans-serif;
  color: var(--ink); background: var(--paper); overflow-wrap: anywhere; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 1rem 0 0.3rem; }
h2 { font-size: 1.2rem; margin: 2.4rem 0 0.6rem; padding-top: 0.8rem; border-top: 1px solid var(--rule); }
p { margin: 0.6rem 0; max-width: 46rem; }
ul { padding-left: 1.2rem; max-width: 46rem; }
table { border-collapse: collapse; font-size: 0.92rem; font-variant-numeric: tabular-nums;
  overflow-wrap: normal; }
figcaption { color: var(--quiet); font-size: 0.9rem; padding-top: 0.4rem; max-width: 46rem; }
th, td { padding: 0.32rem 0.6rem; border-bottom: 1px solid var(--rule); text-align: left;
  vertical-align: top; }
th { background: var(--head); font-weight: 600; }
.number { text-align: right; }
.number, .short { white-space: nowrap; }
td:not([class]) { min-width: 14rem; }
figure { margin: 1.2rem 0 1.8rem; max-width: 46rem; }
figure.wide { max-width: none; }
.wide > div { overflow-x: auto; }
img { display: block; width: 100%; height: auto; background: #ffffff; border: 1px solid var(--rule);
  border-radius: 4px; }
"""
_SHORT = 24
_NUMBER = re.compile(
    r"[-+\u2212]?\d[\d.,]*(e[-+]?\d+)?(\s?(%|m|s|ms|\u00b5s|rad))?|\u2013|nan", re.IGNORECASE
)


def page(title: str, sections: Iterable[tuple[str, Sequence[Markup]]]) -> str:
    """A whole page; a section is a heading, which may be empty, and its pieces.

    Laws:
        Nothing given as text becomes markup (tests/report/test_page.py).

    Example:
    >>> "Boats &amp; bearings" in page("Boats & bearings", [("", [text("Well.")])])
    True
    """
    digest = base64.b64encode(hashlib.sha256(_STYLE.encode()).digest()).decode()
    policy = (
        f"default-src 'none'; img-src data:; style-src 'sha256-{digest}'; "
        "base-uri 'none'; form-action 'none'"
    )
    body = "\n".join(
        (f"<h2>{html.escape(heading)}</h2>\n" if heading else "") + "\n".join(pieces)
        for heading, pieces in sections
    )
    name = html.escape(title)
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="referrer" content="no-referrer">
<title>{name}</title>
<style>{_STYLE}</style>
</head>
<body>
<h1>{name}</h1>
{body}
</body>
</html>
"""


def text(words: str) -> Markup:
    """A paragraph."""
    return Markup(f"<p>{html.escape(words)}</p>")


def points(several: Iterable[str]) -> Markup:
    """A list of points."""
    return Markup(f"<ul>{''.join(f'<li>{html.escape(one)}</li>' for one in several)}</ul>")


def table(head: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "") -> Markup:
    """A table; columns that hold nothing but numbers are set flush right."""
    body = [list(row) for row in rows]
    columns = list(zip(*body, strict=True)) if body else [()] * len(head)
    classes = [_kind(column) for column in columns]

    def row(tag: str, cells: Sequence[str]) -> str:
        return "".join(
            f"<{tag}{kind}>{html.escape(cell)}</{tag}>"
            for kind, cell in zip(classes, cells, strict=True)
        )

    lines = "\n".join(f"<tr>{row('td', cells)}</tr>" for cells in body)
    said = f"<figcaption>{html.escape(caption)}</figcaption>" if caption else ""
    return Markup(
        f'<figure class="wide"><div><table><thead><tr>{row("th", head)}</tr></thead>\n'
        f"<tbody>{lines}</tbody></table></div>{said}</figure>"
    )


def _kind(column: Sequence[str]) -> str:
    if column and all(map(_NUMBER.fullmatch, column)):
        return ' class="number"'
    return ' class="short"' if all(len(cell) <= _SHORT for cell in column) else ""


def figure(picture: bytes, caption: str, alternative: str) -> Markup:
    """A picture, SVG or PNG; ``alternative`` says what it shows to those who cannot see it."""
    data = base64.b64encode(picture).decode("ascii")
    form = "png" if picture.startswith(b"\x89PNG") else "svg+xml"
    return Markup(
        f'<figure><img alt="{html.escape(alternative)}" src="data:image/{form};base64,{data}">'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )
