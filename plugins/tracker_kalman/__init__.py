"""Kalman-type filters and their smoothers, one module per published method."""

from importlib import import_module
from typing import Any

_HOME = {
    "ExtendedKalmanFilter": "ekf1",
    "FixedLagSmoother": "fixed_lag",
    "FixedPoint": "fixed_point",
    "GaussianSumFilter": "gaussian_sum",
    "InteractingMultipleModels": "imm",
    "HuberUpdate": "huber",
    "InformationFilter": "information",
    "InformationState": "information",
    "IteratedExtendedKalmanFilter": "iterated",
    "JosephFilter": "joseph",
    "KalmanFilter": "kf",
    "ModeSmoother": "imm_smoother",
    "PosteriorLinearisationFilter": "posterior_linearisation",
    "RauchTungStriebel": "rts",
    "SquareRootRauchTungStriebel": "square_root_rts",
    "TwoFilterSmoother": "two_filter",
    "drawn": "starts",
    "two_point": "starts",
    "SigmaPointFilter": "sigma_point",
    "SigmaPointRauchTungStriebel": "sigma_point_rts",
    "SquareRootSigmaPointFilter": "square_root_sigma_point",
    "SchmidtFilter": "schmidt",
    "SecondOrderExtendedKalmanFilter": "ekf2",
    "SquareRootFilter": "square_root",
    "StudentTUpdate": "student_t",
}
__all__ = sorted(_HOME)  # noqa: PLE0605 - kept beside what it names


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"tracker_kalman.{_HOME[name]}"), name)
    raise AttributeError(f"module 'tracker_kalman' has no attribute {name!r}")
