"""The conformance kit: whether a component obeys the laws of its kind, for our plugins and anyone's.

Three lines are a test::

    from tracker.testing import parametrize_checks

    @parametrize_checks([MySensor()], expected_failures={"hessian": "first order by design"})
    def test_conforms(component, check): check(component)

`check_component` gives the same as a report; ``tracker check NAME`` prints it. Laws are in
`tracker.testing.laws`, one module per kind; strategies that draw states, poses, covariances and
records are public, in `tracker.testing.strategies`. Needs hypothesis (``tracker-lab[test]``); nothing
in the framework imports this package. Nothing here estimates anything.
"""

from tracker.testing.kit import (
    FLOOR,
    Check,
    Outcome,
    Report,
    check_component,
    check_record,
    from_record,
    kind_of,
    outcomes,
    parametrize_checks,
)
from tracker.testing.law import KINDS, Law, laws
from tracker.testing.strategies import (
    batch_shapes,
    covariances,
    generators,
    poses,
    records,
    states,
    time_steps,
)

__all__ = [
    "FLOOR",
    "KINDS",
    "Check",
    "Law",
    "Outcome",
    "Report",
    "batch_shapes",
    "check_component",
    "check_record",
    "covariances",
    "from_record",
    "generators",
    "kind_of",
    "laws",
    "outcomes",
    "parametrize_checks",
    "poses",
    "records",
    "states",
    "time_steps",
]
