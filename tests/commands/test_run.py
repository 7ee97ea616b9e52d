"""``tracker run`` as a person meets it: a table, a report, and one line where something is wrong."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from tracker.cli import main

EXAMPLES = Path(__file__).parents[2] / "examples"


def tell(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["run", *map(str, arguments)])


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example with names that try to be markup."""
    text = (EXAMPLES / "harbour.toml").read_text(encoding="utf-8")
    text = text.replace('"data/', f'"{(EXAMPLES / "data").as_posix()}/')
    text = text.replace("Two boats in a harbour", "<b>Boats</b> & <script>alert(1)</script>")
    text = text.replace("cameras only", "<i>cameras</i>")
    file = tmp_path_factory.mktemp("config") / "scene.toml"
    file.write_text(text, encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def told(short: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path]:
    out = tmp_path_factory.mktemp("run") / "new" / "folder"
    return tell(short, "--out", out), out


def test_it_prints_a_row_for_each_set_and_boat_and_the_reports_path_last(
    told: tuple[Result, Path],
) -> None:
    result, out = told
    assert result.exit_code == 0, result.output
    lines = result.output.splitlines()
    assert lines[0].split()[:2] == ["sensors", "target"]
    assert [line.split("  ")[0] for line in lines[1:7]] == [
        *["<i>cameras</i>"] * 2,
        *["radar and lidar"] * 2,
        *["all four"] * 2,
    ]
    assert lines[-1] == str(out / "report.html")


def test_it_says_in_words_that_the_cameras_are_overconfident(told: tuple[Result, Path]) -> None:
    result, out = told
    assert "Target 1 from <i>cameras</i>: overconfident" in result.output
    assert "do not rely on them" in result.output
    rows = json.loads((out / "results.json").read_text(encoding="utf-8"))["rows"]
    assert [row["verdict"] for row in rows[:2]] == ["overconfident"] * 2


def test_results_hold_the_numbers_of_the_table(told: tuple[Result, Path]) -> None:
    _, out = told
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    assert results["schema"] == 1
    radar = [row for row in results["rows"] if row["sensors"] == "radar and lidar"]
    assert [row["target"] for row in radar] == ["1", "2"]
    # The data set's own baseline, global nearest neighbour from a true start, and 10 %.
    assert radar[0]["rmse"] <= 3.6 * 1.1
    assert radar[1]["rmse"] <= 8.0 * 1.1
    assert all(0.0 < row["used"] <= 1.0 and row["seconds_per_update"] > 0.0 for row in radar)


def test_the_report_is_one_file_in_which_names_stay_text(told: tuple[Result, Path]) -> None:
    _, out = told
    report = (out / "report.html").read_text(encoding="utf-8")
    assert "<script" not in report
    assert "<i>" not in report
    assert "&lt;i&gt;cameras&lt;/i&gt;" in report
    assert report.count("<img") == 7
    assert "http" not in report.replace("http-equiv", "")
    assert len(report) < 3_000_000


def test_quiet_prints_the_path_alone(short: Path, tmp_path: Path) -> None:
    result = tell(short, "--out", tmp_path, "--quiet")
    assert result.output == f"{tmp_path / 'report.html'}\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("missing.toml", "--out", "x"), "ConfigError: missing.toml: got no such file"),
        ((EXAMPLES / "harbour.toml", "--out", __file__), "--out"),
    ],
)
def test_what_is_wrong_is_one_line_and_code_2(arguments: tuple[str, ...], said: str) -> None:
    result = tell(*arguments)
    assert result.exit_code == 2
    assert said in result.output
    assert len(result.output.splitlines()) == 1


def test_a_set_of_sensors_that_saw_nothing_is_named(tmp_path: Path) -> None:
    (tmp_path / "log_scans.csv").write_text(
        "scan,t,sensor,own_n,own_e,n_det\n0,0.0,eo,0,0,0\n1,9.0,radar,0,0,0\n", encoding="utf-8"
    )
    (tmp_path / "log_detections.csv").write_text(
        "scan,sensor,rel_n,rel_e,bearing\n", encoding="utf-8"
    )
    (tmp_path / "log_truth.csv").write_text(
        "target,t,n,e\n1,1.0,5,5\n1,3.0,6,6\n1,9.0,9,9\n", encoding="utf-8"
    )
    text = (EXAMPLES / "harbour.toml").read_text(encoding="utf-8").partition("[[compare]]")[0]
    text = text.replace("data/autoferry", ".").replace("scenario02", "log")
    sets = "".join(
        f'[[compare]]\nname = "only {name}"\nsensors = ["{name}"]\n' for name in ("radar", "eo")
    )
    file = tmp_path / "scene.toml"
    file.write_text(text + sets, encoding="utf-8")
    result = tell(file, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "'only eo'" in result.output
    file.write_text(text + sets.partition('[[compare]]\nname = "only eo"')[0], encoding="utf-8")
    result = tell(file, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "nan" in result.output, "nothing was measured, so there is no NIS"
