"""Pages made from the code itself, so that they cannot be stale: catalogue, commands, API."""

import csv
import importlib
import inspect
import json
import math
import pkgutil
import re
from pathlib import Path
from typing import Any

FOLDER = "generated"
PLUGINS = Path(__file__).resolve().parents[2] / "plugins"


# ---------------------------------------------------------------------------------- catalogue
def catalogue() -> str:
    """Every registered component of this distribution: summary, source, parameters, capabilities."""
    from tracker.registry import MEANINGS, OWN_DISTRIBUTION, default_registry

    registry = default_registry()
    lines = ["# Component catalogue", ""]
    lines += [
        "Made from the registry when this site was built; `tracker list` prints the same.",
        "Numbers of papers are [explained here](../reference/papers.md).",
        "",
    ]
    own = [c for c in registry.search() if c.origin.distribution == OWN_DISTRIBUTION]
    for kind, meaning in MEANINGS.items():
        found = [c for c in own if c.kind == kind]
        if not found:
            continue
        lines += [f"## {kind}", "", f"A {kind} {_verb(meaning)}.", ""]
        for component in found:
            lines += _entry(component)
    empty = [kind for kind in MEANINGS if not any(c.kind == kind for c in own)]
    if empty:
        lines += ["## Nothing yet", ""]
        lines += [f"No component of these kinds is shipped yet: {', '.join(empty)}.", ""]
    return "\n".join(lines)


# ---------------------------------------------------------------------------------- decisions
DATA = Path(__file__).resolve().parents[1] / "data"
PROBLEMS = {
    "two_stations": "two stations, bearings",
    "turning_target": "turning target",
    "reentry": "re-entry",
    "growth": "growth model",
}


def decisions() -> str:
    """What `tracker compare --out` wrote for each problem, as one table: accuracy, consistency, cost."""
    results = {name: json.loads((DATA / name / "results.json").read_text()) for name in PROBLEMS}
    names = dict.fromkeys(r["estimator"] for found in results.values() for r in found["rows"])
    lines = ["| filter | " + " | ".join(PROBLEMS.values()) + " | microseconds a step |"]
    lines += ["|---" * (len(PROBLEMS) + 2) + "|"]
    for name in names:
        rows = {
            problem: next((r for r in found["rows"] if r["estimator"] == name), None)
            for problem, found in results.items()
        }
        cost = [r["cost_us"] for r in rows.values() if r is not None]
        cells = [_decision(row) for row in rows.values()]
        lines.append(f"| `{name}` | " + " | ".join([*cells, _span(cost)]) + " |")
    runs = {found["runs"] for found in results.values()}
    lines += ["", f"{' and '.join(map(str, sorted(runs)))} runs of each problem, seed 0."]
    return "\n".join(lines) + "\n"


def _decision(row: Any) -> str:
    if row is None:
        return "-"
    nees = row["nees"] / row["n"]
    lost = f", {row['diverged']} lost" if row["diverged"] else ""
    return (
        f"{row['median']:.3g}; {nees:.2g}{lost}"
        if nees < 1e4
        else f"{row['median']:.3g}; beyond 1e4{lost}"
    )


def _span(cost: list[float]) -> str:
    low, high = (f"{v:.2g}" if v < 100.0 else f"{v:.0f}" for v in (min(cost), max(cost)))
    return low if low == high else f"{low} to {high}"


# -------------------------------------------------------------------------- noise under water
UNDER_WATER = DATA / "noise_under_water"


def under_water(table: str) -> dict[str, dict[str, Any]]:
    """What `tracker reproduce 4` wrote: by problem and filter its CSV row, with numbers as `ratio`."""
    found: dict[str, dict[str, Any]] = {}
    with (UNDER_WATER / f"{table}.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            numbers = re.findall(r"[-+.\de]+", row["to the EKF told the truth"])
            ratio = tuple(float(v) for v in numbers) if len(numbers) == 3 else (math.inf,) * 3
            found.setdefault(row["problem"], {})[row["filter"]] = row | {"ratio": ratio}
    return found


def best_under_water(table: str, column: str) -> str:
    """One row per filter, best on average first: a value with its interval for each problem."""
    found = under_water(table)
    names = sorted(
        next(iter(found.values())),
        key=lambda name: sum(math.log(by[name]["ratio"][0]) for by in found.values()),
    )
    lines = [f"| filter | {' | '.join(found)} | NEES / n |", "|---" * (len(found) + 2) + "|"]
    for name in names:
        rows = [by[name] for by in found.values()]
        nees = _span([float(row["NEES / n"]) for row in rows])
        cells = (_with_interval(row, column) for row in rows)
        lines.append(f"| {name} | {' | '.join(cells)} | {nees} |")
    return "\n".join(lines) + "\n"


def _with_interval(row: Any, column: str) -> str:
    if math.isinf(row["ratio"][0]):
        return f"lost in {row['lost']} of {row['runs']} runs"
    plain = re.sub(r"[.\d]+e\+0\d", lambda m: f"{float(m[0]):.0f}", row[column])
    return plain.replace(", ", ",&nbsp;").replace(" [", "<br>[")


def _verb(meaning: str) -> str:
    starts = ("how", "what", "targets")
    return f"says {meaning}" if meaning.startswith(starts[:2]) else (
        f"holds {meaning}" if meaning.startswith(starts[2]) else meaning
    )  # fmt: skip


def _entry(component: Any) -> list[str]:
    from tracker.registry import describe_parameters

    lines = [f"### `{component.name}`", "", _sentence(component.summary), ""]
    lines += [f"Source: {component.source}. Tags: {', '.join(component.tags) or 'none'}."]
    lines += [f"Code: {{py:obj}}`{component.target.replace(':', '.')}`.", ""]
    if component.missing():
        return lines
    parameters = describe_parameters(component)
    if parameters:
        lines += ["| parameter | unit | default |", "|---|---|---|"]
        lines += [
            f"| `{p.name}` | {p.unit or '-'} | {'required' if p.required else _default(p)} |"
            for p in parameters
        ]
        lines += [""]
    for example in component.examples:
        lines += [f"Example: `{example}`", ""]
    return lines


def _default(parameter: Any) -> str:
    from tracker.types import PLANAR, SPATIAL

    named = {repr(PLANAR): "PLANAR", repr(SPATIAL): "SPATIAL"}
    return f"`{named.get(parameter.default, parameter.default)}`"


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:].rstrip(".") + "."


# ----------------------------------------------------------------------------------- commands
def commands() -> str:
    """What every command prints for --help."""
    import click

    from tracker.cli import main

    lines = ["# Commands", "", "What `--help` prints, taken from the program itself.", ""]
    context = click.Context(main, info_name="tracker", terminal_width=88, **main.context_settings)
    lines += ["```text", main.get_help(context), "```", ""]
    for name in main.list_commands(context):
        command = main.get_command(context, name)
        below = click.Context(command, info_name=name, parent=context, terminal_width=88)
        lines += [f"## `tracker {name}`", "", "```text", command.get_help(below), "```", ""]
    lines += [
        "## Environment",
        "",
        "`TRACKER_PLUGINS=a,b`",
        ": loads only these plugins.",
        "",
        "`TRACKER_PLUGINS_BLOCK=c`",
        ": leaves plugins out.",
        "",
        "`TRACKER_STRICT_PLUGINS=1`",
        ": raises on the first plugin that fails to load, instead of recording it.",
        "",
        "`TRACKER_DEBUG=1`",
        ": shows a traceback instead of one line when a command fails.",
        "",
    ]
    return "\n".join(lines)


# ----------------------------------------------------------------------------------------- API
def public_modules(name: str) -> list[str]:
    """The module and, if it is a package, its public modules, depth first."""
    module = importlib.import_module(name)
    found = [name]
    for info in pkgutil.iter_modules(getattr(module, "__path__", ()), f"{name}."):
        if not info.name.rpartition(".")[2].startswith("_"):
            found += public_modules(info.name)
    return found


def roots() -> list[str]:
    """What gets a page of its own: each module of the core, each plugin."""
    core = [name for name in public_modules("tracker")[1:] if name.count(".") == 1]
    return [*core, *sorted(path.parent.name for path in PLUGINS.glob("*/__init__.py"))]


def api_page(root: str) -> str:
    """One page: the module, and below it the modules it contains."""
    lines = []
    for name in public_modules(root):
        mark = "=" if name == root else "-"
        lines += [name, mark * len(name), "", f".. automodule:: {name}"]
        # A module of commands is described by the page of commands.
        if not name.startswith(("tracker.cli", "tracker.commands")):
            lines += ["   :members:", "   :ignore-module-all:"]
        lines += [""]
    return "\n".join(lines)


def facade() -> str:
    """The names that `import tracker` offers, each with its home and first sentence."""
    import tracker

    lines = ["| name | what it is |", "|---|---|"]
    for name in tracker.__all__:
        value = getattr(tracker, name)
        home = f"tracker.{tracker._HOME[name]}.{name}"  # noqa: SLF001 - the one list of names
        if callable(value) or inspect.isclass(value):
            doc = (inspect.getdoc(value) or "").split("\n\n")[0].replace("\n", " ")
        else:
            doc = f"`{value}`" if not hasattr(value, "make") else f"the catalogue of {name}"
        if hasattr(value, "make") and not inspect.isclass(value):
            doc = f"the catalogue of {name}: `tk.{name}.make(name, ...)`"
        doc = doc.replace("|", r"\|").replace("``", "`").rstrip(".")
        lines.append(f"| {{py:obj}}`tk.{name} <{home}>` | {doc} |")
    return "\n".join(lines) + "\n"


# --------------------------------------------------------------------------------------- hooks
def pages() -> dict[str, str]:
    """Every generated page: its path below the folder, and its text."""
    made = {
        "catalogue.md": catalogue(),
        "commands.md": commands(),
        "decisions.md": decisions(),
        **{
            f"under-water-{start}-{what}.md": best_under_water(table, column)
            for start, table in (("thesis", "best_where"), ("fair", "best_where_fair"))
            for what, column in (
                ("ratios", "to the EKF told the truth"),
                ("metres", "position RMSE [m]"),
            )
        },
        "facade.md": facade(),
    }
    made |= {f"api/{root}.rst": api_page(root) for root in roots()}
    return made


def _write(app: Any) -> None:
    folder = Path(app.srcdir, FOLDER)
    wanted = pages()
    for path in [*folder.glob("*.md"), *folder.glob("api/*.rst")]:
        if path.relative_to(folder).as_posix() not in wanted:
            path.unlink()  # its module is gone
    for name, text in wanted.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def setup(app: Any) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True}
