"""What commands write, and the one line a person reads where that fails; what is in it is theirs."""

from __future__ import annotations

import math
import platform
from pathlib import Path

import numpy as np

from tracker.errors import ConfigError, wording


def folder_of(out: str) -> Path:
    """The folder that ``--out`` names, made if it is not there.

    Raises:
        ConfigError: if it cannot be made.
    """
    try:
        folder = Path(out)
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise ConfigError(
            wording(f"--out {out!r}", got=str(error), expected="a folder", do="name another")
        ) from None
    return folder


def write(file: Path, content: str | bytes) -> None:
    """Write a whole file.

    Raises:
        ConfigError: if that fails.
    """
    data = content.encode("utf-8") if isinstance(content, str) else content
    try:
        file.write_bytes(data)
    except OSError as error:
        raise ConfigError(
            wording(str(file), got=str(error), expected="a file to write", do="see to the folder")
        ) from None


def finite(value: float) -> float | None:
    """The value, or None where JSON has no word for it."""
    return value if math.isfinite(value) else None


def versions() -> dict[str, str]:
    """What results depend on."""
    import tracker

    return {
        "tracker": tracker.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
