"""Laws of gates."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from tracker.testing.calls import Call, Given, calls_of
from tracker.testing.law import Case, law
from tracker.testing.strategies import BATCHES


def _distances(gate: Any, case: Case, shape: tuple[int, ...], m: int) -> Any:
    """Squared distances on both sides of the threshold, some of them NaN."""
    d2 = case.rng.uniform(0.0, 3.0, shape) * gate.threshold(m)
    d2[case.rng.uniform(size=shape) < 0.2] = np.nan
    return d2


@calls_of("gate")
def gate_calls(gate: Any, case: Case, batch: tuple[int, ...]) -> list[Call]:
    """How a gate is called."""
    m = 2
    d2 = _distances(gate, case, (2, 3, *batch), m)
    given = (Given("distance", d2, 2), Given("m", m, None))
    return [Call("admits", lambda g, *a: (g.admits(*a),), given, (2,), batch)]


@law("gate", name="threshold depends only on m")
def threshold(gate: Any, _case: Case) -> None:
    """The threshold is a positive number that depends only on m and never falls as m grows."""
    found = [float(gate.threshold(m)) for m in range(1, 7)]
    assert all(np.isfinite(found)), f"thresholds for m = 1 to 6 are not all finite: {found}"
    assert min(found) > 0.0, f"a threshold is not positive: {found}"
    assert found == [float(gate.threshold(m)) for m in range(1, 7)], (
        "thresholds change when asked again"
    )
    assert found == sorted(found), f"a larger m has a smaller threshold: {found}"


@law("gate", name="admits up to the threshold")
def admits(gate: Any, case: Case) -> None:
    """What is nearer than the threshold passes, what is farther does not, in any shape."""
    for shape in (*BATCHES, (2, 3, 0)):
        for m in (1, 2, 3):
            limit = gate.threshold(m)
            d2 = np.asarray(case.rng.uniform(0.0, 3.0, shape) * limit)
            flags = np.asarray(gate.admits(d2, m))
            assert flags.dtype == np.bool_, f"admits answers {flags.dtype}, not flags"
            assert flags.shape == shape, f"admits answers shape {flags.shape} to shape {shape}"
            assert np.array_equal(flags, d2 <= limit), (
                "flags are not those of distance <= threshold"
            )
    assert np.all(gate.admits(np.zeros(3), 2)), "a distance of zero does not pass"


@law("gate", name="NaN never passes")
def nan_never_passes(gate: Any, case: Case) -> None:
    """A distance that is NaN, as of a diverged track, belongs to nobody."""
    for m in (1, 2, 3):
        d2 = np.asarray(case.rng.uniform(0.0, 1.0, (2, 3)) * gate.threshold(m))
        d2[1, 1] = np.nan
        assert not np.asarray(gate.admits(d2, m))[1, 1], "a distance of NaN passes"
        assert not np.any(gate.admits(np.array([np.nan]), m)), "a distance of NaN passes"


def _no_probability(gate: Any) -> str:
    ok = hasattr(gate, "probability") and attrs.has(type(gate))
    return "" if ok else "it has no probability"


@law("gate", name="a larger probability gates no less", unless=_no_probability)
def larger_probability(gate: Any, case: Case) -> None:
    """A gate for a larger probability admits whatever one for a smaller probability admits."""
    low, high = np.sort(case.rng.uniform(0.5, 0.9999, 2))
    narrow, wide = (attrs.evolve(gate, probability=float(p)) for p in (low, high))
    for m in (1, 2, 3):
        a, b = narrow.threshold(m), wide.threshold(m)
        assert a <= b, f"probability {low:.4f} has threshold {a:.4g}, {high:.4f} has {b:.4g}"
