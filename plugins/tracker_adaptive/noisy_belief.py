"""What filters carry that estimate something of each measured component, beside a Gaussian state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tracker.errors import ShapeError, wording

COMPONENTS = 6
"""How many measured components a belief has room for that begins without knowing its sensors."""


def room_for(sensors: Sequence[Any] | None) -> int:
    """How many components the largest of some sensors measures."""
    return max(s.space.size for s in sensors) if sensors else COMPONENTS


def within(room: int, m: int, owner: str) -> None:
    """Refuse a sensor that measures more than a belief has room for.

    Raises:
        ShapeError: saying so.
    """
    if m > room:
        raise ShapeError(
            wording(
                f"filter {owner!r}",
                got=f"a sensor of {m} components, for a belief that has room for {room}",
                expected=f"at most {room}",
                do="begin with begin(prior, sensors=[...]), as tk.filter does",
            )
        )
