"""The page of a reproduction: verdicts, claims, errata, tables and figures; nothing is judged here."""

from __future__ import annotations

from collections.abc import Mapping

from tracker.report import page as html
from tracker.report.drawing import svg_and_png
from tracker.reproduction import Reproduction, ResultRow

HEAD = ("number", "published", "ours", "95 % interval", "runs", "verdict", "by reading")


def rows(reproduction: Reproduction) -> list[tuple[str, ...]]:
    """The rows with verdicts, as words; `HEAD` names the columns."""
    return [
        (
            one.id,
            f"{one.published:.4g}",
            f"{one.ours:.4g}",
            _interval(one),
            str(one.runs),
            one.verdict,
            _givers(one),
        )
        for one in reproduction.rows
    ]


def _givers(one: ResultRow) -> str:
    """By which reading a number is reproduced: the first of them, and how many more there are."""
    if not one.given_by:
        return "-"
    first, *others = one.given_by
    return f"{first}; {len(others)} more" if others else first


def _interval(one: ResultRow) -> str:
    return f"{one.ci95[0]:.4g} to {one.ci95[1]:.4g}"


def write_up(
    reproduction: Reproduction, versions: Mapping[str, str], *, quick: bool = False
) -> tuple[str, dict[str, bytes]]:
    """A page that needs no network, and every picture as PNG under its id.

    The page holds pictures as SVG; ``quick``, the same PNG: each is then drawn once.

    Raises:
        PluginError: if matplotlib is not installed.
    """
    figures, files = [], {}
    for picture in reproduction.pictures:
        drawn = svg_and_png(picture.draw, ("png",) if quick else ("svg", "png"))
        shown, files[picture.id] = drawn[0], drawn[-1]
        title = f"Figure {picture.number}. {picture.title}" if picture.number else picture.title
        figures.append(html.figure(shown, f"{title}. {picture.caption}", picture.alternative))
    verdicts = _counted([one.verdict for one in reproduction.rows])
    judgements = _counted([one.verdict for one in reproduction.claims])
    sections = [
        (
            "",
            [
                html.text(
                    f"{reproduction.runs} runs, seed {reproduction.seed}. Published numbers: "
                    f"{verdicts}. Claims: {judgements}. Errata shown: {len(reproduction.errata)}."
                ),
                html.text(
                    "A number is reproduced if it lies inside the 95 % interval of ours, or inside "
                    "the range that one documented reading of the paper gives. A claim is confirmed "
                    "if its rule holds under every condition it was tried under, refuted if it "
                    "does not under one of them: the evidence says under which."
                ),
                *[html.text(note) for note in (*reproduction.notes, reproduction.together) if note],
            ],
        ),
        (
            "Published numbers",
            [
                html.table(HEAD, rows(reproduction)),
                html.points(f"{one.id}: {one.why}" for one in reproduction.rows),
            ],
        ),
        (
            "Claims",
            [
                html.table(
                    ("", "claim", "verdict", "rule", "evidence"),
                    [
                        (one.id, one.text, one.verdict, one.rule, f"{one.tally} {one.evidence}")
                        for one in reproduction.claims
                    ],
                )
            ],
        ),
        *[
            (table.title, [html.table(table.head, table.rows, table.caption)])
            for table in reproduction.tables
        ],
        ("Figures", figures),
        (
            "Errata",
            [
                html.table(
                    ("place", "printed", "corrected", "shown by"),
                    [
                        (one.id, one.printed, one.corrected, one.shown_by)
                        for one in reproduction.errata
                    ],
                )
            ],
        ),
        ("Made with", [html.text(", ".join(f"{k} {v}" for k, v in versions.items()) + ".")]),
    ]
    title = f"Paper {reproduction.paper} reproduced: {reproduction.title}"
    return html.page(title, [(head, pieces) for head, pieces in sections if pieces]), files


def _counted(words: list[str]) -> str:
    return ", ".join(f"{words.count(word)} {word}" for word in dict.fromkeys(words)) or "none"
