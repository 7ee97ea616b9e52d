"""What the thesis names as future work, tried: seven studies, each with a rule and a verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import attrs
import numpy as np

import tracker as tk
from tracker.metrics.consistency import Interval
from tracker.metrics.errors import error, squared_position_error
from tracker.metrics.resampling import ratio_of_medians
from tracker.reproduction import Table, within
from tracker.types import Array, Gaussian, Record
from tracker_papers.flying_object import TOLD_R, flying_object, sensor
from tracker_papers.paper4 import methods
from tracker_papers.paper4.claims import LEVEL, holm, signed_rank
from tracker_papers.paper4.scores import Outcome, Outcomes, by_restart, measured, rms
from tracker_papers.paper4.tuning import (
    OPTIMISERS,
    STRONGER,
    Tuned,
    problem,
    tune,
)
from tracker_papers.underwater_angles import PLACES, angle_sensors, underwater_angles
from tracker_papers.underwater_angles import TOLD_R as TOLD_ANGLES
from tracker_papers.underwater_angles import TRUE_R as TRUE_ANGLES
from tracker_papers.underwater_multipath import KMH, underwater_multipath

BETTER = 0.98
"""A ratio of medians below this, with its 95 % interval, counts as better."""

PARTICLES = 1000

AROUND = (
    *PLACES,
    (400.0, 400.0, -100.0),
    (1500.0, -300.0, -60.0),
    (-400.0, 300.0, -150.0),
    (900.0, -500.0, -100.0),
    (1600.0, 400.0, -80.0),
    (100.0, -600.0, -120.0),
)
"""The two places of the thesis and six more around the target's path [m]."""

TARGETS = (
    (0.0, -5.0, -98.0, -5.0, -1.0, -0.1),
    (-700.0, 200.0, -120.0, 4.0, -3.0, 0.1),
    (200.0, -500.0, -60.0, -3.0, 2.0, 0.0),
    (-300.0, 400.0, -200.0, 1.0, -5.0, 0.2),
)
"""Starts of four targets in chapter 4's water, speeds in km/h; the first is the thesis's."""


@attrs.frozen(eq=False)
class Study:
    """One item of future work: what was asked, by which rule, what was found.

    ``runs`` says how many it rests on; ``votes`` what each comparison says.
    """

    item: str
    question: str
    rule: str
    runs: str
    votes: Mapping[str, bool | None]
    found: str

    @property
    def verdict(self) -> str:
        """In a word or three: a study asks where something pays, so it may do so in part."""
        cast = list(self.votes.values())
        if all(vote is True for vote in cast):
            return "yes"
        if any(vote is False for vote in cast):
            return "in part" if True in cast else "no"
        return "not to be told"


@attrs.frozen(eq=False)
class Beyond:
    """All seven, and what the pictures are made of."""

    studies: tuple[Study, ...]
    sensors: Mapping[int, Outcomes] = attrs.field(repr=False)
    stronger: Tuned = attrs.field(repr=False)


def _ratio(above: Array, below: Array, rng: np.random.Generator) -> Interval:
    return ratio_of_medians(above, below, rng=rng)


def _shown(one: Interval) -> str:
    if not np.isfinite(one.value):
        return "not a number"
    if one.value > 1e3:
        return f"{one.value:.0e}"
    return f"{one.value:.2f} [{one.low:.2f}, {one.high:.2f}]"


def _better(one: Interval) -> bool | None:
    return within(one, -np.inf, BETTER)


# ---------------------------------------------------------------------------------- studies
def both_noises(runs: int, seed: int, rng: np.random.Generator) -> Study:
    """R and Q both told wrongly: each adapted by itself, and both together."""
    base = flying_object("Q")
    scene = attrs.evolve(base, sensor=sensor(TOLD_R), name="flying_object (R and Q)")
    right = flying_object("Q", told=True)
    fuzzy_r, fuzzy_q = methods.fuzzy_r(scene), methods.fuzzy_q(scene)
    joint = tk.adapters.make("joint_noise", measurement=fuzzy_r, process=fuzzy_q)
    made = {
        "kf": methods.estimator(scene, "kf"),
        "true": methods.estimator(right, "kf"),
        "R alone": methods.estimator(scene, "kf", fuzzy_r),
        "Q alone": methods.estimator(scene, "kf", fuzzy_q),
        "R and Q": methods.estimator(scene, "kf", joint),
    }
    one = measured(scene, made, runs, seed)
    whole = {
        name: (o.rmse / np.median(one["true"].rmse, axis=1)[:, None]).mean(axis=0)
        for name, o in one.of.items()
    }
    votes, words = {}, []
    for other in ("kf", "R alone", "Q alone"):
        ratio = _ratio(whole["R and Q"], whole[other], rng)
        votes[other] = _better(ratio)
        words.append(f"over {'no adapter' if other == 'kf' else other} {_shown(ratio)}")
    table = "; ".join(
        f"{name}: {', '.join(f'{v:.2f}' for v in np.median(o.rmse, axis=1))}"
        for name, o in one.of.items()
    )
    return Study(
        "adapt R and Q together",
        "Is adapting both better than adapting either, where both are told wrongly?",
        "Mean RMSE of the three states, each over that of the filter told the truth: joint over either alone, "
        "and over none, below 0.98.",
        str(runs),
        votes,
        f"Error of joint adaptation {', '.join(words)}. RMSE of X1, X2, X3: {table}.",
    )


def fuzzy_unscented(
    echoes: Outcomes, angles: Mapping[str, Outcomes], rng: np.random.Generator
) -> Study:
    """Fuzzy R in a UKF, from what was measured for Tables 4-1 to 5-3."""
    votes, words = {}, []
    for label, one in {"echoes": echoes, **{f"angles, {m}": o for m, o in angles.items()}}.items():
        plain = _ratio(one["fuzzy UKF"].place, one["ukf"].place, rng)
        ekf = _ratio(one["fuzzy UKF"].place, one["fuzzy"].place, rng)
        votes[f"{label}, over the UKF"] = _better(plain)
        votes[f"{label}, over the fuzzy EKF"] = _better(ekf)
        words.append(f"{label}: over the UKF {_shown(plain)}, over the fuzzy EKF {_shown(ekf)}")
    return Study(
        "fuzzy R in a UKF",
        "Is a fuzzy UKF better than the UKF, and than the fuzzy EKF?",
        "Position RMSE, ratios of medians below 0.98.",
        str(echoes["ukf"].place.size),
        votes,
        f"{'; '.join(words)}.",
    )


def particles(runs: int, seed: int, rng: np.random.Generator, count: int = PARTICLES) -> Study:
    """Particle filters told the true R against the EKF told the same; with a prior that holds the start."""
    votes, words = {}, []
    for label, scene in (
        ("echoes", underwater_multipath(told=True)),
        ("angles, static", underwater_angles(told=True)),
    ):
        for prior_label, now in (
            ("prior of the thesis", scene),
            ("prior that holds the start", methods.fairly_begun(scene)),
        ):
            made = {"ekf": methods.estimator(now, "ekf1")} | {
                name: methods.estimator(now, name, particles=count)
                for name in ("bootstrap", "regularised")
            }
            one = measured(now, made, runs, seed)
            for name in ("bootstrap", "regularised"):
                ratio = _ratio(one[name].place, one["ekf"].place, rng)
                votes[f"{label}, {prior_label}, {name}"] = _better(ratio)
                words.append(f"{label}, {prior_label}: {name} {_shown(ratio)}")
    return Study(
        "particle filter",
        f"Is a particle filter with {count} particles better than the EKF, both told the true R?",
        "Position RMSE, ratio of medians below 0.98, for bootstrap and regularised filters, with the thesis's prior "
        "and with one whose covariance holds the true start.",
        str(runs),
        votes,
        f"Error over that of the EKF: {'; '.join(words)}.",
    )


def network(
    fuzzy: Tuned,
    fresh: Outcomes,
    runs: int,
    seed: int,
    rng: np.random.Generator,
    budget: Mapping[str, int],
) -> Study:
    """A neural network of three hidden units in the fuzzy system's place, by the same optimiser and budget."""
    votes, words = {}, []
    scene = fresh.scene
    asked = problem(
        scene, "kf", methods.network_r(scene), fuzzy.problem.restarts, seed, shared=(0, 1)
    )
    only = {"ica": OPTIMISERS["ica"]}
    found = tune(asked, only, seed=seed, **budget)
    one = measured(scene, {"network": found.estimators()["ica"]}, runs, seed)["network"]
    for state in range(3):
        ratio = _ratio(one.rmse[state], fresh["ica"].rmse[state][: one.rmse.shape[1]], rng)
        votes[f"X{state + 1}"] = _better(ratio)
        words.append(f"X{state + 1} {_shown(ratio)}")
    cost = float(np.median(found.cost["ica"]) / np.median(fuzzy.cost["ica"]))
    return Study(
        "neural network",
        "Is a network of three hidden units (9 numbers) better than five fuzzy rules (15 numbers)?",
        "Experiment R, both tuned by ICA on the same runs with the same budget: RMSE of each state on fresh runs, ratio "
        "of medians below 0.98.",
        f"{runs} fresh, {fuzzy.problem.restarts} tuned on",
        votes,
        f"Error over that of the fuzzy filter: {', '.join(words)}; mismatch tuned to {cost:.2f} of the fuzzy one.",
    )


def stronger(
    fuzzy: Tuned, fresh: Outcomes, runs: int, seed: int, budget: Mapping[str, int]
) -> tuple[Study, Tuned]:
    """Differential evolution, CMA-ES and a constricted swarm against ICA: same runs, same evaluations.

    What each restart tuned is scored on fresh runs as well, dealt as those of ``fresh``.
    """
    found = tune(fuzzy.problem, STRONGER, seed=seed, **budget)
    restarts = fuzzy.problem.restarts
    scored = measured(fresh.scene, found.estimators(), runs, seed)

    def error(one: Outcome) -> Array:
        return by_restart(one.rmse.mean(axis=0)[:runs], restarts)

    votes: dict[str, bool | None] = {}
    words = {}
    for what, theirs, ica in (
        ("cost", found.cost, fuzzy.cost["ica"]),
        (
            "error on fresh runs",
            {name: error(one) for name, one in scored.of.items()},
            error(fresh["ica"]),
        ),
    ):
        tests = [signed_rank(theirs[name], ica) for name in STRONGER]
        lower, higher = holm([t[0] for t in tests]), holm([t[1] for t in tests])
        parts = []
        for name, less, more in zip(STRONGER, lower, higher, strict=True):
            votes[f"{name}, {what}"] = True if less < LEVEL else False if more < LEVEL else None
            gain = float(np.median(theirs[name] / ica)) - 1.0
            parts.append(f"{name.upper()} {100 * gain:+.1f} % (p = {min(less, more):.1g})")
        words[what] = ", ".join(parts)
    said = "; ".join(f"{what}: {parts}" for what, parts in words.items())
    return (
        Study(
            "stronger optimisers",
            "Do differential evolution, CMA-ES or a constricted swarm find a lower cost than ICA, and a filter that "
            "errs less on fresh runs?",
            "Experiment R, paired restarts at equal evaluations, cost and mean RMSE of the three states: Wilcoxon's "
            "signed-rank test with Holm's correction at 5 %.",
            f"{runs} fresh, dealt to {restarts} restarts",
            votes,
            f"Median difference to ICA in {said}; {fuzzy.evaluations} evaluations of each restart.",
        ),
        found,
    )


def more_sensors(
    runs: int, seed: int, rng: np.random.Generator, counts: Sequence[int] = tuple(range(2, 9))
) -> tuple[Study, dict[int, Outcomes]]:
    """Two to eight sensors that stand still around the target's path."""
    out, base = {}, underwater_angles()
    for count in counts:
        places = np.concatenate([np.array(p) for p in AROUND[:count]])
        pose = np.tile(places, (len(base.t), 1))
        scene = attrs.evolve(
            base,
            name=f"{count} sensors",
            sensor=angle_sensors(TOLD_ANGLES, "1e-4 rad^2", count),
            truth_sensor=angle_sensors(TRUE_ANGLES, "1e-4 rad^2", count),
            pose=pose,
        )
        right = attrs.evolve(scene, sensor=scene.true_sensor)
        made = {
            "ekf": methods.estimator(scene, "ekf1"),
            "true": methods.estimator(right, "ekf1"),
            "hand": methods.estimator(scene, "ekf1", methods.fuzzy_r(scene, methods.HAND_ANGLES)),
        }
        out[count] = measured(scene, made, runs, seed)
    few, many = counts[0], counts[-1]
    votes, words = {}, []
    for name, label in (("ekf", "EKF"), ("hand", "fuzzy EKF"), ("true", "told the truth")):
        ratio = _ratio(out[many][name].place, out[few][name].place, rng)
        root = float(np.sqrt(few / many))
        votes[label] = within(ratio, -np.inf, root)
        words.append(
            f"{label}: {many} sensors over {few} {_shown(ratio)}, where averaging alone gives {root:.2f}"
        )
    steps = ", ".join(f"{c}: {np.median(o['hand'].place):.1f} m" for c, o in out.items())
    return (
        Study(
            "more sensors",
            "Do 8 sensors do better than averaging the errors of 2 would?",
            "Position RMSE with 8 sensors over that with 2 below the root of 2/8, with its 95 % interval.",
            str(runs),
            votes,
            f"{'; '.join(words)}. Fuzzy EKF by hand: {steps}.",
        ),
        out,
    )


def several_targets(runs: int, seed: int, rng: np.random.Generator) -> Study:
    """Four targets in the same water, each with its own filter; which delay is whose is known."""
    place = targets_together(TARGETS, runs, seed)
    votes, words = {}, []
    for number, (ekf, hand) in enumerate(zip(place["ekf"], place["hand"], strict=True), 1):
        ratio = _ratio(hand, ekf, rng)
        votes[f"target {number}"] = _better(ratio)
        words.append(f"target {number}: {_shown(ratio)}, {float(np.median(hand)):.0f} m")
    return Study(
        "several targets",
        "Is fuzzy R better than the EKF for each of four independent targets with known association?",
        "Position RMSE of the fuzzy EKF by hand over that of the EKF, ratio of medians below 0.98 for each target.",
        str(runs),
        votes,
        f"{'; '.join(words)}. Targets and runs are lanes of one call: no filter knows of the others.",
    )


def targets_together(starts: Sequence[Sequence[float]], runs: int, seed: int) -> dict[str, Array]:
    """Position RMSE ``(targets, runs)`` of the EKF and of fuzzy R by hand: one call each for all targets.

    ``starts`` are those of `TARGETS`; every target is guessed as far off as the thesis guesses its one.
    """
    scale, base = np.array([1.0] * 3 + [KMH] * 3), underwater_multipath()
    guess = base.prior.mean - np.asarray(base.start)
    made = []
    for number, start in enumerate(starts, 1):
        at = scale * np.array(start)
        scene = attrs.evolve(base, start=at, prior=Gaussian(at + guess, base.prior.cov))
        made.append(scene.simulate(seed, runs, condition=10 + number))
    record = Record(base.t, np.stack([np.asarray(one.record.z) for one in made], axis=-2))
    prior = Gaussian(
        np.stack([one.prior.mean for one in made], axis=-2),
        np.stack([one.prior.cov for one in made], axis=-2),
    )
    truth = np.stack([one.truth for one in made], axis=-2)
    out = {}
    for name, adapter in (("ekf", None), ("hand", methods.fuzzy_r(base))):
        one = methods.estimator(base, "ekf1", adapter)
        history = tk.filter(one, record, prior, start=base.prior_time)
        off = error(truth, np.asarray(history.filtered.mean), base.motion.space)
        out[name] = rms(np.sqrt(squared_position_error(off, base.motion.space)))
    return out


# -------------------------------------------------------------------------------------- all
def beyond(
    fuzzy: Tuned,
    fresh: Outcomes,
    echoes: Outcomes,
    angles: Mapping[str, Outcomes],
    runs: int,
    seed: int,
    budget: Mapping[str, int],
    tell: Callable[[], None],
    count: int = PARTICLES,
) -> Beyond:
    """All seven studies."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(7,)))
    done: list[Study] = []

    def keep(one: Any) -> Any:
        tell()
        done.append(one[0] if isinstance(one, tuple) else one)
        return one

    keep(both_noises(runs, seed, rng))
    keep(fuzzy_unscented(echoes, angles, rng))
    keep(particles(runs, seed, rng, count))
    keep(network(fuzzy, fresh, runs, seed, rng, budget))
    _, better = keep(stronger(fuzzy, fresh, runs, seed, budget))
    _, sensors = keep(more_sensors(runs, seed, rng))
    keep(several_targets(runs, seed, rng))
    return Beyond(tuple(done), sensors, better)


def table(found: Beyond) -> Table:
    """The verdicts."""
    return Table(
        "beyond",
        "Beyond the thesis: its future work, tried",
        ("item", "question", "verdict", "found", "rule", "runs"),
        tuple((s.item, s.question, s.verdict, s.found, s.rule, s.runs) for s in found.studies),
        "Ratios of medians with their 95 % intervals.",
    )
