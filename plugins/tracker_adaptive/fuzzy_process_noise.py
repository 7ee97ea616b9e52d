"""Process noise from a fuzzy system that reads a mismatch (paper 4, eq. 3-8, 3-9 and 3-21)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

import attrs
import numpy as np

from tracker.adaptation import untuned, with_scaled_process_noise
from tracker.errors import DomainError, wording
from tracker.models import absolute, isnan, less, maximum, minimum, where
from tracker.models.parameters import one_of
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Gaussian, Step
from tracker_adaptive.fuzzy_measurement_noise import Scaled
from tracker_adaptive.fuzzy_system import FuzzySystem
from tracker_adaptive.innovation_adaptive import HIGHEST
from tracker_adaptive.mismatch import Squares, corrections, diagonal_of
from tracker_adaptive.settings import between, chosen, fuzzy_numbers, replaced, systems, unit_name
from tracker_kalman.inner import at_least

OWN = ("scale", "floor")
OWNER = "adapter 'fuzzy_process_noise'"

Source = tuple[str, str] | None


def _cross(value: str) -> str:
    return one_of("cross", value, ("signed", "plain", "squared"))


def _sources(value: Iterable[Any] | None) -> tuple[Source, ...] | None:
    if value is None:
        return None
    out: list[Source] = []
    for one in value:
        pair = (one, one) if isinstance(one, str) else one
        if pair is not None and (len(pair) != 2 or not all(isinstance(p, str) for p in pair)):
            raise DomainError(
                wording(
                    f"parameter 'sources' of {OWNER}",
                    got=repr(one),
                    expected="for each state component: a measured component, a pair of them, or None",
                    do="write for example ['x', 'y', ('x', 'y')]",
                )
            )
        out.append(None if pair is None else tuple(pair))
    return tuple(out)


@attrs.frozen(eq=False)
class FuzzyProcessNoise:
    """Each variance of the process noise is moved by a fuzzy system that reads a mismatch.

    Without ``sources``, that of the state's own corrections: one less the mean of their squares over
    their expectation ``P- - P+``. This needs no measurement of each state, and works for any sensor,
    filter and time step; but a gain shares out what it corrects as Q says, so that a state which is
    not measured itself, and whose Q is too large, takes up what its neighbours' lack. With ``sources``, as in the thesis: for each state component the component of
    the measurement, or the pair, whose ``DOM = S - C`` drives it, or None to leave it alone. By eq. 3-8
    ``S = H (F P F' + Q) H' + R``, so that raising Q raises S. (Printed: ``H (H P- H' + Q) H' + R``,
    whose dimensions do not fit.) A pair's DOM enters as ``cross`` says: "signed" by its square with its
    sign, "plain" as it is, "squared" as printed in eq. 3-21, which is never negative, so that the
    rules can only ever lower that variance.

    ``Q(i,i) <- Q(i,i) + unit * system(mismatch / unit)`` for diagonal entries (eq. 3-9 prints a
    scalar added to a matrix). The unit of a relative mismatch is ``scale`` times the present
    variance. That of DOM is ``scale`` times the motion's own variance ("given", the thesis) or
    the present one ("present"). It is scales of the motion's own Q that are remembered: how Q
    depends on dt, and its correlations, stay; a state without process noise gets none.

    What was not measured teaches nothing; nothing moves until a window has passed of which half
    was measured.

    Numbers:
        system: one fuzzy system for all state components, or one for each; None, the five rules by hand.
        scale: the input's and output's unit.
        window: steps in the means.
        floor: least variance, in the motion's own; the greatest is a million of them.
        sources: see above.
        cross: "signed", "plain" or "squared".
        unit: "given" or "present"; of use with ``sources``.

    Raises:
        DomainError: for numbers out of range, or sources or systems that do not fit the models.
    Source: paper 4, eq. 3-8, 3-9, 3-21, as corrected; mismatch of corrections after Mohamed and
        Schwarz (1999).
    Laws: those of kind "adapter".
    """

    system: tuple[FuzzySystem, ...] = attrs.field(default=None, converter=systems)
    scale: Any = attrs.field(default=0.125, validator=between(0.0, np.inf, OWNER))
    window: int = attrs.field(default=25, validator=at_least(1, OWNER))
    floor: Any = attrs.field(default=1e-3, validator=between(0.0, np.inf, OWNER))
    sources: tuple[Source, ...] | None = attrs.field(default=None, converter=_sources)
    cross: str = attrs.field(default="signed", converter=_cross)
    unit: str = attrs.field(default="given", converter=unit_name)

    tunes = ("Q",)

    def begin(self, motion: MotionModel, sensor: SensorModel, prior: Gaussian, pose: Any) -> Scaled:  # noqa: ARG002 - the protocol
        """Nothing in the window, the motion's own noise."""
        n, *batch = prior.mean.shape
        chosen(self.system, n, f"the components of {motion.space}")
        if self.sources is not None and len(self.sources) != n:
            raise DomainError(
                wording(
                    f"parameter 'sources' of {OWNER}",
                    got=f"{len(self.sources)} of them",
                    expected=f"{n}: one for each of {motion.space}",
                    do="write None for a component that is to be left alone",
                )
            )
        k = n if self.sources is None else len(self._pairs(sensor))
        return Scaled(Squares.of(self.window, k, tuple(batch)), np.ones((n, *batch)))

    def tuned(
        self, memory: Scaled, motion: MotionModel, sensor: SensorModel
    ) -> tuple[MotionModel, SensorModel]:
        """The motion with its variances scaled, and the sensor."""
        return with_scaled_process_noise(motion, memory.scale), sensor

    def adapt(self, memory: Scaled, step: Step, motion: MotionModel, sensor: SensorModel) -> Scaled:
        """After one more step."""
        if self.sources is None:
            found, expected = corrections(step, motion.space.circular)
            squares = memory.squares.after(found / expected)
            known, usable = 1.0 - squares.mean, squares.trusted
            pairs: list[int | None] = list(range(len(memory.scale)))
        else:
            squares, known, usable, found, pairs = self._measured(memory, step, sensor)
        own = diagonal_of(untuned(motion).Q(step.predicted.mean, step.dt))
        out = np.empty_like(memory.scale)
        for i, system in enumerate(chosen(self.system, len(out), "the components")):
            now, k = memory.scale[i], pairs[i]
            if k is None:
                out[i] = now
                continue
            relative = self.sources is None
            unit = self.scale * (now if relative or self.unit == "present" else 1.0)
            # The unit of DOM is a variance, that of a relative mismatch is a number.
            there = where(less(own[i], 1e-290), 1.0, own[i])
            given = known[k] / (self.scale if relative else unit * there)
            moved = minimum(maximum(now + unit * system(given), self.floor), HIGHEST)
            teaches = where(isnan(found[k]), 0.0, where(usable[k], 1.0, 0.0))
            out[i] = where(less(0.5, where(less(own[i], 1e-290), 0.0, teaches)), moved, now)
        return Scaled(squares, out)

    def _pairs(self, sensor: SensorModel) -> list[tuple[int, int]]:
        space = sensor.space
        asked = {p for p in self.sources or () if p is not None}
        return sorted({(space.index(a), space.index(b)) for a, b in asked})

    def _measured(
        self, memory: Scaled, step: Step, sensor: SensorModel
    ) -> tuple[Squares, Any, Any, Any, list[int | None]]:
        """Squares, degrees of mismatch, whether they count, products, and the place of each state's."""
        v, S, pairs = step.innovation.residual, step.innovation.S, self._pairs(sensor)
        products = np.stack([v[i] * v[j] for i, j in pairs])
        squares = memory.squares.after(products)
        mean, dom = squares.mean, []
        for k, (i, j) in enumerate(pairs):
            one = S[i, j] - mean[k]
            if i != j and self.cross != "plain":
                one = one * (absolute(one) if self.cross == "signed" else one)
            dom.append(one)
        index = sensor.space.index
        places = [
            None if p is None else pairs.index((index(p[0]), index(p[1])))
            for p in self.sources or ()
        ]
        return squares, dom, squares.trusted, products, places

    @property
    def parameters(self) -> Mapping[str, Any]:
        """Its numbers, each a scalar or ``(*batch)``."""
        own = {name: getattr(self, name) for name in OWN}
        return MappingProxyType(own | fuzzy_numbers(self.system))

    def with_parameters(self, **parameters: Any) -> FuzzyProcessNoise:
        """The same adapter with other numbers."""
        made: FuzzyProcessNoise = replaced(self, OWN, parameters, "system")
        return made

    @property
    def structure(self) -> tuple[Any, ...]:
        """All but the numbers."""
        own = (self.window, self.sources, self.cross, self.unit)
        return (*own, tuple(s.structure for s in self.system))
