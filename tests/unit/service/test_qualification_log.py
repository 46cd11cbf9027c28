"""A log gives its pairs before the first load, with the positions of the stage in pixels of the files."""

from __future__ import annotations

import asyncio
import queue
from collections.abc import Container, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from semlive.cli.during_run.qualification_process import QualificationProcess
from semlive.data.experiment import Phase, Step
from semlive.data.frame import ExportedFile
from semlive.data.pair import Pair, PairDecision
from semlive.engine import OperatorCommand
from semlive.errors import BadInput
from semlive.formats import read_info
from semlive.formats.log import conversions as values
from semlive.formats.log.messages import SEM_ORIGINAL, FileMessage, RunMessage
from semlive.formats.log.writer import LogWriter
from semlive.qualify.protocol import STEPS as CROSS
from semlive.service.config.configuration import load_config, parse_config
from semlive.service.control.socket import ControlSocket, SocketAddress
from semlive.service.log.opened_log import OpenedLog
from semlive.service.log.settings import settings_of
from semlive.service.qualification.log_pairs import is_log, unloaded_count, unloaded_pairs
from semlive.service.qualification.plan import plan_of
from semlive.service.qualification.run import Progress, QualifyRequest, qualify_source
from semlive_simulators.exporters.image_metadata import ImageMetadata
from semlive_simulators.exporters.settings import Export, Vendor, WriteStyle
from semlive_simulators.scenario import load_scenario

from ...waiting import PATIENCE_S

S, BEGIN_NS = 10**9, 1_772_439_825 * 10**9
SCENARIO = load_scenario("rehearsal_short").scan
CONFIG = {
    "sem": {"folder": "/lab/export", "pixel_size_um": 1.25},
    "stage": {"driver": "null"},
    "protocol": {"calibration_shifts_px": [[0, 0], [12, 0]]},
}
_NOISE = np.random.default_rng(1).standard_normal((SCENARIO.height_px, SCENARIO.width_px))
_SMOOTH = np.asarray(gaussian_filter(_NOISE, 2.0, mode="wrap"))
PATTERN = 128.0 + 40.0 * _SMOOTH / _SMOOTH.std()
STEPS = (
    Step(0, Phase.CALIBRATION, (0.0, 0.0), (0.0, 0.0), None),
    Step(1, Phase.CALIBRATION, (15.0, -2.5), (12.0, 0.0), None),  # recentred by -2 px along y
    Step(2, Phase.TENSION, (0.0, 0.0), (0.0, 0.0), 100.0),
)


def _file(export: int, shift_px: tuple[float, float] = (0.0, 0.0)) -> ExportedFile:
    """A frame of a periodic pattern with its own noise."""
    moved = np.roll(PATTERN, (round(shift_px[1]), round(shift_px[0])), (0, 1))
    image = np.clip(np.rint(moved + 4.0 * np.random.default_rng(export).standard_normal(moved.shape)), 0, 255).astype(np.uint8)
    end_ns = BEGIN_NS + 30 * export * S
    exporter = Export(WriteStyle.DIRECT, 0.0, 1.0, 1, 0, "x", Vendor.FEI)
    data = exporter.encode(image, ImageMetadata(SCENARIO, end_ns, 0, 0, export, f"x{export}.tif")).image
    return ExportedFile(export, f"x{export}.tif", data, "", end_ns, end_ns)


def _write(path: Path, imaged: Container[int] = (0, 1, 2), config: dict[str, Any] = CONFIG, steps: Sequence[Step] = STEPS) -> None:
    """A log with the images of some of its steps. The run determined the start of the first frames to 0.25 s."""
    profile = parse_config(CONFIG, "test").sem.scan_profile
    with path.open("wb") as stream:
        writer = LogWriter(stream)
        writer.write("/run", RunMessage(run="a", started_time_ns=BEGIN_NS, host="h", versions={}, config=config), BEGIN_NS, BEGIN_NS)
        for step in steps:
            files = [_file(2 * step.step + member, step.shift_px) for member in (0, 1)]
            for file in files if step.step in imaged else ():
                now_ns = file.arrival_time_ns
                arrived = FileMessage(
                    export=file.index, name=file.name, size=len(file.data), sha256="", mtime_ns=file.mtime_ns, arrival_time_ns=now_ns,
                    decision="arrived", reason="",
                )  # fmt: skip
                writer.write("/sem/file", arrived, now_ns, now_ns)
                writer.write(SEM_ORIGINAL, file.data, now_ns, now_ns, file.index)
            first, second = (read_info(file, profile) for file in files)
            decision = PairDecision(step.step, step, replace(first, start_sigma_s=0.25), second, None)
            writer.write("/pair", values.pair_message(decision), second.end_time_ns, second.end_time_ns)
        writer.finish()


def _read(path: Path) -> tuple[list[Pair], list[str]]:
    log, not_paired = OpenedLog(path), list[str]()
    return list(unloaded_pairs(log.messages(), path, settings_of(log.run).scan, not_paired)), not_paired


def test_pairs_under_load_are_omitted(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    _write(path)
    assert is_log(path)
    assert is_log(tmp_path)
    assert unloaded_count(OpenedLog(path).run, path) == 2
    pairs, not_paired = _read(path)
    assert ([pair.decision.pair for pair in pairs], not_paired) == ([0, 1], [])
    assert pairs[1].decision.step.shift_px == pytest.approx((12.0, -2.0))
    assert pairs[1].first.info.start_sigma_s == 0.25
    assert pairs[1].second.image.shape == (SCENARIO.height_px, SCENARIO.width_px)


def test_pairs_without_images_are_named(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    _write(path, (1, 2))
    pairs, not_paired = _read(path)
    assert [pair.decision.step.shift_px[0] for pair in pairs] == pytest.approx([12.0])
    assert [text.split(":")[0] for text in not_paired] == ["x0.tif", "x1.tif"]


def test_a_log_without_frames_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    _write(path, (2,))
    with pytest.raises(BadInput, match="images of its 2 pairs without load are not in it"):
        _read(path)
    _write(path, config={"imported": {"folder": "maps", "engines": ["ncorr"]}})
    with pytest.raises(BadInput, match="maps of another program"):
        qualify_source(QualifyRequest(path))


def test_the_instrument_of_a_log_takes_the_next_protocol(tmp_path: Path) -> None:
    log, path = tmp_path / "a.mcap", tmp_path / "next.yaml"
    _write(log)
    path.write_text(plan_of(log).text, encoding="utf-8")
    config = load_config(path)
    assert (config.sem.folder, config.run.name) == (Path("/lab/export"), "run-qualify")
    assert max(x for x, _ in config.protocol.calibration_shifts_px) == 12.0


def _write_two_crosses(path: Path) -> list[tuple[float, float]]:
    """A log with twice the pairs that a qualification needs; returns their shifts."""
    shifts = [(6.0 * x, 6.0 * y) for x, y in (*CROSS, *CROSS)]
    config = {**CONFIG, "protocol": {"calibration_shifts_px": [list(shift) for shift in shifts]}}
    steps = [Step(number, Phase.CALIBRATION, (1.25 * x, 1.25 * y), (x, y), None) for number, (x, y) in enumerate(shifts)]
    _write(path, range(len(steps)), config, steps)
    return shifts


def test_a_run_is_stopped_as_soon_as_no_figure_needs_further_pairs(tmp_path: Path) -> None:
    pairs, lines = len(_write_two_crosses(tmp_path / "a.mcap")), list[str]()
    commands: queue.SimpleQueue[tuple[OperatorCommand, str]] = queue.SimpleQueue()

    async def served() -> tuple[OperatorCommand, str]:
        control = ControlSocket(lambda command, origin: commands.put((command, origin)), lambda *_: True, lambda *_: True)
        process = QualificationProcess(tmp_path, lines.append)
        process.start(await control.open())
        try:
            return await asyncio.to_thread(commands.get, timeout=PATIENCE_S)
        finally:
            process.close()
            control.close()

    assert asyncio.run(served()) == (OperatorCommand.STOP, "semlive qualify")
    evaluated = [line for line in lines if line.startswith("pair ")]
    assert 5 <= len(evaluated) < pairs
    assert evaluated[-1] == f"pair {len(evaluated)} of {pairs}: every figure is known well enough"


def test_a_run_whose_pairs_cannot_be_evaluated_is_not_stopped(tmp_path: Path) -> None:
    _write(tmp_path / "a.mcap", imaged=())
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    process = QualificationProcess(tmp_path, lines.put)
    process.start(SocketAddress("127.0.0.1", 9, "no run"))
    try:
        while "cannot be read" not in lines.get(timeout=PATIENCE_S):
            pass
    finally:
        process.close()
    assert not process.has_stopped_run


def test_a_growing_log_is_followed_until_no_figure_needs_further_pairs(tmp_path: Path) -> None:
    shifts = _write_two_crosses(tmp_path / "a.mcap")
    reported: list[Progress] = []
    found = qualify_source(QualifyRequest(tmp_path, search_effects=False, follow=True), report=reported.append)
    assert [item.pairs for item in reported] == list(range(1, found.conditions.pairs + 1))
    assert {item.planned for item in reported} == {len(shifts)}
    assert {"distortion", "drift_decay", "stage"} <= {need.name for need in reported[0].needs}
    # Two frames of 30 s for each pair.
    assert reported[1].left_s == pytest.approx(60.0 * (len(shifts) - 2), abs=1.0)
    assert 5 <= found.conditions.pairs < len(shifts)
    assert (reported[-1].needs, reported[-1].left_s) == ((), 0.0)
