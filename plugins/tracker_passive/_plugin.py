"""The component records of passive tracking; nothing heavy is imported here."""

from tracker.hookspecs import hookimpl
from tracker.registry import Component, Registry


@hookimpl
def tracker_components(registry: Registry) -> None:
    """Offer the starts and filters of this package."""
    registry.add(
        Component(
            kind="filter",
            name="range_parameterised",
            target="tracker_passive.range_parameterised:RangeParameterised",
            summary="A bank of filters along the line of the first direction, for unknown range.",
            paper="Peach, Bearings-only tracking using a set of range-parameterised extended Kalman filters, 1995",
            tags=("bearings", "mixture", "nonlinear", "passive", "start"),
            deviations={
                "an update never raises the covariance": "the first direction turns a Gaussian into what "
                "is not one: along the line of sight the true posterior can be wider than the prior"
            },
        )
    )
