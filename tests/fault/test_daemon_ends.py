"""The end of a run is bounded, whatever the disk, the run's folder or the analysis process do."""

from __future__ import annotations

import os
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from semlive.formats.log.messages import SEM_ORIGINAL
from semlive.service.log.files import messages

IMAGES = 40


def export(folder: Path, numbers: range, side_px: int) -> None:
    """Images as the SEM would write them, each from noise of its own."""
    for number in numbers:
        pixels = np.random.default_rng(number).integers(0, 256, (side_px, side_px), dtype=np.uint8)
        tifffile.imwrite(folder / f"image{number:03d}.tif", pixels)


def originals(log: Path) -> int:
    return sum(item.topic == SEM_ORIGINAL for item in messages(log))


def stopped(patient: Any, number: int = signal.SIGTERM) -> tuple[int, str, float]:
    """Exit code, last output, and the time to its end."""
    patient.daemon.send_signal(number)
    began_s = time.monotonic()
    code, printed = patient.end(90.0)
    return code, printed, time.monotonic() - began_s


def test_a_failed_fsync_is_reported_and_analysis_continues_in_the_next_segment(
    patient: Any, disk_peer: Path, monkeypatch: pytest.MonkeyPatch, wait_until: Callable[..., None], tmp_path: Path
) -> None:
    switches = tmp_path / "switches"
    switches.mkdir()
    monkeypatch.setenv("LD_PRELOAD", str(disk_peer))
    monkeypatch.setenv("SICK_DISK_ROOT", str(patient.log))
    monkeypatch.setenv("SICK_DISK_SWITCHES", str(switches))
    terminal, operator = os.openpty()
    patient.config["sem"]["profile"] = {"dwell_time_s": 1e-6, "row_time_s": 3e-4, "pixel_size_m": 1e-6}
    patient.start(operator=operator).reach("ramping")
    (switches / "fsync").write_text("1")
    export(tmp_path / "export", range(3), 256)
    wait_until(lambda: len(patient.logged("/sem/scan")) == 3)
    wait_until(lambda: any(item["after"] == "paused" for item in patient.logged("/state")))
    code, printed, took_s = stopped(patient)
    assert (code, "not analysed" in printed) == (1, False), printed
    assert took_s < 10.0
    faults = [item for item in patient.logged("/fault") if item["where"] == "log"]
    assert {item["code"] for item in faults} == {"log"}
    assert any("did not confirm what was written" in item["what"] for item in faults)
    assert any("read back from there" in item["what"] for item in faults)
    assert not any("nothing was lost" in item["what"] for item in faults)
    assert sorted(path.name for path in patient.log.iterdir()) == ["run.000.mcap", "run.001.mcap"]
    assert originals(patient.log) == 3
    assert "stop" in patient.calls()
    os.close(terminal)
    os.close(operator)


def test_a_run_whose_folder_is_deleted_ends_within_ten_seconds(patient: Any) -> None:
    patient.start().reach("ramping")
    began_s = time.monotonic()
    shutil.rmtree(patient.log)
    code, printed = patient.end(90.0)
    assert (code, "could not be finished" in printed) == (1, True), printed
    assert time.monotonic() - began_s < 10.0 + 5.0  # the log is missed after a second or more, then the run ends
    assert "stop" in patient.calls()


def test_a_run_ends_within_twenty_seconds_while_analysis_hangs(patient: Any, wait_until: Callable[..., None], tmp_path: Path) -> None:
    patient.start().reach("ramping")
    analysis = patient.child()
    os.kill(analysis, signal.SIGSTOP)
    export(tmp_path / "export", range(IMAGES), 1000)
    wait_until(lambda: originals(patient.log) == IMAGES)
    code, printed, took_s = stopped(patient)
    assert code == 1
    assert took_s < 20.0
    assert "the last pairs are not analysed; semlive replay" in printed
    patient.is_in_order()
    with pytest.raises(ProcessLookupError):
        os.kill(analysis, 0)
