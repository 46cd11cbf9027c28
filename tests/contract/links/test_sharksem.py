"""The trigger of TESCAN microscopes with a peer that follows the manual, and with one that does not."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from semlive.data.checks import Verdict
from semlive.data.frame import ExportedFile
from semlive.data.scan import Provenance
from semlive.data.scan_report import ScanReport
from semlive.data.settings import ScanProfile
from semlive.errors import BadConfig, LinkError, LinkRefused
from semlive.formats import read_frame
from semlive_drivers.microscope.sharksem.trigger import check_device, open_trigger
from semlive_drivers.microscope.trigger import MicroscopeTrigger

from ...clocks import WallClock
from .sharksem_peer import Microscope, Peer, noise

WIDTH, HEIGHT = 64, 48
MOVES = ("Stg", "SetViewField", "SetWD", "SetGeometry", "HVBeam", "HVSet", "ScSet", "DtSelect", "DtSetGain", "SMSet", "Arl", "Vac")


@pytest.fixture
def peer() -> Iterator[Peer]:
    made = Peer(Microscope())
    yield made
    made.close()


def settings(peer: Peer, folder: Path, **more: Any) -> dict[str, Any]:
    own = {"host": "127.0.0.1", "port": peer.port, "width_px": WIDTH, "height_px": HEIGHT, "answer_timeout_s": 0.5, "frame_timeout_s": 5}
    return {"folder": str(folder), **own, **more}


def opened(peer: Peer, folder: Path, **more: Any) -> MicroscopeTrigger:
    return open_trigger(settings(peer, folder, **more), WallClock())


def scanned(peer: Peer, folder: Path, **more: Any) -> ScanReport:
    trigger = opened(peer, folder, **more)
    try:
        return trigger.scan_once()
    finally:
        trigger.close()


def refused(peer: Peer, folder: Path, **more: Any) -> str:
    """Why a frame that was requested is not there; nothing is left in the folder."""
    trigger = opened(peer, folder)
    for name, value in more.items():
        setattr(peer.microscope, name, value)
    try:
        with pytest.raises(LinkError) as refusal:
            trigger.scan_once()
    finally:
        trigger.close()
    assert list(folder.iterdir()) == []
    return str(refusal.value)


def test_a_frame_has_the_pixels_that_were_sent_and_the_settings_that_were_reported(peer: Peer, tmp_path: Path) -> None:
    began_ns = time.time_ns()
    report = scanned(peer, tmp_path)
    assert report.before.dwell_time_s == pytest.approx(3.2e-6)
    assert report.before.field_width_m == pytest.approx(0.2e-3)
    assert report.before.row_time_s == pytest.approx(0.05 / HEIGHT)
    assert dict(report.after.others) == {
        "scan mode": "DEPTH",
        "detector": "BSE",
        "beam shift": "0 0 mm",
        "rotation": "0 deg",
    }
    path = tmp_path / report.file
    assert tifffile.imread(path).tobytes() == noise(WIDTH, HEIGHT, 8, 1)
    stat = path.stat()
    file = ExportedFile(0, path.name, path.read_bytes(), "", stat.st_mtime_ns, stat.st_mtime_ns, path.with_suffix(".hdr").read_bytes())
    info = read_frame(file, ScanProfile()).info
    assert (info.vendor, info.width_px, info.height_px, info.databar_rows) == ("tescan", WIDTH, HEIGHT, 0)
    assert info.timing.dwell_time_s.value == pytest.approx(3.2e-6)
    assert info.timing.row_time_s.value == pytest.approx(0.05 / HEIGHT)
    assert info.timing.row_time_s.source is Provenance.FILE
    assert info.pixel_size_m.value == pytest.approx(0.2e-3 / WIDTH)
    assert began_ns - 2e6 <= info.start_time_ns.value <= info.end_time_ns <= time.time_ns()
    assert info.column.detector is not None
    assert info.column.detector.value == "BSE"


def test_no_request_to_the_microscope_moves_or_sets_anything(peer: Peer, tmp_path: Path) -> None:
    scanned(peer, tmp_path)
    commands = peer.microscope.commands
    assert not [name for name in commands if name.startswith(MOVES)]
    assert commands.count("GUISetScanning") == 2
    assert peer.microscope.live == 1
    assert peer.microscope.scans == [(1 + 1, WIDTH, HEIGHT, 0, 0, WIDTH - 1, HEIGHT - 1, 1, 3200)]


def test_the_measured_row_time_is_that_of_the_scan(peer: Peer, tmp_path: Path) -> None:
    peer.microscope.frame_s = 0.5
    report = scanned(peer, tmp_path)
    assert report.measured_row_time_s == pytest.approx(0.5 / HEIGHT, rel=0.3)


def test_names_count_up_and_never_repeat(peer: Peer, tmp_path: Path) -> None:
    (tmp_path / "frame_000041.tif").touch()
    trigger = opened(peer, tmp_path)
    assert [trigger.scan_once().file for _ in range(2)] == ["frame_000042.tif", "frame_000043.tif"]
    trigger.close()


def test_sixteen_bit_data_are_little_endian(peer: Peer, tmp_path: Path) -> None:
    report = scanned(peer, tmp_path, bits=16)
    assert np.array_equal(tifffile.imread(tmp_path / report.file).ravel(), np.frombuffer(noise(WIDTH, HEIGHT, 16, 1), "<u2"))


@pytest.mark.parametrize("fault", ["old", "twice"])
def test_data_of_an_earlier_frame_and_repeated_data_do_no_harm(peer: Peer, tmp_path: Path, fault: str) -> None:
    peer.microscope.data_fault = fault
    assert tifffile.imread(tmp_path / scanned(peer, tmp_path).file).tobytes() == noise(WIDTH, HEIGHT, 8, 1)


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("close", "closed the connection before the image data was complete"),
        ("silent", "no image data within 0.5 s"),
        ("outside", "of a frame of 3072"),
        ("short", "bytes of image data instead of"),
        ("bits", "pixels of 16 bit instead of 8"),
    ],
)
def test_an_incomplete_frame_is_refused(peer: Peer, tmp_path: Path, fault: str, reason: str) -> None:
    assert reason in refused(peer, tmp_path, data_fault=fault)


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"speed": 2}, "dwell time 1e-06 s instead of 3.2e-06 s"),
        ({"field_mm": 0.21}, "field width 0.00021 m instead of 0.0002 m"),
        ({"estimate_s": 0.06}, "row time 0.00125 s instead of"),
        ({"rotation_deg": 2.0}, "rotation 2 deg instead of 0 deg"),
        ({"detector": 0}, "detector SE instead of BSE"),
        ({"beam": 0}, "its beam is off"),
    ],
)
def test_settings_that_change_during_the_scan_refuse_the_frame(peer: Peer, tmp_path: Path, changed: dict[str, Any], reason: str) -> None:
    peer.microscope.after_scan = changed
    assert reason in refused(peer, tmp_path)


@pytest.mark.parametrize(
    ("state", "reason"),
    [
        ({"beam": 0}, "its beam is off"),
        ({"beam": -1}, "its filament is blown"),
        ({"blanker": 1}, "its beam is blanked"),
        ({"external": 1}, "its scan is external"),
        ({"busy": 1 << 9}, "its stage moves"),
        ({"busy": 1 << 11}, "an automatic procedure is running"),
        ({"result": -1}, "refused the scan of 64 x 48 px at 3200 ns"),
        ({"speed": 9}, "no dwell time for its scan speed 9"),
        ({"field_mm": 0.0}, "reports a field of 0 mm"),
    ],
)
def test_a_microscope_that_cannot_scan_is_named(peer: Peer, tmp_path: Path, state: dict[str, Any], reason: str) -> None:
    assert reason in refused(peer, tmp_path, **state)


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("name", "answered TcpGetDevice"),
        ("identity", "to GetViewField"),
        ("short", "bytes to GetViewField"),
        ("late", "no answer to GetViewField within 0.5 s"),
        ("text", "'no number' to GetViewField, which is no number"),
        ("close", "closed the connection before the answer to GetViewField was complete"),
    ],
)
def test_a_wrong_or_late_reply_is_an_error(peer: Peer, tmp_path: Path, fault: str, reason: str) -> None:
    assert reason in refused(peer, tmp_path, wrong={"GetViewField": fault})


def test_a_command_that_is_ignored_costs_the_time_of_one_answer(peer: Peer, tmp_path: Path) -> None:
    began_s = time.monotonic()
    assert "no answer to ScScanXY within 0.5 s" in refused(peer, tmp_path, unanswered="ScScanXY")
    assert time.monotonic() - began_s < 4.0


def test_a_scan_that_takes_too_long_is_abandoned_and_writes_nothing(peer: Peer, tmp_path: Path) -> None:
    trigger = opened(peer, tmp_path, frame_timeout_s=0.3)
    peer.microscope.frame_s = 1.0
    with pytest.raises(LinkError, match=r"was not complete within 0.3 s|of the frame are missing"):
        trigger.scan_once()
    peer.microscope.frame_s = 0.05
    end_s = time.monotonic() + 10
    report, reasons = None, set[str]()
    while report is None:
        assert time.monotonic() < end_s
        try:
            report = trigger.scan_once()
        except LinkError as error:
            reasons.add(str(error))
            time.sleep(0.05)
    trigger.close()
    assert all("an earlier request is not finished" in reason for reason in reasons)
    assert {path.name for path in tmp_path.iterdir() if path.suffix == ".tif"} == {report.file}


def test_an_old_protocol_and_another_program_are_refused_at_the_start(peer: Peer, tmp_path: Path) -> None:
    peer.microscope.version = "2.0.5"
    with pytest.raises(LinkRefused, match=r"has SharkSEM '2.0.5', the trigger needs 2.0.9 or later"):
        opened(peer, tmp_path)
    peer.close()
    with pytest.raises(LinkRefused, match="no answer"):
        opened(peer, tmp_path)


def test_without_an_estimate_of_the_microscope_the_row_time_is_not_invented(peer: Peer, tmp_path: Path) -> None:
    peer.microscope.version = "2.0.22"
    report = scanned(peer, tmp_path)
    assert report.before.row_time_s is None
    assert "RowTime" not in (tmp_path / report.file).with_suffix(".hdr").read_text("cp1252")


def test_the_check_reports_and_changes_nothing(peer: Peer, tmp_path: Path) -> None:
    (found,) = check_device(settings(peer, tmp_path), WallClock())
    assert found.verdict is Verdict.UNKNOWN
    assert (
        "VG1234567US (SharkSEM 3.2.20) reports dwell time 3.2 us, row time 1.0417 ms, field width 200 um, 64 x 48 px" in found.observation
    )
    assert "not yet tried at a microscope" in found.advice
    assert {"ScScanXY", "ScStopScan", "GUISetScanning", "DtEnable"}.isdisjoint(peer.microscope.commands)
    peer.microscope.estimate_s = 60.0
    assert [finding.verdict for finding in check_device(settings(peer, tmp_path), WallClock())] == [Verdict.UNKNOWN, Verdict.FAILED]
    (missing,) = check_device(settings(peer, tmp_path / "none"), WallClock())
    assert "is no folder in which this user can write" in missing.observation
    peer.microscope.beam = 0
    (off,) = check_device(settings(peer, tmp_path), WallClock())
    assert (off.verdict, "its beam is off" in off.observation) == (Verdict.FAILED, True)


def test_settings_are_checked(peer: Peer, tmp_path: Path) -> None:
    with pytest.raises(BadConfig, match="sharksem trigger: bits"):
        opened(peer, tmp_path, bits=12)
    with pytest.raises(BadConfig, match="sharksem trigger: stage"):
        opened(peer, tmp_path, stage=1)
