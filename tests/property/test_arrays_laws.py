"""Laws of saved arrays: what goes in comes out, and damage is always noticed or harmless."""

import io
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import numpy.typing as npt
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tracker.errors import ConfigError
from tracker.io.arrays import load_arrays, save_arrays

dtypes = st.one_of(
    hnp.floating_dtypes(),
    hnp.integer_dtypes(),
    hnp.boolean_dtypes(),
    hnp.complex_number_dtypes(),
    hnp.unicode_string_dtypes(),
)
shapes = hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=4)
some_arrays = st.dictionaries(
    st.from_regex(r"[a-z0-9_][a-z0-9_./-]{0,8}", fullmatch=True),
    dtypes.flatmap(lambda dtype: hnp.arrays(dtype, shapes)),
    max_size=3,
)
json = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(some_arrays, st.dictionaries(st.text(), json, max_size=3))
def test_what_is_saved_is_loaded(
    arrays: dict[str, npt.NDArray[np.generic]], metadata: dict[str, object]
) -> None:
    with TemporaryDirectory() as folder:
        save_arrays(f"{folder}/a.npz", arrays, metadata)
        back, back_metadata = load_arrays(f"{folder}/a.npz")
    assert back_metadata == metadata
    assert list(back) == list(arrays)
    for name, array in arrays.items():
        assert back[name].dtype == array.dtype
        np.testing.assert_array_equal(back[name], array)


def example() -> bytes:
    with TemporaryDirectory() as folder:
        save_arrays(f"{folder}/a.npz", {"x": np.arange(40.0), "ok": [True, False]}, {"seed": 7})
        return Path(f"{folder}/a.npz").read_bytes()


WHOLE = example()


def loads_or_is_refused(content: bytes) -> bool:
    with TemporaryDirectory() as folder:
        path = Path(f"{folder}/a.npz")
        path.write_bytes(content)
        try:
            arrays, metadata = load_arrays(path)
        except ConfigError:
            return False
    assert metadata == {"seed": 7}
    np.testing.assert_array_equal(arrays["x"], np.arange(40.0))
    return True


@given(st.integers(0, len(WHOLE) - 1))
def test_a_file_cut_off_anywhere_is_refused(length: int) -> None:
    assert not loads_or_is_refused(WHOLE[:length])


@given(st.integers(0, len(WHOLE) - 1), st.integers(1, 255))
def test_a_changed_byte_is_noticed_or_changes_nothing_read(place: int, change: int) -> None:
    content = bytearray(WHOLE)
    content[place] ^= change
    loads_or_is_refused(bytes(content))


@given(st.binary(max_size=200))
def test_bytes_that_are_no_archive_are_refused(content: bytes) -> None:
    assert not loads_or_is_refused(content)


def parts() -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(WHOLE)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


PARTS = parts()


@given(
    st.sampled_from(sorted(PARTS)),
    st.lists(st.tuples(st.integers(0, 200), st.binary(min_size=1, max_size=3)), max_size=3),
)
def test_a_forged_member_is_refused_or_gives_arrays(
    member: str, edits: list[tuple[int, bytes]]
) -> None:
    forged = PARTS[member]
    for place, patch in edits:
        forged = forged[:place] + patch + forged[place + len(patch) :]
    with TemporaryDirectory() as folder:
        with zipfile.ZipFile(f"{folder}/a.npz", "w") as archive:
            for name, content in {**PARTS, member: forged}.items():
                archive.writestr(name, content)
        try:
            arrays, _ = load_arrays(f"{folder}/a.npz")
        except ConfigError:
            return
    assert all(isinstance(array, np.ndarray) for array in arrays.values())
