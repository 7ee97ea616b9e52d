"""The command ``tracker``: what is installed, where it comes from, and whether it is well.

Only the printing belongs here. Commands that do heavier work live in modules of their own, named in
``LAZY``, and every command imports what it needs when it runs: ``tracker --help`` must stay instant.
"""

from __future__ import annotations

import importlib
import json
import os
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import click

from tracker.commands.tables import print_table

if TYPE_CHECKING:
    from tracker.parameters import Parameter
    from tracker.registry import Component, Registry

# Commands in other modules: name -> ("package.module:command", the line shown by --help).
LAZY: dict[str, tuple[str, str]] = {
    "compare": (
        "tracker.commands.compare:compare",
        "Compare filters on a scenario: accuracy, consistency and cost side by side.",
    ),
    "reproduce": (
        "tracker.commands.reproduce:reproduce",
        "Remake the tables and figures of a paper, with a verdict for each number.",
    ),
    "run": ("tracker.commands.run:run", "Track what a config file describes, and report on it."),
}

_CAPABILITIES = ("jacobian", "hessian", "linearise", "prior")
_SPACES = ("space", "pose_space", "state")


class _Commands(click.Group):
    """A group that imports a lazy command only to run it, and words errors for a person."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted({*super().list_commands(ctx), *LAZY})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in LAZY:
            module, _, attribute = LAZY[cmd_name][0].partition(":")
            command: click.Command = getattr(importlib.import_module(module), attribute)
            return command
        return super().get_command(ctx, cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(
                [
                    (
                        name,
                        LAZY[name][1]
                        if name in LAZY
                        else self.commands[name].get_short_help_str(limit=80),
                    )
                    for name in self.list_commands(ctx)
                ]
            )

    def invoke(self, ctx: click.Context) -> Any:
        from tracker.errors import TrackerError

        try:
            return super().invoke(ctx)
        except TrackerError as error:
            if os.environ.get("TRACKER_DEBUG", "") not in {"", "0"}:
                raise
            line = " ".join(str(error).split())
            click.echo(f"{type(error).__name__}: {line}", err=True)
            raise click.exceptions.Exit(2) from error


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="tracker-lab", prog_name="tracker")
def main() -> None:
    """Passive target tracking: see, check and run what is installed."""


@main.command("list")
@click.argument("kind", required=False)
@click.option("--tag", help="Only components with this tag.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, as described above.")
def list_(kind: str | None, tag: str | None, *, as_json: bool) -> None:
    """List components, of one KIND or of all, each with its source.

    With --json: {"schema": 1, "components": [...], "plugins": [...]}. A component has kind, name,
    summary, paper, equations, tags, requires (module, install), available, examples, deviations,
    target, origin (distribution, version). A plugin that is not loaded has name, distribution, version,
    status, cause. Within a schema number keys are only ever added.
    """
    from tracker.registry import KINDS, default_registry

    registry = default_registry()
    if kind and kind.endswith("s") and kind[:-1] in KINDS:
        kind = kind[:-1]  # as in tracker.sensors
    found = registry.search(kind=kind, tag=tag)
    if as_json:
        click.echo(json.dumps(_as_data(found, registry), indent=2))
        return
    if found:
        print_table(
            ("kind", "name", "summary", "source", "origin"),
            [(one.kind, one.name, one.summary, one.source, str(one.origin)) for one in found],
        )
    else:
        tags = sorted({tag for one in registry.search(kind=kind) for tag in one.tags})
        click.echo(f"No component matches. Tags in use: {', '.join(tags) or 'none'}.", err=True)
    failed = sum(report.status == "failed" for report in registry.plugins)
    if failed:
        click.echo(f"{failed} plugin(s) failed to load: see 'tracker doctor'.", err=True)


def _as_data(components: Iterable[Component], registry: Registry) -> dict[str, object]:
    return {
        "schema": 1,
        "components": [
            {
                "kind": one.kind,
                "name": one.name,
                "summary": one.summary,
                "paper": one.paper,
                "equations": list(one.equations),
                "tags": list(one.tags),
                "requires": [{"module": name, "install": pip} for name, pip in one.requires],
                "available": not one.missing(),
                "examples": list(one.examples),
                "deviations": dict(one.deviations),
                "target": one.target,
                "origin": {
                    "distribution": one.origin.distribution,
                    "version": one.origin.version,
                },
            }
            for one in components
        ],
        "plugins": [
            {
                "name": report.name,
                "distribution": report.distribution,
                "version": report.version,
                "status": report.status,
                "cause": report.cause,
            }
            for report in registry.plugins
            if report.status != "loaded"
        ],
    }


@main.command()
@click.argument("name")
@click.option("--kind", help="Only the component of this kind, where several share the name.")
@click.option(
    "--kernel",
    is_flag=False,
    flag_value="program",
    type=click.Choice(["program", "llvm"]),
    help="Print its compiled step on an example instead: the step program, or the LLVM text.",
)
def show(name: str, kind: str | None, kernel: str | None) -> None:
    """Show all that is known of the component NAME."""
    for component in _named(name, kind):
        if kernel is None:
            _show(component)
            continue
        from tracker.commands.kernel import kernel_text

        click.echo(kernel_text(component, kernel))


def _named(name: str, kind: str | None) -> tuple[Component, ...]:
    from tracker.registry import default_registry

    registry = default_registry()
    return registry.find(name) if kind is None else (registry.get(kind, name),)


def _show(component: Component) -> None:
    import inspect

    from tracker.registry import describe_parameters

    click.echo(f"{component}\n{component.summary}\n")
    facts = [
        ("source", component.source),
        *(("", work) for work in component.works),
        ("origin", str(component.origin)),
        ("target", component.target),
        ("tags", ", ".join(component.tags)),
        ("requires", ", ".join(pip for _, pip in component.requires)),
    ]
    if component.missing():
        _facts(facts)
        component.load()  # raises, saying what to install
    parameters = describe_parameters(component)
    if component.kind != "function":  # which is not made, and has the laws that its text states
        facts += _abilities(component, required=[p.name for p in parameters if p.required])
        facts += _laws(component)
    _facts(facts)
    said = inspect.getdoc(component.load())
    if said:
        click.echo("\n" + said.split("\n\nExample")[0])
    if parameters:
        click.echo()
        print_table(
            ("parameter", "unit", "default", "type"),
            [
                (p.name, p.unit, "(required)" if p.required else p.default, _plain_type(p))
                for p in parameters
            ],
        )
    for example in component.examples:
        click.echo(f"\nexample: {example}")
    click.echo()


def _plain_type(parameter: Parameter) -> str:
    """The annotation without the unit, which has a column of its own."""
    text = parameter.annotation
    if "numpy._typing._array_like" in text:  # an alias that Python wrote out
        return "ArrayLike"
    if text.startswith("Annotated[") and text.endswith("]"):
        return text[len("Annotated[") : text.rindex(",")]
    return text


def _abilities(component: Component, required: Sequence[str]) -> list[tuple[str, str]]:
    """Shapes and capabilities: of the component with its defaults, or else of its class."""
    facts = []
    made: object
    try:
        made = _example(component)
    except Exception as error:  # noqa: BLE001 - a stranger's constructor may raise anything
        made = component.load()
        hint = f"known once made with {', '.join(required)}" if required else ""
        facts.append(("shapes", hint or f"unknown, it cannot be made from its defaults: {error}"))
    else:
        for name in _SPACES:
            space = getattr(made, name, None)
            if getattr(space, "axes", ()):
                facts.append((name.replace("_", " "), _components(space)))
    has = [name for name in _CAPABILITIES if callable(getattr(made, name, None))]
    if getattr(made, "why_opaque", None) == "":
        has.append("components (can be traced)")
    needs = getattr(made, "needs", ())
    facts += [("has", ", ".join(has))]
    facts += [("needs", ", ".join(needs))] if isinstance(needs, tuple) else []
    return facts


def _example(component: Component) -> object:
    """The component as its defaults or its first example make it."""
    try:
        from tracker.testing import from_record
    except ModuleNotFoundError:  # the kit needs the extra "test"
        return component.make()
    return from_record(component)


def _components(space: Any) -> str:
    return ", ".join(
        axis.name
        + (f" [{axis.unit}]" if axis.unit else "")
        + (" circular" if axis.circular else "")
        for axis in space.axes
    )


def _laws(component: Component) -> list[tuple[str, str]]:
    """What the conformance kit says, in a line or two."""
    from tracker.errors import TrackerError

    try:
        laws = conformance(component)
    except TrackerError as error:
        return [("passes", f"not checked: {error}")]
    if laws is None:
        return []
    tried = [outcome for outcome in laws if outcome[1] != "not applicable"]
    passed = [law for law, outcome, _ in tried if outcome == "passed"]
    facts = [("passes", f"{len(passed)} of {len(tried)} laws: {', '.join(passed)}")]
    return facts + [
        ("deviates" if outcome == "expected failure" else "breaks", f"{law}: {reason}")
        for law, outcome, reason in tried
        if outcome != "passed"
    ]


def conformance(component: Component) -> list[tuple[str, str, str]] | None:
    """Return each law with outcome and reason; None where the kit, or what it needs, is missing.

    The only place where commands meet the kit: ``tracker.testing.outcomes(component)``.

    Raises:
        CapabilityError: there are no laws for its kind, or it cannot be made from its record.
    """
    try:
        from tracker import testing
    except ModuleNotFoundError:
        return None
    return testing.outcomes(component)


@main.command()
@click.argument("name")
@click.option("--kind", help="Only the component of this kind, where several share the name.")
def check(name: str, kind: str | None) -> None:
    """Check that the component NAME obeys the laws of its kind; exit code 1 if it does not."""
    failed = False
    for component in _named(name, kind):
        laws = conformance(component)
        if laws is None:
            click.echo(
                "The conformance kit is not there: pip install 'tracker-lab[test]'.", err=True
            )
            raise click.exceptions.Exit(2)
        click.echo(str(component))
        print_table(("law", "outcome"), [(law, outcome) for law, outcome, _ in laws])
        for law, outcome, reason in laws:
            if reason:
                click.echo(f"\n{law} ({outcome}): {reason}")
            failed |= outcome == "failed"
    raise click.exceptions.Exit(int(failed))


@main.command()
def doctor() -> None:
    """Report on plugins, versions and optional extras; exit code 1 if a plugin failed."""
    import platform

    from tracker.compile import objects
    from tracker.registry import Registry

    # A registry of its own: load times are then measured here, and strict mode cannot end the report.
    registry = Registry()
    registry.discover(strict=False)
    if registry.plugins:
        print_table(
            ("plugin", "origin", "status", "components", "load [ms]"),
            [
                (
                    report.name,
                    f"{report.distribution} {report.version}",
                    report.status,
                    str(report.components),
                    f"{1e3 * report.seconds:.1f}",
                )
                for report in registry.plugins
            ],
        )
    else:
        click.echo("No plugins are installed, not even our own: reinstall tracker-lab.")
    failed = [report for report in registry.plugins if report.status == "failed"]
    for report in failed:
        click.echo(f"\nplugin {report.name!r} ({report.target}) failed: {report.cause}")
        click.echo("\n".join(f"    {line}" for line in report.traceback.splitlines()))
    click.echo()
    _facts(
        [
            ("python", f"{platform.python_version()} on {platform.platform()}"),
            *(
                (name, _version(name) or "not installed")
                for name in ("tracker-lab", "numpy", "scipy")
            ),
            *_extras(),
            *objects.report(),
        ]
    )
    raise click.exceptions.Exit(int(bool(failed)))


def _version(distribution: str) -> str | None:
    from importlib import metadata

    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def _extras() -> list[tuple[str, str]]:
    import re
    from importlib import metadata

    try:
        requirements = metadata.requires("tracker-lab") or []
    except metadata.PackageNotFoundError:
        return []
    absent: dict[str, list[str]] = {}
    for requirement in requirements:
        match = re.match(
            r"(?P<name>[\w.-]+).*extra\s*==\s*['\"](?P<extra>[\w-]+)['\"]", requirement
        )
        if match:
            missing = absent.setdefault(match["extra"], [])
            missing += [] if _version(match["name"]) else [match["name"]]
    return [
        (
            f"extra {extra}",
            f"lacks {', '.join(missing)}: pip install 'tracker-lab[{extra}]'"
            if missing
            else "present",
        )
        for extra, missing in absent.items()
    ]


def _facts(facts: Iterable[tuple[str, str]]) -> None:
    for name, value in facts:
        if value:
            click.echo(f"{name:<13} {value}")
