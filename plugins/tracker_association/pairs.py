"""Which pairs of track and detection an association may choose from; how it chooses is not decided here."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tracker.errors import ShapeError, wording
from tracker.types import Array


def possible_pairs(distance: Array, admitted: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Admitted pairs at a finite distance: a detection that is NaN is near to nobody.

    Shapes:
        distance, admitted ``(tracks, D, *batch)``; result alike.

    Raises:
        ShapeError: if the two shapes differ or have less than two axes.
    """
    if distance.ndim < 2 or admitted.shape != distance.shape:
        raise ShapeError(
            wording(
                "arguments 'distance' and 'admitted'",
                got=f"shapes {distance.shape} and {admitted.shape}",
                expected="(tracks, D, *batch), both alike",
                do="pass what the gate answered for these distances",
            )
        )
    return admitted & np.isfinite(distance)
