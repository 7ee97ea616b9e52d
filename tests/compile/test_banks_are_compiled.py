"""Filters that keep several Gaussians run as one compiled step, member after member, and agree with the arrays."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np
import pytest

import tracker as tk
from tracker.compile import objects, run
from tracker.compile.values import Leaf, form_of, leaves
from tracker.errors import CapabilityError
from tracker.models import ComponentSensor, atan2
from tracker_kalman import GaussianSumFilter
from tracker_kalman.gaussian_sum import MOST
from tracker_kalman.rooted import SquareRootGaussian
from tracker_motion import constant_velocity
from tracker_passive import RangeParameterised
from tracker_sensors import azimuth, azimuth_elevation, position, stack

pytestmark = pytest.mark.skipif(not objects.available(), reason="llvmlite is not installed")

STEPS = 30
FLAT = tk.Gaussian(
    np.array([2000.0, 1500.0, -5.0, 2.0]), np.diag([1500.0**2, 1500.0**2, 100.0, 100.0])
)
SPACE = tk.Gaussian(
    np.array([2000.0, 1500.0, 600.0, -5.0, 2.0, 0.0]),
    np.diag([1500.0**2, 1500.0**2, 400.0**2, 100.0, 100.0, 25.0]),
)
TURNED = azimuth(0.01, convention="north")


def problem(
    rule: Any, sensor: Any, prior: tk.Gaussian = FLAT, batch: tuple[int, ...] = (5,)
) -> tuple[tk.Estimator, tk.Record, tk.Gaussian]:
    """An observer that turns back and forth; some measurements missing, the first ones too."""
    motion = constant_velocity(0.1, axes=len(prior.mean) // 2)
    built = tk.estimator(rule, motion=motion, sensor=sensor)
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.choice([0.0, 5.0, 10.0], STEPS))
    lead = (STEPS, 1, *(1,) * len(batch))
    axes = len(prior.mean) // 2
    size = built.sensors[0].pose_space.size
    pose = 40.0 * np.cumsum(rng.choice([-1.0, 1.0], (STEPS, size)), axis=0) if size else None
    x = np.empty((STEPS, len(prior.mean), *batch))
    start = prior.mean.reshape(-1, *(1,) * len(batch))
    x[:] = start + 0.2 * rng.standard_normal((1, len(prior.mean), *batch)) * 500.0
    x[:, axes:] = 5.0 * rng.standard_normal((1, axes, *batch))
    x[:, :axes] += t.reshape(lead) * x[:, axes:]
    z = np.stack(
        [built.sensors[0].h(x[k], None if pose is None else pose[k]) for k in range(STEPS)]
    )
    z = z + 0.01 * rng.standard_normal(z.shape)
    z[rng.uniform(size=z.shape) < 0.15] = np.nan
    z[:2, ..., 1::2] = np.nan if batch else z[:2, ..., 1::2]
    return built, tk.Record(t, z, pose=pose), prior


def both(monkeypatch: Any, built: tk.Estimator, record: tk.Record, prior: tk.Gaussian) -> Any:
    out = []
    for mode in ("require", "off"):
        monkeypatch.setenv("TRACKER_COMPILE", mode)
        out.append(tk.filter(built, record, prior, start=0.0))
    return out


def agree(found: tk.History, arrays: tk.History) -> None:
    """To 1e-9 of the size of each component, or of the deviation that is claimed of it."""
    sigma = np.sqrt(np.einsum("kii...->ki...", arrays.predicted.cov))
    for stage in ("predicted", "filtered"):
        one, other = getattr(found, stage), getattr(arrays, stage)
        assert (np.abs(one.mean - other.mean) <= 1e-9 * (np.abs(other.mean) + sigma)).all()
        assert (np.abs(one.cov - other.cov) <= 1e-9 * sigma[:, :, None] * sigma[:, None]).all()
    for name in ("nis", "loglik", "count"):
        one, other = getattr(found.innovation, name), getattr(arrays.innovation, name)
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9, err_msg=name)
    assert np.array_equal(found.innovation.ok, arrays.innovation.ok)


PAIR = stack([azimuth(0.01).at(sx=0.0, sy=0.0), azimuth(0.02).at(sx=0.0, sy=900.0)])


@pytest.mark.parametrize("batch", [(), (1,), (11,), (2, 3)], ids=str)
@pytest.mark.parametrize("rule", ["ekf1", "ukf", "ukf_square_root", "iekf"])
def test_a_compiled_gaussian_sum_agrees_with_the_arrays(monkeypatch, rule, batch):
    agree(*both(monkeypatch, *problem(GaussianSumFilter(rule, components=3), PAIR, batch=batch)))


@pytest.mark.parametrize("options", [{"components": 1}, {"components": 9, "prune": 1e-3}], ids=str)
def test_one_member_or_many_that_are_given_up_agree_too(monkeypatch, options):
    agree(*both(monkeypatch, *problem(GaussianSumFilter("ekf1", **options), PAIR)))


@pytest.mark.parametrize("batch", [(), (1,), (11,), (2, 3)], ids=str)
@pytest.mark.parametrize("sensor", [azimuth(0.01), TURNED], ids=["math", "north"])
def test_a_compiled_bank_is_laid_out_where_the_arrays_lay_it_out(monkeypatch, sensor, batch):
    rule = RangeParameterised("ekf1", components=6)
    found, arrays = both(monkeypatch, *problem(rule, sensor, batch=batch))
    agree(found, arrays)
    first = np.isfinite(arrays.innovation.residual[:, 0]).argmax(axis=0)
    assert batch in ((), (1,)) or len(np.unique(first)) > 1, "lanes should begin at several steps"


@pytest.mark.parametrize("rule", ["ekf1", "ukf_square_root"])
def test_so_it_is_along_a_line_in_space(monkeypatch, rule):
    bank = RangeParameterised(rule, components=4, nearest=100.0, prune=1e-6)
    agree(*both(monkeypatch, *problem(bank, azimuth_elevation(0.01, 0.01), SPACE)))


def test_where_the_sensor_stands_and_how_wrong_it_is_may_differ_per_lane(monkeypatch):
    sensor = azimuth(0.01).at(sx=np.linspace(-90.0, 90.0, 5), sy=10.0)
    sensor = sensor.with_parameters(sigma=np.linspace(0.01, 0.03, 5))
    built, record, prior = problem(RangeParameterised("ekf1", components=3), sensor)
    assert record.pose is None
    agree(*both(monkeypatch, built, record, prior))


def test_sensors_that_see_no_direction_start_nothing_compiled_either(monkeypatch):
    sensors = [position(50.0), azimuth(0.01).at(sx=0.0, sy=0.0)]
    built = tk.estimator(
        RangeParameterised(components=4), motion=constant_velocity(0.1), sensor=sensors
    )
    z = np.array([[2100.0, 1400.0], [0.6, np.nan], [2000.0, 1300.0], [0.61, np.nan]])
    record = tk.Record(np.arange(4.0), z, sensor=np.array([0, 1, 0, 1]))
    agree(*both(monkeypatch, built, record, FLAT))


@pytest.mark.parametrize(
    ("rule", "sensor"),
    [(GaussianSumFilter("ekf1", components=3), PAIR), (RangeParameterised(components=3), TURNED)],
    ids=["sum", "bank"],
)
def test_bits_do_not_depend_on_the_batch_and_a_lost_lane_harms_no_neighbour(
    monkeypatch, rule, sensor
):
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    built, record, prior = problem(rule, sensor, batch=(21,))
    whole = tk.filter(built, record, prior, workers=2)
    for lanes in (slice(0, 1), slice(3, 20)):
        some = tk.filter(built, attrs.evolve(record, z=record.z[..., lanes]), prior)
        assert np.array_equal(some.filtered.mean, whole.filtered.mean[..., lanes])
        assert np.array_equal(some.filtered.cov, whole.filtered.cov[..., lanes])
    mean = np.repeat(prior.mean[:, None], 21, axis=1)
    mean[:, 4] = np.nan
    ill = tk.Gaussian.trusted(mean, np.repeat(prior.cov[..., None], 21, axis=2))
    other, rest = tk.filter(built, record, ill), np.arange(21) != 4
    assert np.array_equal(other.filtered.mean[..., rest], whole.filtered.mean[..., rest])
    assert np.isnan(other.filtered.mean[-1, :, 4]).all()
    assert not other.innovation.ok[-1, 4]


def test_a_campaign_scores_the_same_compiled_and_on_arrays(monkeypatch):
    scene, found = tk.scenario("moving_observer"), []
    rule = RangeParameterised("ekf1", components=4)
    built = tk.estimator(rule, motion=scene.motion, sensor=scene.sensor)
    for mode in ("require", "off"):
        monkeypatch.setenv("TRACKER_COMPILE", mode)
        found.append(tk.monte_carlo(built, scene, runs=40, seed=1).scores["estimator"]["filter"])
    for part in ("per_run", "per_step"):
        one, other = (getattr(scores, part) for scores in found)
        for name in one:
            np.testing.assert_allclose(one[name], other[name], rtol=1e-7, err_msg=name)


# ------------------------------------------------------------------------------ what cannot be
@pytest.mark.parametrize(
    ("rule", "why"),
    [
        (GaussianSumFilter(components=MOST + 1), f"{MOST + 1} members are too many to unroll"),
        (RangeParameterised(), f"32 members are too many to unroll .at most {MOST}"),
        (GaussianSumFilter(components=3, merge=0.1), "comparing all pairs"),
    ],
)
def test_what_cannot_be_compiled_says_why(monkeypatch, rule, why):
    built = tk.estimator(rule, motion=constant_velocity(0.1), sensor=TURNED)
    assert why.partition(" .")[0] in built.explain().splitlines()[0]
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    with pytest.raises(CapabilityError, match=why):
        run.reason(built)


def test_a_sensor_that_hides_where_it_is_is_refused_before_anything_is_compiled():
    sensor = ComponentSensor(
        name="hidden", measure=lambda x, y, *, px, py: (atan2(y - py, x - px),),
        noise=lambda: ((1e-4,),), space=tk.Space.of("azimuth [rad] circular"),
        parameters={"px": 500.0, "py": 0.0},
    )  # fmt: skip
    built = tk.estimator(
        RangeParameterised(components=2), motion=constant_velocity(0.1), sensor=sensor
    )
    with pytest.raises(CapabilityError, match="sx, sy"):
        tk.filter(built, tk.Record([0.0, 1.0], [[0.7], [0.7]]), FLAT)


def test_matrices_of_several_members_are_carried_without_their_other_halves():
    n, count = 3, 5
    sums = tk.Gaussian.trusted(np.zeros((n, count, 1)), np.zeros((n, n, count, 1)))
    rooted = SquareRootGaussian(np.zeros((n, count, 1)), np.zeros((n, n, count, 1)))
    for value, name in ((sums, "cov"), (rooted, "root")):
        found = {leaf.name: leaf for leaf in leaves(form_of(value, 1, "of"))}
        leaf: Leaf = found[f"of.{name}"]
        assert leaf.count == count * n * (n + 1) // 2
        reached = {*leaf.places(), *map(leaf.mirrored, leaf.places())}
        assert len(reached) == (count * n * n if name == "cov" else leaf.count)
