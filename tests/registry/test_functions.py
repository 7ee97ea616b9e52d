"""Functions that are listed beside components: each can be called, and says where it is from."""

import inspect

import numpy as np
import pytest

import tracker as tk
from tracker.testing import from_record

FUNCTIONS = [one for one in tk.functions if not one.missing()]


@pytest.mark.parametrize("record", FUNCTIONS, ids=lambda one: one.name)
def test_a_function_is_called_by_its_name_and_states_its_source(record):
    target = record.load()
    assert callable(target)
    said = inspect.getdoc(target) or ""
    if record.paper not in {"ours", "scikit-fuzzy"}:
        assert "Reference:\n" in said or "Source:" in said, (
            f"{record} does not say where it is from"
        )


@pytest.mark.parametrize(
    "record", [one for one in FUNCTIONS if one.examples], ids=lambda one: one.name
)
def test_the_example_of_a_function_gives_finite_numbers(record):
    answer = from_record(record)
    if callable(answer):  # a fuzzy system is a function itself
        answer = answer(0.3)
    assert np.isfinite(np.asarray(answer, dtype=float)).all()


def test_functions_of_several_kinds_of_thing_are_there():
    """What issue and checklist name, and no protocol has: by the tags under which they are listed."""
    tags = {tag for one in tk.functions for tag in one.tags}
    assert tags >= {
        "ambient noise", "conversion", "delays", "fuzzy", "measurement noise", "signals", "sonar",
        "sound speed", "start",
    }  # fmt: skip


def test_a_function_is_shown_without_laws_that_it_cannot_have():
    from click.testing import CliRunner

    from tracker.cli import main

    shown = CliRunner().invoke(main, ["show", "mackenzie"]).output
    assert "source        Mackenzie" in shown
    assert "temperature" in shown
    assert "not checked" not in shown
    listed = CliRunner().invoke(main, ["list", "functions"]).output
    assert "zero_order_hold" in listed
    refused = CliRunner().invoke(main, ["check", "mackenzie"])
    assert refused.exit_code == 2
    assert "no laws" in refused.output + refused.stderr


def test_paths_are_made_by_name():
    one = tk.paths.make("straight", place=(0.0, 1.0), velocity=(2.0, 0.0))
    assert tk.paths.make("together", paths=[one, one]).pose(3.0).tolist() == [6.0, 1.0, 6.0, 1.0]
