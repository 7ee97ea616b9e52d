"""What this plugin offers, as records; the sensors themselves are imported when first made."""

from __future__ import annotations

from tracker.hookspecs import hookimpl
from tracker.registry import Component, Registry


@hookimpl
def tracker_components(registry: Registry) -> None:
    """Add the sensors."""
    for component in _COMPONENTS:
        registry.add(component)


_COMPONENTS = (
    Component(
        kind="sensor",
        name="azimuth",
        target="tracker_sensors.azimuth:azimuth",
        summary="horizontal direction to the target, from the x axis or from north",
        paper="0",
        equations=("(30)-(33)", "paper 2 (9)-(12), (20)-(22)", "paper 3 (12), (15)"),
        tags=("passive", "angles", "2-D"),
        examples=("azimuth(sigma=0.03)",),
    ),
    Component(
        kind="sensor",
        name="azimuth_elevation",
        target="tracker_sensors.azimuth_elevation:azimuth_elevation",
        summary="azimuth of the target and its elevation above the horizontal plane",
        paper="3",
        equations=("(5)", "(12)", "paper 4 (5-3)-(5-12)"),
        tags=("passive", "angles", "3-D"),
        examples=("azimuth_elevation(sigma_azimuth=0.01, sigma_elevation=0.01)",),
    ),
    Component(
        kind="sensor",
        name="azimuth_height",
        target="tracker_sensors.azimuth_height:azimuth_height",
        summary="azimuth of the target and its height above the sensor",
        paper="3",
        equations=("(14)", "(15)"),
        tags=("passive", "angles", "3-D"),
        examples=("azimuth_height(sigma_azimuth=0.05, sigma_height=2.0)",),
    ),
    Component(
        kind="sensor",
        name="conical_angle",
        target="tracker_sensors.conical_angle:conical_angle",
        summary="angle between a line array and the direction to the target, left and right alike",
        paper="Van Trees, Optimum Array Processing, 2002",
        equations=("chapter 2",),
        tags=("passive", "angles", "ambiguous", "2-D", "3-D"),
        examples=("conical_angle(sigma=0.02)",),
    ),
    Component(
        kind="sensor",
        name="doppler_frequency",
        target="tracker_sensors.doppler_frequency:doppler_frequency",
        summary="received frequency of a tone of known carrier",
        paper="Landau and Lifshitz, Fluid Mechanics, 2nd edition, 1987",
        equations=("section 68",),
        tags=("passive", "doppler", "2-D", "3-D"),
        examples=("doppler_frequency(sigma=0.01, carrier=300.0)",),
    ),
    Component(
        kind="sensor",
        name="position",
        target="tracker_sensors.position:position",
        summary="Cartesian position in the frame of the state",
        paper="1",
        equations=("(7)", "paper 4 (3-12)"),
        tags=("linear", "2-D", "3-D"),
        examples=("position(sigma=5.0)",),
    ),
    Component(
        kind="sensor",
        name="position_velocity",
        target="tracker_sensors.position_velocity:position_velocity",
        summary="Cartesian position and velocity in the frame of the state",
        paper="1",
        equations=("(7)",),
        tags=("linear", "2-D", "3-D"),
        examples=("position_velocity(sigma=5.0, sigma_velocity=0.2)",),
    ),
    Component(
        kind="sensor",
        name="range_azimuth",
        target="tracker_sensors.range_azimuth:range_azimuth",
        summary="range and azimuth of the target, as a radar measures them",
        paper="4",
        equations=("(4-5)-(4-7)",),
        tags=("active", "angles", "range", "2-D"),
        examples=("range_azimuth(sigma_range=5.0, sigma_azimuth=0.01)",),
    ),
    Component(
        kind="sensor",
        name="range_only",
        target="tracker_sensors.range_only:range_only",
        summary="distance of the target from the sensor",
        paper="3",
        equations=("(3)", "(4)"),
        tags=("active", "range", "2-D", "3-D"),
        examples=("range_only(sigma=5.0)",),
    ),
    Component(
        kind="sensor",
        name="range_rate",
        target="tracker_sensors.range_rate:range_rate",
        summary="how fast the distance between sensor and target grows",
        paper="3",
        equations=("(3)-(4), differentiated in time",),
        tags=("doppler", "2-D", "3-D"),
        examples=("range_rate(sigma=0.1)",),
    ),
    Component(
        kind="sensor",
        name="relative_position",
        target="tracker_sensors.relative_position:relative_position",
        summary="position of the target relative to a platform, axes parallel to the state's",
        paper="3",
        equations=("(1)-(3)",),
        tags=("active", "linear", "2-D", "3-D"),
        examples=("relative_position(sigma=2.5)",),
    ),
    Component(
        kind="sensor",
        name="biased",
        target="tracker_sensors.biased:biased",
        summary="any sensor whose measurements are off by components of the state",
        paper="Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001",
        equations=("section 11.9",),
        tags=("composition", "bias"),
        examples=("biased(azimuth(0.03), biases={'azimuth': 'bias'})",),
    ),
    Component(
        kind="sensor",
        name="stack",
        target="tracker_sensors.stack:stack",
        summary="several sensors with their own poses, read at the same instant, as one",
        paper="0",
        equations=("(30)", "paper 4 (4-14), (5-10)"),
        tags=("composition",),
        examples=("stack(sensors=[azimuth(0.03), azimuth(0.03)])",),
    ),
    Component(
        kind="sensor",
        name="time_difference",
        target="tracker_sensors.time_difference:time_difference",
        summary="delays of arrival between receivers",
        paper="Chan and Ho, A simple and efficient estimator for hyperbolic location, 1994",
        tags=("passive", "time-delay", "2-D", "3-D"),
        examples=("time_difference(sigma=1e-3)",),
    ),
)
