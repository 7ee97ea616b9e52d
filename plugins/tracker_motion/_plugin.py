"""What this plugin offers, as records; the models themselves are imported when first made."""

from __future__ import annotations

from tracker.hookspecs import hookimpl
from tracker.registry import Component, Registry


@hookimpl
def tracker_components(registry: Registry) -> None:
    """Add the motion models."""
    for component in _COMPONENTS:
        registry.add(component)


_COMPONENTS = (
    Component(
        kind="motion",
        name="constant_velocity",
        target="tracker_motion.constant_velocity:constant_velocity",
        summary="constant velocity disturbed by white acceleration, 1 to 3 axes",
        paper="0",
        equations=("(3)", "(4)", "(26)-(29)", "paper 3 (6)-(10)"),
        tags=("linear", "kinematic", "continuous-noise", "1-D", "2-D", "3-D"),
        examples=("constant_velocity(density=0.1)",),
    ),
)
