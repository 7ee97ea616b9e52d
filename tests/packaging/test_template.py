"""The template is a complete third-party distribution: its wheel works beside ours, outside the tree."""

import json
import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TEMPLATE = ROOT / "contrib" / "tracker-template"
BIN, SUFFIX = ("Scripts", ".exe") if os.name == "nt" else ("bin", "")


def run(*command: object, cwd: Path, **environment: str) -> str:
    """The output of a command that must succeed."""
    inherited = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "PYTEST"))}
    done = subprocess.run(
        [str(part) for part in command], cwd=cwd, env={**inherited, **environment},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{command[:4]} failed:\n{done.stdout}{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh environment holding both wheels, the libraries lent by this one; no network is used."""
    folder = tmp_path_factory.mktemp("template")
    source = folder / "source"
    ignore = shutil.ignore_patterns("__pycache__", "*.egg-info", "dist", ".pytest_cache")
    shutil.copytree(TEMPLATE, source, ignore=ignore)  # as someone who copied the folder elsewhere
    for tree in (ROOT, source):
        run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder, cwd=tree)
    home = folder / "environment"
    venv.create(home, with_pip=False, symlinks=os.name != "nt")
    python = home / BIN / f"python{SUFFIX}"
    run(
        sys.executable, "-m", "pip", "--python", python, "install", "--no-index", "--no-deps",
        "--quiet", "--disable-pip-version-check", *folder.glob("*.whl"), cwd=folder,
    )  # fmt: skip
    paths = run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder)
    # A line of a .pth file is added behind what is installed; .pth files found there are not read,
    # so the editable installation of this tree stays out.
    lent = [path for path in sys.path if path.endswith("site-packages")]
    Path(paths.strip(), "lent.pth").write_text("\n".join(lent), encoding="utf-8")
    shutil.copytree(source / "tests", folder / "tests")
    shutil.rmtree(source)
    return folder


def test_both_wheels_are_what_is_imported(fresh: Path) -> None:
    python = fresh / "environment" / BIN / f"python{SUFFIX}"
    script = "import tracker, tracker_template; print(tracker.__file__, tracker_template.__file__)"
    for path in run(python, "-c", script, cwd=fresh).split():
        assert Path(path).is_relative_to(fresh), "the tree, not the wheel, was imported"


def test_the_template_s_own_tests_pass_outside_the_tree(fresh: Path) -> None:
    python = fresh / "environment" / BIN / f"python{SUFFIX}"
    output = run(
        python, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--import-mode=importlib",
        "-W", "error", fresh / "tests", cwd=fresh, OPENBLAS_NUM_THREADS="1",
    )  # fmt: skip
    assert " passed" in output


def test_the_commands_know_the_template(fresh: Path) -> None:
    command = fresh / "environment" / BIN / f"tracker{SUFFIX}"
    listed = json.loads(run(command, "list", "sensor", "--json", cwd=fresh))
    ours = [one for one in listed["components"] if one["name"] == "relative_bearing"]
    assert [one["origin"]["distribution"] for one in ours] == ["tracker-template"]
    assert "rad" in run(command, "show", "relative_bearing", cwd=fresh)
    assert "template" in run(command, "doctor", cwd=fresh)


def test_listing_components_does_not_import_the_template_s_sensor(fresh: Path) -> None:
    python = fresh / "environment" / BIN / f"python{SUFFIX}"
    script = (
        "import sys, tracker; tracker.default_registry().search();"
        "print([name for name in sys.modules if name.startswith('tracker_template')])"
    )
    loaded = run(python, "-c", script, cwd=fresh).strip()
    assert loaded == "['tracker_template', 'tracker_template._plugin']"
