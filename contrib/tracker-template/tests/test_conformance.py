"""The three lines that hold the sensor to the laws of its kind."""

from tracker.testing import parametrize_checks
from tracker_template.relative_bearing import relative_bearing


@parametrize_checks([relative_bearing(sigma=0.02)])
def test_conforms(component, check):
    check(component)
