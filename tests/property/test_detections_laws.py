"""Laws of detection logs: no text, however mutilated, raises anything but the framework's errors."""

import gzip
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tracker.errors import TrackerError
from tracker.io.detections import read_detection_log

TABLES = {
    "scans": "scan,t,sensor,own_n,own_e,n_det\n0,0.0,radar,1.0,2.0,2\n1,0.5,eo,1.5,2.5,1\n2,0.5,ir,1,2,0\n",
    "detections": "scan,sensor,rel_n,rel_e,bearing\n0,radar,1.0,2.0,\n0,radar,3.0,4.0,\n1,eo,,,0.25\n",
    "truth": "target,t,n,e\na,0.0,1.0,2.0\na,1.0,2.0,3.0\nb,0.5,0.0,0.0\n",
}
patches = st.one_of(
    st.text(max_size=3),
    st.sampled_from(
        [
            "",
            ",",
            "\n",
            "\r",
            '"',
            "\0",
            "-",
            "1e308",
            "-1e308",
            "1e-320",
            "nan",
            "inf",
            "1e999",
            "radar",
            "eo",
            "9" * 400,
        ]
    ),
)


def read(tables: dict[str, bytes], suffix: str = ".csv") -> None:
    with TemporaryDirectory() as folder:
        for name, content in tables.items():
            Path(f"{folder}/log_{name}{suffix}").write_bytes(content)
        try:
            log = read_detection_log(f"{folder}/log")
        except TrackerError:
            return
    times = [scan.t for scan in log.scans]
    assert times == sorted(times)
    for track in (log.ownship, *log.truth.values()):
        middle = np.linspace(times[0], times[-1], 5)
        assert track.at(middle).shape == track.velocity_at(middle).shape == (2, 5)


@given(
    st.sampled_from(sorted(TABLES)),
    st.lists(st.tuples(st.integers(0, 120), st.integers(0, 4), patches), max_size=4),
)
def test_mutated_tables_are_read_or_refused(table: str, edits: list[tuple[int, int, str]]) -> None:
    text = TABLES[table]
    for place, length, patch in edits:
        text = text[:place] + patch + text[place + length :]
    content = text.encode("utf-8", "surrogatepass")
    read({**{name: whole.encode() for name, whole in TABLES.items()}, table: content})


@given(
    st.sampled_from(sorted(TABLES)),
    st.integers(0, 9),
    st.integers(0, 5),
    patches,
)
def test_mutated_cells_are_read_or_refused(table: str, line: int, column: int, patch: str) -> None:
    rows = [row.split(",") for row in TABLES[table].splitlines()]
    row = rows[line % len(rows)]
    row[column % len(row)] = patch
    content = "\n".join(",".join(cells) for cells in rows).encode("utf-8", "surrogatepass")
    read({**{name: whole.encode() for name, whole in TABLES.items()}, table: content})


@given(st.sampled_from(sorted(TABLES)), st.binary(max_size=100))
def test_arbitrary_bytes_are_refused(table: str, content: bytes) -> None:
    read({**{name: whole.encode() for name, whole in TABLES.items()}, table: content})


@given(st.integers(0, 200), st.integers(0, 255))
def test_damaged_archives_are_read_or_refused(place: int, byte: int) -> None:
    packed = {name: gzip.compress(text.encode(), mtime=0) for name, text in TABLES.items()}
    scans = bytearray(packed["scans"])
    scans[place % len(scans)] = byte
    read({**packed, "scans": bytes(scans)}, suffix=".csv.gz")
    read({**packed, "scans": packed["scans"][:place]}, suffix=".csv.gz")


@pytest.mark.parametrize("table", sorted(TABLES))
def test_a_table_cut_off_anywhere_is_read_or_refused(table: str) -> None:
    for length in range(len(TABLES[table])):
        content = TABLES[table][:length].encode()
        read({**{name: whole.encode() for name, whole in TABLES.items()}, table: content})
