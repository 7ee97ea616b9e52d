"""LLVM text to machine code, and the cache of object files; a cache entry is never trusted blindly.

The cache folder belongs to the user alone (mode 0700). An entry is named by a hash of text (or of
what it follows from), CPU, features and versions, and holds a hash of its own bytes: one that is
damaged, truncated, foreign or swapped is compiled again. Whatever goes wrong with the folder, the
answer is to compile.
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import os
import stat
import sys
import tempfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import attrs

from tracker.errors import PluginError

MAGIC = b"tracker object 1\n"


@attrs.frozen(eq=False)
class Machine:
    """Code in memory: the address of ``run`` and what keeps it alive."""

    address: int
    engine: Any
    cached: bool


def available() -> bool:
    """Whether llvmlite is installed."""
    return find_spec("llvmlite") is not None


def folder() -> Path | None:
    """The cache folder, made if need be; None if there is none that only this user can write."""
    given = os.environ.get("TRACKER_CACHE")
    if given == "off":
        return None
    if given:
        base = Path(given)
    elif sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", Path.home())) / "tracker"
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches" / "tracker"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tracker"
    try:
        base.mkdir(mode=0o700, parents=True, exist_ok=True)
        if hasattr(os, "getuid"):
            found = base.stat()
            if found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) & 0o022:
                return None
    except OSError:
        return None
    return base


def report() -> list[tuple[str, str]]:
    """What a person should know of compiled steps on this machine, as names and values."""
    given = os.environ.get("TRACKER_COMPILE")
    mode = "on, as TRACKER_COMPILE is not set" if given is None else f"TRACKER_COMPILE={given}"
    if not available():
        return [
            ("compiled", "no, all runs on arrays: pip install 'tracker-lab[fast]'"),
            ("mode", mode),
        ]
    import llvmlite
    from llvmlite import binding as llvm

    found = llvm.get_host_cpu_features()
    told = [name for name in _FEATURES if found.get(name)]
    base = folder()
    if base is None:
        cache = "none: off, or not writable by this user alone; each process compiles anew"
    else:
        sizes = [path.stat().st_size for path in base.glob("*.o")]
        cache = f"{base}: {len(sizes)} objects, {sum(sizes) / 1e6:.1f} MB"
    return [
        ("compiled", f"steps are, by llvmlite {llvmlite.__version__}"),
        ("mode", mode),
        ("cpu", f"{llvm.get_host_cpu_name()}: {', '.join(told) or 'no wide vectors'}"),
        ("cache", cache),
    ]


_FEATURES = ("avx512f", "avx2", "fma", "avx", "sse4.2", "sve", "neon")


def compiled(text: str | Callable[[], str], name: str = "") -> Machine:
    """Machine code for an LLVM text, from the cache if it is there.

    A text that takes time to write may be given as a function, beside a name that tells it from
    any other: it is called if the cache does not know the name.

    Raises:
        PluginError: if llvmlite is not installed.
    """
    if not available():
        raise PluginError("compiled steps need llvmlite: pip install 'tracker-lab[fast]'")
    import llvmlite
    from llvmlite import binding as llvm

    with contextlib.suppress(RuntimeError):  # automatic, and refused, in newer llvmlite
        llvm.initialize()
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    cpu, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    target = llvm.Target.from_default_triple().create_target_machine(
        cpu=cpu, features=features, opt=2
    )
    if not name:
        text = name = text if isinstance(text, str) else text()
    parts = (name, cpu, features, llvmlite.__version__, ".".join(map(str, llvm.llvm_version_info)))
    key = hashlib.sha256("\0".join(parts).encode()).hexdigest()
    base = folder()
    path = None if base is None else base / f"{key}.o"
    code = None if path is None else _read(path, key)
    cached = code is not None
    if code is None:
        written = text if isinstance(text, str) else text()
        code = target.emit_object(llvm.parse_assembly(written))
        if path is not None:
            _write(path, key, code)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), target)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return Machine(engine.get_function_address("run"), (engine, target), cached)


def _digest(key: str, code: bytes) -> bytes:
    return hashlib.sha256(key.encode() + code).digest()


def _read(path: Path, key: str) -> bytes | None:
    try:
        if path.is_symlink():
            return None
        data = path.read_bytes()
    except OSError:
        return None
    head = len(MAGIC) + 32
    code = data[head:]
    if not data.startswith(MAGIC) or not hmac.compare_digest(
        data[len(MAGIC) : head], _digest(key, code)
    ):
        return None
    return code


def _write(path: Path, key: str, code: bytes) -> None:
    """Atomic, so that two processes may compile at once; a full or read-only folder is no error."""
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=".new-")
    except OSError:
        return
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(MAGIC + _digest(key, code) + code)
        Path(temporary).replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            Path(temporary).unlink()
