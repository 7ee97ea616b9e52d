"""Paper 4 from start to end: tuning, campaigns, verdicts, claims and pictures put together."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.resources import files
from typing import Any

import attrs
import numpy as np

import tracker as tk
from tracker.reproduction import Paper, Reproduction, paper_from_toml
from tracker.types import Array
from tracker_papers.flying_object import TRUE_R, flying_object
from tracker_papers.paper4 import beyond, claims, figures, methods, tables
from tracker_papers.paper4.scores import (
    LATE,
    Followed,
    Outcome,
    Outcomes,
    by_restart,
    follow,
    measured,
)
from tracker_papers.paper4.tables import ANGLES, ECHOES
from tracker_papers.paper4.tuning import (
    OPTIMISERS,
    TRAINING,
    Problem,
    Tuned,
    problem,
    true_variances,
    tune,
)
from tracker_papers.underwater_angles import MOTIONS, UNITS, underwater_angles
from tracker_papers.underwater_multipath import PRESETS, underwater_multipath

CHOSEN = "ica"
"""The optimiser whose filter stands for "the" fuzzy filter, as in the thesis's later chapters."""

BEYOND = 200
"""Runs of each study of future work."""


@attrs.frozen
class Size:
    """How large the parts of a reproduction are."""

    restarts: int
    """Restarts of each optimiser in the linear example."""
    few: int
    """Restarts under water."""
    population: int
    generations: int
    readings: int
    """Runs of readings other than the adopted one, at most."""
    every: bool
    """Whether every reading of the units is tried, and the thesis's future work."""


FULL = Size(restarts=30, few=10, population=50, generations=30, readings=200, every=True)
QUICK = Size(restarts=6, few=4, population=16, generations=5, readings=24, every=False)


@attrs.frozen(eq=False)
class Linear:
    """Chapter 3 under one reading: what was tuned, on fresh runs and on those it was tuned on."""

    tuned: Tuned
    fresh: Outcomes
    training: Outcomes


@attrs.frozen(eq=False)
class Everything:
    """All that was measured, by the parts of the thesis; what rows, tables and pictures are made of."""

    linear: Mapping[tuple[str, str], Linear]
    """By experiment and reading; the first reading of each is the adopted one."""
    printed_cross: Linear
    """Experiment Q with eq. 3-21 as printed."""
    literal: Outcomes
    """Experiment R with 2 wherever F may have a 5."""
    by_error: Mapping[str, Tuned]
    """Tuned on the true error instead of the mismatch: experiment R, chapters 4 and 5."""
    echoes: Mapping[str, Outcomes]
    echo_tuned: Tuned
    angles: Mapping[tuple[str, str], Outcomes]
    """By sensor motion and reading."""
    angle_tuned: Tuned
    fair: Mapping[str, Outcomes]
    """The adopted readings with a prior that holds the start."""
    scatter: Mapping[str, Array]
    """Mismatch and error of many fuzzy systems on the same runs."""
    followed: Mapping[str, Followed]


@attrs.frozen
class PaperFour:
    """The reproduction of paper 4; see `tracker.reproduction.Study`."""

    runs: int = 500
    quick_runs: int = 40

    @property
    def paper(self) -> Paper:
        """What was published."""
        file = files("tracker_papers.paper4") / "paper.toml"
        return paper_from_toml(file.read_text(encoding="utf-8"), "paper4/paper.toml")

    def run(
        self, *, runs: int, seed: int, quick: bool, progress: Callable[[int, int | None], None]
    ) -> Reproduction:
        """Tables 3-1 to 5-3, the figures of chapters 3 to 5, the seven claims."""
        size = QUICK if quick else FULL
        paper, rng = self.paper, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(4,)))
        done = 0

        def tell() -> None:
            nonlocal done
            done += 1
            progress(done, None)

        found = everything(runs, seed, size, tell)
        judged = _claims(paper, found, rng)
        more = _beyond(found, min(runs, BEYOND), seed, size, tell) if size.every else None
        beside = tables.cells(paper, found, rng)
        rows = tuple(one.row for one in beside)
        tell()
        return Reproduction(
            paper=paper.number,
            title=paper.title,
            seed=seed,
            runs=runs,
            rows=rows,
            claims=judged,
            errata=paper.errata,
            tables=(
                *tables.tables(found, beside, rng),
                *([beyond.table(more)] if more else []),
            ),
            pictures=(
                *figures.pictures(found, rows),
                *(figures.beyond_pictures(more, found) if more else []),
            ),
            notes=(*tables.NOTES, *([] if more else [tables.SHORTENED])),
        )


def _beyond(
    found: Everything, runs: int, seed: int, size: Size, tell: Callable[[], None]
) -> beyond.Beyond:
    main = found.linear["R", "text"]
    return beyond.beyond(
        main.tuned,
        main.fresh,
        next(iter(found.echoes.values())),
        {m: next(o for (n, _), o in found.angles.items() if n == m) for m in MOTIONS},
        runs,
        seed,
        {"population": size.population, "generations": size.generations},
        tell,
    )


# --------------------------------------------------------------------------------- chapter 3
def linear(
    experiment: str,
    reading: str,
    runs: int,
    seed: int,
    size: Size,
    tell: Callable[[], None],
    *,
    cross: str = "signed",
    more: bool = False,
) -> Linear:
    """Tune the fuzzy system by the three optimisers, then filter fresh runs and those tuned on."""
    scene = flying_object(experiment, reading=reading)
    right = flying_object(experiment, reading=reading, told=True)
    hand = methods.fuzzy_r(scene) if experiment == "R" else methods.fuzzy_q(scene, cross=cross)
    shared = (0, 1) if experiment == "R" else (0, 1, 2)
    asked = problem(scene, "kf", hand, size.restarts, seed, shared=shared)
    tuned = tune(
        asked, OPTIMISERS, population=size.population, generations=size.generations, seed=seed
    )
    tell()
    made = methods.linear_estimators(scene, right, hand) | tuned.estimators()
    if more:
        made |= methods.baselines(scene, "kf")
    fresh = measured(scene, made, runs, seed)
    training = measured(scene, tuned.estimators(), size.restarts, seed, condition=TRAINING)
    tell()
    return Linear(tuned, fresh, training)


def scattered(asked: Problem, tuned: Tuned, seed: int, count: int) -> dict[str, Array]:
    """Cost and error of random fuzzy systems, and of the tuned ones, on the runs they are tuned on.

    Shapes:
        "cost" and "error" ``(count, restarts)``; "tuned cost" and "tuned error" ``(restarts,)``.
    """
    bounds, d = asked.bounds, len(asked.bounds)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(40,)))
    drawn = rng.uniform(size=(d, count, asked.restarts))
    # from the five rules by hand to anywhere in the bounds: poor systems and good ones
    hand = methods.by_hand(methods.HAND, len(asked.largest))[:, None, None]
    mix = rng.uniform(size=(1, count, asked.restarts))
    low, width = bounds[:, :1, None], np.diff(bounds, axis=1)[:, :, None]
    numbers = mix * (low + drawn * width) + (1.0 - mix) * hand
    errors = attrs.evolve(asked, objective="error")
    own = tuned.numbers[CHOSEN][:, None]
    return {
        "cost": asked.cost(numbers),
        "error": errors.cost(numbers) / 3.0,
        "tuned cost": asked.cost(own)[0],
        "tuned error": errors.cost(own)[0] / 3.0,
    }


# ------------------------------------------------------------------------------ under water
def echo_readings(every: bool) -> dict[str, dict[str, Any]]:
    """Options of the scenario of chapter 4 by the name of the reading; the first is adopted."""
    out: dict[str, dict[str, Any]] = {}
    for noise in (True, False):
        for preset in PRESETS:
            if every or noise or preset == "M1":
                label = preset if noise else f"{preset}, target undisturbed"
                out[label] = {"preset": preset, "truth_noise": noise}
    if every:
        out["M1, speeds raw"] = {"preset": "M1", "speed_unit": "raw"}
    return out


def angle_readings(every: bool) -> dict[str, dict[str, Any]]:
    """The same for chapter 5."""
    out: dict[str, dict[str, Any]] = {
        "1e-4 rad^2, km/h": {},
        "target undisturbed": {"truth_noise": False},
        "speeds raw": {"speed_unit": "raw"},
        "speeds raw, target undisturbed": {"speed_unit": "raw", "truth_noise": False},
    }
    if every:
        out |= {f"{unit}, km/h": {"unit": unit} for unit in UNITS if unit != "1e-4 rad^2"}
    return out


def underwater(
    scene: tk.Scenario, right: tk.Scenario, numbers: Array, asked: Problem, scale: float
) -> dict[str, Any]:
    """EKF, UKF, EKF told the truth, fuzzy EKF by hand and tuned."""
    made = methods.underwater_estimators(scene, right, scale)
    return made | {"fuzzy": methods.estimator(scene, "ekf1", asked.adapted(numbers))}


def _more(
    scene: tk.Scenario, scale: float, asked: Problem, tuned: Mapping[str, Any], likeliest: Array
) -> dict[str, Any]:
    """What the thesis does not compare with; ``tuned`` are numbers by mismatch and by error, and a network."""
    return {
        **methods.underwater_baselines(scene, scale, likeliest),
        "network": methods.estimator(scene, "ekf1", tuned["network"]),
        "tuned on error": methods.estimator(scene, "ekf1", asked.adapted(tuned["error"])),
        "fuzzy UKF": methods.estimator(scene, "ukf", asked.adapted(tuned["mismatch"])),
    }


def _network(asked: Problem, budget: Mapping[str, int]) -> Any:
    """The adapter with a network in the fuzzy system's place, tuned on the same runs."""
    scene, only = asked.scene, {CHOSEN: OPTIMISERS[CHOSEN]}
    mine = problem(
        scene, asked.name, methods.network_r(scene), asked.restarts, budget["seed"], shared=(0, 1, 0, 1)
    )  # fmt: skip
    return mine.adapted(tune(mine, only, **budget).median(CHOSEN))


# ------------------------------------------------------------------------------------- all
def everything(runs: int, seed: int, size: Size, tell: Callable[[], None]) -> Everything:
    """Everything that is measured, in the order of the thesis."""
    budget = {"population": size.population, "generations": size.generations, "seed": seed}
    found: dict[tuple[str, str], Linear] = {}
    for experiment, readings in TRUE_R.items():
        for place, reading in enumerate(readings):
            count = runs if place == 0 else min(runs, size.readings)
            found[experiment, reading] = linear(
                experiment, reading, count, seed, size, tell, more=place == 0
            )
    few = min(runs, size.readings)
    printed = linear("Q", "table", few, seed, size, tell, cross="squared")
    literal, known = flying_object(matrix="literal"), flying_object(matrix="literal", told=True)
    misread = measured(
        literal, methods.linear_estimators(literal, known, methods.fuzzy_r(literal)), few, seed
    )
    tell()
    main = found["R", "text"].tuned
    only = {CHOSEN: OPTIMISERS[CHOSEN]}
    by_error = {"R": tune(attrs.evolve(main.problem, objective="error"), only, **budget)}
    scatter = scattered(main.problem, main, seed, 4 * size.population)
    tell()

    scene, right = underwater_multipath(), underwater_multipath(told=True)
    asked = problem(scene, "ekf1", methods.fuzzy_r(scene), size.few, seed, shared=(0, 1, 0, 1))
    echo_tuned, network = tune(asked, only, **budget), _network(asked, budget)
    by_error["echoes"] = tune(attrs.evolve(asked, objective="error"), only, **budget)
    tell()
    numbers = echo_tuned.median(CHOSEN)
    both = {"network": network, "error": by_error["echoes"].median(CHOSEN), "mismatch": numbers}
    likeliest = methods.likeliest_noise(scene, asked.simulation)
    echoes: dict[str, Outcomes] = {}
    fair: dict[str, Outcomes] = {}
    for label, options in echo_readings(size.every).items():
        first = not echoes
        scene = underwater_multipath(**options)
        right = underwater_multipath(**options, told=True)
        made = underwater(scene, right, numbers, asked, methods.HAND)
        if first:
            made |= _more(scene, methods.HAND, asked, both, likeliest)
            fair[ECHOES] = measured(methods.fairly_begun(scene), made, runs, seed)
            tell()
            made["printed Jacobian"] = methods.with_printed_jacobian(scene)
            made["printed Jacobian, R / 100"] = methods.with_printed_jacobian(scene, shrink=100.0)
        echoes[label] = measured(scene, made, runs if first else few, seed)
        tell()

    scene = underwater_angles()
    hand = methods.fuzzy_r(scene, methods.HAND_ANGLES)
    asked = problem(scene, "ekf1", hand, size.few, seed, shared=(0, 1, 0, 1))
    angle_tuned, network = tune(asked, only, **budget), _network(asked, budget)
    by_error["angles"] = tune(attrs.evolve(asked, objective="error"), only, **budget)
    likeliest = methods.likeliest_noise(scene, asked.simulation)
    tell()
    numbers = angle_tuned.median(CHOSEN)
    both = {"network": network, "error": by_error["angles"].median(CHOSEN), "mismatch": numbers}
    angles = {}
    for motion in MOTIONS:
        for label, options in angle_readings(size.every).items():
            first = (motion, label) == (motion, next(iter(angle_readings(size.every))))
            scene = underwater_angles(motion, **options)
            right = underwater_angles(motion, **options, told=True)
            made = underwater(scene, right, numbers, asked, methods.HAND_ANGLES)
            if first:
                made |= _more(scene, methods.HAND_ANGLES, asked, both, likeliest)
                fair[ANGLES.format(motion)] = measured(
                    methods.fairly_begun(scene), made, runs, seed
                )
                tell()
            angles[motion, label] = measured(scene, made, runs if first else few, seed)
            tell()
    partial_ = Everything(
        found,
        printed,
        misread,
        by_error,
        echoes,
        echo_tuned,
        angles,
        angle_tuned,
        fair,
        scatter,
        {},
    )
    return attrs.evolve(partial_, followed=_followed(partial_, seed))


def _followed(found: Everything, seed: int) -> dict[str, Followed]:
    """The runs that single-run figures show: those whose untuned error is the median."""
    out = {}
    for experiment, reading in (("R", "text"), ("Q", "table")):
        one = found.linear[experiment, reading]
        scene = one.fresh.scene
        right = flying_object(experiment, reading=reading, told=True)
        made = {
            "kf": methods.estimator(scene, "kf"),
            "true": methods.estimator(right, "kf"),
            CHOSEN: one.tuned.problem.estimator(one.tuned.median(CHOSEN)),
        }
        out[experiment] = follow(scene, made, _typical(one.fresh["kf"]), seed)
    for label, outcomes, tuned in (
        ("echoes", next(iter(found.echoes.values())), found.echo_tuned),
        *(
            (
                motion,
                next(o for (m, _), o in found.angles.items() if m == motion),
                found.angle_tuned,
            )
            for motion in MOTIONS
        ),
    ):
        scene = outcomes.scene
        made = {
            "ekf": methods.estimator(scene, "ekf1"),
            "ukf": methods.estimator(scene, "ukf"),
            "fuzzy": methods.estimator(scene, "ekf1", tuned.problem.adapted(tuned.median(CHOSEN))),
        }
        out[label] = follow(scene, made, _typical(outcomes["ekf"]), seed)
    return out


def _typical(one: Outcome) -> int:
    order = np.argsort(np.where(one.ok, one.place, np.inf))
    return int(order[len(order) // 2])


# ---------------------------------------------------------------------------------- claims
def _claims(paper: Paper, found: Everything, rng: np.random.Generator) -> tuple[Any, ...]:
    main = {e: found.linear[e, next(iter(TRUE_R[e]))] for e in TRUE_R}
    rmse = {
        e: {name: one.fresh[name].rmse for name in ("kf", *OPTIMISERS)} for e, one in main.items()
    }
    cost = {e: one.tuned.cost for e, one in main.items()}
    # each restart on the runs that it was not tuned on: their mean over the states
    error = {
        e: {
            name: by_restart(one.fresh[name].rmse.mean(axis=0), len(one.tuned.cost[name]))
            for name in OPTIMISERS
        }
        for e, one in main.items()
    }
    echoes = next(iter(found.echoes.values()))
    angles = {m: next(o for (motion, _), o in found.angles.items() if motion == m) for m in MOTIONS}
    titles = {"Table 4-1": echoes} | {f"Table 5-{k}": angles[m] for k, m in enumerate(MOTIONS, 1)}
    place = {
        title: {name: one[name].place for name in ("fuzzy", "ukf", "ekf")}
        for title, one in titles.items()
    }
    late = {"R experiment": _late(main["R"].fresh, "kf", CHOSEN)} | {
        title: _late(one, "ekf", "fuzzy") for title, one in titles.items()
    }
    x1 = {name: {m: angles[m][name].rmse[0] for m in MOTIONS} for name in ("ekf", "fuzzy")}
    position = {
        title: {name: one[name].position for name in ("fuzzy", "ekf")}
        for title, one in titles.items()
    }
    relative = {title: _relative(one) for title, one in titles.items()}
    return (
        claims.fuzzy_beats(paper, rmse, rng),
        claims.in_order(paper, "1b", cost),
        claims.in_order(paper, "1c", error),
        claims.measurement_rather_than_process(paper, rmse, rng),
        claims.fuzzy_then_unscented_then_extended(paper, place, rng),
        claims.mismatch_vanishes(paper, late, rng),
        claims.motion_helps(paper, x1, rng),
        claims.jumps_soon(paper, position, rng),
        claims.tracked_in_large_noise(paper, relative),
    )


def _late(one: Outcomes, plain: str, adapted: str) -> dict[str, Array]:
    right = true_variances(one.scene, "R")
    return {
        "plain": one[plain].late_dom,
        "dom": one[adapted].late_dom,
        "R": one[adapted].late_R / right[:, None],
    }


def _relative(one: Outcomes) -> Array:
    """Mean position error over the last steps, in mean distances of an undisturbed target then."""
    scene = one.scene
    t = scene.t[-LATE:]
    start = np.asarray(scene.start)
    path = start[:3, None] + start[3:, None] * t
    if scene.pose is None:
        sensor = np.array(PRESETS["M1"].places[0])[:, None]
    else:
        sensor = np.asarray(scene.pose)[-LATE:, :3].T
    distance = float(np.linalg.norm(path - sensor, axis=0).mean())
    return np.asarray(one["fuzzy"].position[-LATE:].mean(axis=0) / distance)
