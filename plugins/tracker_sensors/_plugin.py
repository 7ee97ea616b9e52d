"""What this plugin offers, as records; the sensors themselves are imported when first made."""

from __future__ import annotations

from tracker.hookspecs import hookimpl
from tracker.registry import Component, Registry


@hookimpl
def tracker_components(registry: Registry) -> None:
    """Add the sensors."""
    for component in _COMPONENTS:
        registry.add(component)


_COMPONENTS = (
    Component(
        kind="sensor",
        name="azimuth",
        target="tracker_sensors.azimuth:azimuth",
        summary="horizontal direction to the target, from the x axis or from north",
        paper="0",
        equations=("(30)-(33)", "paper 2 (9)-(12), (20)-(22)", "paper 3 (12), (15)"),
        tags=("passive", "angles", "2-D"),
        examples=("azimuth(sigma=0.03)",),
    ),
    Component(
        kind="sensor",
        name="position",
        target="tracker_sensors.position:position",
        summary="Cartesian position in the frame of the state",
        paper="1",
        equations=("(7)", "paper 4 (3-12)"),
        tags=("linear", "2-D", "3-D"),
        examples=("position(sigma=5.0)",),
    ),
    Component(
        kind="sensor",
        name="range_only",
        target="tracker_sensors.range_only:range_only",
        summary="distance of the target from the sensor",
        paper="3",
        equations=("(3)", "(4)"),
        tags=("active", "range", "2-D", "3-D"),
        examples=("range_only(sigma=5.0)",),
    ),
    Component(
        kind="sensor",
        name="stack",
        target="tracker_sensors.stack:stack",
        summary="several sensors with their own poses, read at the same instant, as one",
        paper="0",
        equations=("(30)", "paper 4 (4-14), (5-10)"),
        tags=("composition",),
    ),
)
