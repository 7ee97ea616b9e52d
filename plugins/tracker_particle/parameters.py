"""What the parameters of particle filters must be, and the words when they are not."""

from __future__ import annotations

import math
from typing import Any

from tracker.errors import DomainError, wording


def a_count(_instance: object, attribute: Any, value: Any) -> None:
    """Refuse what is not a positive whole number."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise DomainError(
            wording(
                f"parameter {attribute.name!r}",
                got=repr(value),
                expected="a positive whole number",
                do="pass for example 1000",
            )
        )


def a_share(_instance: object, attribute: Any, value: Any) -> None:
    """Refuse what is not a number from 0 to 1."""
    if not 0.0 <= value <= 1.0:
        raise DomainError(
            wording(
                f"parameter {attribute.name!r}",
                got=value,
                expected="a share of the particles, from 0 (never) to 1 (always)",
                do="pass for example 0.5",
            )
        )


def positive(_instance: object, attribute: Any, value: Any) -> None:
    """Refuse what is not a positive number."""
    if not 0.0 < value < math.inf:
        raise DomainError(
            wording(
                f"parameter {attribute.name!r}",
                got=value,
                expected="a positive number",
                do="pass for example 1.0",
            )
        )
