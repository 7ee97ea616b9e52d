"""Every error the framework raises on purpose; numerical failures of single lanes are flagged, never raised.

A message follows the house form *what - got - expected - do this*, so that it can be acted on without
reading the source. Nothing but exception classes and the functions that word them belongs here.
"""

from __future__ import annotations


class TrackerError(Exception):
    """Base of all errors raised by the framework; catch this to catch them all."""


class ShapeError(TrackerError, ValueError):
    """An array has the wrong number of axes, a wrong length, or does not broadcast."""


class DomainError(TrackerError, ValueError):
    """A number is outside the range in which it means something (NaN, negative variance, ...)."""


class CapabilityError(TrackerError, TypeError):
    """A component lacks an optional ability (a Hessian, a trace, ...) that another one needs."""


class TraceError(TrackerError, TypeError):
    """A component function cannot be run on graph nodes."""


class UnknownComponent(TrackerError, LookupError):
    """No component of that kind and name is registered."""


class PluginError(TrackerError, RuntimeError):
    """A plugin failed to import, registered twice, or needs something that is not installed."""


class ConfigError(TrackerError, ValueError):
    """A configuration file is wrong; the message carries file, line and path where they are known."""


def a_or_an(noun: str) -> str:
    """A noun with its article.

    Example:
    >>> a_or_an("filter"), a_or_an("adapter")
    ('a filter', 'an adapter')
    """
    return f"an {noun}" if noun[:1] in "aeio" else f"a {noun}"


def wording(what: str, *, got: object, expected: str, do: str) -> str:
    """Word a message in the house form.

    Example:
    >>> wording("argument 'sigma'", got=-1.0, expected="a positive number of radians", do="pass sigma > 0")
    "argument 'sigma': got -1.0; expected a positive number of radians. Do this: pass sigma > 0."
    """
    return f"{what}: got {got}; expected {expected}. Do this: {do}."
