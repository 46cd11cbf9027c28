"""The real daemon takes its frames from a TESCAN microscope that follows the manual, over TCP."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy import ndimage

from semlive.service.checks.instrument import check_trigger
from semlive.service.config.configuration import load_config
from semlive.service.log.files import messages

from ...waiting import RUN_END_S
from .sharksem_peer import Microscope, Peer

SIZE = 160


def speckle(width: int, height: int, bits: int, seed: int) -> bytes:
    """The same pattern in every frame, and noise of its own."""
    pattern = ndimage.gaussian_filter(np.random.default_rng(1).standard_normal((height, width)), 2.0)
    noise = np.random.default_rng(seed).standard_normal((height, width))
    return np.clip(128 + 40 * pattern / pattern.std() + 2 * noise, 1, 254).astype(np.uint8).tobytes()


@pytest.fixture
def peer() -> Iterator[Peer]:
    made = Peer(Microscope(image=speckle, frame_s=0.2))
    yield made
    made.close()


def configured(peer: Peer, folder: Path) -> Path:
    export = folder / "export"
    export.mkdir()
    settings = {"folder": str(export), "host": "127.0.0.1", "port": peer.port, "width_px": SIZE, "height_px": SIZE}
    config = {
        "run": {"name": "run", "folder": "log"},
        "sem": {
            "folder": "export",
            "pixel_size_um": 1.25,
            "poll_s": 0.05,
            "stable_for_s": 0.1,
            "profile": {"start_sigma_s": 0.05},
            "trigger": {"driver": "sharksem", "settings": {**settings, "answer_timeout_s": 10.0}},
        },
        "protocol": {"calibration_shifts_px": [[0, 0]], "hold_s": 0.1, "settle_s": 0.1, "frame_timeout_s": 60},
        "dic": {"subset_px": 31, "step_px": 16, "roi_px": None},
        "estimate": {"accept_poor_calibration": True},
    }
    path = folder / "run.yaml"
    path.write_text(yaml.safe_dump(config), encoding="utf-8")
    return path


def semlive(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "semlive", *arguments], capture_output=True, text=True, timeout=RUN_END_S, check=False)


def logged(folder: Path, topic: str) -> list[dict[str, Any]]:
    return [json.loads(item.payload) for item in messages(folder / "log" / "run") if item.topic == topic]


def test_a_pair_is_scanned_on_request_and_its_settings_are_in_the_log(peer: Peer, tmp_path: Path) -> None:
    path = configured(peer, tmp_path)
    done = semlive("run", str(path), "--no-page", "--stop-on-fault")
    assert done.returncode == 0, done.stderr
    (pair,) = logged(tmp_path, "/pair")
    scans = logged(tmp_path, "/sem/trigger")
    triggers = [command for command in logged(tmp_path, "/command") if command["what"] == "trigger"]
    assert [scan["file"] for scan in scans][-2:] == [pair["first"]["name"], pair["second"]["name"]]
    assert len(triggers) == len(scans) == len(peer.microscope.scans)
    for scan in scans:
        for reading in (scan["before"], scan["after"]):
            assert (reading["dwell_time_s"], reading["field_width_m"]) == (pytest.approx(3.2e-6), pytest.approx(2e-4))
            assert reading["row_time_s"] == pytest.approx(0.2 / SIZE)
        assert scan["before"]["others"]["detector"] == "BSE"
    assert pair["first"]["timing"]["row_time_s"] == {"value": pytest.approx(0.2 / SIZE), "source": "file"}
    assert pair["first"]["pixel_size_m"]["value"] == pytest.approx(2e-4 / SIZE)
    config = load_config(path)
    (found,) = check_trigger(config)
    assert "reports dwell time 3.2 us, row time 1.25 ms, field width 200 um, 160 x 160 px" in found.observation
    elsewhere = config.model_copy(update={"sem": config.sem.model_copy(update={"folder": tmp_path})})
    wrong, _ = check_trigger(elsewhere)
    assert f"the trigger writes into {tmp_path / 'export'}, the run reads {tmp_path}" in wrong.observation


def test_a_field_that_changes_during_a_scan_ends_in_a_named_fault(peer: Peer, tmp_path: Path) -> None:
    peer.microscope.after_scan = {"field_mm": 0.3}
    done = semlive("run", str(configured(peer, tmp_path)), "--no-page", "--stop-on-fault")
    assert done.returncode == 1, done.stderr
    # On a busy computer the run also reports at its end that its analysis was not ready.
    (fault,) = [item for item in logged(tmp_path, "/fault") if item["where"] == "SEM"]
    assert "the frame is refused: its settings changed during the scan, field width 0.0003 m instead of 0.0002 m" in fault["what"]
    assert logged(tmp_path, "/sem/trigger") == []
    assert not list((tmp_path / "export").glob("*.tif"))
