"""Detection logs: what is read, what is refused, and what the message says."""

import gzip
import pickle
from pathlib import Path

import numpy as np
import pytest

from tracker.errors import ConfigError, DomainError, ShapeError, TrackerError
from tracker.io.detections import (
    DetectionLog,
    TruthTrack,
    read_detection_log,
    write_detection_log,
)
from tracker.types import Scan

ROOT = Path(__file__).parents[2]
LOGS = {
    "02": ROOT / "examples/data/autoferry/scenario02",
    "13": ROOT / "tests/reference/data/autoferry/scenario13",
    "16": ROOT / "tests/reference/data/autoferry/scenario16",
}
SMALL = {
    "scans": """\
scan,t,sensor,own_n,own_e,n_det
0,0.0,radar,10.0,20.0,2
1,0.5,eo,10.5,20.5,1
2,0.5,lidar,10.5,20.5,0
3,2.0,radar,11.0,21.0,1
""",
    "detections": """\
scan,sensor,rel_n,rel_e,bearing
0,radar,1.0,2.0,
0,radar,3.0,4.0,
1,eo,,,0.25
3,radar,5.0,6.0,
""",
    "truth": """\
target,t,n,e
boat,0.0,100.0,200.0
boat,10.0,110.0,220.0
ship,1.0,0.0,0.0
""",
}


def put(folder: Path, **changed: str | None) -> Path:
    for name, text in {**SMALL, **changed}.items():
        if text is not None:
            (folder / f"log_{name}.csv").write_text(text, encoding="utf-8")
    return folder / "log"


def test_positions_become_east_and_north_and_stay_relative_to_ownship(tmp_path: Path) -> None:
    radar, eye, lidar, last = read_detection_log(put(tmp_path)).scans
    assert radar.z.tolist() == [[2.0, 4.0], [1.0, 3.0]]
    assert radar.pose is not None
    assert radar.pose.tolist() == [20.0, 10.0]
    assert eye.z.tolist() == [[0.25]]
    assert lidar.z.shape == (2, 0), "an empty scan must be kept: it says that everything was missed"
    assert [scan.sensor for scan in (radar, eye, lidar, last)] == ["radar", "eo", "lidar", "radar"]
    assert [scan.t for scan in (radar, eye, lidar, last)] == [0.0, 0.5, 0.5, 2.0]


def test_truth_and_ownship_are_paths_of_east_and_north(tmp_path: Path) -> None:
    log = read_detection_log(put(tmp_path))
    assert log.sensors == ("radar", "lidar", "eo")
    assert sorted(log.truth) == ["boat", "ship"]
    assert log.truth["boat"].at(5.0).tolist() == [210.0, 105.0]
    assert log.truth["boat"].velocity_at([0.0, 5.0, 10.0]).tolist() == [[2.0] * 3, [1.0] * 3]
    assert log.ownship.t.tolist() == [0.0, 0.5, 2.0]
    assert log.ownship.at(1.25).tolist() == [20.75, 10.75]
    assert log.notes == ()
    assert pickle.loads(pickle.dumps(log)).truth["boat"].t.tolist() == [0.0, 10.0]


def test_outside_its_span_a_path_is_unknown() -> None:
    track = TruthTrack([1.0, 3.0], [[0.0, 2.0], [0.0, 4.0]])
    assert np.isnan(track.at([0.99, 3.01, np.nan])).all()
    assert np.isnan(track.velocity_at([0.99, 3.01, np.nan])).all()
    assert track.velocity_at([[1.0, 3.0]], span=100.0).tolist() == [[[1.0, 1.0]], [[2.0, 2.0]]]
    single = TruthTrack([1.0], [[5.0], [6.0]])
    assert single.at(1.0).tolist() == [5.0, 6.0]
    assert np.isnan(single.velocity_at(1.0)).all()


def test_a_path_refuses_what_is_not_one() -> None:
    with pytest.raises(ShapeError, match=r"T at least 1"):
        TruthTrack([], np.empty((2, 0)))
    with pytest.raises(DomainError, match="do not increase"):
        TruthTrack([0.0, 0.0], np.zeros((2, 2)))
    with pytest.raises(DomainError, match="NaN"):
        TruthTrack([0.0, 1.0], [[0.0, np.nan], [0.0, 0.0]])
    with pytest.raises(DomainError, match="'span'"):
        TruthTrack([0.0], np.zeros((2, 1))).velocity_at(0.0, span=0.0)


def test_sensors_and_times_can_be_picked(tmp_path: Path) -> None:
    path = put(tmp_path)
    log = read_detection_log(path, sensors=("radar",), start=0.5, stop=2.0)
    assert [(scan.sensor, scan.t) for scan in log.scans] == [("radar", 2.0)]
    assert log.sensors == ("radar",)
    assert log.ownship.t.size == 3, "ownship and truth are kept whole"
    assert read_detection_log(path, sensors="eo").sensors == ("eo",)
    assert read_detection_log(path, start=50.0).scans == ()
    with pytest.raises(ConfigError, match=r"'ir'; expected some of radar, lidar, eo"):
        read_detection_log(path, sensors=("radar", "ir"))
    for start, stop in ((2.0, 1.0), (np.nan, 1.0)):
        with pytest.raises(DomainError, match="'start' and 'stop'"):
            read_detection_log(path, start=start, stop=stop)


def test_rows_out_of_order_are_sorted_stably_and_noted(tmp_path: Path) -> None:
    head, first, *others = SMALL["scans"].splitlines()
    target = "target,t,n,e\nboat,1.0,0.0,0.0\nboat,0.0,5.0,6.0\n"
    path = put(tmp_path, scans="\n".join([head, *others, first]), truth=target)
    log = read_detection_log(path)
    assert [scan.sensor for scan in log.scans] == ["radar", "eo", "lidar", "radar"]
    assert log.truth["boat"].at(0.0).tolist() == [6.0, 5.0]
    assert len(log.notes) == 2
    assert "log_scans.csv: t = 0.0 comes after t = 2.0" in log.notes[0]


def test_a_log_without_truth_has_no_truth(tmp_path: Path) -> None:
    assert dict(read_detection_log(put(tmp_path, truth=None)).truth) == {}


def test_other_sensors_can_be_declared(tmp_path: Path) -> None:
    changes = {name: SMALL[name].replace("eo", "sonar") for name in ("scans", "detections")}
    path = put(tmp_path, **changes)
    log = read_detection_log(
        path, kinds={"sonar": "bearing", "radar": "position", "lidar": "position"}
    )
    assert log.sensors == ("sonar", "radar", "lidar")
    with pytest.raises(DomainError, match="sensor 'sonar': got 'angle'"):
        read_detection_log(path, kinds={"sonar": "angle"})  # type: ignore[dict-item]


@pytest.mark.parametrize(
    ("table", "old", "new", "message"),
    [
        ("scans", "own_n,", "", r"scans\.csv:1: got columns scan, t, .*column 'own_n' once"),
        ("scans", "0.5,eo", "soon,eo", r"scans\.csv:3: got 'soon' in column 't'"),
        ("scans", "10.0,20.0", "nan,20.0", r"scans\.csv:2: got 'nan' in column 'own_n'"),
        ("scans", "10.0,20.0", "1_0,20.0", r"scans\.csv:2: got '1_0' in column 'own_n'"),
        ("scans", "0.5,eo", "0.5,sonar", r"scans\.csv:3: got sensor 'sonar'; .*radar, lidar"),
        ("scans", "2,0.5,lidar", "1,0.5,lidar", r"scans\.csv:4: got scan '1' again.*line 3 has"),
        ("scans", "20.5,1", "20.5,-1", r"scans\.csv:3: got n_det '-1'"),
        ("scans", "20.5,1", "20.5,1.5", r"scans\.csv:3: got n_det '1.5'"),
        ("scans", "20.5,1", "20.5,3", r"scans\.csv:3: got n_det 3 for scan '1'; expected 1"),
        ("scans", "20.0,2", "20.0,2,9", r"scans\.csv:2: got 7 cells; expected 6"),
        ("scans", "20.0,2", '20.0,"2', r"scans\.csv:\d: got unreadable content"),
        ("detections", "1,eo", "7,eo", r"detections\.csv:4: got a detection of scan '7'"),
        ("detections", "1,eo", "1,ir", r"detections\.csv:4: got sensor 'ir'; expected 'eo'"),
        ("detections", "0.25", "", r"detections\.csv:4: got '' in column 'bearing'"),
        ("detections", "1.0,2.0", ",2.0", r"detections\.csv:2: got '' in column 'rel_n'"),
        ("truth", "10.0,110.0", "0.0,110.0", r"truth\.csv:3: got target 'boat' at t = 0\.0 again"),
        ("truth", "110.0", "far", r"truth\.csv:3: got 'far' in column 'n'"),
    ],
)
def test_a_mistake_is_named_with_file_and_line(
    tmp_path: Path, table: str, old: str, new: str, message: str
) -> None:
    assert old in SMALL[table]
    with pytest.raises(ConfigError, match=message):
        read_detection_log(put(tmp_path, **{table: SMALL[table].replace(old, new, 1)}))


@pytest.mark.parametrize("missing", ["scans", "detections"])
def test_a_missing_file_is_named_with_what_to_give(tmp_path: Path, missing: str) -> None:
    with pytest.raises(ConfigError, match=rf"log_{missing}\.csv: got no such file.*in common"):
        read_detection_log(put(tmp_path, **{missing: None}))


def test_an_empty_log_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"scans\.csv:1: got no scans"):
        read_detection_log(put(tmp_path, scans=SMALL["scans"].splitlines()[0]))
    with pytest.raises(ConfigError, match=r"scans\.csv:1: got columns none"):
        read_detection_log(put(tmp_path, scans=""))


@pytest.mark.parametrize("name", ["nul\0nul", "x" * 5000, ".", ""])
def test_a_path_that_cannot_exist_is_a_missing_file(tmp_path: Path, name: str) -> None:
    with pytest.raises(TrackerError, match="no such file"):
        read_detection_log(f"{tmp_path}/{name}")


def test_a_damaged_archive_is_named(tmp_path: Path) -> None:
    path = put(tmp_path, scans=None)
    packed = gzip.compress(SMALL["scans"].encode(), mtime=0)
    archive = tmp_path / "log_scans.csv.gz"
    archive.write_bytes(packed)
    assert len(read_detection_log(path).scans) == 4
    damaged = bytearray(packed)
    damaged[30] ^= 0xFF
    for content in (packed[:40], packed[:5], b"plain text", bytes(damaged)):
        archive.write_bytes(content)
        with pytest.raises(ConfigError, match=r"log_scans\.csv\.gz:\d+: got"):
            read_detection_log(path)


def test_a_byte_order_mark_and_blank_lines_are_no_mistake(tmp_path: Path) -> None:
    text = "\ufeff" + SMALL["scans"].replace("\n", "\r\n") + "\r\n\r\n"
    assert len(read_detection_log(put(tmp_path, scans=text)).scans) == 4


@pytest.mark.parametrize(
    ("scenario", "scans", "detections", "radar"),
    [("02", 1907, 4239, 70), ("13", 1885, 15369, None), ("16", 1914, 17873, None)],
)
def test_the_measured_logs_are_read_whole(
    scenario: str, scans: int, detections: int, radar: int | None
) -> None:
    log = read_detection_log(LOGS[scenario])
    assert len(log.scans) == scans
    assert sum(scan.detections for scan in log.scans) == detections
    assert log.sensors == ("radar", "lidar", "ir", "eo")
    assert sorted(log.truth) == ["1", "2"]
    assert log.notes == ()
    if radar is not None:
        assert sum(scan.sensor == "radar" for scan in log.scans) == radar


@pytest.mark.parametrize("scenario", ["02", "13", "16"])
def test_measured_detections_lie_where_the_truth_is(scenario: str) -> None:
    log = read_detection_log(LOGS[scenario])
    for sensor, tolerance in (("radar", 10.0), ("lidar", 10.0), ("eo", np.radians(4.0))):
        distances = []
        for scan in log.scans:
            if scan.sensor != sensor or not scan.detections:
                continue
            assert scan.pose is not None
            for track in log.truth.values():
                relative = track.at(scan.t) - scan.pose
                if sensor == "eo":
                    turn = scan.z[0] - np.arctan2(relative[0], relative[1])
                    distances.append(np.abs((turn + np.pi) % (2 * np.pi) - np.pi).min())
                else:
                    distances.append(np.hypot(*(scan.z - relative[:, None])).min())
        near = np.array(distances)[np.isfinite(distances)] < tolerance
        share = {"radar": 0.6, "lidar": 0.3, "eo": 0.5}[sensor]
        assert near.mean() > share, f"{sensor}: axes or conventions are mixed up"


def test_writing_and_reading_give_back_the_same_log(tmp_path: Path) -> None:
    log = read_detection_log(LOGS["02"], stop=20.0)
    write_detection_log(log, tmp_path / "copy")
    back = read_detection_log(tmp_path / "copy")
    assert back.sensors == log.sensors
    for ours, theirs in zip(back.scans, log.scans, strict=True):
        assert (ours.t, ours.sensor) == (theirs.t, theirs.sensor)
        np.testing.assert_array_equal(ours.z, theirs.z)
        np.testing.assert_array_equal(np.array(ours.pose), np.array(theirs.pose))
    for name, track in log.truth.items():
        np.testing.assert_array_equal(back.truth[name].t, track.t)
        np.testing.assert_array_equal(back.truth[name].position, track.position)


def test_empty_slots_are_not_written_and_batches_are_refused(tmp_path: Path) -> None:
    ownship = TruthTrack([0.0], [[0.0], [0.0]])
    padded = Scan(0.0, [[1.0, np.nan], [2.0, np.nan]], pose=[0.0, 0.0], sensor="radar")
    write_detection_log(DetectionLog((padded,), ("radar",), {}, ownship), tmp_path / "log")
    assert read_detection_log(tmp_path / "log").scans[0].z.tolist() == [[1.0], [2.0]]
    batch = Scan(0.0, np.zeros((2, 3, 5)), pose=[0.0, 0.0], sensor="radar")
    with pytest.raises(ShapeError, match="pick one lane"):
        write_detection_log(DetectionLog((batch,), ("radar",), {}, ownship), tmp_path / "log")
