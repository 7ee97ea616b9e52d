"""What a person can read of compiled steps: the step itself, and whether this machine has them."""

import pytest
from click.testing import CliRunner

from tracker.cli import main
from tracker.compile import objects


def tell(*arguments):
    return CliRunner().invoke(main, arguments)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("ekf1", ("two stations", "step program: forward", "input   motion.density", "= atan2(")),
        ("kf", ("position measured", "step program: forward")),
        ("rts", ("after ekf1", "step program: backward", "state   smoothed.P")),
        ("square_root_rts", ("step program: backward", "state   smoothed.carried.root")),
        ("imm_smoother", ("after imm, two stations, two modes", "input   predicted.carried.prob")),
        ("gaussian_sum", ("step program: forward", "state   carried.members.cov")),
        ("moving_observer", ("its motion (constant_velocity)", "input   pose0")),
    ],
)
def test_the_step_of_a_component_can_be_read(name, words):
    told = tell("show", name, "--kernel")
    assert told.exit_code == 0, told.output
    for word in words:
        assert word in told.output


def test_the_text_that_is_compiled_can_be_read():
    told = tell("show", "ekf1", "--kernel", "llvm")
    assert "define void @run(" in told.output
    assert "<8 x double>" in told.output


def test_a_component_without_a_step_is_refused_in_words():
    told = tell("show", "azimuth", "--kernel")
    assert told.exit_code == 2
    assert "sensor 'azimuth' has no step of its own" in told.output


def test_the_doctor_tells_of_compiled_steps(monkeypatch, tmp_path):
    monkeypatch.setenv("TRACKER_CACHE", str(tmp_path))
    monkeypatch.setenv("TRACKER_COMPILE", "require")
    (tmp_path / "one.o").write_bytes(bytes(2_000_000))
    tmp_path.chmod(0o700)
    facts = dict(objects.report())
    assert facts["mode"] == "TRACKER_COMPILE=require"
    if objects.available():
        assert facts["compiled"].startswith("steps are, by llvmlite ")
        assert facts["cache"] == f"{tmp_path}: 1 objects, 2.0 MB"
        assert ":" in facts["cpu"]
    monkeypatch.setenv("TRACKER_CACHE", "off")
    assert objects.available() is False or "none" in dict(objects.report())["cache"]
    monkeypatch.setattr(objects, "available", lambda: False)
    monkeypatch.delenv("TRACKER_COMPILE")
    facts = dict(objects.report())
    assert "pip install" in facts["compiled"]
    assert facts["mode"].startswith("on")
    assert facts["compiled"] in tell("doctor").output
