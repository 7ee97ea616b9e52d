"""What the motion and sensor plugins register: every factory, with its sources, and nothing heavy."""

import importlib
import inspect
import subprocess
import sys

import pytest

import tracker_motion
import tracker_motion._plugin
import tracker_sensors
import tracker_sensors._plugin
from tracker.registry import Registry, describe_parameters

PACKAGES = {"motion": tracker_motion, "sensor": tracker_sensors}


def registered(kind):
    registry = Registry()
    importlib.import_module(f"{PACKAGES[kind].__name__}._plugin").tracker_components(registry)
    return {component.name: component for component in registry.search(kind=kind)}


@pytest.mark.parametrize("kind", PACKAGES)
def test_every_public_factory_is_registered_with_source_tags_and_example(kind):
    components = registered(kind)
    assert sorted(components) == sorted(PACKAGES[kind].__all__)
    for name, component in components.items():
        assert component.load() is getattr(PACKAGES[kind], name)
        assert component.tags
        assert component.examples


@pytest.mark.parametrize("kind", PACKAGES)
def test_parameters_that_have_a_unit_declare_it(kind):
    dimensionless = {"axes", "convention", "discretisation", "errors", "form", "state", "sensors"}
    dimensionless |= {"names", "space", "F", "L", "Qc", "Q", "paths"}
    dimensionless |= {"motion", "modes", "components", "sensor", "biases"}  # of compositions
    for component in registered(kind).values():
        for parameter in describe_parameters(component):
            assert bool(parameter.unit) is (parameter.name not in dimensionless), parameter


@pytest.mark.parametrize("kind", PACKAGES)
def test_importing_a_module_does_not_hide_the_factory_of_its_name(kind):
    package = PACKAGES[kind]
    for name in package.__all__:
        module = importlib.import_module(f"{package.__name__}.{name}")
        assert getattr(package, name) is getattr(module, name)
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        package.nonsense  # noqa: B018


@pytest.mark.parametrize("kind", PACKAGES)
def test_listing_a_plugin_imports_none_of_its_models(kind):
    name = PACKAGES[kind].__name__
    program = (
        f"import sys, {name}._plugin; print([m for m in sys.modules if m.startswith('{name}.')])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == f"['{name}._plugin']"


def test_switching_is_recorded_as_what_most_filters_average():
    component = registered("motion")["switching"]
    assert "others average" in component.summary  # what `tracker list` and the catalogue print
    said = " ".join((inspect.getdoc(component.load()) or "").split())  # and `tracker show`
    assert "To every other filter, ekf1 and ukf say, this is one motion: the average" in said
