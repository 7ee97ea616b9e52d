"""Parameters are read where they are declared: name, default and unit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import attrs

from tracker.parameters import parameters_of

if TYPE_CHECKING:
    from nowhere import Unimportable

Radians = Annotated[float, "rad"]


def function(
    sigma: Annotated[float, "m"],
    offset: Radians = 0.5,
    *,
    pose: Annotated[Unimportable, "m"] | None = None,
    name: str = "x",
    **more: object,
) -> None: ...


@attrs.frozen
class Model:
    sigma: Radians = attrs.field(default=0.1, converter=float)
    _rate: Annotated[float, "1/s"] | None = None
    poles: Annotated[list[float], "rad/s"] = attrs.field(factory=list)
    total: float = attrs.field(init=False, default=0.0)


def test_a_function_shows_units_through_aliases_unions_and_unimportable_names() -> None:
    described = {p.name: p for p in parameters_of(function)}
    assert list(described) == ["sigma", "offset", "pose", "name"]
    assert {name: p.unit for name, p in described.items()} == {
        "sigma": "m",
        "offset": "rad",
        "pose": "m",
        "name": "",
    }
    assert [p.required for p in described.values()] == [True, False, False, False]
    assert described["offset"].default == "0.5"


def test_an_attrs_class_shows_what_its_author_wrote_and_not_what_attrs_generated() -> None:
    described = {p.name: (p.unit, p.default) for p in parameters_of(Model)}
    assert described == {
        "sigma": ("rad", "0.1"),
        "rate": ("1/s", "None"),
        "poles": ("rad/s", "[]"),
    }


def test_a_callable_without_a_signature_has_no_known_parameters() -> None:
    assert parameters_of(type) == ()
