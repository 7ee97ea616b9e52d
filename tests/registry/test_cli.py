"""What a person, or a script, reads from the command."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import attrs
import click
import pytest
from click.testing import CliRunner, Result
from hypothesis import given
from hypothesis import strategies as st

import tracker.cli
import tracker.registry
from tracker.commands.tables import print_table
from tracker.errors import PluginError
from tracker.registry import KINDS, Component, Origin, Registry

Install = Callable[..., Path]
Run = Callable[..., "subprocess.CompletedProcess[str]"]


def component(name: str, **fields: object) -> Component:
    """A component whose target is in the standard library, with every field that may be changed."""
    defaults = {"kind": "filter", "target": "fractions:Fraction", "summary": "a fake", "paper": "0"}
    return Component(**{"name": name} | defaults | fields)


@attrs.frozen
class Axis:
    name: str
    unit: str
    circular: bool = False


@attrs.frozen
class Space:
    axes: tuple[Axis, ...]


@attrs.frozen
class Bearing:
    sigma: float = 0.01

    @property
    def space(self) -> Space:
        return Space((Axis("azimuth", "rad", circular=True),))

    def jacobian(self) -> None: ...

    why_opaque = ""
    needs = ("hessian",)


def tell(*arguments: str) -> Result:
    return CliRunner().invoke(tracker.cli.main, arguments)


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch) -> Registry:
    """The default registry, replaced by one that has nothing to discover."""
    registry = Registry(Origin("dist-a", "1.2"))
    registry._discovered = True
    monkeypatch.setattr(tracker.registry, "_default", registry)
    monkeypatch.setitem(sys.modules, "fake_bearing", sys.modules[__name__])
    registry.add(
        component(
            "azimuth",
            kind="sensor",
            target="fake_bearing:Bearing",
            summary="angle from north",
            equations=("(3)", "(7)"),
            tags=("passive",),
            examples=("azimuth(sigma=0.02)",),
        )
    )
    registry.add(component("shorten", target="textwrap:shorten", paper="Someone, 1999"))
    return registry


def test_list_shows_each_component_with_its_source_and_origin(registry: Registry) -> None:
    told = tell("list")
    assert told.exit_code == 0
    assert "angle from north" in told.output
    assert "paper 0, eq. (3), (7)" in told.output
    assert "Someone, 1999" in told.output
    assert "dist-a 1.2" in told.output
    assert "shorten" not in tell("list", "sensor").output
    assert "azimuth" in tell("list", "--tag", "passive").output
    assert "Tags in use: passive" in tell("list", "--tag", "pasive").output


def test_list_as_json_keeps_its_schema(registry: Registry) -> None:
    told = json.loads(tell("list", "sensor", "--json").stdout)
    assert told == {
        "schema": 1,
        "components": [
            {
                "kind": "sensor",
                "name": "azimuth",
                "summary": "angle from north",
                "paper": "0",
                "equations": ["(3)", "(7)"],
                "tags": ["passive"],
                "requires": [],
                "available": True,
                "examples": ["azimuth(sigma=0.02)"],
                "deviations": {},
                "target": "fake_bearing:Bearing",
                "origin": {"distribution": "dist-a", "version": "1.2"},
            }
        ],
        "plugins": [],
    }


@given(
    st.builds(
        component,
        st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True),
        kind=st.sampled_from(KINDS),
        summary=st.text(min_size=1).filter(str.strip),
        equations=st.lists(st.text()),
        tags=st.lists(st.text()),
        requires=st.dictionaries(st.sampled_from(["os", "no_such_module"]), st.text()),
    )
)
def test_the_json_record_carries_all_of_a_component(one: Component) -> None:
    (record,) = tracker.cli._as_data([one], Registry())["components"]
    record = json.loads(json.dumps(record))
    assert record.pop("available") == (not one.missing())
    record["requires"] = {each["module"]: each["install"] for each in record["requires"]}
    record["origin"] = Origin(**record["origin"])
    assert Component(**record) == one


def test_show_tells_source_parameters_shapes_and_capabilities(registry: Registry) -> None:
    told = tell("show", "azimuth").output
    for expected in (
        "sensor 'azimuth'",
        "paper 0, eq. (3), (7)",
        "azimuth [rad] circular",
        "jacobian, components",
        "needs         hessian",
        "0.01",
        "azimuth(sigma=0.02)",
    ):
        assert expected in told, told


def test_show_of_a_component_with_required_parameters_says_which(registry: Registry) -> None:
    told = tell("show", "shorten")
    assert told.exit_code == 0, told.output
    assert "known once made with text, width" in told.output


def test_show_of_an_unavailable_component_says_what_to_install(registry: Registry) -> None:
    registry.add(component("fast", requires={"no_such_module": "tracker-lab[fast]"}))
    told = tell("show", "fast")
    assert told.exit_code == 2
    assert "paper 0" in told.stdout
    assert "unavailable: pip install 'tracker-lab[fast]'" in told.stderr


def test_a_name_shared_by_two_kinds_is_shown_twice_or_chosen(registry: Registry) -> None:
    registry.add(component("azimuth", kind="gate"))
    assert "gate 'azimuth'" in tell("show", "azimuth").output
    assert "sensor 'azimuth'" in tell("show", "azimuth").output
    assert "gate 'azimuth'" not in tell("show", "azimuth", "--kind", "sensor").output


def test_an_error_is_one_line_and_exit_code_two_unless_debugging(
    registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = tell("show", "azimut")
    assert told.exit_code == 2
    assert told.stdout == ""
    assert told.stderr.count("\n") == 1
    assert "did you mean 'azimuth'" in told.stderr
    monkeypatch.setenv("TRACKER_DEBUG", "1")
    assert isinstance(tell("show", "azimut").exception, LookupError)


def test_check_prints_each_law_and_fails_if_one_does(
    registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tracker.cli, "conformance", lambda _: None)
    assert tell("check", "azimuth").exit_code == 2
    monkeypatch.setattr(
        tracker.cli,
        "conformance",
        lambda _: [
            ("wrap", "passed", ""),
            ("R", "failed", "negative"),
            ("hessian", "not applicable", "none"),
        ],
    )
    told = tell("check", "azimuth")
    assert told.exit_code == 1
    assert "wrap" in told.output
    assert "R (failed): negative" in told.output
    assert "1 of 2 laws: wrap" in tell("show", "azimuth").output


def test_doctor_reports_every_plugin_and_the_cause_of_a_failure(
    install: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    install("good", "kf", version="2.5")
    install("bad", top="import no_such_module")
    install("away", "x")
    monkeypatch.setenv("TRACKER_PLUGINS", "good,bad")
    monkeypatch.setenv("TRACKER_STRICT_PLUGINS", "1")
    told = tell("doctor")
    assert told.exit_code == 1, told.output
    lines = {line.split()[0]: line.split() for line in told.output.splitlines() if line.strip()}
    assert lines["good"][1:5] == ["dist-good", "2.5", "loaded", "1"]
    assert float(lines["good"][5]) > 0
    assert lines["bad"][1:4] == ["dist-bad", "1.0", "failed"]
    assert "not pinned" in " ".join(lines["away"])
    assert "ModuleNotFoundError: No module named 'no_such_module'" in told.output
    assert "numpy" in lines
    assert "python" in lines
    monkeypatch.setenv("TRACKER_PLUGINS", "good")
    assert tell("doctor").exit_code == 0


def test_a_failed_plugin_is_mentioned_beside_the_list_and_inside_the_json(
    install: Install, run: Run
) -> None:
    install("good", "kf")
    install("bad", top="import no_such_module")
    code = "from tracker.cli import main; main()"
    told = run(f"import sys; sys.argv[1:] = ['list']; {code}", TRACKER_PLUGINS="good,bad")
    assert "kf" in told.stdout
    assert "1 plugin(s) failed to load" in told.stderr
    told = run(f"import sys; sys.argv[1:] = ['list', '--json']; {code}", TRACKER_PLUGINS="good,bad")
    assert "bad" in {report["name"] for report in json.loads(told.stdout)["plugins"]}
    told = run(f"import sys; sys.argv[1:] = ['list']; {code}", TRACKER_PLUGINS="goood")
    assert told.returncode == 2
    assert "did you mean 'good'" in told.stderr


def test_a_lazy_command_is_listed_unimported_and_runs(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "fake_lazy_command.py").write_text(
        "import click\n@click.command()\ndef go():\n    click.echo('gone')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(tracker.cli.LAZY, "go", ("fake_lazy_command:go", "Goes."))
    assert "Goes." in tell("--help").output
    assert "fake_lazy_command" not in sys.modules
    assert tell("go").output == "gone\n"


def test_a_wide_terminal_gets_a_ruled_table_with_units_intact(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "120")
    print_table(("name", "unit"), [("sigma", "[rad]")])
    told = capsys.readouterr().out
    assert "[rad]" in told
    assert "─" in told or "━" in told


def test_help_loads_nothing_that_it_does_not_print(run: Run) -> None:
    told = run(
        """
        import sys
        from tracker.cli import main
        main(["--help"], standalone_mode=False)
        loaded = {"numpy", "scipy", "rich", "attrs", "pluggy", "importlib.metadata"} & set(sys.modules)
        print(sorted(loaded), "doctor" in sys.modules)
        """
    )
    assert told.returncode == 0, told.stderr
    for name in ("list", "show", "doctor", "check"):
        assert name in told.stdout
    assert told.stdout.splitlines()[-1] == "[] False", told.stdout


def test_every_command_has_help_of_its_own() -> None:
    for name in tracker.cli.main.list_commands(click.Context(tracker.cli.main)):
        told = tell(name, "--help")
        assert told.exit_code == 0, name
        assert "Usage" in told.output


def test_errors_of_lazy_commands_are_worded_too(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "fake_failing_command.py").write_text(
        "import click\nfrom tracker.errors import PluginError\n"
        "@click.command()\ndef go():\n    raise PluginError('a\\nb')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(tracker.cli.LAZY, "go", ("fake_failing_command:go", "Fails."))
    told = tell("go")
    assert told.stderr == f"{PluginError.__name__}: a b\n"
    assert told.exit_code == 2
