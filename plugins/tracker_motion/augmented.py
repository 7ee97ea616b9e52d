"""Any motion with further components that stay as they are, or drift: biases and the like."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any

import attrs

from tracker.errors import CapabilityError, ShapeError, wording
from tracker.models import ComponentMotion, positive
from tracker.models.component import signature_of
from tracker.protocols import MotionModel
from tracker.types import ArrayLike, Space


@attrs.frozen
class _Advanced:
    """The motion's own function, then the further components as they are."""

    function: Callable[..., Any]
    more: tuple[str, ...]

    @property
    def positional(self) -> tuple[str, ...]:
        return (*signature_of(self.function)[0], *self.more)

    @property
    def keywords(self) -> tuple[str, ...]:
        return signature_of(self.function)[1]

    def __call__(self, *components: Any, **given: Any) -> Any:
        own = len(components) - len(self.more)
        return (*self.function(*components[:own], **given), *components[own:])


@attrs.frozen
class _Noise:
    """The motion's own covariance, and a random walk for each further component."""

    function: Callable[..., Any]
    more: tuple[str, ...]

    @property
    def positional(self) -> tuple[str, ...]:
        return signature_of(self.function)[0]

    @property
    def keywords(self) -> tuple[str, ...]:
        densities = (f"density_{name}" for name in self.more)
        return tuple(dict.fromkeys((*signature_of(self.function)[1], "dt", *densities)))

    def __call__(self, *components: Any, **given: Any) -> Any:
        chosen = {name: given[name] for name in signature_of(self.function)[1]}
        rows = self.function(*components, **chosen)
        own, count = len(rows), len(self.more)
        drift = [given[f"density_{name}"] * given["dt"] for name in self.more]
        return (
            *((*row, *(0.0,) * count) for row in rows),
            *(
                (*(0.0,) * own, *(drift[i] if i == j else 0.0 for j in range(count)))
                for i in range(count)
            ),
        )


def augmented(
    motion: MotionModel,
    components: Sequence[str],
    density: Annotated[ArrayLike | Sequence[ArrayLike], "unit^2/s"] = 0.0,
) -> ComponentMotion:
    """The same motion with further components that are constant, or drift as random walks.

    For what a sensor does not know of itself - a bias, a misalignment, an unknown frequency - and a
    filter estimates or considers (`tracker_sensors.biased`, filter "schmidt"). Over ``dt`` seconds a
    component gains the variance ``density * dt``: zero is a constant. One number serves all; a tuple
    or list holds one per component. They become the parameters ``density_<name>``.

    Shapes:
        state ``(n + k, *batch)``: those of the motion, then the k further ones.
    Units:
        density: the square of the component's unit, per second.

    Raises:
        CapabilityError: if the motion is not written over components.
        ShapeError: if there are as many densities as components neither nor one.
        DomainError: if a density is negative, or a component is there already.
    Reference:
        Bar-Shalom, Li and Kirubarajan (2001), section 11.9: augmentation of the state.
    Laws:
        those of kind "motion"; its own components move as they do alone.

    Example:
    >>> from tracker_motion import constant_velocity
    >>> motion = augmented(constant_velocity(0.1), ["bias [rad]"], density=1e-6)
    >>> motion.space.names, motion.f([0.0, 0.0, 1.0, 2.0, 0.1], dt=2.0).tolist()
    (('x', 'y', 'vx', 'vy', 'bias'), [2.0, 4.0, 1.0, 2.0, 0.1])
    """
    if not isinstance(motion, ComponentMotion):
        raise CapabilityError(
            wording(
                "parameter 'motion' of motion 'augmented'",
                got=f"a {type(motion).__name__}",
                expected="a motion written over components (tracker.models.ComponentMotion)",
                do="write its f and Q as functions of named components",
            )
        )
    space = Space.of(*components)
    several = isinstance(density, (tuple, list))
    given: Any = density
    densities: list[Any] = list(given) if several else [given] * len(space)
    if len(densities) != len(space) or not len(space):
        raise ShapeError(
            wording(
                "parameter 'density' of motion 'augmented'",
                got=f"{len(densities)} densities for {len(space)} components",
                expected="at least one component, and one density for all or one for each",
                do="give a number, or a tuple with one per component",
            )
        )
    names = space.names
    more = {
        f"density_{name}": positive(f"density_{name}", value, zero=True)
        for name, value in zip(names, densities, strict=True)
    }
    return ComponentMotion(
        name="augmented",
        advance=_Advanced(motion.advance, names),
        noise=_Noise(motion.noise, names),
        space=motion.space + space,
        input_space=motion.input_space,
        parameters={**motion.parameters, **more},
        parts=motion.parts or (motion.name,),
    )
