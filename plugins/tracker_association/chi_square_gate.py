"""The chi-square gate: which detections could belong to a track; who gets them is not decided here."""

from __future__ import annotations

import functools
from typing import Annotated, Any

import attrs
import numpy as np
import numpy.typing as npt

from tracker.errors import DomainError, wording
from tracker.types import Array


@functools.cache
def _quantile(probability: float, m: int) -> float:
    from scipy.special import gammaincinv  # SciPy is only for those who ask for a quantile

    return 2.0 * float(gammaincinv(m / 2.0, probability))


@attrs.frozen
class ChiSquareGate:
    """Admits a detection whose squared Mahalanobis distance is at most a threshold.

    The threshold is the quantile of the chi-square distribution with as many degrees of freedom as
    components were measured: a detection that belongs to the track passes with ``probability``. A
    ``squared_distance``, if given, is the threshold for any number of components instead.

    Shapes:
        distance of any shape; flags alike.
    Units:
        1 (squared standard deviations).

    Raises:
        DomainError: if probability is not in (0, 1), squared_distance is not positive, or m < 1.
    Reference:
        Bar-Shalom and Fortmann, Tracking and Data Association, 1988 (validation region).
    Laws:
        those of kind "gate": a larger probability gates no less; NaN never passes.

    Example:
    >>> round(ChiSquareGate(probability=0.999).threshold(2), 2)
    13.82
    >>> ChiSquareGate(squared_distance=13.8).admits(np.array([1.0, 13.9, np.nan]), 2).tolist()
    [True, False, False]
    """

    probability: float = attrs.field(default=0.99)
    squared_distance: Annotated[float | None, "1"] = attrs.field(default=None)

    @probability.validator
    def _a_probability(self, _attribute: object, value: Any) -> None:
        if not 0.0 < value < 1.0:
            raise DomainError(
                wording(
                    "parameter 'probability'",
                    got=value,
                    expected="a number between 0 and 1",
                    do="pass for example 0.99",
                )
            )

    @squared_distance.validator
    def _a_distance(self, _attribute: object, value: Any) -> None:
        if value is not None and not 0.0 < value < np.inf:
            raise DomainError(
                wording(
                    "parameter 'squared_distance'",
                    got=value,
                    expected="a positive number, or None for the quantile",
                    do="pass the square of the distance in standard deviations, for example 13.8",
                )
            )

    def threshold(self, m: int) -> float:
        """The largest squared distance that passes, for ``m`` measured components."""
        if m < 1:
            raise DomainError(
                wording(
                    "argument 'm'",
                    got=m,
                    expected="at least one measured component",
                    do="gate only what was measured",
                )
            )
        if self.squared_distance is not None:
            return self.squared_distance
        return _quantile(self.probability, m)

    def admits(self, distance: Array, m: int) -> npt.NDArray[np.bool_]:
        """Which squared distances pass."""
        return np.less_equal(distance, self.threshold(m))
