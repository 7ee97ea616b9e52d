"""The component records of adaptive noise; nothing heavy is imported here."""

from tracker.hookspecs import hookimpl
from tracker.registry import Component, Registry


@hookimpl
def tracker_components(registry: Registry) -> None:
    """Offer the adapters and adaptive filters of this package."""
    for component in _COMPONENTS:
        registry.add(component)


_COMPONENTS = (
    Component(
        kind="adapter",
        name="innovation_matching",
        target="tracker_adaptive.innovation_matching:InnovationMatching",
        summary="Measurement noise by covariance matching: a part of the degree of mismatch each step.",
        paper="4",
        equations=("3-3", "3-4", "3-5", "3-6"),
        tags=("measurement noise", "traced", "window"),
    ),
    Component(
        kind="adapter",
        name="fuzzy_measurement_noise",
        target="tracker_adaptive.fuzzy_measurement_noise:FuzzyMeasurementNoise",
        summary="Measurement noise from a fuzzy system that reads the degree of mismatch.",
        paper="4",
        equations=("3-3", "3-4", "3-5", "3-6", "3-7", "3-10"),
        tags=("fuzzy", "measurement noise", "traced", "window"),
    ),
    Component(
        kind="adapter",
        name="fuzzy_process_noise",
        target="tracker_adaptive.fuzzy_process_noise:FuzzyProcessNoise",
        summary="Process noise from a fuzzy system that reads a mismatch of state or measurement.",
        paper="4",
        equations=("3-8", "3-9", "3-10", "3-21"),
        tags=("fuzzy", "process noise", "traced", "window"),
    ),
    Component(
        kind="adapter",
        name="neural_measurement_noise",
        target="tracker_adaptive.neural_measurement_noise:NeuralMeasurementNoise",
        summary="Measurement noise from a small neural network that reads the degree of mismatch.",
        paper="4",
        equations=("future work",),
        tags=("measurement noise", "neural network", "traced", "window"),
    ),
    Component(
        kind="adapter",
        name="joint_noise",
        target="tracker_adaptive.joint_noise:JointNoise",
        summary="An adapter of measurement noise and one of process noise side by side.",
        paper="4",
        equations=("future work",),
        tags=("composition", "measurement noise", "process noise", "traced"),
        examples=("joint_noise(measurement='sage_husa', process='fuzzy_process_noise')",),
        deviations={
            "matched noise is a fixed point": "each noise explains what the other could: what scatter "
            "lowers in R, Q takes up, half as much again",
            "moves towards the truth": "a Q that is too large can be explained by a smaller R",
        },
    ),
    Component(
        kind="adapter",
        name="innovation_adaptive",
        target="tracker_adaptive.innovation_adaptive:InnovationAdaptive",
        summary="Innovation- or residual-based adaptive estimation of R, and of Q as a ratio.",
        paper="Mehra, Approaches to adaptive filtering, 1972",
        equations=("Mohamed and Schwarz 1999, 18-20",),
        tags=("measurement noise", "process noise", "traced", "window"),
    ),
    Component(
        kind="adapter",
        name="sage_husa",
        target="tracker_adaptive.sage_husa:SageHusa",
        summary="Noise with a fading memory of the innovations, in a form that stays positive.",
        paper="Sage and Husa, Adaptive filtering with unknown prior statistics, 1969",
        tags=("measurement noise", "process noise", "traced"),
    ),
    Component(
        kind="filter",
        name="variational_bayes",
        target="tracker_adaptive.variational_bayes:VariationalBayes",
        summary="Any Gaussian filter that estimates the variances of its measurement noise as well.",
        paper="Särkkä and Nummenmaa, Recursive noise adaptive Kalman filtering, 2009",
        equations=("algorithm 1",),
        tags=("adaptive", "composition", "gaussian", "nonlinear", "traced"),
        examples=("variational_bayes(inner='ukf', forgetting=0.98)",),
        deviations={
            "equals the textbook filter": "the given noise is a first guess here; with a great worth "
            "the law holds",
            "subtracts through the residual": "the residual is wrapped, but the step is not that of the "
            "given noise, which the law expects",
            "one measurement at a time": "what a component teaches about its noise changes what it is "
            "worth; taken at once, all are judged by the same prediction",
            "iterating a linear update changes nothing": "more turns find the noise more exactly",
        },
    ),
    Component(
        kind="filter",
        name="strong_tracking",
        target="tracker_adaptive.strong_tracking:StrongTracking",
        summary="Any Gaussian filter with a fading factor for targets that manoeuvre (STF, STF-UKF).",
        paper="Zhou and Frank, Strong tracking filtering of nonlinear time-varying systems, 1996",
        tags=("adaptive", "composition", "gaussian", "manoeuvre", "nonlinear", "traced"),
        examples=("strong_tracking(inner='ukf')",),
        deviations={
            "equals the textbook filter": "a residual that is too large inflates the prediction: that is "
            "its purpose; with a great softening the law holds",
            "an update never raises the covariance": "as before: the inflation is part of the update",
            "one measurement at a time": "one factor serves all components measured together",
            "NIS in its band": "noise alone inflates now and then, so that residuals look small",
        },
    ),
    Component(
        kind="filter",
        name="smooth_variable_structure",
        target="tracker_adaptive.smooth_variable_structure:SmoothVariableStructure",
        summary="Sliding-mode correction within a boundary layer (SVSF), with a covariance.",
        paper="Habibi, The smooth variable structure filter, 2007",
        equations=("38", "39", "40", "Gadsden and Habibi 2010, 2.10"),
        tags=("gaussian", "nonlinear", "robust", "traced"),
        deviations={
            "equals the textbook filter": "the gain is the sliding mode's, not Kalman's",
            "an update never raises the covariance": "a gain that is not optimal may",
            "subtracts through the residual": "the residual is wrapped, but the step is not Kalman's, "
            "which the law expects",
            "one measurement at a time": "the correction is not linear in the residual",
            "NEES in its band": "the prediction after a gain that is not optimal is too cautious",
            "NIS in its band": "as before",
        },
    ),
)
