"""Passive target tracking: where something is, and where it goes, from angles and time delays alone.

This module is only the front door: every name is imported when it is first used, so that
``import tracker`` stays light. Read `tracker.protocols` first.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tracker import testing as testing
    from tracker.errors import TrackerError as TrackerError
    from tracker.estimation import Estimator as Estimator
    from tracker.estimation import estimator as estimator
    from tracker.estimation import filter as filter  # noqa: A004
    from tracker.estimation import smooth as smooth
    from tracker.montecarlo import Campaign as Campaign
    from tracker.montecarlo import monte_carlo as monte_carlo
    from tracker.simulation import Scenario as Scenario
    from tracker.simulation import scenario as scenario

__version__ = "0.1.0"

_HOME = {
    "Association": "types",
    "Axis": "types",
    "Campaign": "montecarlo",
    "Columns": "types",
    "Component": "registry",
    "Estimator": "estimation",
    "Gaussian": "types",
    "History": "types",
    "Innovation": "types",
    "LocalTangentPlane": "geodesy",
    "PLANAR": "types",
    "Pipeline": "pipeline",
    "Projection": "types",
    "Record": "types",
    "SPATIAL": "types",
    "Scan": "types",
    "Scenario": "simulation",
    "Space": "types",
    "TrackerError": "errors",
    "Tracks": "types",
    "Trajectory": "types",
    "adapters": "registry",
    "associators": "registry",
    "default_registry": "registry",
    "estimator": "estimation",
    "filter": "estimation",
    "filters": "registry",
    "gates": "registry",
    "hookimpl": "hookspecs",
    "load_campaign": "montecarlo",
    "monte_carlo": "montecarlo",
    "motions": "registry",
    "optimisers": "registry",
    "planners": "registry",
    "read_detection_log": "io.detections",
    "scenario": "simulation",
    "scenarios": "registry",
    "sensors": "registry",
    "smooth": "estimation",
    "smoothers": "registry",
}
_MODULES = frozenset({
    "algebra", "errors", "estimation", "geodesy", "io", "metrics", "models", "montecarlo", "pipeline",
    "protocols", "registry", "report", "simulation", "testing", "types",
})  # fmt: skip

__all__ = sorted(_HOME)  # noqa: PLE0605 - kept beside what it names


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name in _MODULES:
        return import_module(f"tracker.{name}")
    if name in _HOME:
        value = getattr(import_module(f"tracker.{_HOME[name]}"), name)
        globals()[name] = value
        return value
    import difflib

    near = difflib.get_close_matches(name, [*_HOME, *_MODULES], n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise AttributeError(f"module 'tracker' has no attribute {name!r}{hint}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME, *_MODULES})
