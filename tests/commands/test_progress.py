"""A progress bar comes late, on a terminal only, and changes nothing."""

import sys

import pytest

import tracker.progress
from tracker.progress import progress


def test_on_a_terminal_it_shows_label_count_and_time_left_after_a_while(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setattr(tracker.progress, "PATIENCE", 0.0)
    assert list(progress((run for run in range(5)), "runs", total=5)) == [0, 1, 2, 3, 4]
    told = capsys.readouterr()
    assert "runs" in told.err
    assert "5/5" in told.err
    assert "s left" in told.err
    assert not told.out


@pytest.mark.parametrize("terminal", [True, False])
def test_what_is_fast_or_piped_stays_silent(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *, terminal: bool
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal, raising=False)
    monkeypatch.setattr(tracker.progress, "PATIENCE", 60.0 if terminal else 0.0)
    assert list(progress([1, 2], "runs")) == [1, 2]
    assert capsys.readouterr() == ("", "")


def test_an_error_in_the_loop_passes_through_and_the_bar_is_gone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(tracker.progress, "PATIENCE", 0.0)
    with pytest.raises(ZeroDivisionError):
        sum(1 / (1 - run) for run in progress(range(3), "runs"))
