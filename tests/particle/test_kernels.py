"""Machine code computes what the arrays say, and steps aside where it cannot."""

from typing import Any

import numpy as np
import pytest
from clouds import growth, linear, ran

import tracker as tk
from tracker.compile import objects
from tracker.models import ComponentMotion, ComponentSensor
from tracker_particle import BootstrapFilter, Particles, RegularisedFilter, kernels
from tracker_sensors import position, range_azimuth

pytestmark = pytest.mark.skipif(not objects.available(), reason="llvmlite is not installed")

FIELDS = ("residual", "S", "nis", "loglik", "count")


def both(rule: Any, problem: Any, monkeypatch: pytest.MonkeyPatch, seed: int = 1) -> Any:
    monkeypatch.setenv("TRACKER_COMPILE", "on")
    compiled = ran(rule, problem, seed)
    monkeypatch.setenv("TRACKER_COMPILE", "off")
    return compiled, ran(rule, problem, seed)


def agree(a: tk.History, b: tk.History, tolerance: float = 1e-9) -> None:
    for stage in ("predicted", "filtered"):
        for name in ("mean", "cov"):
            ours, theirs = (getattr(getattr(h, stage), name) for h in (a, b))
            size = np.abs(theirs).max()
            assert np.abs(ours - theirs).max() <= tolerance * size, f"{stage} {name}"
    for name in FIELDS:
        ours, theirs = (getattr(h.innovation, name) for h in (a, b))
        assert np.array_equal(np.isnan(ours), np.isnan(theirs)), name
        assert np.nanmax(np.abs(ours - theirs) / (1.0 + np.abs(theirs))) < tolerance, name
    assert np.array_equal(a.innovation.ok, b.innovation.ok)


@pytest.mark.parametrize("rule", [BootstrapFilter(particles=64), RegularisedFilter(particles=64)])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_compiled_and_arrays_agree(rule: Any, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    agree(*both(rule, linear(steps=30, seed=seed), monkeypatch, seed))


@pytest.mark.parametrize("seed", [1, 2])
def test_they_agree_on_bearings_across_the_cut(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    models, record, _ = linear(steps=20)
    sensor = range_azimuth(sigma_range=2.0, sigma_azimuth=0.05).at(sx=50.0, sy=0.0)
    z = np.stack([np.full(20, 60.0), np.pi - 0.02 * np.arange(20.0)], axis=1)
    z[4, 0] = z[9, 1] = np.nan
    z[12] = np.nan
    z[15, 1] = -np.pi + 0.01
    prior = tk.Gaussian(np.array([-10.0, 0.0, 0.0, 0.0]), np.diag([25.0, 25.0, 1.0, 1.0]))
    problem = ({**models, "sensor": sensor}, tk.Record(record.t, z), prior)
    agree(*both(BootstrapFilter(particles=400), problem, monkeypatch, seed))


def test_they_agree_where_time_matters_and_one_source_of_noise_is_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = growth()
    simulation = scenario.simulate(1, 1)
    record = tk.Record(simulation.record.t, simulation.record.z[..., 0])
    problem = ({"motion": scenario.motion, "sensor": scenario.sensor}, record, scenario.prior)
    agree(*both(BootstrapFilter(particles=80), problem, monkeypatch))


def compiled_step(models: Any, monkeypatch: pytest.MonkeyPatch, particles: int = 64) -> Any:
    """A step of the bootstrap filter, and how many passes ran as machine code."""
    calls = []
    for name in ("ahead", "weigh"):
        original = getattr(kernels, name)

        def counted(*arguments: Any, original: Any = original) -> Any:
            done = original(*arguments)
            calls.append(done is not None)
            return done

        monkeypatch.setattr(kernels, name, counted)
    rule = BootstrapFilter(particles=particles)
    prior = tk.Gaussian(np.array([30.0, 40.0, 1.0, 1.0]), np.eye(4))
    motion, sensor = models["motion"], models["sensor"]
    state = rule.begin(prior, rng=np.random.default_rng(1), motion=motion)
    rule.update(rule.predict(state, motion, 1.0), sensor, np.full(sensor.space.size, 1.0))
    return sum(calls)


def test_the_usual_step_is_machine_code(monkeypatch: pytest.MonkeyPatch) -> None:
    models, _, _ = linear()
    assert compiled_step(models, monkeypatch) == 2


def test_what_cannot_be_traced_stays_on_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    models, _, _ = linear()
    opaque = ComponentSensor(
        name="opaque", measure=lambda x: (np.interp(x, [0.0, 1.0], [0.0, 1.0]),),
        noise=lambda: ((1.0,),), space=tk.Space.of("z"),
    )  # fmt: skip
    assert compiled_step({**models, "sensor": opaque}, monkeypatch) == 1


@pytest.mark.parametrize("count", [1, 7, 8, 63, 301])
def test_any_number_of_particles_is_compiled(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = linear(steps=20)
    assert compiled_step(problem[0], monkeypatch, particles=count) == 2
    agree(*both(BootstrapFilter(particles=count), problem, monkeypatch), tolerance=1e-7)


def test_per_particle_noise_and_circles_stay_on_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    models, _, _ = linear()
    noisy = ComponentSensor(
        name="faint", measure=lambda x: (x,), noise=lambda x: ((1.0 + x * x,),),
        space=tk.Space.of("z"),
    )  # fmt: skip
    assert compiled_step({**models, "sensor": noisy}, monkeypatch) == 1
    space = tk.Space.of("x [m]", "y [m]", "vx [m/s]", "heading [rad] circular")
    circle = ComponentMotion(
        name="circle", advance=lambda x, y, vx, heading, *, dt: (x + dt * vx, y, vx, heading),
        noise=lambda: tuple(map(tuple, np.eye(4).tolist())), space=space,
    )  # fmt: skip
    assert (
        compiled_step({"motion": circle, "sensor": position(sigma=1.0).over(space)}, monkeypatch)
        == 0
    )


def test_moments_found_on_the_way_are_those_of_the_particles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Far from the origin, and with one measurement that is much better than the prior."""
    models, _, _ = linear()
    rule = BootstrapFilter(particles=800, threshold=0.0)
    mean = np.array([1e6, -2e6, 10.0, -5.0])
    state = rule.begin(
        tk.Gaussian(mean, np.diag([1e4, 1e4, 1.0, 1.0])), rng=np.random.default_rng(1),
        motion=models["motion"],
    )  # fmt: skip
    for z in (mean[:2] + 150.0, mean[:2] + 151.0, mean[:2] + 900.0):
        state = rule.predict(state, models["motion"], 0.1)
        for _ in range(2):
            plain = Particles(
                state.points, state.log_weights, state.key, state.step, state.circular
            )
            ours, theirs = state.moments(), plain.moments()
            sigma = np.sqrt(np.diagonal(theirs.cov))
            assert (np.abs(ours.mean - theirs.mean) <= 1e-9 * sigma + 1e-9).all()
            assert (np.abs(ours.cov - theirs.cov) <= 1e-9 * np.outer(sigma, sigma)).all()
            assert np.isclose(state.effective_sample_size, plain.effective_sample_size, rtol=1e-9)
            state, _ = rule.update(state, models["sensor"], z)


def test_a_changed_copy_forgets_what_was_found_on_the_way() -> None:
    import attrs

    models, _, prior = linear()
    rule = BootstrapFilter(particles=64)
    state = rule.begin(prior, rng=np.random.default_rng(1), motion=models["motion"])
    ahead = rule.predict(state, models["motion"], 1.0)
    moved = attrs.evolve(ahead, points=ahead.points + 5.0)
    assert np.abs(moved.moments().mean - ahead.moments().mean - 5.0).max() < 1e-9
