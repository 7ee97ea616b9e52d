"""The catalogues keep their promise to a strict type checker."""

from __future__ import annotations

from pathlib import Path

import pytest

CODE = """\
from typing import Any, assert_type
from tracker.protocols import Filter, MotionModel
from tracker.registry import filters, motions, Component

assert_type(filters.make("ekf1", order=1), Filter[Any])
assert_type(motions.make("cv"), MotionModel)
assert_type(motions["cv"], Component)
assert_type([one.name for one in filters], list[str])
gate: MotionModel = filters.make("ekf1")
"""


def test_what_a_catalogue_makes_has_the_type_of_its_kind(tmp_path: Path) -> None:
    api = pytest.importorskip("mypy.api", reason="mypy comes with the lint extra")
    (tmp_path / "code.py").write_text(CODE)
    told, _, code = api.run(["--strict", "--no-incremental", str(tmp_path / "code.py")])
    errors = [line for line in told.splitlines() if f"{tmp_path}" in line and "error" in line]
    assert len(errors) == 1, told
    assert "code.py:9" in errors[0], "a Filter is no MotionModel"
    assert code == 1
