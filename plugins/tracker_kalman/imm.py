"""The interacting multiple model filter (Blom and Bar-Shalom 1988); motions that switch live elsewhere."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import attrs
import numpy as np

from tracker.algebra import mix
from tracker.errors import CapabilityError, wording
from tracker.models import absolute, exp, less, log, maximum, one_of, where
from tracker.protocols import MotionModel, SensorModel
from tracker.types import Gaussian, Innovation, Projection, Space
from tracker_kalman.mixture import begun, chosen, gaussian_member, innovation, together

MISSING = ("zero", "prior", "common")
"""What a component is in a mode that lacks it; see `InteractingMultipleModels`."""

FAINTEST = 1e-300
"""A mode that is possible is at least this likely: a probability that underflows would stay zero."""


# ------------------------------------------------------------------------------------- belief
@attrs.frozen(eq=False)
class ModeMixture:
    """A state for each mode, in that mode's own components, and how likely each mode is.

    ``places`` tells where a mode's components lie in the whole state, ``circular`` which of the whole
    live on a circle; ``missing`` is the filter's, and ``prior`` the state that it began with, where
    that stands for what a mode lacks.

    Shapes:
        members: beliefs ``(n_j, *batch)``; probabilities ``(modes, *batch)``, which sum to one; prior
        ``(n, *batch)`` or None.
    """

    members: tuple[Any, ...]
    probabilities: Any
    places: tuple[tuple[int, ...], ...]
    circular: tuple[bool, ...]
    missing: str = MISSING[0]
    prior: Gaussian | None = None

    def moments(self) -> Gaussian:
        """Mean and covariance of the whole state, over all modes."""
        own = [member.moments() for member in self.members]
        return mixed(own, self.probabilities, self.places, self.circular, self.missing, self.prior)


def mixed(
    members: Sequence[Gaussian],
    weights: Any,
    places: Sequence[Sequence[int]],
    circular: tuple[bool, ...],
    missing: str = MISSING[0],
    prior: Gaussian | None = None,
) -> Gaussian:
    """Moments over ``circular``'s components of modes of which some lack some.

    Shapes:
        members ``(n_j, *batch)``; weights ``(modes, *batch)``; places, where each lies in the whole;
        prior ``(n, *batch)`` of what members lack, None for zeros.
    """
    n = len(circular)
    if len(members) == 1 and len(places[0]) == n:
        return members[0]
    whole = [embedded(m, p, n, prior) for m, p in zip(members, places, strict=True)]
    cov = np.stack([m.cov for m in whole], axis=2)
    mean = np.stack([m.mean for m in whole], axis=1)
    if missing != "common" or all(len(p) == n for p in places):
        return Gaussian.trusted(*mix(mean, cov, weights, circular))
    centre, _ = mix(mean, cov, weights, circular)
    for k, p in enumerate(places):  # no difference from the mean where there is no component
        absent = sorted(set(range(n)).difference(p))
        mean[absent, k] = centre[absent]
    return Gaussian.trusted(*mix(mean, cov, weights, circular, about=centre))


def embedded(
    member: Gaussian, places: Sequence[int], n: int, prior: Gaussian | None = None
) -> Gaussian:
    """A mode's own components at their places; what it lacks is as in ``prior``, or certainly zero."""
    if len(places) == n:
        return member
    batch, dtype = member.mean.shape[1:], member.mean.dtype
    mean, cov = np.zeros((n, *batch), dtype), np.zeros((n, n, *batch), dtype)
    if prior is not None:
        absent = sorted(set(range(n)).difference(places))
        mean[absent] = prior.mean[absent]
        cov[np.ix_(absent, absent)] = prior.cov[np.ix_(absent, absent)]
    mean[list(places)] = member.mean
    cov[np.ix_(places, places)] = member.cov
    return Gaussian.trusted(mean, cov)


def part(whole: Gaussian, places: Sequence[int]) -> Gaussian:
    """Some components of a Gaussian."""
    if tuple(places) == tuple(range(len(whole.mean))):
        return whole
    return Gaussian.trusted(whole.mean[list(places)], whole.cov[np.ix_(places, places)])


@attrs.frozen(eq=False)
class ModeProjection:
    """What all modes together predict of a measurement, and each of them alone.

    Shapes:
        z ``(m, *batch)``, S ``(m, m, *batch)`` and cross ``(n, m, *batch)``: moments over the modes.
    """

    z: Any
    S: Any
    cross: Any
    modes: tuple[Projection, ...]


# ------------------------------------------------------------------------------------- filter
def filters_of(value: Any) -> tuple[Any, ...]:
    """One filter, or several, each itself or the name of a registered one."""
    given = [value] if isinstance(value, str) or not isinstance(value, Iterable) else list(value)
    return tuple(gaussian_member(one) for one in given)


@attrs.frozen
class InteractingMultipleModels:
    """One filter per mode of a switching motion; before each prediction the modes' states are mixed.

    With ``mu`` the modes' probabilities and ``p[i][j]`` those of a switch, each step
    mixes the states of all modes i into the one that mode j starts from, with weights
    ``p[i][j] mu[i] / c[j]``, ``c[j] = sum_i p[i][j] mu[i]``; predicts and updates each with its own
    model; and sets ``mu[j]`` proportional to ``c[j]`` times the likelihood of the measurement in
    mode j. Likelihoods are compared as logarithms, so that none underflows. A mode whose state is no
    longer finite has probability zero and starts again from the others; the lane is lost (``ok`` is
    False) only if all modes are.

    ``filters``: any Gaussian filter or the name of one, for all modes, or one for each mode. The
    motion is made by `tracker_motion.switching`; any other motion is a single mode. What the sensor
    reads must be part of every mode.

    Modes may differ in their components. ``missing="zero"``: in a mode that lacks it, a component is
    zero, and certain: a target at constant velocity has no acceleration. ``missing="prior"``: it is
    what the prior of the run said, so that a turn rate, say, starts anew with every turn.
    ``missing="common"``: as "zero", but the absent component adds no spread to the covariance,
    which thus is too small; the convention of the EKF/UKF toolbox.

    The innovation is that of the mixture: ``residual`` and ``S`` come from the moments over the modes
    of the predicted measurement, ``nis`` from these (chi-square only as far as the mixture is
    Gaussian), while ``loglik`` is that of the mixture itself. Without a measurement the modes keep
    their predicted probabilities.

    Raises:
        CapabilityError: if there are several filters, but not one for each mode; if one draws random numbers.
    Reference:
        Blom and Bar-Shalom (1988), IEEE Trans. Automatic Control 33 (8), pp. 780-783; Bar-Shalom, Li
        and Kirubarajan (2001), section 11.6.6.
    Laws:
        those of kind "filter"; one mode equals its filter; the order of the modes does not matter;
        equal modes equal one.

    Example:
    >>> import tracker as tk
    >>> from tracker_motion import constant_velocity, switching
    >>> from tracker_sensors import position
    >>> calm_or_not = switching(
    ...     [constant_velocity(0.01), constant_velocity(9.0)], [[0.95, 0.05], [0.1, 0.9]])
    >>> estimator = tk.estimator("imm", motion=calm_or_not, sensor=position(1.0))
    >>> state = tk.Gaussian([0.0, 0.0, 1.0, 0.0], [[1.0, 0, 0, 0], [0, 1.0, 0, 0],
    ...                                            [0, 0, 0.1, 0], [0, 0, 0, 0.1]])
    >>> state, _ = estimator.step(state, [9.0, 4.0], 1.0)
    >>> state.probabilities.round(2).tolist()
    [0.0, 1.0]
    """

    filters: tuple[Any, ...] = attrs.field(default="ekf1", converter=filters_of)
    missing: str = MISSING[0]

    smoothers = ("imm_smoother",)

    def __attrs_post_init__(self) -> None:
        one_of("missing", self.missing, MISSING)

    @property
    def needs(self) -> tuple[str, ...]:
        """What its filters need."""
        return tuple(dict.fromkeys(need for rule in self.filters for need in rule.needs))

    @property
    def tags(self) -> tuple[str, ...]:
        """What its filters say of themselves."""
        return tuple(dict.fromkeys(tag for f in self.filters for tag in getattr(f, "tags", ())))

    @property
    def why_opaque(self) -> str:
        """Why one of its filters cannot be traced, or ''."""
        return next(filter(None, (getattr(f, "why_opaque", "") for f in self.filters)), "")

    def beyond_moments(self, motion: MotionModel) -> str:
        """What it believes that mean and covariance do not say."""
        count = len(modes_of(motion))
        return f"a mixture of {count} modes" if count > 1 else ""

    # --------------------------------------------------------------------------- the start
    def begin(self, prior: Any, motion: MotionModel | None = None) -> ModeMixture:
        """A state for each mode from one for all: each takes what it has of it.

        Raises:
            CapabilityError: if given a mixture of other modes than those of the motion.
        """
        count = 1 if motion is None else len(modes_of(motion))
        if isinstance(prior, ModeMixture):
            if motion is not None:
                _refuse_other_modes(prior, motion)
            return prior
        n, batch = len(prior.mean), prior.mean.shape[1:]
        places = _places(motion, n)
        initial = (1.0,) if count == 1 else motion.initial  # type: ignore[union-attr]  # it has modes
        circular = (False,) * n if motion is None else motion.space.circular
        members = tuple(
            begun(rule, part(prior, p))
            for rule, p in zip(self._of_each(count), places, strict=True)
        )
        if not prior.mean.dtype.hasobject:
            initial = tuple(np.broadcast_to(p, batch) for p in initial)
        lacking = any(len(p) < n for p in places)
        return ModeMixture(
            members,
            np.stack(initial),
            places,
            circular,
            self.missing,
            prior if self.missing == "prior" and lacking else None,
        )

    def _of_each(self, count: int) -> tuple[Any, ...]:
        if len(self.filters) == 1:
            return self.filters * count
        if len(self.filters) != count:
            raise CapabilityError(
                wording(
                    "parameter 'filters' of the interacting multiple models",
                    got=f"{len(self.filters)} filters for {count} modes",
                    expected="one for all modes, or one for each",
                    do="give as many filters as the motion has modes",
                )
            )
        return self.filters

    # ------------------------------------------------------------------------- prediction
    def predict(
        self, state: Any, motion: MotionModel, dt: Any, u: Any = None, t: Any = None
    ) -> ModeMixture:
        """Mix, then predict each mode through its own motion."""
        before = self.begin(state, motion)
        modes = modes_of(motion)
        rules = self._of_each(len(modes))
        if len(modes) == 1:
            member = rules[0].predict(before.members[0], modes[0], dt, u, t)
            return attrs.evolve(before, members=(member,), circular=motion.space.circular)
        own = [member.moments() for member in before.members]
        switching: Any = motion  # of more than one mode, it says how they follow each other
        chances = switching.transition(dt)
        members, after = [], []
        for j, (rule, mode) in enumerate(zip(rules, modes, strict=True)):
            joint = [row[j] * p for row, p in zip(chances, before.probabilities, strict=True)]
            total: Any = 0.0
            for value in joint:
                total = total + value
            after.append(total)
            # A mode that nothing leads to goes on by itself, with probability zero.
            reached = less(0.0, total)
            total = where(reached, total, 1.0)
            weights = [
                where(reached, value / total, 1.0 if i == j else 0.0)
                for i, value in enumerate(joint)
            ]
            start = _into(own, np.stack(weights), before, j)
            given = switching.inputs(j, u)
            members.append(rule.predict(begun(rule, start), mode, dt, given, t))
        return attrs.evolve(before, members=tuple(members), probabilities=np.stack(after))

    # -------------------------------------------------------------------------- projection
    def project(self, state: Any, sensor: SensorModel, pose: Any = None) -> ModeProjection:
        """Moments over the modes of the measurement that they predict."""
        before = self.begin(state)
        seen = self._projected(before, sensor, pose)
        if len(seen) == 1:
            return ModeProjection(seen[0].z, seen[0].S, seen[0].cross, seen)
        z, S = _together(seen, before.probabilities, sensor)
        # State and measurement side by side: what they have to do with each other is a block.
        n, m = len(before.circular), len(z)
        pairs = []
        for member, its, p in zip(before.members, seen, before.places, strict=True):
            x = member.moments()
            cov = np.empty((len(x.mean) + m,) * 2 + its.S.shape[2:], x.cov.dtype)
            cov[:-m, :-m], cov[-m:, -m:] = x.cov, its.S
            cov[:-m, -m:], cov[-m:, :-m] = its.cross, its.cross.swapaxes(0, 1)
            pair = Gaussian.trusted(np.concatenate([x.mean, its.z]), cov)
            pairs.append(embedded(pair, (*p, *range(n, n + m)), n + m))
        flags = (*before.circular, *sensor.space.circular)
        both = mixed(pairs, before.probabilities, [range(n + m)] * len(pairs), flags)
        return ModeProjection(z, S, both.cov[:n, n:], seen)

    def _projected(self, before: ModeMixture, sensor: SensorModel, pose: Any) -> tuple[Any, ...]:
        rules, sensors = self._of_each(len(before.members)), _sensors(before, sensor)
        parts = zip(rules, before.members, sensors, strict=True)
        return tuple(rule.project(member, one, pose) for rule, member, one in parts)

    # ------------------------------------------------------------------------------ update
    def update(
        self,
        state: Any,
        sensor: SensorModel,
        z: Any,
        pose: Any = None,
        projection: Any = None,
    ) -> tuple[ModeMixture, Innovation]:
        """Update each mode; components of ``z`` that are NaN were not measured."""
        before = self.begin(state)
        known = isinstance(projection, ModeProjection)
        seen = projection.modes if known else self._projected(before, sensor, pose)
        rules, sensors = self._of_each(len(before.members)), _sensors(before, sensor)
        members, told = [], []
        for rule, member, one, its in zip(rules, before.members, sensors, seen, strict=True):
            after, alone = rule.update(member, one, z, pose, its)
            members.append(after)
            told.append(alone)
        if len(members) == 1:
            return attrs.evolve(before, members=tuple(members)), told[0]
        shown = projection if known else None
        zhat, S = (shown.z, shown.S) if shown else _together(seen, before.probabilities, sensor)
        for k, its in enumerate(told):
            members[k] = chosen(less(absolute(its.loglik), math.inf), members[k], 0.0)
        likelier, loglik = posterior(before.probabilities, [its.loglik for its in told])
        done = attrs.evolve(before, members=tuple(members), probabilities=np.stack(likelier))
        return done, innovation(sensor, z, zhat, S, loglik, told[0].count)


# ------------------------------------------------------------------------------------- inside
def posterior(prior: Sequence[Any], logliks: Sequence[Any]) -> tuple[list[Any], Any]:
    """Probabilities after a measurement, and the logarithm of its likelihood over all modes.

    A mode whose likelihood is not finite gets probability zero; one that is merely unlikely keeps at
    least `FAINTEST`, so that it can come back where no other mode leads to it.
    """
    heard = [
        less(0.0, where(less(absolute(its), math.inf), p, 0.0))
        for p, its in zip(prior, logliks, strict=True)
    ]
    known = [where(h, its, -math.inf) for h, its in zip(heard, logliks, strict=True)]
    most = known[0]
    for value in known[1:]:
        most = maximum(most, value)
    joint = [
        where(h, p * exp(its - most), 0.0) for h, p, its in zip(heard, prior, known, strict=True)
    ]
    total: Any = 0.0
    for value in joint:
        total = total + value
    total = where(less(0.0, total), total, math.nan)  # no mode is left
    shared = [
        where(h, maximum(value / total, FAINTEST), value / total)
        for h, value in zip(heard, joint, strict=True)
    ]
    return shared, most + log(total)


def _places(motion: Any, n: int) -> tuple[tuple[int, ...], ...]:
    """Where the components of each mode lie in the whole state of ``n``."""
    if hasattr(motion, "transition"):
        return tuple(motion.places)
    return (tuple(range(n)),)


def _refuse_other_modes(mixture: ModeMixture, motion: Any) -> None:
    places = _places(motion, len(mixture.circular))
    if mixture.places == places:
        return

    def listed(of: Sequence[Sequence[int]]) -> str:
        sizes = ", ".join(str(len(own)) for own in of)
        return f"{len(of)} mode{'s' * (len(of) > 1)} of {sizes} components"

    raise CapabilityError(
        wording(
            "argument 'state' of the interacting multiple models",
            got=f"a mixture of {listed(mixture.places)}",
            expected=f"{listed(places)}, those of the motion, at the same places in the state",
            do="begin again from its mean and covariance, state.moments(), which forgets the modes",
        )
    )


def _together(seen: Sequence[Any], weights: Any, sensor: SensorModel) -> tuple[Any, Any]:
    """The predicted measurement and its covariance, over the modes."""
    z, S = np.stack([p.z for p in seen], axis=1), np.stack([p.S for p in seen], axis=2)
    return together(z, S, weights, sensor)


def modes_of(motion: Any) -> tuple[Any, ...]:
    """The modes of a motion; one that does not switch has one."""
    return tuple(motion.modes) if hasattr(motion, "transition") else (motion,)


def _into(own: Sequence[Gaussian], weights: Any, before: ModeMixture, j: int) -> Gaussian:
    """The states of all modes mixed into the one that mode j starts from, in its components."""
    target = before.places[j]
    circular = tuple(before.circular[place] for place in target)
    members, places = [], []
    for member, having in zip(own, before.places, strict=True):
        common = [place for place in target if place in having]
        members.append(part(member, [having.index(place) for place in common]))
        places.append([target.index(place) for place in common])
    prior = None if before.prior is None else part(before.prior, target)
    return mixed(members, weights, places, circular, before.missing, prior)


def _sensors(before: ModeMixture, sensor: Any) -> list[Any]:
    """The sensor as each mode's filter reads it, in its own components."""
    n = len(before.circular)
    out = []
    for places in before.places:
        if places == tuple(range(n)):
            out.append(sensor)
            continue
        if not hasattr(sensor, "over"):
            raise CapabilityError(
                wording(
                    f"sensor {getattr(sensor, 'name', type(sensor).__name__)!r}",
                    got="one that cannot be moved to the states of single modes",
                    expected="a method over(state), as modes have different components",
                    do="write it over components, or give all modes the same components",
                )
            )
        axes = sensor.state.axes
        out.append(sensor.over(Space(tuple(axes[place] for place in places))))
    return out
