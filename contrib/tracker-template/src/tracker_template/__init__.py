"""Relative bearing: the direction to a target counted from the bow of the observer."""

from tracker_template.relative_bearing import relative_bearing

__all__ = ["relative_bearing"]
