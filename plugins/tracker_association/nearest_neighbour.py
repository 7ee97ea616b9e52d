"""Nearest neighbour per target; the assignment that is best for all targets together lives next door."""

from __future__ import annotations

import math

import attrs
import numpy as np
import numpy.typing as npt

from tracker.types import Array, Association
from tracker_association.pairs import possible_pairs


@attrs.frozen
class NearestNeighbour:
    """Each track takes the nearest detection that its gate admits, the nearest pair first.

    Two tracks may want the same detection, and it may be given away only once: the nearer track
    gets it, and the other takes the nearest of what is left, or misses. Of equal distances the
    first track, then the first detection, goes first.

    Shapes:
        distance, admitted ``(tracks, D, *batch)``; weights ``(tracks, D + 1, *batch)``, one-hot.

    Raises:
        ShapeError: if the two shapes differ or have less than two axes.
    Reference:
        Blackman and Popoli, Design and Analysis of Modern Tracking Systems, 1999.
    Laws:
        those of kind "associator"; equal to the global nearest neighbour where no two tracks want
        the same detection.

    Example:
    >>> distance = np.array([[1.0, 4.0], [0.5, 1.0]])
    >>> NearestNeighbour().associate(distance, distance < 5.0).hard.tolist()
    [1, 0]
    """

    def associate(self, distance: Array, admitted: npt.NDArray[np.bool_]) -> Association:
        """Hand out detections, the nearest pair first."""
        left = np.where(possible_pairs(distance, admitted), distance, np.inf)
        tracks, detections, *batch = left.shape
        lanes = np.arange(math.prod(batch))
        left = left.reshape(tracks, detections, len(lanes))
        weights = np.zeros((tracks, detections + 1, len(lanes)))
        for _ in range(min(tracks, detections)):
            first = left.reshape(tracks * detections, len(lanes)).argmin(axis=0)
            track, detection = np.divmod(first, detections)
            found = np.isfinite(left[track, detection, lanes])
            if not found.any():
                break
            weights[track, detection, lanes] += found
            left[track, :, lanes] = np.inf
            left[:, detection, lanes] = np.inf
        weights[:, detections] = 1.0 - weights[:, :detections].sum(axis=1)
        return Association(weights.reshape(tracks, detections + 1, *batch))
