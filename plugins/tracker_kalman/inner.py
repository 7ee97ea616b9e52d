"""What filters made of other filters take as parameters, how it is checked, and what they leave to those.

No filter lives here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from tracker.errors import CapabilityError, DomainError, wording
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Projection


def gaussian_filter(value: Any) -> Any:
    """A filter whose belief is a Gaussian, or the registered one of that name.

    Raises:
        UnknownComponent: for a name that is not registered.
        CapabilityError: for what is no filter, or carries another kind of belief.
    """
    if isinstance(value, str):
        from tracker.registry import default_registry

        value = default_registry().get("filter", value).make()
    lacks = [name for name in ("predict", "project", "update") if not hasattr(value, name)]
    if lacks or hasattr(value, "begin"):
        raise CapabilityError(
            wording(
                "parameter 'inner'",
                got=f"a {type(value).__name__}, "
                + (f"without {lacks[0]}" if lacks else "which carries its own kind of belief"),
                expected="a filter whose belief is a Gaussian, such as 'ekf1', 'ekf2' or 'ukf'",
                do="name one of those; `tracker list filter` shows all",
            )
        )
    return value


def conditioning_filter(value: Any) -> Any:
    """As `gaussian_filter`, for who replaces the update: that of the inner filter must be Bayes' rule alone.

    Raises:
        CapabilityError: as `gaussian_filter`, and for a filter that updates by a rule of its own, which
            would be lost without a word (class attribute ``own_update``).
    """
    value = gaussian_filter(value)
    if getattr(value, "own_update", False):
        raise CapabilityError(
            wording(
                "parameter 'inner'",
                got=f"a {type(value).__name__}, whose update is its own",
                expected="a filter that only projects and conditions, such as 'ekf1', 'ekf2' or 'ukf'",
                do="wrap the filter inside it instead: two such updates cannot both be made",
            )
        )
    return value


# Methods of a filter with a parameter ``inner``; it takes them by name, as ``project = project_as_inner``.
def _needs(self: Any) -> tuple[str, ...]:
    """What its inner filter needs."""
    return tuple(self.inner.needs)


def _tags(self: Any) -> tuple[str, ...]:
    """What its inner filter says of itself."""
    return tuple(getattr(self.inner, "tags", ()))


needs_of_inner, tags_of_inner = property(_needs), property(_tags)


def predict_as_inner(
    self: Any, state: Any, motion: MotionModel, dt: Any, u: Any = None, t: Any = None
) -> Any:
    """As its inner filter."""
    return self.inner.predict(state, motion, dt, u, t)


def project_as_inner(self: Any, state: Any, sensor: SensorModel, pose: Any = None) -> Projection:
    """As its inner filter."""
    seen: Projection = self.inner.project(state, sensor, pose)
    return seen


def names(value: str | Iterable[str]) -> tuple[str, ...]:
    """Names of components, from one of them or several."""
    return (value,) if isinstance(value, str) else tuple(value)


def at_least(least: int, owner: str) -> Any:
    """A validator: an integer that is not below ``least``."""

    def check(_instance: Any, attribute: Any, value: Any) -> None:
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise DomainError(
                wording(
                    f"parameter {attribute.name!r} of {owner}",
                    got=repr(value),
                    expected=f"an integer of at least {least}",
                    do="pass a small number: each one costs another turn",
                )
            )

    return check


def positive_number(owner: str) -> Any:
    """A validator: a finite number above zero."""

    def check(_instance: Any, attribute: Any, value: Any) -> None:
        if not (isinstance(value, (int, float)) and 0.0 < value < math.inf):
            raise DomainError(
                wording(
                    f"parameter {attribute.name!r} of {owner}",
                    got=repr(value),
                    expected="a finite number above zero",
                    do="leave it out for the usual one",
                )
            )

    return check
