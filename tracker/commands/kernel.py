"""The compiled step of a component, as text: what ``tracker show NAME --kernel`` prints.

The example problem is chosen here; composing and emitting are `tracker.compile`.
"""

from __future__ import annotations

from typing import Any

from tracker.compile.fuse import backward, forward, why_not
from tracker.compile.llvm import emit
from tracker.compile.program import Program
from tracker.compile.run import FAILURES, _afterwards, _layout
from tracker.errors import CapabilityError
from tracker.estimation import Estimator, estimator
from tracker.registry import Component, default_registry
from tracker.types import EMPTY_SPACE


def kernel_text(component: Component, form: str) -> str:
    """The step program of a filter, smoother, adapter or scenario, or (form "llvm") the text made from it.

    Raises:
        CapabilityError: for another kind, or if the step cannot be compiled.
    """
    if component.kind not in ("filter", "smoother", "adapter", "scenario"):
        raise CapabilityError(
            f"{component.kind} {component.name!r} has no step of its own: --kernel is for a "
            "filter, a smoother, an adapter or a scenario."
        )
    made, words = _example(component)
    program = _program(component, made)
    text = emit(program) if form == "llvm" else program.describe()
    return f"{component.kind} {component.name}: {words}\n\n{text.rstrip()}\n"


def _example(component: Component) -> tuple[Estimator, str]:
    registry = default_registry()
    if component.kind == "scenario":
        scenario = component.make()
        words = f"example: ekf1 on its motion ({scenario.motion.name}) and sensor ({scenario.sensor.name})"
        return estimator("ekf1", motion=scenario.motion, sensor=scenario.sensor), words
    motion = registry.get("motion", "constant_velocity").make(density=0.1)
    if component.kind == "filter":
        rule = component.make()
        if "linear" in getattr(rule, "needs", ()):
            sensor = registry.get("sensor", "position").make(sigma=1.0)
            words = "example: position measured, constant velocity, as it needs linear models"
        else:
            sensor = registry.get("scenario", "two_stations").make().sensor
            words = "example: two stations that measure azimuth, constant velocity"
        return estimator(rule, motion=motion, sensor=sensor), words
    sensor = registry.get("scenario", "two_stations").make().sensor
    if component.kind == "adapter":
        words = "example: beside ekf1, two stations that measure azimuth, constant velocity"
        return estimator("ekf1", motion=motion, sensor=sensor, adapter=component.make()), words
    rule, chosen = component.make(), "ekf1"
    words = "example: after ekf1, two stations that measure azimuth, constant velocity"
    if hasattr(rule, "step") and "beliefs" in rule.needs:
        chosen, wild = rule.follows, registry.get("motion", "constant_velocity").make(density=10.0)
        parts = {"modes": (motion, wild), "transition": ((0.95, 0.05), (0.1, 0.9))}
        motion = registry.get("motion", "switching").make(**parts)
        words = f"example: after {chosen}, two stations, two modes of constant velocity"
    return estimator(chosen, motion=motion, sensor=sensor, smoother=rule), words


def _program(component: Component, made: Estimator) -> Program:
    why = why_not(made.filter, made.motion, made.sensors)
    if not why:
        backwards = component.kind == "smoother"
        inputs = getattr(made.motion, "input_space", EMPTY_SPACE).size
        compose: Any = backward if backwards else forward
        keep = ("smoothed" if backwards else "filtered",)
        try:
            parts = _afterwards(made) if backwards else made
            return compose(_layout(parts, {}, inputs, keep))  # type: ignore[no-any-return]
        except FAILURES as error:
            why = str(error)
    raise CapabilityError(f"{component.kind} {component.name!r} runs on arrays: {why}")
