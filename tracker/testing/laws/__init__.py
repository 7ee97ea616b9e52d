"""The laws, one module per kind of component and one for what every kind must do."""

from tracker.testing.laws import (  # noqa: F401 - importing declares the laws
    motion,  # isort: skip
    sensor,
    filter,  # noqa: A004 - named after the kind
    smoother,
    gate,
    associator,
    every,
)
