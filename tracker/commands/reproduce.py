"""``tracker reproduce``: remake a paper's tables and figures, and judge its numbers and claims.

What a reproduction is, and the rules of its verdicts, are in `tracker.reproduction`.
"""

from __future__ import annotations

import csv
import io
import json

import click

from tracker.commands.output import folder_of, versions, write
from tracker.commands.tables import print_table
from tracker.errors import UnknownComponent, wording
from tracker.progress import progress_of
from tracker.registry import Component, default_registry
from tracker.report.reproduction import HEAD, rows, write_up
from tracker.reproduction import Reproduction, Study, Table


@click.command()
@click.argument("paper")
@click.option(
    "--out", required=True, metavar="DIR", help="Folder for report.html, results.json and figures."
)
@click.option(
    "--runs", type=click.IntRange(min=2), metavar="R", help="Monte Carlo runs of each number."
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    metavar="S",
    show_default=True,
    help="Seed of every random number.",
)
@click.option("--quick", is_flag=True, help="Fewer runs and smaller studies: a minute at most.")
def reproduce(paper: str, out: str, runs: int | None, seed: int, *, quick: bool) -> None:  # fmt: skip
    """Reproduce the paper of number PAPER, or what a reproduction component of that name does.

    Prints a verdict for each published number and claim, and the path of the report. Writes
    report.html, which needs no network; figures/*.png; tables/*.csv; and results.json: {"paper", "seed",
    "runs", "versions", "rows", "claims", "errata"}. A row has id, published, ours, ci95, runs, verdict
    ("reproduced", "not reproduced" or "not comparable") and why; a claim has id, text, verdict
    ("confirmed", "refuted" or "undecided") and evidence; an erratum has id, printed, corrected, shown_by.
    Undefined numbers are null.
    """
    study: Study = _component(paper).make()
    folder = folder_of(out)
    with progress_of(f"paper {study.paper.number}") as report:
        done = study.run(
            runs=runs or (study.quick_runs if quick else study.runs),
            seed=seed,
            quick=quick,
            progress=report,
        )
    page, pictures = write_up(done, versions(), quick=quick)
    figures = folder_of(str(folder / "figures"))
    for name, picture in pictures.items():
        write(figures / f"{name}.png", picture)
    tables = folder_of(str(folder / "tables"))
    for table in done.tables:
        write(tables / f"{table.id}.csv", _as_csv(table))
    write(folder / "results.json", json.dumps(done.results(versions()), indent=2))
    write(folder / "report.html", page)
    _print(done)
    click.echo(str(folder / "report.html"))


def _component(paper: str) -> Component:
    found = default_registry().search(kind="reproduction")
    for one in found:
        if paper in (one.paper, one.name):
            return one
    known = ", ".join(f"{one.paper} ({one.name})" for one in found) or "none at all"
    raise UnknownComponent(
        wording(
            "argument PAPER",
            got=repr(paper),
            expected=f"a paper that can be reproduced: {known}",
            do="name one of these, or install the plugin that offers it",
        )
    )


def _as_csv(table: Table) -> str:
    stream = io.StringIO()
    csv.writer(stream).writerows([table.head, *table.rows])
    return stream.getvalue()


def _print(done: Reproduction) -> None:
    print_table(HEAD, rows(done))
    if done.together:
        click.echo(done.together)
    click.echo()
    print_table(
        ("claim", "verdict", "text", "found"),
        [(one.id, one.verdict, one.text, one.tally) for one in done.claims],
    )
    click.echo(f"\n{len(done.errata)} errata, each with the test that shows it: see the report.")
