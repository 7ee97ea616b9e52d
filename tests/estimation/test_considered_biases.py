"""Biases as states: motions and sensors that have them, and the filter that considers them."""

import pickle
from typing import Any

import numpy as np
import pytest
import scipy.special

import tracker as tk
from tracker.errors import CapabilityError, DomainError, ShapeError
from tracker.models import ComponentSensor
from tracker.types import Array
from tracker_kalman import ExtendedKalmanFilter, SchmidtFilter
from tracker_motion import augmented, constant_velocity, linear
from tracker_sensors import azimuth, biased, position, stack

PLAIN = constant_velocity(0.1)
MOTION = augmented(PLAIN, ["bias [rad]"])
STATIONS = stack([azimuth(0.01).at(sx=0.0, sy=0.0), azimuth(0.01).at(sx=100.0, sy=0.0)])
SENSOR = biased(STATIONS, {"azimuth_1": "bias"})
PRIOR = tk.Gaussian([40.0, 60.0, 1.0, 0.0, 0.0], np.diag([25.0, 25.0, 1.0, 1.0, 0.05**2]))


# ------------------------------------------------------------------------------------ models
def test_further_components_stay_and_drift_and_the_others_move_as_alone() -> None:
    motion = augmented(PLAIN, ["bias [rad]", "offset [Hz]"], density=(0.0, 0.3))
    rng = np.random.default_rng(1)
    for batch in ((), (3,), (2, 0)):
        x = rng.standard_normal((6, *batch))
        ahead, alone = motion.f(x, 2.0), PLAIN.f(x[:4], 2.0)
        np.testing.assert_array_equal(ahead[:4], alone)
        np.testing.assert_array_equal(ahead[4:], x[4:])
        Q = np.asarray(motion.Q(x, 2.0)).reshape(6, 6)
        np.testing.assert_array_equal(Q[:4, :4], np.asarray(PLAIN.Q(x[:4], 2.0)).reshape(4, 4))
        np.testing.assert_allclose(Q[4:, 4:], [[0.0, 0.0], [0.0, 0.6]])
        assert not Q[:4, 4:].any()
    assert motion.space.units[4:] == ("rad", "Hz")
    assert motion.linear
    assert motion.parts == ("constant_velocity",)
    assert motion.with_parameters(density_offset=0.1).parameters["density_offset"] == 0.1


def test_what_is_augmented_twice_has_both() -> None:
    twice = augmented(augmented(PLAIN, ["a"], 1.0), ["b"], 2.0)
    once = augmented(PLAIN, ["a", "b"], [1.0, 2.0])
    np.testing.assert_array_equal(twice.Q(np.zeros(6), 0.5), once.Q(np.zeros(6), 0.5))


def test_a_biased_sensor_is_off_by_the_state() -> None:
    x = np.array([40.0, 60.0, 1.0, 0.0, 0.3])
    np.testing.assert_allclose(SENSOR.h(x) - STATIONS.h(x[:4]), [0.3, 0.0], atol=1e-15)
    H = SENSOR.jacobian(x)
    np.testing.assert_allclose(H[:, 4], [1.0, 0.0])
    np.testing.assert_allclose(H[:, :4], STATIONS.jacobian(x[:4]))
    assert SENSOR.state.units[4] == "rad"
    copy = pickle.loads(pickle.dumps(SENSOR))
    np.testing.assert_array_equal(copy.h(x), SENSOR.h(x))


def test_biases_may_be_shared_and_are_found_by_name() -> None:
    shared = biased(STATIONS, {"azimuth_1": "bias", "azimuth_2": "bias"})
    x = np.array([40.0, 60.0, 1.0, 0.0, 0.3])
    np.testing.assert_allclose(shared.h(x) - STATIONS.h(x[:4]), [0.3, 0.3], atol=1e-15)
    longer = augmented(PLAIN, ["other", "bias [rad]"])
    moved = tk.estimator("ekf1", motion=longer, sensor=shared).sensors[0]
    np.testing.assert_allclose(moved.h(np.insert(x, 4, 9.0)), shared.h(x))


def test_what_cannot_have_a_bias_is_refused_in_words() -> None:
    with pytest.raises(DomainError, match="azimuth_3"):
        biased(STATIONS, {"azimuth_3": "bias"})
    with pytest.raises(CapabilityError, match="sensor 'biased'"):
        biased(object(), {"azimuth": "bias"})  # type: ignore[arg-type]
    opaque = linear(PLAIN.space, np.eye(4), Q=np.eye(4))
    with pytest.raises(CapabilityError, match="motion 'augmented'"):
        augmented(opaque, ["bias [rad]"])
    with pytest.raises(ShapeError, match="one density"):
        augmented(PLAIN, ["a", "b"], density=(1.0, 2.0, 3.0))
    with pytest.raises(ShapeError, match="at least one"):
        augmented(PLAIN, [])
    with pytest.raises(DomainError, match="density_a"):
        augmented(PLAIN, ["a"], density=-1.0)
    with pytest.raises(DomainError, match="more than once"):
        augmented(PLAIN, ["vx [m/s]"])


# ------------------------------------------------------------------------------------ filter
def considered(**changes: Any) -> tk.Estimator:
    rule = SchmidtFilter(**{"considered": "bias", **changes})
    return tk.estimator(rule, motion=MOTION, sensor=SENSOR)


def simulated(runs: int, steps: int, seed: int) -> tuple[Array, tk.Record]:
    rng = np.random.default_rng(seed)
    x = tk.Gaussian(np.repeat(PRIOR.mean[:, None], runs, axis=1), PRIOR.cov).sample(rng=rng)
    root = np.linalg.cholesky(PLAIN.Q(np.zeros(4), 1.0))
    truth, z = [], []
    for _ in range(steps):
        x = np.concatenate([PLAIN.f(x[:4], 1.0) + root @ rng.standard_normal((4, runs)), x[4:]])
        truth.append(x)
        z.append(SENSOR.h(x) + 0.01 * rng.standard_normal((2, runs)))
    return np.stack(truth), tk.Record(np.arange(1.0, steps + 1), np.stack(z))


def test_what_is_considered_keeps_its_estimate_and_variance() -> None:
    _, record = simulated(7, 10, 1)
    history = tk.filter(considered(), record, PRIOR, start=0.0)
    np.testing.assert_array_equal(history.filtered.mean[:, 4], PRIOR.mean[4])
    np.testing.assert_array_equal(history.filtered.cov[:, 4, 4], PRIOR.cov[4, 4])
    correlated = np.abs(history.filtered.cov[-1, :2, 4]).max()
    assert correlated > 0.0, "the position is off because the bearing is: they are correlated"


@pytest.mark.parametrize("batch", [(), (7,), (3, 5)])
def test_the_covariance_is_that_of_the_gain_in_joseph_form(batch: tuple[int, ...]) -> None:
    rng = np.random.default_rng(2)
    sensor = biased(position(2.0), {"x": "bx", "y": "by"})
    A = rng.standard_normal((6, 6, *batch))
    cov = np.einsum("ik...,jk...->ij...", A, A)
    state = tk.Gaussian(rng.standard_normal((6, *batch)), (cov + cov.swapaxes(0, 1)) / 2)
    z = rng.standard_normal((2, *batch))
    after, told = SchmidtFilter(considered=["bx", "by"]).update(state, sensor, z)
    full, innovation = ExtendedKalmanFilter().update(state, sensor, z)
    np.testing.assert_array_equal(told.nis, innovation.nis)
    H = np.concatenate([np.eye(2, 4), np.eye(2)], axis=1)
    for lane in np.ndindex(*batch):
        at: Any = (..., *lane)
        P, x = state.cov[at], state.mean[at]
        S = H @ P @ H.T + 4.0 * np.eye(2)
        K = np.linalg.solve(S, H @ P).T
        K[4:] = 0.0
        I_KH = np.eye(6) - K @ H
        np.testing.assert_allclose(after.mean[at], x + K @ (z[at] - H @ x), atol=1e-9)
        np.testing.assert_allclose(
            after.cov[at], I_KH @ P @ I_KH.T + 4.0 * K @ K.T, atol=1e-9 * np.abs(P).max()
        )
        assert np.linalg.eigvalsh(after.cov[at] - full.cov[at]).min() > -1e-9


def test_with_nothing_considered_it_is_its_inner_filter() -> None:
    _, record = simulated(5, 8, 3)
    for inner in ("ekf1", "ekf2", "ukf"):
        found = [
            tk.filter(
                tk.estimator(rule, motion=MOTION, sensor=SENSOR), record, PRIOR, start=0.0
            ).filtered
            for rule in (inner, tk.filters.make("schmidt", inner=inner))
        ]
        np.testing.assert_allclose(found[1].mean, found[0].mean, rtol=1e-12)
        np.testing.assert_allclose(found[1].cov, found[0].cov, rtol=1e-10, atol=1e-14)


@pytest.mark.statistical
def test_its_covariance_is_that_of_its_errors_and_leaving_the_bias_out_is_overconfident() -> None:
    """NEES of four components after 15 steps over 1,000 runs with drawn biases; false alarm 1e-6.

    The problem is slightly nonlinear: the band of the filter that considers is widened by 10 %.
    """
    runs = 1000
    truth, record = simulated(runs, 15, 4)

    def nees(estimator: tk.Estimator, prior: tk.Gaussian) -> float:
        end = tk.filter(estimator, record, prior, start=0.0).filtered
        e = (end.mean[-1, :4] - truth[-1, :4]).T[..., None]
        P = np.moveaxis(end.cov[-1, :4, :4], -1, 0)
        return float(np.mean((e * np.linalg.solve(P, e)).sum(axis=(1, 2))))

    low = 4.0 * runs
    bounds = scipy.special.chdtri(low, 1 - 5e-7) / runs, scipy.special.chdtri(low, 5e-7) / runs
    assert 0.9 * bounds[0] < nees(considered(), PRIOR) < 1.1 * bounds[1]
    ignorant = tk.estimator("ekf1", motion=PLAIN, sensor=STATIONS)
    assert nees(ignorant, tk.Gaussian(PRIOR.mean[:4], PRIOR.cov[:4, :4])) > 3.0 * bounds[1]


def test_a_name_that_is_no_component_is_named() -> None:
    _, record = simulated(1, 2, 5)
    with pytest.raises(DomainError, match="bais"):
        tk.filter(considered(considered=("bais",)), record, PRIOR, start=0.0)


def test_only_a_gaussian_filter_can_be_inside() -> None:
    for inner in ("square_root", "imm", object()):
        with pytest.raises(CapabilityError, match="parameter 'inner'"):
            SchmidtFilter(inner=inner)


def test_missing_measurements_and_names_given_alone() -> None:
    _, record = simulated(3, 6, 6)
    z = record.z.copy()
    z[2], z[3, 0] = np.nan, np.nan
    history = tk.filter(considered(), tk.Record(record.t, z), PRIOR, start=0.0)
    assert history.innovation.ok.all()
    np.testing.assert_array_equal(history.filtered.mean[2], history.predicted.mean[2])
    assert SchmidtFilter(considered="bias") == SchmidtFilter(considered=("bias",))


def test_a_sensor_with_a_derivative_by_hand_is_refused() -> None:
    sensor = ComponentSensor(
        name="hand",
        measure=lambda x: (x,),
        noise=lambda: ((1.0,),),
        derivative=lambda x: ((1.0,),),
        space=tk.Space.of("z [m]"),
    )
    with pytest.raises(CapabilityError, match="derivative by hand"):
        biased(sensor, {"z": "bias"})
