"""J1 to J4 of the thesis as metrics: what its reproduction counts, on histories of any filter."""

import numpy as np
import pytest

import tracker as tk
from tracker.errors import CapabilityError, DomainError
from tracker.registry import metrics
from tracker_adaptive import MismatchCost, NoiseError, StateError
from tracker_papers.flying_object import flying_object
from tracker_papers.paper4 import methods
from tracker_papers.paper4.scores import measured
from tracker_papers.underwater_angles import underwater_angles


@pytest.mark.parametrize(
    ("scene", "name"),
    [(flying_object(), "kf"), (underwater_angles("manoeuvring", steps=120), "ekf1")],
)
def test_the_metrics_are_what_the_reproduction_counts(scene, name):
    made = scene.simulate(3, 4)
    one = methods.estimator(scene, name)
    history = tk.filter(one, made.record, made.prior, start=made.start)
    found = measured(scene, {"one": one}, 4, 3)
    for metric, expected in (
        ("noise_rms", found.j1),
        ("measured_rms", found["one"].j2),
        ("state_rms", found["one"].rmse),
        ("mismatch_cost", 1000.0 * found["one"].dom),
    ):
        score = metrics.make(metric).score(history, made.truth)
        np.testing.assert_allclose(score, expected, rtol=1e-9, err_msg=metric)


def test_what_was_not_measured_is_no_noise():
    scene = flying_object()
    made = scene.simulate(1, 3)
    z = np.array(made.record.z)
    z[::2, 0] = np.nan
    one = methods.estimator(scene, "kf")
    history = tk.filter(one, tk.Record(made.record.t, z), made.prior, start=made.start)
    off = np.asarray(made.record.z)[1::2, 0] - made.truth[1::2, 0]
    score = NoiseError().score(history, made.truth)
    np.testing.assert_allclose(score[0], np.sqrt(np.mean(off**2, axis=0)), rtol=1e-12)
    assert np.isfinite(MismatchCost().score(history, made.truth)).all()


def test_a_smoothed_history_is_judged_by_what_was_smoothed():
    scene = tk.scenario("line")
    made = scene.simulate(1, 5)
    one = tk.estimator("kf", motion=scene.motion, sensor=scene.sensor, smoother="rts")
    history = tk.smooth(one, made.record, made.prior, start=made.start)
    score = StateError().score(history, made.truth)
    off = history.smoothed.mean - made.truth
    np.testing.assert_allclose(score, np.sqrt(np.mean(off**2, axis=0)), rtol=1e-12)


def test_what_cannot_be_judged_is_refused():
    scene = flying_object()
    made = scene.simulate(1, 2)
    history = tk.filter(methods.estimator(scene, "kf"), made.record, made.prior, start=made.start)
    import attrs

    with pytest.raises(CapabilityError, match="a history by itself"):
        StateError().score(attrs.evolve(history, run=None), made.truth)
    for wrong in ({"alpha": 0.0}, {"alpha": np.nan}, {"window": 0}):
        with pytest.raises(DomainError, match="alpha"):
            MismatchCost(**wrong)
