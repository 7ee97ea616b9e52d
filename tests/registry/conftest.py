"""Distributions made of files, as an installer would leave them, and a way to run code beside them."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

Install = Callable[..., Path]
Run = Callable[..., "subprocess.CompletedProcess[str]"]

_ADD = "registry.add(Component('filter', '{}', 'fractions:Fraction', 'a fake', '0'))"
_HOOK = """\
from tracker.hookspecs import hookimpl
from tracker.registry import Component
@hookimpl
def tracker_components(registry):
"""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Install a distribution of one plugin: importable, with metadata and entry point.

    Its hook registers a filter for each identifier in the body and runs what is none; the source of
    ``top`` stands before it, and alone if there is no body.
    """
    monkeypatch.syspath_prepend(tmp_path)
    for variable in ("TRACKER_PLUGINS", "TRACKER_PLUGINS_BLOCK", "TRACKER_STRICT_PLUGINS"):
        monkeypatch.delenv(variable, raising=False)

    def installed(
        plugin: str, *body: str, top: str = "", distribution: str = "", version: str = "1.0"
    ) -> Path:
        distribution = distribution or f"dist-{plugin}"
        lines = [_ADD.format(line) if line.isidentifier() else line for line in body]
        source = [top, _HOOK + textwrap.indent("\n".join(lines), "    ") if lines else ""]
        (tmp_path / f"fake_{plugin}.py").write_text("\n".join(source))
        info = tmp_path / f"{distribution.replace('-', '_')}-{version}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {distribution}\nVersion: {version}\n"
        )
        (info / "entry_points.txt").write_text(f"[tracker.plugins]\n{plugin} = fake_{plugin}\n")
        return tmp_path

    yield installed
    for name, module in list(sys.modules.items()):
        if str(getattr(module, "__file__", "")).startswith(str(tmp_path)):
            del sys.modules[name]


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """Run Python code in a process that sees what was installed; returns what it printed."""

    def ran(code: str, **variables: str) -> subprocess.CompletedProcess[str]:
        environment = {k: v for k, v in os.environ.items() if not k.startswith("TRACKER_")}
        environment["PYTHONPATH"] = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
        return subprocess.run(
            [sys.executable, "-c", textwrap.dedent(code)],
            env=environment | variables,
            capture_output=True,
            text=True,
            check=False,
        )

    return ran
