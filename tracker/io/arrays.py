"""Named arrays and JSON metadata in one ``.npz`` file, for results; what they mean is not known here.

The file is an ordinary NumPy archive, ``numpy.load`` reads its arrays, with one more member,
``tracker.json``, that holds the format, its version, the arrays' names and the metadata. Nothing is ever pickled. The
same arrays and metadata give the same bytes.
"""

from __future__ import annotations

import io
import json
import os
import re
import secrets
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tracker.errors import ConfigError, DomainError, wording

_HEADER = "tracker.json"
_FORMAT = "tracker-arrays"
_VERSION = 1
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.\-/]*")


def save_arrays(
    path: str | Path, arrays: Mapping[str, npt.ArrayLike], metadata: Mapping[str, Any]
) -> None:
    """Write arrays and metadata; a reader sees the old file or the whole new one, never a part.

    Shapes:
        any; every dtype but object.

    Raises:
        DomainError: if an array holds Python objects, a name is not a plain word, or the metadata are
            not JSON (NaN and inf are not: put numbers into arrays).
        ConfigError: if the file cannot be written.

    Laws:
        ``load_arrays`` gives back equal arrays of equal dtype (tests/property/test_arrays_laws.py).

    Example:
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     save_arrays(f"{folder}/run.npz", {"rmse": [1.0, 0.5]}, {"seed": 7})
    ...     arrays, metadata = load_arrays(f"{folder}/run.npz")
    >>> arrays["rmse"].tolist(), metadata
    ([1.0, 0.5], {'seed': 7})
    """
    members = {_HEADER: _header(list(arrays), metadata)}
    for name, array in arrays.items():
        if not _NAME.fullmatch(str(name)):
            raise DomainError(
                wording(
                    "an array's name",
                    got=repr(name),
                    expected="letters, digits and any of _ . - /, not beginning with . - /",
                    do="rename it",
                )
            )
        members[f"{name}.npy"] = _packed(name, array)
    target = Path(path)
    draft = target.with_name(f"{target.name}.{secrets.token_hex(4)}.part")
    try:
        try:
            with zipfile.ZipFile(draft, "x", zipfile.ZIP_DEFLATED) as archive:
                for name, content in members.items():
                    archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)
            os.replace(draft, target)  # noqa: PTH105 (says atomic more plainly)
        finally:
            draft.unlink(missing_ok=True)
    except OSError as error:
        raise ConfigError(
            wording(
                str(target),
                got=error.strerror or str(error),
                expected="a file that can be written, in a folder that exists",
                do="create the folder or choose another path",
            )
        ) from None


def load_arrays(path: str | Path) -> tuple[dict[str, npt.NDArray[Any]], dict[str, Any]]:
    """Arrays by name, and the metadata, of a file that ``save_arrays`` wrote.

    Raises:
        ConfigError: if the file is missing, damaged, cut off, of another program or of a newer version.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            known = _HEADER in archive.namelist()
            names, metadata = _contents(path, archive.read(_HEADER) if known else b"null")
            arrays = {
                name: np.lib.format.read_array(
                    io.BytesIO(archive.read(f"{name}.npy")), allow_pickle=False
                )
                for name in names
            }
    except ConfigError:
        raise
    except FileNotFoundError:
        raise _unreadable(path, "no such file", "check the path") from None
    except Exception as error:  # noqa: BLE001 (damage surfaces as whatever the parsers below trip over)
        got = f"a damaged or foreign file ({error})"
        raise _unreadable(path, got, "make the file again") from None
    return arrays, metadata


def _header(names: list[str], metadata: Mapping[str, Any]) -> bytes:
    content = {
        "format": _FORMAT,
        "version": _VERSION,
        "arrays": names,  # so that a lost member is noticed
        "metadata": dict(metadata),
    }
    try:
        return json.dumps(content, allow_nan=False).encode()
    except (TypeError, ValueError, RecursionError) as error:
        raise DomainError(
            wording(
                "argument 'metadata'",
                got=str(error),
                expected="what JSON can hold: text, finite numbers, true, false, null, lists, dicts",
                do="put numbers into arrays and convert the rest to text",
            )
        ) from None


def _packed(name: str, array: npt.ArrayLike) -> bytes:
    buffer = io.BytesIO()
    try:
        np.lib.format.write_array(buffer, np.asarray(array), allow_pickle=False)
    except ValueError as error:
        raise DomainError(
            wording(
                f"array {name!r}",
                got=str(error),
                expected="a regular array of numbers, flags or text",
                do="convert it; Python objects are never stored",
            )
        ) from None
    return buffer.getvalue()


def _contents(path: str | Path, header: bytes) -> tuple[list[str], dict[str, Any]]:
    content = json.loads(header)
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise _unreadable(path, "a file of another program", "load it with numpy.load")
    if content.get("version") != _VERSION:
        got = f"version {content.get('version')!r} of the format"
        raise _unreadable(path, got, "update tracker-lab, or make the file again")
    names, metadata = content.get("arrays"), content.get("metadata")
    if not isinstance(names, list) or not isinstance(metadata, dict):
        raise _unreadable(path, "no list of arrays or no metadata", "make the file again")
    return names, metadata


def _unreadable(path: str | Path, got: str, do: str) -> ConfigError:
    expected = f"arrays that save_arrays wrote, version {_VERSION}"
    return ConfigError(wording(str(path), got=got, expected=expected, do=do))
