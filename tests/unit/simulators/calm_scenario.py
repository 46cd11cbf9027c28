"""A scenario without other effects, and the largest displacement of an effect in it."""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import numpy as np

from semlive_simulators.effects.library import build_effects
from semlive_simulators.scenario import Scenario, load_scenario
from semlive_simulators.specimen.history import History, LoadStep, Move
from semlive_simulators.specimen.specimen import at_rest

STEPS = tuple(LoadStep(float(time_s), change_n) for time_s, change_n in ((500, 350.0), (3500, 1500.0), (6900, 350.0)))
MOVES = tuple(
    Move(float(time_s), (float(a), 0.0), (float(b), 0.0))
    for time_s, a, b in ((490, 0, 24), (595, 24, -24), (2000, -24, 40), (6000, 40, 32))
)
HISTORY = History(STEPS, MOVES)
STARTS_S = (0.0, 505.0, 600.0, 3600.0, 7000.0)


@functools.cache
def paper_x200() -> Scenario:
    return load_scenario("paper_x200")


def calm(magnification: str, chosen: dict[str, Any], width: int = 1024, height: int = 884, bits: int = 16) -> Scenario:
    paper = paper_x200()
    flat = dataclasses.replace(paper.distortion.x, constant_px=0, xx_px=0, xy_px=0, yy_px=0, wave_px=0)
    still = dataclasses.replace(paper.drift.x, warmup_px=0, linear_px_s=0, quadratic_px_s2=0)
    row_s = paper.scan.row_time_s
    scan = dataclasses.replace(paper.scan, width_px=width, height_px=height, frame_time_s=height * row_s)
    if magnification == "x10000":
        scan = dataclasses.replace(scan, dwell_time_s=5.1e-6, frame_time_s=height * 5.35e-3, pixel_size_um=0.025)
    return dataclasses.replace(
        paper,
        scan=scan,
        detector=dataclasses.replace(paper.detector, read_noise=0.0, shot_noise=0.0, bits=bits),
        distortion=dataclasses.replace(paper.distortion, x=flat, y=flat),
        drift=dataclasses.replace(paper.drift, x=still, y=still),
        effects=build_effects(chosen),
    )


def peak_px(scenario: Scenario) -> float:
    """Largest displacement over some rows of some frames of an experiment."""
    column, found = scenario.column(), 0.0
    for number, start_s in enumerate(STARTS_S):
        load_n = sum(step.change_n for step in STEPS if step.time_s <= start_s)
        motion = at_rest(load_n=load_n, history=HISTORY)
        for rows in (range(0, 12), range(400, 406), range(878, 884)):
            x_px, y_px, at = column.specimen_points(rows, 0, start_s, motion, 3 * number)
            found = max(found, float(np.hypot(at.x_px - x_px, at.y_px - y_px).max()))
    return found
