"""What a user gets from the wheel, and what the lock file pins."""

import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PLUGINS = sorted(path.parent.name for path in ROOT.glob("plugins/*/__init__.py"))
LOCK = (ROOT / "requirements.txt").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built by the locked hatchling without a network."""
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"the wheel does not build:\n{done.stdout}{done.stderr}"
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def contents(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if ".dist-info/" not in name}


def test_the_wheel_holds_every_file_of_the_core_and_of_the_plugins(contents: set[str]) -> None:
    source = {
        path.relative_to(base).as_posix()
        for base, pattern in ((ROOT, "tracker/**/*"), (ROOT / "plugins", "tracker_*/**/*"))
        for path in base.glob(pattern)
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert source - contents == set(), "not shipped: does its folder lack an __init__.py?"
    assert contents - source == set(), "shipped without being source"


def test_the_wheel_holds_nothing_but_the_core_and_the_plugins(contents: set[str]) -> None:
    assert {name.split("/")[0] for name in contents} == {"tracker", *PLUGINS}
    assert not [name for name in contents if re.search(r"(^|/)(tests?|conftest\.py)(/|$)", name)]


def test_every_package_declares_its_types(contents: set[str]) -> None:
    missing = [p for p in ("tracker", *PLUGINS) if f"{p}/py.typed" not in contents]
    assert missing == [], "add an empty py.typed: without it a user's mypy ignores our types"


def test_the_core_imports_from_the_wheel(wheel: Path) -> None:
    # -S keeps the editable installation, and with it the source tree, out of sys.path; so the
    # libraries are added by hand, behind the wheel.
    script = "import sys; sys.path[:0] = sys.argv[1:]; import tracker; print(tracker.__file__)"
    libraries = [path for path in sys.path if path.endswith("site-packages")]
    command = [sys.executable, "-S", "-P", "-c", script, str(wheel), *libraries]
    done = subprocess.run(command, cwd=wheel.parent, capture_output=True, text=True, check=False)
    assert done.stdout.startswith(str(wheel)), done.stderr


def test_every_plugin_package_has_an_entry_point_and_a_layer() -> None:
    targets = PROJECT["project"]["entry-points"]["tracker.plugins"].values()
    assert sorted(target.removesuffix("._plugin") for target in targets) == PLUGINS
    linter = PROJECT["tool"]["importlinter"]
    assert sorted(linter["root_packages"]) == sorted(["tracker", *PLUGINS])
    layers = " ".join(linter["contracts"][-1]["layers"])
    assert sorted(re.findall(r"\w+", layers)) == sorted(["tracker", *PLUGINS])


def test_the_lock_pins_every_declared_requirement_by_hash() -> None:
    project = PROJECT["project"]
    extras = project["optional-dependencies"].values()
    declared = {
        re.match(r"[\w-]+", line).group().lower()  # type: ignore[union-attr]
        for line in [*project["dependencies"], *(line for extra in extras for line in extra)]
    }
    entries = re.split(r"\n(?=\w)", re.sub(r"^#.*\n", "", LOCK, flags=re.MULTILINE))
    pinned = {entry.split("==")[0] for entry in entries}
    assert declared - pinned == set(), "run ./x lock"
    assert [entry for entry in entries if "--hash=sha256:" not in entry] == []


def test_the_lock_names_no_place_to_download_from() -> None:
    assert not re.search(r"://|--(extra-)?index-url|--find-links", LOCK)


def test_the_lock_serves_pythons_that_need_different_versions() -> None:
    assert "python_full_version < " in LOCK, "not universal: numpy's newest is not for Python 3.11"
