"""What a config file says when it is right, and what a person reads when it is wrong."""

import sys
from pathlib import Path

import pytest

from tracker.errors import ConfigError
from tracker.io import toml
from tracker.io.config import Experiment, parse_experiment, read_experiment

EXAMPLES = Path(__file__).parents[2] / "examples"
HARBOUR = (EXAMPLES / "harbour.toml").read_text(encoding="utf-8")


def refusal(old: str, new: str) -> str:
    assert old in HARBOUR, "the example has changed: adapt this test"
    with pytest.raises(ConfigError) as caught:
        parse_experiment(HARBOUR.replace(old, new, 1), EXAMPLES, "scene.toml")
    return str(caught.value)


def line_of(text: str) -> int:
    return HARBOUR[: HARBOUR.index(text)].count("\n") + 1


def test_the_example_is_read_with_every_component_made() -> None:
    experiment = read_experiment(EXAMPLES / "harbour.toml")
    assert [one.name for one in experiment.compare] == [
        "cameras only",
        "radar and lidar",
        "all four",
    ]
    assert experiment.motion.made.space.names == ("x", "y", "vx", "vy")
    assert str(experiment.parts["gate"]) == "chi_square(squared_distance=13.8)"
    assert isinstance(experiment, Experiment)
    assert set(experiment.read_log().truth) == {"1", "2"}


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("density =", "desnity =", ['motion.desnity: unknown key; did you mean "density"?',
                                    "(constant_velocity takes: name, density, axes, discretisation)"]),
        ('"constant_velocity"', '"constant_velocty"', ["motion.name", "did you mean 'constant_velocity'?"]),
        ('"lidar"]', '"lidarr"]', ['compare[1].sensors[1]: unknown sensor \'lidarr\'; did you mean "lidar"?']),
        ("[[compare]]", "[[comapre]]", ['comapre: unknown key; did you mean "compare"?']),
        ("density = 0.05", "density = -0.05", ["motion.density", "-0.05", "non-negative", "m^2/s^3"]),
        ("density = 0.05", "density = inf", ["motion.density", "got inf", "a number"]),
        ("density = 0.05", 'density = "0.05"', ["motion.density", "got '0.05'", "a number"]),
        ("axes = 2", "axes = 2.5", ["motion.axes", "2.5"]),
        ("axes = 2", "axes = true", ["motion.axes", "got true"]),
        ("axes = 2", "axes = 0x" + "f" * 5000, ["motion.axes", "a whole number of 20000 bits"]),
        ("axes = 2", "axes = " + "9" * 5000, ["4300 digits"]),
        ("axes = 2", "axes = 2020-02-02", ["motion.axes", "2020-02-02 (a date or time)"]),
        (", sigma = 6.0 }", " }", ["sensors.radar", 'no "sigma"', "[m]"]),
        ('eo = { name = "azimuth"', 'eo = { name = "position"', ["sensors.eo.convention: unknown key"]),
        ('"north", sigma', '"up", sigma', ["sensors.eo.convention", "'up'", "'north'"]),
        ("truth_seconds = 3.0", "truth_seconds = 0", ["start.truth_seconds", "> 0"]),
        ("[10.0, 10.0, 1.0, 1.0]", "[10.0, 10.0, 1.0]", ["start.sigma", "a list of 3", "4 numbers"]),
        ("[10.0, 10.0, 1.0, 1.0]", "[10.0, nan, 1.0, 1.0]", ["start.sigma[1]", "got nan"]),
        ('"data/autoferry"', '"data/autofery"', ["data.folder", "no folder"]),
        ('"scenario02"', '"scenario99"', ["data.scenario", "there is no", "scenario99_scans.csv"]),
        ('title = "Two boats in a harbour"', 'title = ""', ["title"]),
        ("axes = 2", "axes = " + "[" * 5000, ["deeper nesting"]),
    ],
)  # fmt: skip
def test_a_mistake_is_named_with_file_line_path_and_help(
    old: str, new: str, parts: list[str]
) -> None:
    said = refusal(old, new)
    assert said.startswith("scene.toml:"), said
    for part in parts:
        assert part in said
    assert int(said.split(":")[1]) == line_of(old), said


def test_a_motion_without_a_plane_cannot_start_from_the_truth() -> None:
    said = refusal("axes = 2", "axes = 1")
    assert said.startswith(f"scene.toml:{line_of('[start]')}: start")
    assert "x, y, vx and vy" in said


def test_what_does_not_fit_together_is_refused_at_its_sensor() -> None:
    said = refusal('radar = { name = "relative_position"', 'radar = { name = "azimuth"')
    assert said.startswith(f"scene.toml:{line_of('radar =')}: sensors.radar")
    assert "2 wide" in said


def test_a_missing_table_is_named() -> None:
    said = refusal('[filter]\nname = "ekf1"\n', "")
    assert said.startswith("scene.toml:1")
    assert 'no "filter"' in said


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"a = 1\nb = \xff\n", ":2: got byte 0xff; expected text in UTF-8"),
        (b"#" * (toml.MOST_BYTES + 1), "a larger file"),
        (b"a = 1\n\na = 2\n", ":3: got text that is no TOML"),
        (b"a = 1\nb =", ":2: got text that is no TOML"),
        (b'x = "\x00"', ":1: got text that is no TOML"),
    ],
)
def test_a_file_that_is_no_config_is_refused_with_its_line(
    tmp_path: Path, content: bytes, said: str
) -> None:
    file = tmp_path / "scene.toml"
    file.write_bytes(content)
    with pytest.raises(ConfigError, match="scene") as caught:
        toml.read(file)
    assert said in str(caught.value)


@pytest.mark.parametrize("name", ["missing.toml", ".", "a\0b", "x" * 5000])
def test_a_path_that_is_no_file_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError):
        toml.read(f"{tmp_path}/{name}")


def test_a_name_in_a_config_is_never_imported(tmp_path: Path) -> None:
    (tmp_path / "planted.py").write_text("raise SystemExit('imported')", encoding="utf-8")
    said = refusal('"ekf1"', '"planted:Filter"')
    assert "filter.name" in said
    assert "planted" not in sys.modules


def test_every_value_knows_its_line() -> None:
    text = (
        "a = 1\nb.c = [1,\n  {x = 1, 'y z' = 2},\n  3]\n[[filters]]\nalpha = 1\n[[filters]]\n"
        'beta = """\n[no] = table\n"""\n[filters.sub]\nq = 1979-05-27 07:32:00\n[s."t.u"]\nv = 0.5\n'
    )
    lines = toml.parse(text).lines
    assert lines["a",] == 1
    assert lines["b", "c", 1, "y z"] == 3
    assert lines["b", "c", 2] == 4
    assert lines["filters", 0, "alpha"] == 6
    assert lines["filters", 1, "beta"] == 8
    assert lines["filters", 1, "sub", "q"] == 12
    assert lines["s", "t.u", "v"] == 14
    assert ("no",) not in lines


def test_a_key_of_many_dots_is_refused_before_it_costs_time() -> None:
    with pytest.raises(ConfigError, match="deeper nesting"):
        toml.parse("x = 1\n" + ".".join("a" * 30000) + " = 1")
