"""The live bench scans what `render_frame` renders, visit by visit as time passes, and keeps what a long frame needs to be true."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from semlive_simulators.bench_clock import BenchClock
from semlive_simulators.effects.composition import EffectSet
from semlive_simulators.effects.scan_deflection import Vibration
from semlive_simulators.effects.scan_timing import WrongRowTime
from semlive_simulators.effects.specimen_motion import StageStepTransient
from semlive_simulators.microscope.exposure import row_passes
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.microscope.sem import Exported, Sem
from semlive_simulators.scenario import Scenario, load_scenario
from semlive_simulators.specimen.machine import STEP_NS, LoadTrain
from semlive_simulators.specimen.stage import Actuator

RATE = 20.0
PAPER = load_scenario("paper_x200")
SCANS: dict[str, dict[str, Any]] = {
    "plain": {},
    "16 scans": {"integrations": 16},
    "lines": {"integrations": 3, "integration": "line"},
    "snake": {"integrations": 2, "direction": "snake"},
    "rotated": {"integrations": 2, "rotation_rad": 0.4},
    "interlaced": {"integrations": 2, "interlaced": True},
}


def small(**scan: Any) -> Scenario:
    raster = replace(PAPER.scan, width_px=96, height_px=75, dwell_time_s=1e-4, frame_time_s=1.2, gap_s=0.3, **scan)
    export = replace(PAPER.export, delay_s=0.05, duration_s=0.1, databar_rows=20)
    return replace(PAPER, scan=raster, export=export, first_scan_s=0.5)


def live(scenario: Scenario, folder: Path, frames: int = 1) -> tuple[list[Exported], LoadTrain, BenchClock]:
    """Frames of a bench on which load frame, stage and beam all move meanwhile."""
    clock = BenchClock(RATE, lambda _: None)
    machine = LoadTrain(scenario, clock.start_ns)
    exported: list[Exported] = []
    failures: list[BaseException] = []
    sem = Sem(scenario, clock, machine, folder, False, exported.append, failures.append)
    machine.ramp_to(1500.0, 300.0)
    machine.move_stage(12.0, -9.0)
    machine.move_stage(30.0, 20.0, Actuator.BEAM_SHIFT)
    clock.begin()
    sem.start()
    deadline = time.monotonic() + 100
    while len(exported) < frames and time.monotonic() < deadline and not failures:
        time.sleep(0.01)
    sem.stop()
    assert failures == []
    assert len(exported) >= frames
    return exported, machine, clock


@pytest.fixture(scope="module", autouse=True)
def warm_kernels() -> None:
    render_frame(small())
    render_frame(small(integrations=2))
    render_frame(replace(small(integrations=2), detector=replace(PAPER.detector, bits=16)))


@pytest.mark.parametrize(("kind", "bits"), [*((kind, 8) for kind in SCANS), ("16 scans", 16)])
def test_a_live_frame_is_the_rendered_one_to_the_last_bit(tmp_path: Path, kind: str, bits: int) -> None:
    scenario = replace(small(**SCANS[kind]), detector=replace(PAPER.detector, bits=bits))
    exported, _, clock = live(scenario, tmp_path)
    first = exported[0]
    assert first.window.moving
    start_s = (first.start_time_ns - clock.start_ns) * 1e-9
    shift_px = first.window.motion.shift_px
    assert np.ptp(shift_px[:, 0]) > 3  # or nothing would be tried
    assert np.array_equal(first.image, render_frame(scenario, start_s, first.window.motion, first.frame))


def test_effects_that_depend_on_moves_and_on_time_are_equal_in_a_live_scan(tmp_path: Path) -> None:
    effects = EffectSet((StageStepTransient(0.1, 5.0), WrongRowTime(0.044), Vibration.defaults("x200")))
    scenario = replace(small(integrations=4), effects=effects)
    exported, _, clock = live(scenario, tmp_path)
    first = exported[0]
    start_s = (first.start_time_ns - clock.start_ns) * 1e-9
    assert np.array_equal(first.image, render_frame(scenario, start_s, first.window.motion, first.frame))


def test_a_frame_takes_as_long_as_its_rows_do_not_as_the_header_reports(tmp_path: Path) -> None:
    scenario = replace(small(), effects=EffectSet((WrongRowTime(0.25),)))
    exported, _, _ = live(scenario, tmp_path, frames=2)
    assert exported[0].end_time_ns - exported[0].start_time_ns == 1_500_000_000
    assert exported[1].start_time_ns - exported[0].start_time_ns == 1_800_000_000
    assert exported[0].window.motion.time_s[-1] >= 0.5 + 1.5


@pytest.mark.parametrize("kind", ["16 scans", "lines", "snake", "rotated"])
def test_the_work_of_a_frame_is_spread_evenly_over_its_time(kind: str) -> None:
    column = load_scenario("paper_x10000").column()
    column = replace(column, scan=replace(column.scan, **{"integrations": 16, **SCANS[kind]}))
    work = row_passes(column)
    due_s = np.array([item.end_s for item in work])
    rows = np.array([item.end_row - item.first_row for item in work])
    done = np.cumsum(rows) / rows.sum()
    assert np.all(np.diff(due_s) >= 0)
    band = 57 / 884 if kind == "lines" else 57 / 884 / column.visits  # all visits of a line come before the next line's
    assert np.abs(done - due_s / column.duration_s).max() < band
    observed = {(row, item.visit) for item in work for row in range(item.first_row, item.end_row)}
    assert len(observed) == rows.sum() == column.visits * column.scan.height_px


def test_the_memory_of_motion_reaches_over_a_long_frame() -> None:
    """16 scans of 94.67 s are 25 minutes."""
    scenario = replace(PAPER, scan=replace(PAPER.scan, integrations=16))
    machine = LoadTrain(scenario, 0)
    frame_s = scenario.frame_duration_s
    assert frame_s == pytest.approx(1514.72)
    for end_s in (frame_s, 1.9 * frame_s, 2.9 * frame_s):  # the memory is cut back now and then
        machine.advance_to(round(end_s * 1e9))
        window = machine.window(end_s - frame_s, end_s)
        assert window.motion.time_s[0] <= end_s - frame_s
        assert window.motion.time_s[-1] >= end_s - STEP_NS * 1e-9


def test_beam_shifts_are_stored_separately_from_stage_moves() -> None:
    machine = LoadTrain(PAPER, 0)
    machine.move_stage(10.0, 0.0)
    machine.advance_to(5_000_000_000)
    machine.move_stage(-20.0, 5.0, Actuator.BEAM_SHIFT)
    machine.advance_to(8_000_000_000)
    history = machine.window(7.0, 8.0).motion.history
    assert [len(history.moves), len(history.beam_shifts), len(history.changes_s())] == [1, 1, 2]
    assert history.beam_shifts[0].from_px == (0.0, 0.0)
    assert history.beam_shifts[0].to_px == pytest.approx((-16.0, 4.0), abs=0.02)
    assert 5.0 < history.beam_shifts[0].time_s < 6.0
