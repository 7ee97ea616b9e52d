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
    from tracker.estimation import filter as filter  # noqa: A004 - the field's word
    from tracker.estimation import smooth as smooth
    from tracker.geodesy import LocalTangentPlane as LocalTangentPlane
    from tracker.hookspecs import hookimpl as hookimpl
    from tracker.io.detections import read_detection_log as read_detection_log
    from tracker.late import FixedLag as FixedLag
    from tracker.montecarlo import Campaign as Campaign
    from tracker.montecarlo import load_campaign as load_campaign
    from tracker.montecarlo import monte_carlo as monte_carlo
    from tracker.noise_estimation import expectation_maximisation as expectation_maximisation
    from tracker.optimisation import Optimisation as Optimisation
    from tracker.optimisation import load_optimisation as load_optimisation
    from tracker.optimisation import optimise as optimise
    from tracker.pipeline import Pipeline as Pipeline
    from tracker.registry import Component as Component
    from tracker.registry import adapters as adapters
    from tracker.registry import associators as associators
    from tracker.registry import default_registry as default_registry
    from tracker.registry import filters as filters
    from tracker.registry import functions as functions
    from tracker.registry import gates as gates
    from tracker.registry import motions as motions
    from tracker.registry import optimisers as optimisers
    from tracker.registry import paths as paths
    from tracker.registry import planners as planners
    from tracker.registry import reproductions as reproductions
    from tracker.registry import scenarios as scenarios
    from tracker.registry import sensors as sensors
    from tracker.registry import smoothers as smoothers
    from tracker.simulation import Scenario as Scenario
    from tracker.simulation import scenario as scenario
    from tracker.tuning import Tuning as Tuning
    from tracker.tuning import load_tuning as load_tuning
    from tracker.tuning import tune as tune
    from tracker.types import PLANAR as PLANAR
    from tracker.types import SPATIAL as SPATIAL
    from tracker.types import Association as Association
    from tracker.types import Axis as Axis
    from tracker.types import Columns as Columns
    from tracker.types import Gaussian as Gaussian
    from tracker.types import History as History
    from tracker.types import Innovation as Innovation
    from tracker.types import Projection as Projection
    from tracker.types import Record as Record
    from tracker.types import Scan as Scan
    from tracker.types import Space as Space
    from tracker.types import Tracks as Tracks
    from tracker.types import Trajectory as Trajectory

__version__ = "0.1.0"

_HOME = {
    "Association": "types",
    "Axis": "types",
    "Campaign": "montecarlo",
    "Columns": "types",
    "Component": "registry",
    "Estimator": "estimation",
    "FixedLag": "late",
    "Gaussian": "types",
    "History": "types",
    "Innovation": "types",
    "LocalTangentPlane": "geodesy",
    "Optimisation": "optimisation",
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
    "Tuning": "tuning",
    "adapters": "registry",
    "associators": "registry",
    "default_registry": "registry",
    "estimator": "estimation",
    "expectation_maximisation": "noise_estimation",
    "filter": "estimation",
    "filters": "registry",
    "functions": "registry",
    "gates": "registry",
    "hookimpl": "hookspecs",
    "load_campaign": "montecarlo",
    "load_optimisation": "optimisation",
    "load_tuning": "tuning",
    "monte_carlo": "montecarlo",
    "motions": "registry",
    "optimise": "optimisation",
    "optimisers": "registry",
    "paths": "registry",
    "planners": "registry",
    "read_detection_log": "io.detections",
    "reproductions": "registry",
    "scenario": "simulation",
    "scenarios": "registry",
    "sensors": "registry",
    "smooth": "estimation",
    "smoothers": "registry",
    "tune": "tuning",
}
_MODULES = frozenset({
    "algebra", "errors", "estimation", "geodesy", "io", "metrics", "models", "montecarlo", "pipeline",
    "protocols", "registry", "report", "reproduction", "simulation", "testing", "types",
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
