"""The component records of Kalman-type filters and smoothers; nothing heavy is imported here."""

from tracker.hookspecs import hookimpl
from tracker.registry import Component, Registry


@hookimpl
def tracker_components(registry: Registry) -> None:
    """Offer the filters and smoothers of this package."""
    registry.add(
        Component(
            kind="filter",
            name="kf",
            target="tracker_kalman.kf:KalmanFilter",
            summary="Kalman filter for linear models, whitened update.",
            paper="4",
            equations=("2-5", "2-6", "2-7", "2-8", "2-9", "2-13", "2-14", "2-15"),
            tags=("gaussian", "linear", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="ekf1",
            target="tracker_kalman.ekf1:ExtendedKalmanFilter",
            summary="First-order extended Kalman filter, whitened update.",
            paper="0",
            equations=("6", "7", "8", "31"),
            tags=("gaussian", "nonlinear", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="ekf2",
            target="tracker_kalman.ekf2:SecondOrderExtendedKalmanFilter",
            summary="Second-order extended Kalman filter, complete innovation covariance.",
            paper="0",
            equations=("9", "10", "11", "33"),
            tags=("gaussian", "nonlinear", "second-order", "traced"),
        )
    )
    registry.add(
        Component(
            kind="filter",
            name="ekf1_joseph",
            target="tracker_kalman.joseph:JosephFilter",
            summary="First-order extended Kalman filter, Joseph form of the covariance.",
            paper="Bar-Shalom, Li and Kirubarajan 2001",
            equations=("5.2.3-18",),
            tags=("gaussian", "nonlinear", "traced"),
        )
    )
    registry.add(
        Component(
            kind="smoother",
            name="rts",
            target="tracker_kalman.rts:RauchTungStriebel",
            summary="Rauch-Tung-Striebel fixed-interval smoother.",
            paper="0",
            equations=("24",),
            tags=("gaussian", "fixed-interval", "traced"),
        )
    )
