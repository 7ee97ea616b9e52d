"""Measurement noise from a small neural network that reads the degree of mismatch, in a fuzzy system's place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

import attrs
import numpy as np

from tracker.adaptation import untuned, with_scaled_noise
from tracker.errors import DomainError, wording
from tracker.models import exp, isnan, maximum, minimum, where
from tracker.models.parameters import checked_parameters
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Gaussian, Step
from tracker_adaptive.fuzzy_measurement_noise import Scaled
from tracker_adaptive.mismatch import Squares, diagonal_of
from tracker_adaptive.settings import between, unit_name
from tracker_kalman.inner import at_least

OWN = ("scale", "floor")
OWNER = "adapter 'neural_measurement_noise'"
PARTS = ("weight", "bias", "answer")
_FLAT = 40.0
"""Beyond this argument the hyperbolic tangent is one to the last bit."""


def tangent(x: Any) -> Any:
    """The hyperbolic tangent, of floats, lanes and graph nodes alike.

    Example:
    >>> round(tangent(0.3), 6), tangent(-1e9)
    (0.291313, -1.0)
    """
    grown = exp(2.0 * maximum(minimum(x, _FLAT), -_FLAT))
    return (grown - 1.0) / (grown + 1.0)


def _numbers(value: Iterable[Any]) -> tuple[Any, ...]:
    return tuple(checked_parameters({"number": v})["number"] for v in value)


@attrs.frozen(eq=False)
class Network:
    """One input, one hidden layer of hyperbolic tangents, one output, which is 0 where the input is.

    ``N(x) = sum_j answer_j (tanh(weight_j x + bias_j) - tanh(bias_j))``: that no mismatch asks for no
    change holds whatever its numbers are.

    Shapes:
        numbers scalars or ``(*batch)``, as many of each; x likewise.

    Raises:
        DomainError: if there are not as many of each, or none.
    """

    weight: tuple[Any, ...] = attrs.field(converter=_numbers)
    bias: tuple[Any, ...] = attrs.field(converter=_numbers)
    answer: tuple[Any, ...] = attrs.field(converter=_numbers)

    def __attrs_post_init__(self) -> None:
        if not len(self.weight) == len(self.bias) == len(self.answer) > 0:
            raise DomainError(
                wording(
                    "a network",
                    got=f"{len(self.weight)} weights, {len(self.bias)} biases, {len(self.answer)} answers",
                    expected="one of each for every hidden unit, at least one unit",
                    do="give sequences of the same length",
                )
            )

    def __call__(self, x: Any) -> Any:
        """What it answers to x."""
        total: Any = 0.0
        for weight, bias, answer in zip(self.weight, self.bias, self.answer, strict=True):
            total = total + answer * (tangent(weight * x + bias) - tangent(bias))
        return total


def by_hand() -> Network:
    """Much the same as the five rules made by hand: small steps for a small mismatch, then larger ones."""
    return Network((0.3, 0.5, 0.5), (0.0, 3.0, -3.0), (-0.1, -0.2, -0.2))


def _networks(value: Any) -> tuple[Network, ...]:
    given = by_hand() if value is None else value
    found = (given,) if isinstance(given, Network) else tuple(given)
    if not found or any(not isinstance(one, Network) for one in found):
        raise DomainError(
            wording(
                f"parameter 'network' of {OWNER}",
                got=f"{[type(one).__name__ for one in found]}",
                expected="one network, or one for each measured component",
                do="pass Network(weight, bias, answer)",
            )
        )
    return found


@attrs.frozen(eq=False)
class NeuralMeasurementNoise:
    """Each variance of the measurement noise is moved by a neural network that reads its mismatch.

    As 'fuzzy_measurement_noise', with a network where the fuzzy system is: with ``DOM = S - C``,
    ``R(i,i) <- R(i,i) + unit * N(DOM(i,i) / unit)``, never below ``floor`` times the sensor's own
    variance; the unit is ``scale`` times that (``unit="given"``), or times the present one
    (``unit="present"``: an R that is wrong by orders of magnitude is found from either side). What was
    not measured teaches nothing; nothing moves until a window has passed of which half was measured.
    Train it with `tracker.optimise`: it needs no gradient, nor a library for it.

    Args:
        network: one for all components, or one for each; None, one that was made by hand.
        scale: the input's and output's unit, in variances of the sensor.
        window: steps in the mean of squares.
        floor: least variance, in variances of the sensor.
        unit: "given" or "present".

    Raises:
        DomainError: for numbers out of range, or networks that do not fit the sensor.
    Source: paper 4, future work ("neural networks instead of the fuzzy system"); the network is ours.
    Laws: those of kind "adapter"; a network that answers as a fuzzy system does adapts as it does.
    """

    network: tuple[Network, ...] = attrs.field(default=None, converter=_networks)
    scale: Any = attrs.field(default=0.125, validator=between(0.0, np.inf, OWNER))
    window: int = attrs.field(default=25, validator=at_least(1, OWNER))
    floor: Any = attrs.field(default=1e-3, validator=between(0.0, np.inf, OWNER))
    unit: str = attrs.field(default="given", converter=unit_name)

    tunes = ("R",)

    def begin(self, motion: MotionModel, sensor: SensorModel, prior: Gaussian, pose: Any) -> Scaled:  # noqa: ARG002 - the protocol
        """Nothing in the window, the sensor's own noise."""
        m, batch = sensor.space.size, prior.mean.shape[1:]
        if len(self.network) not in (1, m):
            raise DomainError(
                wording(
                    f"parameter 'network' of {OWNER}",
                    got=f"{len(self.network)} networks",
                    expected=f"one, or {m}: one for each of {sensor.space}",
                    do="pass one for all, or one for each",
                )
            )
        return Scaled(Squares.of(self.window, m, batch), np.ones((m, *batch)))

    def tuned(
        self, memory: Scaled, motion: MotionModel, sensor: SensorModel
    ) -> tuple[MotionModel, SensorModel]:
        """The motion, and the sensor with its variances scaled."""
        return motion, with_scaled_noise(sensor, memory.scale)

    def adapt(self, memory: Scaled, step: Step, motion: MotionModel, sensor: SensorModel) -> Scaled:  # noqa: ARG002 - the protocol
        """After one more step."""
        v, S = step.innovation.residual, step.innovation.S
        squares = memory.squares.after(v * v)
        own = diagonal_of(untuned(sensor).R(step.predicted.mean, step.pose))
        dom, missing, trusted = diagonal_of(S) - squares.mean, isnan(v), squares.trusted
        found = np.empty_like(memory.scale)
        for i in range(len(v)):
            network = self.network[i if len(self.network) > 1 else 0]
            unit = self.scale * (memory.scale[i] if self.unit == "present" else 1.0)
            moved = memory.scale[i] + unit * network(dom[i] / (unit * own[i]))
            moved = where(trusted[i], maximum(moved, self.floor), memory.scale[i])
            found[i] = where(missing[i], memory.scale[i], moved)
        return Scaled(squares, found)

    @property
    def parameters(self) -> Mapping[str, Any]:
        """Its numbers, each a scalar or ``(*batch)``: ``unit1_weight`` and so on.

        Those of several networks begin with ``entry2_`` and so on.
        """
        out = {name: getattr(self, name) for name in OWN}
        for prefix, one in self._named():
            for part in PARTS:
                for j, value in enumerate(getattr(one, part), 1):
                    out[f"{prefix}unit{j}_{part}"] = value
        return MappingProxyType(out)

    def with_parameters(self, **parameters: Any) -> NeuralMeasurementNoise:
        """The same adapter with other numbers.

        Raises:
            DomainError: for a name that it does not have, or a number that is not finite.
        """
        known = self.parameters
        unknown = [name for name in parameters if name not in known]
        if unknown:
            raise DomainError(
                wording(
                    f"parameters of {OWNER}",
                    got=", ".join(unknown),
                    expected=f"names among {', '.join(known)}",
                    do="correct the name",
                )
            )
        given = dict(known) | dict(checked_parameters(parameters))
        networks = tuple(
            Network(
                *(
                    [given[f"{prefix}unit{j + 1}_{part}"] for j in range(len(one.weight))]
                    for part in PARTS
                )
            )
            for prefix, one in self._named()
        )
        own = {name: given[name] for name in OWN}
        return attrs.evolve(self, network=networks, **own)

    def _named(self) -> list[tuple[str, Network]]:
        many = len(self.network) > 1
        return [(f"entry{i}_" if many else "", one) for i, one in enumerate(self.network, 1)]

    @property
    def structure(self) -> tuple[Any, ...]:
        """All but the numbers."""
        return (self.window, self.unit, tuple(len(one.weight) for one in self.network))
