"""The environment of the benchmarks: `.venv-bench`, which holds the peers and borrows all else.

The libraries that we are compared with bring packages that the project must never depend on, so
they stay out of `.venv`. What both need (NumPy, the project itself) is taken from the environment
that made this one, so that all sides compute with the same NumPy.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / ".venv-bench"
PINS = ROOT / "benchmarks" / "requirements.txt"
PEERS = ("filterpy", "stonesoup", "dynamax")


def _python() -> Path:
    names = ("Scripts", "python.exe") if os.name == "nt" else ("bin", "python")
    return FOLDER.joinpath(*names)


def _digest() -> str:
    parts = (sys.version, str(ROOT), sysconfig.get_path("purelib"), PINS.read_text("utf-8"))
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def _made() -> None:
    """A new environment, in which this one's packages can be imported."""
    print("benchmarks: making .venv-bench for the libraries that we are compared with", flush=True)
    shutil.rmtree(FOLDER, ignore_errors=True)
    venv.create(FOLDER, with_pip=True, symlinks=os.name != "nt")
    inside = subprocess.run(
        [_python(), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
        check=True,
        capture_output=True,
        text=True,
    ).stdout.strip()
    # addsitedir, unlike PYTHONPATH, also follows the link to the project itself.
    line = f"import site; site.addsitedir({sysconfig.get_path('purelib')!r})\n"
    Path(inside, "borrowed.pth").write_text(line, encoding="utf-8")


def _install(peer: str) -> str:
    """Install one peer at its pinned versions; why that failed, or ''."""
    print(f"benchmarks: installing {peer}", flush=True)
    done = subprocess.run(
        [_python(), "-m", "pip", "install", "--no-input", "--constraint", PINS, peer],
        capture_output=True,
        text=True,
        check=False,
    )
    said = [line for line in done.stderr.splitlines() if "error" in line.lower()]
    return (said or ["pip failed"])[-1].strip() if done.returncode else ""


def ready() -> Path:
    """The Python of `.venv-bench`, after what was missing in it has been installed."""
    stamp = FOLDER / "made-of"
    known = stamp.read_text("utf-8").split() if stamp.is_file() else []
    if known[:1] != [_digest()] or not _python().exists():
        _made()
        known = [_digest()]
        stamp.write_text(known[0], encoding="utf-8")
    for peer in PEERS:
        if peer in known:
            continue
        why = _install(peer)
        if why:
            print(f"benchmarks: {peer} is left out: {why}", flush=True)
            continue
        known.append(peer)
        stamp.write_text(" ".join(known), encoding="utf-8")
    return _python()


def enter() -> None:
    """Go on in `.venv-bench`, unless that is where we are."""
    if Path(sys.prefix).resolve() == FOLDER.resolve():
        return
    command = [str(ready()), *sys.argv]
    if os.name == "nt":
        sys.exit(subprocess.call(command))
    os.execv(command[0], command)  # the same process, so that Ctrl-C and exit codes are ours
