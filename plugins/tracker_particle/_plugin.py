"""The component records of particle filters and smoothers; nothing heavy is imported here."""

from tracker.hookspecs import hookimpl
from tracker.registry import Component, Registry


@hookimpl
def tracker_components(registry: Registry) -> None:
    """Offer the filters and smoothers of this package."""
    for component in _COMPONENTS:
        registry.add(component)


_COMPONENTS = (
    Component(
        kind="filter",
        name="bootstrap",
        target="tracker_particle.bootstrap:BootstrapFilter",
        summary="Bootstrap particle filter: particles move as the model says, and are weighed.",
        paper="Gordon, Salmond and Smith 1993",
        tags=("particles", "nonlinear", "random", "opaque"),
    ),
    Component(
        kind="filter",
        name="auxiliary",
        target="tracker_particle.auxiliary:AuxiliaryFilter",
        summary="Auxiliary particle filter: parents are chosen in sight of the measurement.",
        paper="Pitt and Shephard 1999",
        tags=("particles", "nonlinear", "random", "opaque"),
    ),
    Component(
        kind="filter",
        name="regularised",
        target="tracker_particle.regularised:RegularisedFilter",
        summary="Regularised particle filter: copies are spread by a kernel of best bandwidth.",
        paper="Musso, Oudjane and Le Gland 2001",
        tags=("particles", "nonlinear", "random", "opaque"),
    ),
    Component(
        kind="filter",
        name="marginalised",
        target="tracker_particle.marginalised:MarginalisedFilter",
        summary="Marginalised particle filter: what is linear is left to a Kalman filter per particle.",
        paper="Schön, Gustafsson and Nordlund 2005",
        equations=("18", "19", "20", "21", "22", "23", "24", "25"),
        tags=("particles", "nonlinear", "random", "opaque"),
    ),
    Component(
        kind="smoother",
        name="backward_simulation",
        target="tracker_particle.backward_simulation:BackwardSimulation",
        summary="Backward simulation over particles: draws of whole paths given all measurements.",
        paper="Godsill, Doucet and West 2004",
        tags=("particles", "fixed-interval", "random", "opaque"),
    ),
)
