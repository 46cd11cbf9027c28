"""The triggers over objects of vendors (SmartSEM, AutoScript) with stand-ins that follow their public descriptions."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from semlive.data.checks import Verdict
from semlive.errors import LinkError, LinkRefused
from semlive_drivers.microscope import autoscript, smartsem

from ...clocks import MonotonicClock
from .autoscript_peer import AutoScript, module
from .smartsem_peer import SmartSem, modules


@pytest.fixture
def zeiss(monkeypatch: pytest.MonkeyPatch) -> SmartSem:
    made = SmartSem()
    for name, fake in modules(made).items():
        monkeypatch.setitem(sys.modules, name, fake)
    return made


@pytest.fixture
def thermo(monkeypatch: pytest.MonkeyPatch) -> AutoScript:
    made = AutoScript()
    for name, fake in module(made).items():
        monkeypatch.setitem(sys.modules, name, fake)
    return made


def of_zeiss(folder: Path, **more: Any) -> dict[str, Any]:
    return {"folder": str(folder), "settle_s": 0, "frame_timeout_s": 10, **more}


def refused(opened: Callable[[], Any], folder: Path, spoil: Callable[[], object]) -> str:
    trigger = opened()
    spoil()
    with pytest.raises(LinkError) as refusal:
        trigger.scan_once()
    trigger.close()
    assert list(folder.iterdir()) == []
    return str(refusal.value)


def test_a_zeiss_frame_is_written_with_its_settings(zeiss: SmartSem, tmp_path: Path) -> None:
    trigger = smartsem.open_trigger(of_zeiss(tmp_path), MonotonicClock())
    zeiss.commands.clear()
    report = trigger.scan_once()
    assert report.before.row_time_s == pytest.approx(5.376e-3)
    assert report.before.dwell_time_s == pytest.approx(5.25e-6)
    assert (report.before.field_width_m, report.before.width_px, report.before.height_px) == (2.858e-4, 1024, 768)
    assert dict(report.after.others) == {"DP_NOISE_REDUCTION": "Line Avg", "DP_SCANRATE": "7", "AP_SCANROTATION": "0"}
    assert (tmp_path / report.file).read_bytes() == b"image"
    assert zeiss.commands == ["DP_FREEZE_ON=0", "CMD_UNFREEZE_ALL", "CMD_FREEZE_ALL", "Grab", "ClosingControl"]


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda z: z.texts.update(DP_RUNUPSTATE="EHT Off"), "its beam is not on but 'EHT Off'"),
        (lambda z: z.texts.update(DP_BEAM_BLANKED="Yes"), "its beam is blanked"),
        (lambda z: z.texts.update(AP_LINE_TIME="5.376"), "is no time with a unit"),
        (lambda z: z.texts.pop("DP_IMAGE_STORE"), "DP_IMAGE_STORE failed: unknown parameter (code 1000)"),
        (lambda z: setattr(z, "grab_code", 1016), "the image was not written (code 1016)"),
        (lambda z: setattr(z, "write", lambda path: None), "the folder must be reachable under this path there"),
        (lambda z: setattr(z, "connects", 2030), "the EM Server is not running (code 2030)"),
        (lambda z: setattr(z, "after_scan", lambda: z.numbers.update(AP_WIDTH=2.9e-4)), "field width 0.00029 m instead of 0.0002858 m"),
        (lambda z: setattr(z, "after_scan", lambda: z.texts.update(AP_LINE_TIME="10.75 ms")), "dwell time"),
        (lambda z: setattr(z, "after_scan", lambda: z.texts.update(DP_IMAGE_STORE="2048*1536")), "2048 x 1536 px instead of 1024 x 768"),
        (lambda z: setattr(z, "after_scan", lambda: z.texts.update(DP_NOISE_REDUCTION="Frame Avg")), "DP_NOISE_REDUCTION Frame Avg"),
    ],
)
def test_a_zeiss_frame_is_refused(zeiss: SmartSem, tmp_path: Path, spoil: Callable[[SmartSem], object], reason: str) -> None:
    assert reason in refused(lambda: smartsem.open_trigger(of_zeiss(tmp_path), MonotonicClock()), tmp_path, lambda: spoil(zeiss))


def test_a_com_call_that_never_returns_is_a_named_fault_and_blocks_no_one(zeiss: SmartSem, tmp_path: Path) -> None:
    hangs = threading.Event()
    zeiss.write = lambda path: hangs.wait(30)
    trigger = smartsem.open_trigger(of_zeiss(tmp_path, frame_timeout_s=1.5), MonotonicClock())
    began_s = time.monotonic()
    with pytest.raises(LinkError, match=r"the frame was not complete within 1\.5 s"):
        trigger.scan_once()
    with pytest.raises(LinkError, match="an earlier request is not finished"):
        trigger.scan_once()
    assert time.monotonic() - began_s < 15.0
    hangs.set()


def test_missing_com_support_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pythoncom", None)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(LinkRefused, match="run semlive on Windows for this trigger"):
        smartsem.open_trigger(of_zeiss(tmp_path), MonotonicClock())
    monkeypatch.setattr(sys, "platform", "win32")
    (found,) = smartsem.check_device(of_zeiss(tmp_path), MonotonicClock())
    assert (found.verdict, "pip install 'semlive[smartsem]'" in found.observation) == (Verdict.FAILED, True)


def test_a_thermo_fisher_frame_is_written_with_its_settings(thermo: AutoScript, tmp_path: Path) -> None:
    trigger = autoscript.open_trigger({"folder": str(tmp_path), "port": 6500, "bits": 16}, MonotonicClock())
    thermo.calls.clear()
    report = trigger.scan_once()
    assert (report.before.row_time_s, report.after.row_time_s) == (None, 1.6e-3)
    assert (report.before.dwell_time_s, report.before.field_width_m) == (1e-6, 1.28e-4)
    assert dict(report.before.others) == {"rotation": "0 rad", "tilt correction": "off", "dynamic focus": "off"}
    assert (tmp_path / report.file).read_bytes() == b"image"
    assert thermo.calls == ["connect('192.168.0.1', 6500)", "grab_frame 16", "disconnect"]


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda t: setattr(t.beam, "is_on", False), "its electron beam is off"),
        (lambda t: setattr(t.beam, "is_blanked", True), "its electron beam is blanked"),
        (lambda t: setattr(t, "device", 2), "its active view does not show the electron beam"),
        (lambda t: setattr(t.beam.scanning.mode, "value", 4), "not the full frame (mode 4)"),
        (lambda t: setattr(t.beam.scanning.resolution, "value", ""), "reports ''"),
        (lambda t: setattr(t, "answers", False), "no answer (the server is not running)"),
        (lambda t: setattr(t, "size_of_image", (768, 512)), "768 x 512 px instead of 1536 x 1024"),
        (lambda t: setattr(t, "dwell_of_image", 3e-6), "its dwell time is 3e-06 s instead of 1e-06 s"),
        (lambda t: setattr(t, "write", lambda path: None), "the image was not written"),
        (lambda t: setattr(t, "during_scan", lambda: setattr(t.beam.horizontal_field_width, "value", 1e-4)), "field width 0.0001 m"),
        (lambda t: setattr(t, "during_scan", lambda: setattr(t.beam, "is_on", False)), "its electron beam is off"),
        (lambda t: setattr(t, "during_scan", lambda: 1 / 0), "AutoScript at 192.168.0.1: ZeroDivisionError"),
    ],
)
def test_a_thermo_fisher_frame_is_refused(thermo: AutoScript, tmp_path: Path, spoil: Callable[[AutoScript], object], reason: str) -> None:
    assert reason in refused(lambda: autoscript.open_trigger({"folder": str(tmp_path)}, MonotonicClock()), tmp_path, lambda: spoil(thermo))


def test_autoscript_is_named_where_it_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "autoscript_sdb_microscope_client", None)
    with pytest.raises(LinkRefused, match="run semlive with the Python of AutoScript"):
        autoscript.open_trigger({"folder": str(tmp_path)}, MonotonicClock())


def test_the_checks_report_what_the_objects_report(zeiss: SmartSem, thermo: AutoScript, tmp_path: Path) -> None:
    (found,) = smartsem.check_device(of_zeiss(tmp_path), MonotonicClock())
    assert "ZEISS SmartSEM Merlin-61-50 reports dwell time 5.25 us, row time 5.376 ms" in found.observation
    (other,) = autoscript.check_device({"folder": str(tmp_path)}, MonotonicClock())
    assert "reports dwell time 1 us, row time not reported, field width 128 um, 1536 x 1024 px" in other.observation
    assert {found.verdict, other.verdict} == {Verdict.UNKNOWN}
    assert {"Grab", "CMD_UNFREEZE_ALL"}.isdisjoint(zeiss.commands)
    assert "grab_frame 8" not in thermo.calls
