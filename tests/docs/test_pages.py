"""The site says what the program does: hooks, commands, components, dependencies, modules."""

import inspect
import json
import re
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "docs"))  # what the site adds to Sphinx; needs no Sphinx itself

from extensions import docstrings, generated  # noqa: E402

from tracker import hookspecs  # noqa: E402

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
HOOKS = [
    value
    for name, value in vars(hookspecs).items()
    if inspect.isfunction(value) and hasattr(value, "tracker_spec")
]


def read(*parts: str) -> str:
    return ROOT.joinpath(*parts).read_text(encoding="utf-8")


@pytest.mark.parametrize("hook", HOOKS, ids=lambda hook: hook.__name__)
def test_every_hook_and_its_arguments_are_in_the_docs(hook: object) -> None:
    page = read("docs", "reference", "hooks.md")
    names = ", ".join(inspect.signature(hook).parameters)  # type: ignore[arg-type]
    title = f"## `{hook.__name__}({names})`"  # type: ignore[attr-defined]
    assert title in page, f"docs/reference/hooks.md lacks the section {title}"


def test_there_is_a_hook_to_document() -> None:
    assert HOOKS, "pluggy marks hooks otherwise now: correct how this test finds them"


def test_every_field_of_a_component_is_in_the_docs() -> None:
    from tracker.registry import Component

    page = read("docs", "reference", "hooks.md")
    fields = set(Component.__annotations__) - {"origin"}  # filled in by the registry
    assert not {name for name in fields if f"`{name}`" not in page}


def test_the_page_of_commands_holds_every_command_and_option() -> None:
    import click

    from tracker.cli import main

    page = generated.commands()
    context = click.Context(main, info_name="tracker")
    for name in main.list_commands(context):
        command = main.get_command(context, name)
        assert f"## `tracker {name}`" in page
        for parameter in command.params:  # type: ignore[union-attr]
            options = [o for o in parameter.opts if o.startswith("--")] or [
                parameter.opts[0].upper()
            ]
            assert all(option in page for option in options), f"tracker {name} {options}"


def test_the_catalogue_holds_every_component_with_its_source() -> None:
    from tracker.registry import OWN_DISTRIBUTION, default_registry

    page = generated.catalogue()
    own = [c for c in default_registry().search() if c.origin.distribution == OWN_DISTRIBUTION]
    assert own
    assert not [c.name for c in own if f"### `{c.name}`" not in page]
    assert page.count("Source: ") == len(own)


def test_every_public_module_is_in_the_api_pages() -> None:
    pages = "\n".join(generated.api_page(root) for root in generated.roots())
    files = [*ROOT.glob("tracker/**/*.py"), *(ROOT / "plugins").glob("tracker_*/**/*.py")]
    for path in files:
        base = ROOT if path.is_relative_to(ROOT / "tracker") else ROOT / "plugins"
        parts = path.relative_to(base).with_suffix("").parts
        name = ".".join(part for part in parts if part != "__init__")
        private = any(part.startswith("_") for part in name.split("."))
        if not private and name != "tracker":
            assert re.search(rf"automodule:: {re.escape(name)}$", pages, re.MULTILINE), name


def test_every_requirement_is_argued() -> None:
    page = read("docs", "explanation", "dependencies.md")
    for line in PROJECT["dependencies"]:
        name = re.match(r"[\w-]+", line).group()  # type: ignore[union-attr]
        assert f"\n### {name}\n" in page, f"argue {name} in docs/explanation/dependencies.md"
    for extra, lines in PROJECT["optional-dependencies"].items():
        assert f"| `{extra}` |" in page
        names = [re.match(r"[\w-]+", line).group() for line in lines]  # type: ignore[union-attr]
        assert not [name for name in names if name not in page]


def test_a_base_requirement_that_the_page_names_is_one() -> None:
    page = read("docs", "explanation", "dependencies.md")
    named = re.findall(r"^### ([\w-]+)$", page, re.MULTILINE)
    declared = [re.match(r"[\w-]+", line).group() for line in PROJECT["dependencies"]]  # type: ignore[union-attr]
    assert sorted(named) == sorted(declared)


def test_sections_of_a_docstring_become_definitions_and_stars_stay_stars() -> None:
    house = ["Sums (T, *batch).", "", "Shapes:", "    x ``(n, *b)``", "Example:", ">>> 1 + 1", "2"]
    assert docstrings.translated(house) == [
        r"Sums (T, \*batch).", "", "", "Shapes", "    x ``(n, *b)``", "", "Example",
        "    >>> 1 + 1", "    2", "",
    ]  # fmt: skip


def test_each_number_of_a_docstring_is_a_paragraph_whatever_its_indentation() -> None:
    house = ["Numbers:", "    one: of two", "        lines.", "    other: of one."]
    assert docstrings.translated(house) == [
        "", "Numbers", "", "    one: of two", "    lines.", "", "    other: of one.", "",
    ]  # fmt: skip


def test_the_page_of_papers_names_each_as_the_registry_does() -> None:
    from tracker.registry import PAPERS

    page = " ".join((ROOT / "docs" / "reference" / "papers.md").read_text(encoding="utf-8").split())
    for number, work in PAPERS.items():
        assert f"| {number} | {work.split('.')[0]}" in page.replace(".*", ".")


DECIDED = {
    "two_stations": ("ekf1", "ekf2", "ukf"),
    "turning_target": ("ekf1", "ckf5"),
    "reentry": ("ekf1",),
    "growth": ("ekf1", "ukf"),
}


@pytest.mark.parametrize("problem", DECIDED)
def test_the_table_of_decisions_can_be_repeated(problem: str) -> None:
    """The same seed gives the same numbers: what differs is rounding, between processors."""
    import tracker as tk

    kept = json.loads(read("docs", "data", problem, "results.json"))
    scene = tk.scenario(problem)
    named = {
        name: tk.estimator(name, motion=scene.motion, sensor=scene.sensor)
        for name in DECIDED[problem]
    }
    for row in tk.monte_carlo(named, scene, runs=kept["runs"], seed=kept["seed"]).rows():
        table = next(r for r in kept["rows"] if r["estimator"] == row["estimator"])
        assert row["median"] == pytest.approx(table["median"], rel=1e-3)
        assert row["rmse"] == pytest.approx(table["rmse"], rel=0.02)


def test_the_page_of_decisions_shows_every_filter_that_was_run() -> None:
    page = generated.decisions()
    for problem in DECIDED:
        for row in json.loads(read("docs", "data", problem, "results.json"))["rows"]:
            assert f"| `{row['estimator']}` |" in page
