"""What this plugin offers. Nothing heavy is imported here: every `tracker list` reads it."""

from tracker.hookspecs import hookimpl
from tracker.registry import Component, Registry


@hookimpl
def tracker_components(registry: Registry) -> None:
    """Add the sensors of this package."""
    registry.add(
        Component(
            kind="sensor",
            name="relative_bearing",
            target="tracker_template.relative_bearing:relative_bearing",
            summary="direction to the target, clockwise from the observer's bow",
            paper="Bowditch, The American Practical Navigator",
            tags=("passive", "angles", "2-D"),
            examples=("relative_bearing(sigma=0.02)",),
        )
    )
