"""Records and look-up; what concerns installed distributions is in test_discovery."""

from __future__ import annotations

import sys
import types
from pathlib import Path
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.errors import ConfigError, PluginError, UnknownComponent
from tracker.hookspecs import hookimpl
from tracker.registry import KINDS, Catalogue, Component, Origin, Registry


def component(name: str, **fields: object) -> Component:
    """A component whose target is in the standard library, with every field that may be changed."""
    defaults = {"kind": "filter", "target": "fractions:Fraction", "summary": "a fake", "paper": "0"}
    return Component(**{"name": name} | defaults | fields)


names = st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True)
components = st.builds(
    component,
    names,
    kind=st.sampled_from(KINDS),
    tags=st.sets(st.sampled_from(["linear", "passive", "slow"])),
)
distinct = st.lists(components, unique_by=lambda one: (one.kind, one.name), max_size=8)


def filled(*added: Component) -> Registry:
    registry = Registry()
    for one in added:
        registry.add(one)
    return registry


@given(distinct, st.randoms())
def test_the_order_of_registration_does_not_matter(added: list[Component], random: Random) -> None:
    shuffled = random.sample(added, len(added))
    assert list(filled(*shuffled)) == list(filled(*added))


@given(distinct)
def test_the_kinds_and_the_tags_partition_what_search_finds(added: list[Component]) -> None:
    registry = filled(*added)
    assert [one for kind in KINDS for one in registry.search(kind=kind)] == list(registry)
    assert all(tag in one.tags for tag in ("linear", "slow") for one in registry.search(tag=tag))


@given(distinct, st.data())
def test_a_plugin_that_collides_anywhere_adds_nothing(
    added: list[Component], data: st.DataObject
) -> None:
    if not added:
        return
    taken = data.draw(st.sampled_from(added))
    registry = filled(taken)
    plugin = types.ModuleType("colliding")

    @hookimpl
    def tracker_components(registry: Registry) -> None:
        for one in added:
            registry.add(one)

    plugin.tracker_components = tracker_components
    with pytest.raises(PluginError, match=r"(?s)colliding.*taken by added at run time"):
        registry.register(plugin)
    assert list(registry) == [taken]


@given(names, st.integers(0, 8))
def test_a_name_with_a_letter_lost_is_suggested(name: str, place: int) -> None:
    name += "_filter"
    wrong = name[:place] + name[place + 1 :]
    registry = filled(component(name))
    if wrong == name:
        return
    with pytest.raises(UnknownComponent, match=f"did you mean '{name}'"):
        registry.get("filter", wrong)


def test_a_record_added_twice_changes_nothing_but_a_different_one_is_refused() -> None:
    registry = filled(component("kf"), component("kf"))
    assert len(registry) == 1
    with pytest.raises(PluginError, match="taken by added at run time"):
        registry.add(component("kf", summary="another"))


def test_the_registry_writes_the_origin_and_believes_no_claim() -> None:
    registry = Registry(Origin("dist-a", "1.2"))
    registry.add(component("kf", origin=Origin("tracker-lab", "9")))
    assert str(registry.get("filter", "kf").origin) == "dist-a 1.2"


def test_a_name_of_another_kind_is_pointed_out() -> None:
    registry = filled(component("rts", kind="smoother"))
    with pytest.raises(UnknownComponent, match="'rts', which is a smoother"):
        registry.get("filter", "rts")


@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_has_its_article(kind: str) -> None:
    other = next(k for k in ("optimiser", "filter") if k != kind)
    registry = filled(component("mine", kind=other))
    with pytest.raises(UnknownComponent) as caught:
        registry.get(kind, "mine")
    article = "an" if kind in {"adapter", "associator", "initiator", "optimiser"} else "a"
    assert str(caught.value).startswith(f"name of {article} {kind}: ")
    assert f"which is {'a filter' if other == 'filter' else 'an optimiser'}" in str(caught.value)


def test_an_unknown_kind_is_refused_with_a_suggestion() -> None:
    with pytest.raises(PluginError, match="did you mean 'optimiser'"):
        component("ga", kind="optimizer")
    with pytest.raises(UnknownComponent, match="did you mean 'sensor'"):
        Registry().get("sensors", "azimuth")
    with pytest.raises(UnknownComponent, match="did you mean 'sensor'"):
        Registry().search(kind="sensors")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("name", "Two Words"),
        ("target", "fractions.Fraction"),
        ("summary", " "),
        ("paper", ""),
        ("equations", "(3)"),
        ("tags", "linear"),
    ],
)
def test_a_malformed_field_is_refused_where_it_is_written(field: str, value: str) -> None:
    with pytest.raises(PluginError, match="Do this"):
        component(**{"name": "kf", field: value})


def test_text_is_searched_without_regard_to_case() -> None:
    registry = filled(component("kf", summary="Linear Gaussian", tags=("basic",)))
    for text in ("linear", "KF", "Basic"):
        assert len(registry.search(text=text)) == 1, text
    assert not registry.search(text="nonlinear")


def test_an_absent_requirement_says_what_to_install_and_imports_nothing() -> None:
    needing = component(
        "fast",
        target="no_such_target:X",
        requires={"no_such_module.sub": "tracker-lab[fast]", "os": "os"},
    )
    assert needing.missing() == (("no_such_module.sub", "tracker-lab[fast]"),)
    with pytest.raises(PluginError, match=r"unavailable: pip install 'tracker-lab\[fast\]'"):
        needing.make()
    assert component("kf", requires=("os", "fractions")).make() == 0


@pytest.mark.parametrize("target", ["no_such_module:X", "fractions:NoSuchClass", "this_raises:X"])
def test_a_target_that_does_not_import_names_component_and_cause(
    target: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "this_raises.py").write_text("raise RuntimeError('planted')")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(PluginError, match=f"filter 'kf' of .*{target}"):
        component("kf", target=target).load()


def test_a_target_that_cannot_be_called_loads_but_does_not_make() -> None:
    constant = component("pi", target="math:pi")
    assert constant.load() > 3
    with pytest.raises(PluginError, match="a float at 'math:pi'"):
        constant.make()


def test_a_wrong_parameter_is_named_with_the_accepted_ones() -> None:
    indent = component("indent", target="textwrap:indent")
    assert indent.make(text="a", prefix="> ") == "> a"
    with pytest.raises(ConfigError, match=r"'prefxi' \(did you mean 'prefix'\?\).*text, prefix"):
        indent.make(text="a", prefxi="> ")
    with pytest.raises(ConfigError, match="no value for prefix"):
        indent.make(text="a")
    with pytest.raises(ConfigError, match="expected no parameters"):
        component("none", target="os:getcwd").make(path=".")


def test_an_error_of_the_target_itself_passes_unchanged() -> None:
    with pytest.raises(ZeroDivisionError):
        component("half").make(numerator=1, denominator=0)
    with pytest.raises(TypeError, match="Rational"):
        component("half").make(numerator=[], denominator=1)


def test_a_plugin_without_a_hook_or_with_a_misspelt_one_is_refused() -> None:
    registry = Registry()
    with pytest.raises(PluginError, match="no hook implementation"):
        registry.register(types.ModuleType("empty"))
    plugin = types.ModuleType("misspelt")

    @hookimpl
    def tracker_component(registry: Registry) -> None: ...

    plugin.tracker_component = tracker_component
    with pytest.raises(Exception, match="tracker_component"):
        registry.register(plugin)


def test_a_catalogue_makes_lists_and_prints_its_own_kind() -> None:
    registry = filled(component("half", summary="<b>"), component("rts", kind="smoother"))
    filters = Catalogue("filter", lambda: registry)
    assert filters.make("half", numerator=1, denominator=2) * 2 == 1
    assert filters.names() == ("half",)
    assert [one.name for one in filters] == ["half"]
    assert "half" in filters
    assert "rts" not in filters
    assert filters["half"].summary == "<b>"
    assert "&lt;b&gt;" in filters._repr_html_()
    with pytest.raises(UnknownComponent, match="which is a smoother"):
        filters.make("rts")


def test_a_class_of_the_running_program_can_be_registered(monkeypatch: pytest.MonkeyPatch) -> None:
    module = types.ModuleType("a_notebook")
    module.Mine = dict
    monkeypatch.setitem(sys.modules, "a_notebook", module)
    registry = filled(component("mine", kind="sensor", target="a_notebook:Mine"))
    assert registry.get("sensor", "mine").make(sigma=1.0) == {"sigma": 1.0}
