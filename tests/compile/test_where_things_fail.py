"""Without llvmlite, or with a cache folder that fails, everything still works and is right."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tracker.compile import llvm, objects
from tracker.compile.program import Program, Rate, allocate

ROOT = Path(__file__).parents[2]
compiled_only = pytest.mark.skipif(not objects.available(), reason="llvmlite is not installed")


BARE = "tests/estimation/test_filtering.py tests/pipeline tests/compile/test_told.py"


@pytest.mark.slow
def test_behaviour_stays_green_without_llvmlite():
    """Import and search both find nothing, as after pip uninstall; a part of the suite runs.

    With TRACKER_BARE_TESTS=tests all of its quick tests do.
    """
    script = """
        import os
        import sys
        import pytest
        sys.modules["llvmlite"] = None  # what an import of it, or a search for it, then sees
        from tracker.compile import objects
        assert not objects.available()
        sys.exit(pytest.main([
            "-q", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", "-m", "not slow and not statistical",
            *os.environ["TRACKER_BARE_TESTS"].split(),
        ]))
        """
    environment = {k: v for k, v in os.environ.items() if k != "TRACKER_COMPILE"}
    environment = {"TRACKER_BARE_TESTS": BARE} | environment | {"HYPOTHESIS_PROFILE": "dev"}
    lines = "\n".join(line[8:] for line in script.splitlines())
    told = subprocess.run(
        [sys.executable, "-c", lines],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert told.returncode == 0, told.stdout[-3000:] + told.stderr[-1000:]
    assert "passed" in told.stdout


# ------------------------------------------------------------------------------------ cache
@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("TRACKER_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def tripled():
    """What a kernel made now answers."""
    program = Program()
    (a,) = program.input("z", 1, Rate.BOTH)
    program.set("x", program.state("x", 1))
    program.history("out", [a * 3.0])
    kernel = llvm.Kernel(program)
    arrays = {name: allocate(shape) for name, shape in program.shapes(1, 1).items()}
    arrays["z"][:] = np.arange(8.0)
    kernel.bind(arrays, 1, 1)(0, 1)
    return arrays["out"].ravel().tolist()


RIGHT = (3.0 * np.arange(8.0)).tolist()


@compiled_only
def test_a_folder_that_may_only_be_read_is_read_and_not_written(cache, monkeypatch, capfd):
    def refused(*_, **__):
        raise PermissionError(errno.EACCES, "Permission denied")

    cache.mkdir(mode=0o500)
    monkeypatch.setattr(objects.tempfile, "mkstemp", refused)  # a superuser may write anywhere
    assert tripled() == RIGHT
    assert not list(cache.iterdir())
    assert capfd.readouterr() == ("", "")
    monkeypatch.undo()
    monkeypatch.setenv("TRACKER_CACHE", str(cache))
    cache.chmod(0o700)
    tripled()
    (entry,) = cache.glob("*.o")
    cache.chmod(0o500)
    before = entry.stat().st_mtime_ns
    assert tripled() == RIGHT
    assert entry.stat().st_mtime_ns == before


@compiled_only
@pytest.mark.parametrize("when", ["opened", "written", "renamed"])
def test_a_full_disk_costs_a_compilation_and_leaves_nothing_behind(cache, monkeypatch, capfd, when):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    class Full:
        def __init__(self, handle):
            self.handle = handle

        def __enter__(self):
            return self

        def __exit__(self, *_):
            os.close(self.handle)

        write = full

    if when == "opened":
        monkeypatch.setattr(objects.tempfile, "mkstemp", full)
    elif when == "written":
        monkeypatch.setattr(objects.os, "fdopen", lambda handle, _mode: Full(handle))
    else:
        monkeypatch.setattr(Path, "replace", full)
    assert tripled() == RIGHT
    assert not list(cache.iterdir())
    assert capfd.readouterr() == ("", "")


@compiled_only
def test_processes_that_compile_the_same_at_once_all_get_it_right(cache):
    script = """
import sys
import numpy as np
import tracker as tk
scenario = tk.scenario("two_stations", steps=20)
estimator = tk.estimator("ekf1", motion=scenario.motion, sensor=scenario.sensor)
simulation = scenario.simulate(1, 9)
print("ready", flush=True)
sys.stdin.readline()
history = tk.filter(estimator, simulation.record, simulation.prior, start=0.0)
print(history.filtered.mean.tobytes().hex())
"""
    environment = os.environ | {"TRACKER_COMPILE": "require", "TRACKER_CACHE": str(cache)}
    processes = [
        subprocess.Popen(
            [sys.executable, "-W", "error", "-c", script],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for _ in range(3)
    ]
    for process in processes:
        assert process.stdout.readline() == "ready\n"
    for process in processes:  # all at once, as far as anyone can arrange it
        process.stdin.write("go\n")
        process.stdin.flush()
    told = [process.communicate() for process in processes]
    assert all(not errors for _, errors in told), told
    assert len({out for out, _ in told}) == 1
    assert len(list(cache.glob("*.o"))) == 1
    assert not list(cache.glob(".new-*")), "a temporary file was left in the cache"
