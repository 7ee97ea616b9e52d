"""The laws, one module per kind of component, after those that hold for every kind."""

# Importing declares the laws, and this order is that of every report.
from tracker.testing.laws import every  # noqa: F401, I001 - importing registers the laws, in this order
from tracker.testing.laws import motion, sensor, filter, smoother  # noqa: A004, F401 - as above
from tracker.testing.laws import adapter, gate, associator, optimiser  # noqa: F401 - as above
from tracker.testing.laws import path, metric  # noqa: F401 - as above
