"""What this plugin offers, as records; the models themselves are imported when first made."""

from __future__ import annotations

from tracker.hookspecs import hookimpl
from tracker.registry import Component, Registry


@hookimpl
def tracker_components(registry: Registry) -> None:
    """Add the motion models."""
    for component in _COMPONENTS:
        registry.add(component)


_COMPONENTS = (
    Component(
        kind="motion",
        name="acceleration_input",
        target="tracker_motion.acceleration_input:acceleration_input",
        summary="constant velocity driven by accelerations constant over each step, known or random",
        paper="2",
        equations=("(3)-(8)", "paper 1 (6), (14)"),
        tags=("linear", "kinematic", "discrete-noise", "known-input", "1-D", "2-D", "3-D"),
        examples=("acceleration_input(sigma=0.05)",),
        deviations={
            "Q composes": "accelerations are constant over each step by definition (paper 2, eq. 3-8): "
            "two half steps draw two of them, one step draws one"
        },
    ),
    Component(
        kind="motion",
        name="augmented",
        target="tracker_motion.augmented:augmented",
        summary="any motion with further components that are constant or drift: biases and the like",
        paper="Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001",
        equations=("section 11.9",),
        tags=("composition", "bias"),
        examples=("augmented(constant_velocity(0.1), components=['bias [rad]'], density=1e-6)",),
    ),
    Component(
        kind="motion",
        name="constant_acceleration",
        target="tracker_motion.constant_acceleration:constant_acceleration",
        summary="constant acceleration disturbed by white jerk, 1 to 3 axes",
        paper="Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001",
        equations=("section 6.2.3", "paper 0 (3)"),
        tags=("linear", "kinematic", "continuous-noise", "1-D", "2-D", "3-D"),
        examples=("constant_acceleration(density=0.2)",),
    ),
    Component(
        kind="motion",
        name="constant_velocity",
        target="tracker_motion.constant_velocity:constant_velocity",
        summary="constant velocity disturbed by white acceleration, 1 to 3 axes",
        paper="0",
        equations=("(3)", "(4)", "(26)-(29)", "paper 3 (6)-(10)"),
        tags=("linear", "kinematic", "continuous-noise", "1-D", "2-D", "3-D"),
        examples=("constant_velocity(density=0.1)",),
    ),
    Component(
        kind="motion",
        name="coordinated_turn",
        target="tracker_motion.coordinated_turn:coordinated_turn",
        summary="constant speed and unknown turn rate, disturbed by white noise in both",
        paper="Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001",
        equations=("section 11.7", "paper 0 (3)"),
        tags=("nonlinear", "manoeuvre", "continuous-noise", "2-D"),
        examples=("coordinated_turn(density=0.1, turn_density=1e-6)",),
    ),
    Component(
        kind="motion",
        name="linear",
        target="tracker_motion.linear:linear",
        summary="any linear motion, in continuous or discrete time, given by its matrices",
        paper="0",
        equations=("(1)-(4)", "paper 4 (2-1), (3-11)"),
        tags=("linear", "general"),
        examples=(
            "linear(space=Space.of('x [m]', 'vx [m/s]'), F=[[0, 1], [0, 0]], L=[[0], [1]], Qc=[[0.1]])",
        ),
    ),
    Component(
        kind="motion",
        name="switching",
        target="tracker_motion.switching:switching",
        summary="several motions, of which one holds at a time; filter imm tells them apart, others average",
        paper="Blom and Bar-Shalom, The interacting multiple model algorithm, 1988",
        tags=("manoeuvre", "modes", "1-D", "2-D", "3-D"),
        examples=(
            "switching([constant_velocity(density=0.1), constant_velocity(density=5.0)], [[0.9, 0.1], [0.2, 0.8]])",
        ),
    ),
)
