"""The component records of the papers' scenarios; nothing heavy is imported here."""

from tracker.hookspecs import hookimpl
from tracker.registry import Component, Registry


@hookimpl
def tracker_components(registry: Registry) -> None:
    """Offer the scenarios of this package."""
    registry.add(
        Component(
            kind="scenario",
            name="two_stations",
            target="tracker_papers.two_stations:two_stations",
            summary="A ship seen from two fixed stations by azimuth alone.",
            paper="0",
            equations=("26-31", "34", "35"),
            tags=("passive", "bearings", "2-D"),
        )
    )
    registry.add(
        Component(
            kind="scenario",
            name="line",
            target="tracker_papers.line:line",
            summary="A target on a line, its position measured: linear and Gaussian.",
            paper="Särkkä 2013",
            equations=("example 4.3",),
            tags=("linear", "1-D"),
        )
    )
    registry.add(
        Component(
            kind="scenario",
            name="moving_observer",
            target="tracker_papers.moving_observer:moving_observer",
            summary="Bearings only from one observer that goes straight, or manoeuvres.",
            paper="2",
            equations=("9-12",),
            tags=("passive", "bearings", "2-D", "observability"),
        )
    )
