"""Saved arrays: what is refused, when being written and when being read."""

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tracker.errors import ConfigError, DomainError
from tracker.io.arrays import load_arrays, save_arrays


def test_arrays_and_metadata_come_back(tmp_path: Path) -> None:
    path = tmp_path / "results.npz"
    arrays = {"rmse": np.array([1.0, np.nan]), "ok": np.array([True]), "cell/0.ids": np.array("a")}
    save_arrays(path, arrays, {"seed": 7, "methods": ["ekf1"], "band": {"low": 0.1}})
    back, metadata = load_arrays(path)
    assert metadata == {"seed": 7, "methods": ["ekf1"], "band": {"low": 0.1}}
    assert list(back) == list(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(back[name], array)
        assert back[name].dtype == array.dtype


def test_numpy_alone_can_read_the_arrays(tmp_path: Path) -> None:
    save_arrays(tmp_path / "results.npz", {"file": [1.0], "allow_pickle": [2.0]}, {})
    with np.load(tmp_path / "results.npz") as archive:
        assert archive["file"].tolist() == [1.0]
        assert archive["allow_pickle"].tolist() == [2.0]


def test_the_same_content_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("one", "two"):
        save_arrays(tmp_path / name, {"x": np.arange(9.0)}, {"seed": 1})
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


def test_python_objects_are_never_stored(tmp_path: Path) -> None:
    for array in (np.array([object()]), [[1.0], [1.0, 2.0]]):
        with pytest.raises(DomainError, match=r"array 'x'.*Python objects are never stored"):
            save_arrays(tmp_path / "results.npz", {"x": array}, {})  # type: ignore[dict-item]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["", "/x", "../x", "a\0", "a b", "-x", "ä"])
def test_a_name_that_is_no_plain_word_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(DomainError, match="rename it"):
        save_arrays(tmp_path / "results.npz", {name: [1.0]}, {})


@pytest.mark.parametrize("value", [np.nan, np.inf, object(), np.zeros(2), {1, 2}, 1j])
def test_metadata_that_are_not_json_are_refused(tmp_path: Path, value: Any) -> None:
    with pytest.raises(DomainError, match="argument 'metadata'"):
        save_arrays(tmp_path / "results.npz", {}, {"value": value})


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "results.npz"
    save_arrays(path, {"x": [1.0]}, {})
    with pytest.raises(DomainError):
        save_arrays(path, {"x": [2.0], "y": [None]}, {})  # type: ignore[list-item, dict-item]
    assert load_arrays(path)[0]["x"].tolist() == [1.0]
    (tmp_path / "folder").mkdir()
    with pytest.raises(ConfigError, match=r"folder.*expected a file that can be written"):
        save_arrays(tmp_path / "folder", {"x": [1.0]}, {})
    with pytest.raises(ConfigError, match="create the folder"):
        save_arrays(tmp_path / "none" / "results.npz", {"x": [1.0]}, {})
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["folder", "results.npz"]


def test_a_missing_file_is_said_to_be_missing(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nothing\.npz: got no such file"):
        load_arrays(tmp_path / "nothing.npz")


def test_a_file_of_another_program_is_recognised(tmp_path: Path) -> None:
    path = tmp_path / "foreign.npz"
    np.savez(path, x=np.zeros(3))
    with pytest.raises(ConfigError, match=r"another program.*numpy\.load"):
        load_arrays(path)
    path.write_text("not an archive at all")
    with pytest.raises(ConfigError, match="damaged or foreign"):
        load_arrays(path)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ({"format": "tracker-arrays", "version": 2, "metadata": {}}, "version 2 .*update"),
        ({"format": "tracker-arrays", "version": 1, "arrays": []}, "or no metadata"),
        ({"format": "tracker-arrays", "version": 1, "metadata": {}}, "no list of arrays"),
        (
            {"format": "tracker-arrays", "version": 1, "arrays": ["lost"], "metadata": {}},
            r"damaged.*lost\.npy",
        ),
        ({"format": "other", "version": 1, "metadata": {}}, "another program"),
        ([], "another program"),
        ("[" * 100_000, "damaged"),
    ],
)
def test_a_header_that_we_did_not_write_is_refused(
    tmp_path: Path, header: Any, message: str
) -> None:
    path = tmp_path / "odd.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("tracker.json", header if isinstance(header, str) else json.dumps(header))
    with pytest.raises(ConfigError, match=message):
        load_arrays(path)


def test_a_pickle_inside_an_archive_is_never_loaded(tmp_path: Path) -> None:
    path = tmp_path / "results.npz"
    np.savez(path, x=np.array([{"a": 1}]))
    header = {"format": "tracker-arrays", "version": 1, "arrays": ["x"], "metadata": {}}
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("tracker.json", json.dumps(header))
    with pytest.raises(ConfigError, match="damaged or foreign"):
        load_arrays(path)
