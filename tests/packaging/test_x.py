"""The bootstrap script ./x: every way that a first start can go wrong, without a network."""

import ast
import importlib.machinery
import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType

import pytest

SOURCE = Path(__file__).parents[2] / "x"

# Stands for a process that runs ./x with steps that write down what they do, and take their time.
DRIVER = """
import importlib.machinery, importlib.util, sys
loader = importlib.machinery.SourceFileLoader("x", "x")
x = importlib.util.module_from_spec(importlib.util.spec_from_loader("x", loader))
loader.exec_module(x)
real = x.step
def step(says, command, do, options):
    command = [sys.executable, "fake_step.py", str(x.VENV), command[-1]]
    real(says, command, do, options)
x.step = step
x.set_up()
"""
FAKE_STEP = """
import pathlib, sys, time
folder = pathlib.Path(sys.argv[1], "bin")
folder.mkdir(parents=True, exist_ok=True)
(folder / "python").touch()
with open("journal", "a") as journal:
    print("start", file=journal, flush=True)
    time.sleep(0.4)
    print("end", file=journal, flush=True)
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A project in which ./x can do nothing slow."""
    shutil.copy(SOURCE, tmp_path / "x")
    (tmp_path / "requirements.txt").write_text("numpy==2.0\n", encoding="utf-8")
    (tmp_path / "pyproject.toml").write_text("[project]\nname = 'p'\n", encoding="utf-8")
    (tmp_path / "driver.py").write_text(DRIVER, encoding="utf-8")
    (tmp_path / "fake_step.py").write_text(FAKE_STEP, encoding="utf-8")
    return tmp_path


def load(folder: Path) -> ModuleType:
    loader = importlib.machinery.SourceFileLoader("x", str(folder / "x"))
    spec = importlib.util.spec_from_loader("x", loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    return module


@pytest.fixture
def x(folder: Path) -> ModuleType:
    """The script as a module, with steps that only leave a Python behind and count themselves."""
    module = load(folder)
    module.steps = []

    def step(says: str, command: list[str], do: str, options: dict[str, object]) -> None:
        module.steps.append(says)
        (module.VENV / module.BIN).mkdir(parents=True, exist_ok=True)
        (module.VENV / module.BIN / module.PYTHON).touch()

    module.real_step, module.step = module.step, step
    return module


def append(path: Path, text: str) -> None:
    path.write_text(path.read_text(encoding="utf-8") + text, encoding="utf-8")


def test_the_second_start_only_checks_the_stamp(x: ModuleType) -> None:
    x.set_up()
    assert len(x.steps) == 3
    began = time.perf_counter()
    x.set_up()
    assert len(x.steps) == 3
    assert time.perf_counter() - began < 0.5


@pytest.mark.parametrize(
    ("file", "text"),
    [("requirements.txt", "scipy==1.0\n"), ("pyproject.toml", "scripts.tracker = 'a:b'\n")],
)
def test_changed_requirements_rebuild_the_environment(
    x: ModuleType, folder: Path, file: str, text: str
) -> None:
    x.set_up()
    append(folder / file, text)
    x.set_up()
    assert len(x.steps) == 6


def test_changed_lint_settings_do_not_rebuild_the_environment(x: ModuleType, folder: Path) -> None:
    x.set_up()
    append(folder / "pyproject.toml", "[tool.ruff]\nline-length = 90\n")
    x.set_up()
    assert len(x.steps) == 3


def test_another_python_or_another_folder_rebuilds_the_environment(
    x: ModuleType, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    x.set_up()
    before = x.digest()
    with monkeypatch.context() as patch:
        patch.setattr(sys, "version", "3.99.0")
        assert x.digest() != before
    moved = shutil.copytree(folder, folder.parent / "moved", ignore=shutil.ignore_patterns(".venv"))
    assert load(moved).digest() != before


def test_an_environment_whose_python_has_gone_is_rebuilt(x: ModuleType) -> None:
    x.set_up()
    (x.VENV / x.BIN / x.PYTHON).unlink()
    x.set_up()
    assert len(x.steps) == 6


def test_a_set_up_killed_in_the_middle_starts_again_from_nothing(x: ModuleType) -> None:
    whole = x.step

    def killed(says: str, *rest: object) -> None:
        whole(says, *rest)
        (x.VENV / "half-installed").touch()
        if len(x.steps) == 2:
            raise KeyboardInterrupt

    x.step = killed
    with pytest.raises(KeyboardInterrupt):
        x.set_up()
    assert not x.is_ready()
    x.step = whole
    x.set_up()
    assert x.is_ready()
    assert not (x.VENV / "half-installed").exists(), "the broken environment was kept"


@pytest.mark.skipif(os.name == "nt", reason="the driver's fake Python lies where POSIX has it")
def test_of_two_first_starts_one_builds_and_the_other_waits(folder: Path) -> None:
    command = [sys.executable, "driver.py"]
    both = [
        subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) for _ in range(2)
    ]
    printed = "".join(process.communicate(timeout=20)[0] for process in both)
    assert [process.returncode for process in both] == [0, 0]
    assert (folder / "journal").read_text(encoding="utf-8").split() == ["start", "end"] * 3
    assert printed.count("waiting for it") <= 1
    assert printed.count("making .venv") == 1


@pytest.mark.skipif(os.name == "nt", reason="only POSIX lets a child hold the lock")
def test_a_step_that_outlives_its_killed_parent_is_waited_for(folder: Path) -> None:
    command = [sys.executable, "driver.py"]
    journal = folder / "journal"
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL) as first:
        deadline = time.monotonic() + 10
        while not journal.exists() or "start" not in journal.read_text(encoding="utf-8"):
            assert time.monotonic() < deadline, "the first set-up did not begin"
            time.sleep(0.01)
        first.send_signal(signal.SIGKILL)
    subprocess.run(command, cwd=folder, check=True, capture_output=True, timeout=20)
    steps = journal.read_text(encoding="utf-8").split()
    assert steps == ["start", "end"] * 4, "two set-ups wrote into one .venv at the same time"


def test_a_failed_step_ends_in_one_line_with_cause_and_remedy(
    x: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    script = "print('Collecting'); print('ERROR: no route to host'); raise SystemExit(1)"
    x.step = lambda says, command, do, options: x.real_step(
        says, [sys.executable, "-c", script], do, options
    )
    with pytest.raises(SystemExit) as stopped:
        x.set_up()
    line = str(stopped.value)
    assert "\n" not in line
    assert line.startswith("x: set-up stopped - ERROR: no route to host - install Python's venv")
    assert not x.is_ready()
    assert capsys.readouterr().err == ""


def test_a_folder_that_cannot_be_written_is_named_in_one_line(x: ModuleType) -> None:
    (x.ROOT / ".venv.lock").mkdir()  # works for root too, whom permissions do not stop
    with pytest.raises(SystemExit, match=r"^x: cannot set up - .*writable copy$"):
        x.set_up()


def test_a_missing_file_is_named_in_one_line(x: ModuleType) -> None:
    (x.ROOT / "requirements.txt").unlink()
    with pytest.raises(SystemExit, match=r"requirements\.txt.* must be a complete, writable copy$"):
        x.set_up()


def test_too_old_a_python_is_told_so_in_one_line(x: ModuleType) -> None:
    x.OLDEST = (99, 0)
    with pytest.raises(SystemExit, match=r"^x: Python is too old - got 3\..* - install one"):
        x.main(["test"])


def test_a_python_that_is_too_old_can_still_read_the_script() -> None:
    ast.parse(SOURCE.read_text(encoding="utf-8"), feature_version=(3, 7))


def test_a_wrong_tracker_python_is_told_so(x: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TRACKER_PYTHON", "/no/such/python")
    with pytest.raises(SystemExit, match=r"^x: TRACKER_PYTHON - got /no/such/python - expected"):
        x.main(["test"])


def test_tracker_python_takes_over(
    x: ModuleType, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TRACKER_PYTHON", sys.executable)
    with pytest.raises(SystemExit, match="0"):
        x.main(["--help"])
    assert "./x demo" in capfd.readouterr().out
    assert x.steps == []


def test_extra_arguments_go_to_the_last_tool(x: ModuleType) -> None:
    ran: list[str] = []
    x.run = lambda command: ran.append(" ".join(command))
    x.main(["test", "-k", "two words"])
    assert ran[-1] == "pytest -n auto -k two words"
    assert ran[:-1] == ["ruff check", "ruff format --check", "mypy", "lint-imports"]


def test_a_failing_tool_stops_the_command_with_its_code(
    x: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    x.COMMANDS["test"] = [f"{sys.executable} -c raise(SystemExit(7))", "never-reached"]
    with pytest.raises(SystemExit, match="7"):
        x.main(["test"])
    assert "failed with code 7" in capsys.readouterr().err


def test_an_unknown_command_lists_the_known_ones(
    x: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="no command tset"):
        x.main(["tset"])
    assert "./x clean" in capsys.readouterr().out


def test_clean_removes_what_was_built_and_nothing_else(x: ModuleType, folder: Path) -> None:
    x.set_up()
    x.main(["clean"])
    left = {path.name for path in folder.iterdir()} - {".venv.lock", "__pycache__"}
    assert left == {"driver.py", "fake_step.py", "pyproject.toml", "requirements.txt", "x"}
