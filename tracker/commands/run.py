"""``tracker run``: track the targets of a detection log as a config file says, and report on it.

What a config file means is in `tracker.io.config`, what a report looks like in `tracker.report`.
"""

from __future__ import annotations

import json
from typing import Any

import click

from tracker.commands.output import finite, folder_of, versions, write
from tracker.commands.tables import print_table
from tracker.errors import ConfigError, wording
from tracker.io.config import Experiment, read_experiment
from tracker.io.detections import DetectionLog
from tracker.metrics.tracking import score_tracks, true_start
from tracker.progress import progress_of
from tracker.report.tracking import HEAD, Outcome, findings, rows, tracking_page


@click.command()
@click.argument("config")
@click.option(
    "--out", required=True, metavar="DIR", help="Folder for report.html and results.json."
)
@click.option("--quiet", is_flag=True, help="Print the path of the report and nothing else.")
def run(config: str, out: str, *, quiet: bool) -> None:
    """Run the experiment that the file CONFIG describes.

    An experiment tracks the targets of a detection log (comma-separated files of scans, detections and
    truth, as in examples/data/autoferry) with sensors called radar, lidar, ir and eo, each a position or
    an azimuth. For data of another kind use Python: see "Use your own data" in the documentation.

    Prints a table and the path of the report; writes report.html, which needs no network, and
    results.json: {"schema": 1, "title", "config", "versions", "rows": [...], "findings": [...]}, in SI
    units, null where a number is undefined. Within a schema number keys are only ever added.
    """
    experiment = read_experiment(config)
    log = experiment.read_log()
    folder = folder_of(out)
    outcomes = compare(experiment, log, quiet=quiet)
    if not quiet:
        _print(outcomes)
    page = tracking_page(
        experiment.title,
        outcomes,
        log,
        components=[
            (role, str(part), part.component.source, str(part.component.origin))
            for role, part in experiment.parts.items()
        ],
        notes=(
            f"Config: {config}. Log: {experiment.log}.",
            f"Tracks start from the truth's first {experiment.start.seconds:g} s; they do not end.",
            ", ".join(f"{name} {version}" for name, version in versions().items()) + ".",
        ),
    )
    report = folder / "report.html"
    write(report, page)
    write(folder / "results.json", json.dumps(_results(config, experiment, outcomes), indent=2))
    click.echo(str(report))


def compare(experiment: Experiment, log: DetectionLog, *, quiet: bool = True) -> list[Outcome]:
    """Track the targets of a log once with each set of sensors.

    Raises:
        DomainError: if the truth does not tell how the tracks start.
        ConfigError: if a set of sensors saw nothing after that.
    """
    space, start = experiment.motion.made.space, experiment.start
    tracks = true_start(log.truth, space, seconds=start.seconds, sigma=start.sigma)
    scans = [scan for scan in log.scans if scan.t >= tracks.t]
    outcomes = []
    for one in experiment.compare:
        if not any(scan.sensor in one.sensors for scan in scans):
            raise ConfigError(
                wording(
                    f"sensors of {one.name!r}",
                    got=f"no scan from t = {tracks.t:g} s on, when the truth begins",
                    expected="at least one scan",
                    do="drop the set from compare, or use another log",
                )
            )
        with progress_of(one.name, quiet=quiet) as report:
            history = experiment.pipeline(one).run(
                tracks, scans, skip_unknown=True, progress=report
            )
        truth = [log.truth[target].at(history.t) for target in history.ids]
        east, north = space.indices("x", "y")
        scores = score_tracks(history, truth, position=(east, north))
        outcomes.append(Outcome(one.name, history, scores, (east, north)))
    return outcomes


# ------------------------------------------------------------------------------------- output
def _results(config: str, experiment: Experiment, outcomes: list[Outcome]) -> dict[str, Any]:
    return {
        "schema": 1,
        "title": experiment.title,
        "config": config,
        "versions": versions(),
        "rows": [
            {
                "sensors": outcome.name,
                "target": score.id,
                "rmse": finite(score.rmse),
                "nis": finite(score.nis),
                "nis_band": [finite(score.nis_band.low), finite(score.nis_band.high)],
                "nees": finite(score.nees),
                "nees_band": [finite(score.nees_band.low), finite(score.nees_band.high)],
                "used": finite(score.used),
                "seconds_per_update": finite(score.seconds),
                "verdict": score.verdict,
                "words": score.words,
            }
            for outcome in outcomes
            for score in outcome.scores
        ],
        "findings": findings(outcomes),
    }


def _print(outcomes: list[Outcome]) -> None:
    print_table(HEAD, rows(outcomes))
    click.echo()
    for finding in findings(outcomes):
        click.echo(f"- {finding}")
    click.echo()
