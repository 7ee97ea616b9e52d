"""Filters and adapters that find their noise as they go, and fuzzy systems: one module per method."""

from importlib import import_module
from typing import Any

_HOME = {
    "FuzzyMeasurementNoise": "fuzzy_measurement_noise",
    "FuzzyProcessNoise": "fuzzy_process_noise",
    "FuzzySystem": "fuzzy_system",
    "GaussianSet": "fuzzy_sets",
    "InnovationAdaptive": "innovation_adaptive",
    "InnovationMatching": "innovation_matching",
    "JointNoise": "joint_noise",
    "MeasuredError": "indices",
    "MismatchCost": "indices",
    "Network": "neural_measurement_noise",
    "NeuralMeasurementNoise": "neural_measurement_noise",
    "NoiseError": "indices",
    "Rule": "fuzzy_rules",
    "SageHusa": "sage_husa",
    "SampledSet": "fuzzy_sets",
    "SmoothVariableStructure": "smooth_variable_structure",
    "StateError": "indices",
    "StrongTracking": "strong_tracking",
    "TrapezoidalSet": "fuzzy_sets",
    "TriangularSet": "fuzzy_sets",
    "Variable": "fuzzy_system",
    "VariationalBayes": "variational_bayes",
    "antecedent": "fuzzy_rules",
    "clipped": "clipped_inference",
    "degree_of_mismatch": "mismatch",
    "five_rules": "fuzzy_system",
    "from_scikit_fuzzy": "scikit_fuzzy",
    "membership_figure": "fuzzy_figures",
    "read_rule_base": "rule_base",
    "rule_base_text": "rule_base",
    "surface_figure": "fuzzy_figures",
    "to_scikit_fuzzy": "scikit_fuzzy",
}
__all__ = sorted(_HOME)  # noqa: PLE0605 - kept beside what it names


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"tracker_adaptive.{_HOME[name]}"), name)
    raise AttributeError(f"module 'tracker_adaptive' has no attribute {name!r}")
