"""A score's reading of the truth against the simulated column itself: both must show the same material point."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from semlive.data.frame import FrameInfo
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.report.scoring.truth import Truth, true_motion
from semlive_simulators.scenario import Scenario, load_scenario
from semlive_simulators.specimen.specimen import Motion, at_rest
from semlive_simulators.truth import TruthRecorder as Kept
from semlive_simulators.truth import frame_truth

START_NS = 1_767_600_000_000_000_000
MOTIONS = (at_rest((0.3, -0.2), ((1e-5, -2e-5), (2e-5, 0.0))), at_rest((14.0, -9.0), ((-1e-3, -2e-4), (4e-4, 3.1e-3)), load_n=2200.0))
STARTS_S = (40.0, 1900.0)


def info(scenario: Scenario, number: int) -> FrameInfo:
    scan, file = scenario.scan, Provenance.FILE
    timing = ScanTiming(
        Sourced(scan.dwell_time_s, file),
        Sourced(scan.row_time_s, file),
        Sourced(scan.frame_time_s, file),
        Sourced(scan.integrations, file),
    )
    start = Sourced(START_NS + round(STARTS_S[number] * 1e9), file)
    return FrameInfo(number, f"{number}.tif", "fei", scan.width_px, scan.height_px, 0, timing, start, 0.0, Sourced(1e-6, file))


def recorded_truth(scenario: Scenario) -> Truth:
    stored = Kept(scenario, START_NS)
    for number, motion in enumerate(MOTIONS):
        start_ns = START_NS + round(STARTS_S[number] * 1e9)
        stored.add_frame(frame_truth(scenario, f"{number}.tif", start_ns, STARTS_S[number], motion, 0.0, False), motion.history)
    return Truth.of(json.loads(stored.encode(START_NS + 2_400_000_000_000, 0, 0.0)))


def material(scenario: Scenario, motion: Motion, number: int, address_px: np.ndarray) -> np.ndarray:
    """(n, 2) material points at scan addresses (n, 2), mean over the visits, from the column."""
    column, points = scenario.column(), []
    low, high = int(address_px[:, 1].min()) - 20, int(address_px[:, 1].max()) + 21
    for visit in range(column.timing.row_start_s.shape[0]):
        x, y, _ = column.specimen_points(range(low, high), visit, STARTS_S[number], motion, number)
        at = np.stack((address_px[:, 1] - low, address_px[:, 0]))
        points.append(np.stack([map_coordinates(item, at, order=3) for item in (x, y)], axis=-1))
    return np.mean(points, axis=0)


@pytest.mark.parametrize("name", ["paper_x200", "paper_x10000"])
def test_points_are_followed_to_where_the_column_shows_them(name: str) -> None:
    scenario = load_scenario(name)
    if scenario.scan.integrations > 1:
        scenario = replace(scenario, scan=replace(scenario.scan, integrations=4))
    x, y = np.meshgrid(np.linspace(110, 840, 5), np.linspace(380, 520, 4))
    address = np.stack((x.ravel(), y.ravel()), axis=-1)
    found = true_motion(recorded_truth(scenario), info(scenario, 0), info(scenario, 1), address)
    here = material(scenario, MOTIONS[0], 0, address)
    there = material(scenario, MOTIONS[1], 1, address + found.displacement_px + found.correction_px)
    assert np.abs(there - here).max() < 2e-4
    assert np.abs(found.correction_px).max() > 0.3
