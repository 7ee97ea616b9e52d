"""Installed plugins: each is loaded on its own, and what became of it is known."""

from __future__ import annotations

import json
import subprocess
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

import tracker.registry
from tracker.errors import PluginError, UnknownComponent
from tracker.registry import Registry, default_registry

Install = Callable[..., Path]
Run = Callable[..., "subprocess.CompletedProcess[str]"]


MISSPELT = """\
from tracker.hookspecs import hookimpl
@hookimpl
def tracker_components(wrong): ...
"""


def status(registry: Registry) -> dict[str, str]:
    return {report.name: report.status for report in registry.plugins}


def test_a_plugin_is_found_with_its_origin_and_load_time(install: Install) -> None:
    install("good", "one", "two", distribution="acme-filters", version="2.5")
    registry = Registry()
    registry.discover(only=["good"])
    (report,) = (report for report in registry.plugins if report.name == "good")
    assert (report.distribution, report.version, report.status) == ("acme-filters", "2.5", "loaded")
    assert report.components == 2
    assert report.seconds > 0
    assert str(registry.get("filter", "one").origin) == "acme-filters 2.5"


@pytest.mark.parametrize(
    ("top", "body", "cause"),
    [
        ("import no_such_module", (), "ModuleNotFoundError"),
        ("raise SystemExit('planted')", (), "SystemExit: planted"),
        ("def (", (), "SyntaxError"),
        ("", (), "no hook implementation"),
        ("", ("mine", "raise RuntimeError('half-way')"), "RuntimeError: half-way"),
        ("", ("mine", "raise SystemExit"), "SystemExit"),
        ("", ("mine", "registry.add(1)"), "Error"),
        (MISSPELT, (), "PluginValidationError"),
    ],
)
def test_a_plugin_that_fails_harms_nobody_and_leaves_nothing_behind(
    install: Install, top: str, body: tuple[str, ...], cause: str
) -> None:
    install("bad", *body, top=top)
    install("good", "kf")
    registry = Registry()
    registry.discover(only=["bad", "good"], strict=False)
    assert [one.name for one in registry] == ["kf"], "the half-registered component must be gone"
    (failed,) = (report for report in registry.plugins if report.status == "failed")
    assert failed.name == "bad"
    assert cause in failed.cause
    assert failed.traceback
    with pytest.raises(
        UnknownComponent, match=r"Plugins not loaded: .*bad of dist-bad 1\.0: failed"
    ):
        registry.get("filter", "mine")


def test_an_interrupt_is_not_a_plugin_failure(install: Install) -> None:
    install("slow", top="raise KeyboardInterrupt")
    with pytest.raises(KeyboardInterrupt):
        Registry().discover(only=["slow"])


def test_strict_mode_raises_the_failure_with_its_cause(
    install: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    install("bad", top="import no_such_module")
    monkeypatch.setenv("TRACKER_STRICT_PLUGINS", "1")
    with pytest.raises(
        PluginError, match=r"plugin 'bad' of dist-bad 1\.0.*no_such_module"
    ) as caught:
        Registry().discover(only=["bad"])
    assert isinstance(caught.value.__cause__, ModuleNotFoundError)
    Registry().discover(only=["bad"], strict=False)


def test_of_two_plugins_that_claim_a_name_the_second_fails_naming_both(install: Install) -> None:
    install("first", "kf", distribution="aaa")
    install("second", "other", "kf", distribution="bbb")
    registry = Registry()
    registry.discover(only=["first", "second"], strict=False)
    assert [one.name for one in registry] == ["kf"]
    (failed,) = (report for report in registry.plugins if report.status == "failed")
    assert "bbb 1.0" in failed.cause
    assert "aaa 1.0" in failed.cause


def test_a_stranger_never_displaces_a_component_of_ours(
    install: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tracker.registry, "OWN_DISTRIBUTION", "zzz")
    install("stranger", "kf", distribution="aaa")
    install("ours", "kf", distribution="zzz")
    registry = Registry()
    registry.discover(only=["stranger", "ours"], strict=False)
    assert registry.get("filter", "kf").origin.distribution == "zzz"


def test_plugins_are_pinned_and_blocked_by_the_environment(
    install: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    install("one", "kf_one")
    install("two", "kf_two")
    install("three", "kf_three")
    monkeypatch.setenv("TRACKER_PLUGINS", "one, two")
    monkeypatch.setenv("TRACKER_PLUGINS_BLOCK", "two")
    registry = Registry()
    registry.discover()
    assert [one.name for one in registry] == ["kf_one"]
    known = status(registry)
    assert (known["one"], known["two"], known["three"]) == ("loaded", "blocked", "not pinned")
    with pytest.raises(UnknownComponent, match=r"two of dist-two 1\.0: blocked"):
        registry.get("filter", "kf_two")


@pytest.mark.parametrize("variable", ["TRACKER_PLUGINS", "TRACKER_PLUGINS_BLOCK"])
def test_a_pinned_or_blocked_name_that_is_not_installed_is_an_error(
    install: Install, monkeypatch: pytest.MonkeyPatch, variable: str
) -> None:
    install("sonar", "kf")
    monkeypatch.setenv(variable, "sonra")
    with pytest.raises(PluginError, match=rf"{variable}.*did you mean 'sonar'"):
        Registry().discover()


def test_a_repaired_plugin_is_picked_up_and_the_loaded_ones_are_kept(install: Install) -> None:
    site = install("bad", top="import no_such_module")
    install("good", "kf")
    registry = Registry()
    registry.discover(only=["bad", "good"], strict=False)
    (site / "fake_bad.py").write_text(
        (site / "fake_good.py").read_text().replace("'kf'", "'repaired'")
    )
    registry.discover(only=["bad", "good"], strict=False)
    assert [one.name for one in registry] == ["kf", "repaired"]


def test_a_distribution_without_metadata_still_counts(install: Install) -> None:
    site = install("good", "kf")
    (site / "dist_good-1.0.dist-info" / "METADATA").write_text("")
    registry = Registry()
    registry.discover(only=["good"])
    assert registry.get("filter", "kf").origin.distribution == "unknown distribution"


def test_threads_that_come_first_together_discover_once_and_see_everything(
    install: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    pause = "import time; time.sleep(0.05)"
    install("slow", "first", pause, "kf", top=pause)
    monkeypatch.setenv("TRACKER_PLUGINS", "slow")
    monkeypatch.setattr(tracker.registry, "_default", Registry())
    seen: list[list[str]] = []
    barrier = threading.Barrier(8)

    def ask() -> None:
        barrier.wait()
        seen.append([one.name for one in default_registry()])

    threads = [threading.Thread(target=ask) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert seen == [["first", "kf"]] * 8


def test_a_plugin_that_asks_for_the_default_registry_does_not_recurse(
    install: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    install("curious", "kf", top="from tracker.registry import *; default_registry()")
    monkeypatch.setenv("TRACKER_PLUGINS", "curious")
    monkeypatch.setattr(tracker.registry, "_default", Registry())
    assert [one.name for one in default_registry()] == ["kf"]


def test_registering_and_listing_import_no_target_and_nothing_heavy(
    install: Install, run: Run
) -> None:
    site = install("lazy", "registry.add(Component('filter', 'kf', 'fake_target:Heavy', 's', '0'))")
    (site / "fake_target.py").write_text("import decimal\nclass Heavy: ...\n")
    ran = run(
        """
        import json, sys
        from tracker.registry import default_registry, filters
        names = filters.names()
        heavy = {"scipy", "rich", "click", "numpy", "matplotlib", "fake_target"} & set(sys.modules)
        filters.make("kf")
        print(json.dumps([names, sorted(heavy), "fake_target" in sys.modules]))
        """,
        TRACKER_PLUGINS="lazy",
    )
    assert ran.returncode == 0, ran.stderr
    assert json.loads(ran.stdout) == [["kf"], [], True]
