"""Clock offsets of the SEM's computer and of the share, estimated from files."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import pytest

from semlive.data.frame import ExportedFile, FrameInfo
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import ScanProfile
from semlive.formats.log.messages import ClockOffsetMessage
from semlive.service.watch.clock_offsets import FileClockOffsets, probe_share

S = 10**9
T0 = 1_772_439_825 * S
FROM_FILE = Provenance.FILE
TIMING = ScanTiming(Sourced(1e-5, FROM_FILE), Sourced(0.02, FROM_FILE), Sourced(20.0, FROM_FILE), Sourced(1, FROM_FILE))


def after(
    clocks: FileClockOffsets, end_ns: int, export: int, offset_s: float, delay_s: float
) -> tuple[FileClockOffsets, tuple[ClockOffsetMessage, ...]]:
    """A scan that ended, whose file settled later, by a SEM whose clock is off and prints whole seconds."""
    printed = (end_ns + round(offset_s * S)) // S * S + S // 2
    info = FrameInfo(
        export,
        "a.tif",
        "fei",
        8,
        8,
        0,
        TIMING,
        Sourced(0, FROM_FILE),
        0.3,
        Sourced(1e-6, FROM_FILE),
        embedded_time_ns=printed,
        start_anchor="end",
    )
    settled = end_ns + round(delay_s * S)
    file = ExportedFile(export, "a.tif", b"", "", settled - S // 2, settled + 2 * S, stable_time_ns=settled)
    return clocks.updated(file, info, ScanProfile())


def test_a_clock_an_hour_ahead_is_determined_within_the_duration_of_an_export() -> None:
    clocks, reported = FileClockOffsets.with_poll_interval(1.0), []
    for number in range(20):
        clocks, more = after(clocks, T0 + round(number * 31.37 * S), number, 3600.0, 0.5 + 0.1 * (number % 5))
        reported += more
    assert clocks.sem.offset_s == pytest.approx(3600.0, abs=1.0)
    assert abs(clocks.sem.offset_s - 3600.0) < 2.0 * clocks.sem.sigma_s
    assert clocks.share.offset_s == pytest.approx(-0.5)
    sem = [item for item in reported if item.clock == "sem"]
    assert 1 <= len(sem) <= 4
    assert "set one of the clocks, or sem.profile.clock_offset_s: 3600." in sem[-1].advice or "3599" in sem[-1].advice
    assert all(not item.advice for item in reported if item.clock == "share")


def test_a_correct_clock_is_reported_without_advice() -> None:
    clocks, reported = after(FileClockOffsets.with_poll_interval(1.0), T0, 0, 0.0, 1.0)
    assert [item.advice for item in reported] == ["", ""]
    assert [item.reason for item in reported] == ["first file with this clock"] * 2
    assert clocks.sem.sigma_s == pytest.approx((1 / 12 + 4.0 + 1.0) ** 0.5)


def test_late_files_are_no_step_of_a_clock_and_a_clock_that_is_set_is() -> None:
    clocks = FileClockOffsets.with_poll_interval(1.0)
    for number in range(5):
        clocks, _ = after(clocks, T0 + number * 40 * S, number, 0.0, 1.0)
    late = clocks
    for number in range(5, 9):
        late, reported = after(late, T0 + 40 * number * S, number, 0.0, 500.0)
        assert [item.clock for item in reported if item.clock == "sem"] == []
    assert late.sem.offset_s == clocks.sem.offset_s
    winter = clocks
    for number in range(5, 11):
        winter, reported = after(winter, T0 + 40 * number * S, number, -3600.0, 1.0)
    assert [item.reason for item in reported if item.clock == "sem"] == ["the clock was set by -3600.0 s"]
    summer, _ = after(clocks, T0 + 200 * S, 5, 3600.0, 1.0)
    summer, reported = after(summer, T0 + 240 * S, 6, 3600.0, 1.0)
    [step] = [item for item in reported if item.clock == "sem"]
    assert step.reason == "the clock was set by +3600.0 s"
    assert step.offset_s == pytest.approx(3600.0, abs=2.0)


def test_files_of_older_logs_give_no_clock_offset() -> None:
    clocks = FileClockOffsets.with_poll_interval(1.0)
    info = FrameInfo(0, "a.tif", "fei", 8, 8, 0, TIMING, Sourced(0, FROM_FILE), 0.3, Sourced(1e-6, FROM_FILE), embedded_time_ns=T0)
    assert clocks.updated(ExportedFile(0, "a.tif", b"", "", T0, T0), info, ScanProfile()) == (clocks, ())


def test_a_time_that_marks_the_start_is_held_against_the_end() -> None:
    info = FrameInfo(
        0, "a", "fei", 8, 8, 0, TIMING, Sourced(0, FROM_FILE), 0.3, Sourced(1e-6, FROM_FILE), embedded_time_ns=T0, start_anchor="start"
    )
    file = replace(ExportedFile(0, "a", b"", "", T0 + 20 * S, T0 + 22 * S), stable_time_ns=T0 + 21 * S)
    clocks, _ = FileClockOffsets.with_poll_interval(1.0).updated(file, info, ScanProfile())
    assert clocks.sem.offset_s == pytest.approx(-1.0)


def test_a_share_reports_its_time_on_request(tmp_path: Path) -> None:
    reported = probe_share(tmp_path, time.time_ns)
    assert reported is not None
    assert abs(reported.offset_s) < 0.1 + reported.sigma_s
    assert list(tmp_path.iterdir()) == []
    assert probe_share(tmp_path / "none", time.time_ns) is None
