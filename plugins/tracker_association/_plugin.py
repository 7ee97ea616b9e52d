"""What this plugin offers, as records; the methods themselves are imported when first made."""

from __future__ import annotations

from tracker.hookspecs import hookimpl
from tracker.registry import Component, Registry


@hookimpl
def tracker_components(registry: Registry) -> None:
    """Add the gates and associators."""
    for component in _COMPONENTS:
        registry.add(component)


_COMPONENTS = (
    Component(
        kind="gate",
        name="chi_square",
        target="tracker_association.chi_square_gate:ChiSquareGate",
        summary="admits what lies within a quantile of the chi-square distribution, or a given distance",
        paper="Bar-Shalom and Fortmann, Tracking and Data Association, 1988",
        tags=("gating",),
        examples=("chi_square(probability=0.99)", "chi_square(squared_distance=13.8)"),
    ),
    Component(
        kind="associator",
        name="nearest_neighbour",
        target="tracker_association.nearest_neighbour:NearestNeighbour",
        summary="each track takes its nearest detection; the nearer pair goes first",
        paper="Blackman and Popoli, Design and Analysis of Modern Tracking Systems, 1999",
        tags=("hard", "greedy"),
    ),
    Component(
        kind="associator",
        name="global_nearest_neighbour",
        target="tracker_association.global_nearest_neighbour:GlobalNearestNeighbour",
        summary="as many pairs as the gate allows, at least total squared distance",
        paper="Blackman and Popoli, Design and Analysis of Modern Tracking Systems, 1999",
        tags=("hard", "optimal"),
    ),
)
