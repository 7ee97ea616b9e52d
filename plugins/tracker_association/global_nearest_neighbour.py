"""Global nearest neighbour: the assignment that is best for all tracks of a scan together."""

from __future__ import annotations

import attrs
import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from tracker.types import Array, Association
from tracker_association.pairs import possible_pairs


@attrs.frozen
class GlobalNearestNeighbour:
    """One-to-one assignment at least total squared distance.

    As many tracks as the gate allows get a detection; among all such assignments the one with the
    least sum of squared distances is taken. Missing a track therefore costs more than any distance
    that the gate admits; each detection is given away at most once.

    Shapes:
        distance, admitted ``(tracks, D, *batch)``; weights ``(tracks, D + 1, *batch)``, one-hot.

    Raises:
        ShapeError: if the two shapes differ or have less than two axes.
    Reference:
        Blackman and Popoli, Design and Analysis of Modern Tracking Systems, 1999; solved
        by Crouse, On implementing 2D rectangular assignment algorithms, IEEE T-AES 52(4), 2016.
    Laws:
        those of kind "associator"; equal to the best of all assignments tried one by one.

    Example:
    >>> distance = np.array([[1.0, 4.0], [0.5, 1.0]])
    >>> GlobalNearestNeighbour().associate(distance, distance < 5.0).hard.tolist()
    [0, 1]
    """

    def associate(self, distance: Array, admitted: npt.NDArray[np.bool_]) -> Association:
        """Solve one assignment problem per lane of the batch."""
        possible = possible_pairs(distance, admitted)
        tracks, detections, *batch = possible.shape
        weights = np.zeros((tracks, detections + 1, *batch))
        weights[:, detections] = 1.0
        if possible.any():
            # One refused pair costs more than all admitted ones together.
            most = float(np.max(distance, where=possible, initial=0.0))
            cost = np.where(possible, distance, 1.0 + most * min(tracks, detections))
            for lane in np.ndindex(*batch):
                here = (slice(None), slice(None), *lane)
                pairs = zip(*linear_sum_assignment(cost[here]), strict=True)
                for track, detection in pairs:
                    if possible[(track, detection, *lane)]:
                        weights[(track, detection, *lane)] = 1.0
                        weights[(track, detections, *lane)] = 0.0
        return Association(weights)
