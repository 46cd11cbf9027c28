"""Analysis of exported files as the log records them: sidecar texts, frozen images, other clocks."""

from __future__ import annotations

import dataclasses
import hashlib
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from semlive.data.clock import Clock
from semlive.data.frame import ExportedFile
from semlive.data.scan import Provenance
from semlive.formats.log.messages import (
    SEM_ORIGINAL,
    SEM_SIDECAR,
    ClockOffsetMessage,
    FileMessage,
    RunMessage,
    ScanMessage,
    StateMessage,
    from_json,
    to_json,
)
from semlive.formats.log.reader import LogMessage
from semlive.inputs.mask_file import embedded_mask
from semlive.service.analysis.messages import is_output
from semlive.service.analysis.step import WorkerState, process_message
from semlive.service.config.configuration import parse_config
from semlive.service.log.files import messages
from semlive.service.log.recording import Recorder
from semlive.service.log.run_log import RunLog
from semlive_simulators.exporters.image_metadata import EncodedFrame, ImageMetadata
from semlive_simulators.exporters.settings import Export, Vendor, WriteStyle
from semlive_simulators.scenario import load_scenario

S = 10**9
END_NS = 1_772_439_825 * S
SCAN = dataclasses.replace(load_scenario("paper_x200").scan, width_px=64, height_px=48, frame_time_s=0.48)
CONFIG = {
    "sem": {
        "folder": "export",
        "pixel_size_um": 1.25,
        "vendor": "jeol",
        "scan_profiles": [{"scan_speed": "9", "dwell_time_s": 1e-4, "row_time_s": 0.01}],
    },
    "stage": {"driver": "null"},
    "protocol": {"calibration_shifts_px": [[0, 0]]},
}


def product(seed: int, vendor: Vendor = Vendor.JEOL, frame: int = 0) -> EncodedFrame:
    image = np.random.default_rng(seed).integers(0, 256, (48, 64), dtype=np.uint8)
    return Export(WriteStyle.DIRECT, 0.0, 1.0, 1, 0, "x", vendor).encode(
        image, ImageMetadata(SCAN, END_NS + frame * S, 0, 0, frame, "a.tif")
    )


def exported(number: int, made: EncodedFrame, settled_ns: int = END_NS + S) -> ExportedFile:
    sha256 = hashlib.sha256(made.image).hexdigest()
    return ExportedFile(number, f"x_{number}.tif", made.image, sha256, settled_ns, settled_ns + 2 * S, made.sidecar, settled_ns)


class _Now:
    """A clock that does not advance."""

    def now_ns(self) -> int:
        return END_NS

    def mono_ns(self) -> int:
        return END_NS

    def current(self) -> Clock:
        return Clock(END_NS, END_NS)


def logged(tmp_path: Path, *files: ExportedFile, given: dict[str, Any] = CONFIG) -> list[LogMessage]:
    """The log of a run in which these files arrived."""
    shutil.rmtree(tmp_path / "run", ignore_errors=True)
    (tmp_path / "run").mkdir()
    recorder = Recorder(tmp_path / "run" / "run.000.mcap", _Now(), lambda _: None)
    journal = RunLog(recorder)
    config = parse_config(given, "here").model_dump(mode="json")
    journal.write_message(RunMessage(run="run", started_time_ns=END_NS, host="here", versions={}, config=config))
    for file in files:
        journal.file(file)
    assert recorder.close()
    return list(messages(tmp_path / "run"))


def analysed(log: list[LogMessage]) -> list[object]:
    state, reported = WorkerState(), []
    for message in log:
        state, outputs = process_message(state, message)
        reported += [from_json(item.topic, item.payload) for item in outputs]
    return reported


@pytest.mark.parametrize(("guards", "early_s"), [({"held_s": 30.2, "late_s": 0.2}, 0.2), ({"held_s": 30.2}, 0.0)])
def test_a_frame_that_began_before_the_end_of_the_hold_was_noticed_is_meant_for_the_pair(guards: dict[str, Any], early_s: float) -> None:
    over = StateMessage(time_ns=END_NS, before="holding", after="imaging", cause="hold_over", step=0, guards=guards)
    state, _ = process_message(WorkerState(), LogMessage("/state", END_NS, END_NS, 0, to_json(over)))
    assert state.imaging_since_ns == END_NS - round(early_s * S)


def test_bytes_of_image_and_text_are_in_the_log_before_anything_is_decoded(tmp_path: Path) -> None:
    made = product(1)
    log = logged(tmp_path, exported(0, made))
    assert [item.topic for item in log] == ["/run", "/sem/file", SEM_SIDECAR, SEM_ORIGINAL]
    assert [item.payload for item in log[2:]] == [made.sidecar, made.image]
    file = from_json("/sem/file", log[1].payload)
    assert isinstance(file, FileMessage)
    assert file.sidecar_sha256 == hashlib.sha256(made.sidecar or b"").hexdigest()
    assert file.settled_time_ns == END_NS + S


def test_a_jeol_pair_of_files_becomes_a_scan_with_times_by_its_speed(tmp_path: Path) -> None:
    [scan] = [item for item in analysed(logged(tmp_path, exported(0, product(1)))) if isinstance(item, ScanMessage)]
    assert (scan.vendor, scan.width_px, scan.height_px) == ("jeol", 64, 48)
    assert (scan.row_time_s.value, scan.row_time_s.source) == (0.01, Provenance.CONFIG)
    assert scan.column.detector is not None
    assert scan.column.detector.value == "BED-C"
    assert scan.start_anchor == "end"
    assert from_json("/sem/scan", to_json(scan)) == scan


def test_a_text_belongs_to_its_own_image_alone(tmp_path: Path) -> None:
    alone = dataclasses.replace(exported(1, product(2)), sidecar=None)
    reported = analysed(logged(tmp_path, exported(0, product(1)), alone))
    refused = [item for item in reported if isinstance(item, FileMessage)]
    assert [(item.export, item.decision) for item in refused] == [(1, "refused")]
    assert "does not contain its dwell time" in refused[0].reason


def test_frozen_pixels_under_a_new_header_are_refused(tmp_path: Path) -> None:
    reported = analysed(logged(tmp_path, exported(0, product(1)), exported(1, product(1, frame=7)), exported(2, product(2))))
    refused = [item for item in reported if isinstance(item, FileMessage)]
    assert [item.reason for item in refused] == ["x_1.tif: shows the same pixels as x_0.tif; the SEM's image is frozen, so let it scan."]
    assert [item.export for item in reported if isinstance(item, ScanMessage)] == [0, 2]


@pytest.mark.parametrize("late_s", [1, 3601])
def test_clock_offsets_of_sem_and_share_are_reported_with_the_first_frame(tmp_path: Path, late_s: int) -> None:
    reported = analysed(logged(tmp_path, exported(0, product(1), END_NS + late_s * S)))
    clocks = {item.clock: item for item in reported if isinstance(item, ClockOffsetMessage)}
    assert clocks["sem"].offset_s == pytest.approx(0.5 - late_s)
    assert clocks["share"].offset_s == 0.0
    assert bool(clocks["sem"].advice) == (late_s > 60)


def test_clock_offsets_reported_by_analysis_count_as_its_own_in_a_resumed_run(tmp_path: Path) -> None:
    state, outputs = WorkerState(), []
    for message in logged(tmp_path, exported(0, product(1)), exported(1, product(1)), exported(2, product(2))):
        state, more = process_message(state, message)
        outputs += more
    assert {item.topic for item in outputs} == {"/log", "/clock/offset", "/sem/scan", "/sem/file"}
    assert all(is_output(item) for item in outputs)
    requests = ClockOffsetMessage(clock="share", offset_s=0.0, sigma_s=0.1, files=0, export=None, reason="a file was written to it")
    assert not is_output(LogMessage("/clock/offset", 1, 1, 0, to_json(requests)))


def test_a_frame_of_another_size_than_the_mask_is_refused_before_a_pair_is_formed(tmp_path: Path) -> None:
    mask = cv2.imencode(".png", np.eye(80, dtype=np.uint8) * 255)[1].tobytes()
    config = {**CONFIG, "dic": {"subset_px": 21, "roi_px": None, "mask": embedded_mask(mask, "mask.png")}}
    log = logged(tmp_path, exported(0, product(1)), given=config)
    (refused,) = (message for message in analysed(log) if isinstance(message, FileMessage))
    assert refused.decision == "refused"
    assert "the mask is 80 x 80 px but the frame 64 x 48 px" in refused.reason
