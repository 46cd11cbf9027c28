"""An experiment as a run: decisions for the pipeline, and the truth as a simulator writes it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numexp.experiment import Experiment, Taken, timing
from numexp.world import HEIGHT_PX, ROW_S, SCAN, WIDTH_PX, start_s

from semlive import pipeline
from semlive.data.experiment import Step
from semlive.data.frame import FrameInfo
from semlive.data.loading import FrameLoad
from semlive.data.pair import PairDecision
from semlive.data.results import RunResult
from semlive.data.scan import Provenance, Sourced
from semlive.data.settings import AnalysisSettings

START_NS = 1_700_000_000_000_000_000
EVERY_PX = 10


def concluded(experiment: Experiment, settings: AnalysisSettings) -> RunResult:
    """What the pipeline makes of an experiment's maps; loads are as the specimen's settings and E of 71.1 GPa have it."""
    started = None
    for taken in experiment.pairs:
        decision = decision_of(taken, taken.pair, settings)
        started = started or pipeline.start_from_maps(settings, decision.first, experiment.grid)
        started = pipeline.accumulate(started, decision, taken.maps)
    assert started is not None  # an experiment has pairs
    return pipeline.finalise(started)


def decision_of(taken: Taken, pair: int, settings: AnalysisSettings) -> PairDecision:
    """The decision for a pair that shows what one of the experiment's does."""
    first, second = (frame_info(2 * pair + member) for member in (0, 1))
    load_n = float(taken.observed[-1].gradient[1, 1]) * 71.1e3 * (settings.specimen.area_mm2 or 0.0)
    held = FrameLoad(load_n, load_n, load_n, 0.0)
    return PairDecision(pair, Step(pair, taken.phase, (0.0, 0.0), (0.0, 0.0), load_n), first, second, (held, held))


def frame_info(frame: int) -> FrameInfo:
    """Content of the file of a frame."""
    source = Provenance.CONFIG
    start = Sourced(START_NS + round(start_s(frame) * 1e9), source)
    return FrameInfo(frame, _name(frame), "plain", WIDTH_PX, HEIGHT_PX, 0, timing(), start, 0.01, Sourced(1.25e-6, source))


def _name(frame: int) -> str:
    return f"{frame:04d}.tif"


def truth(experiment: Experiment) -> dict[str, Any]:
    """The content of a truth file."""
    time_s = np.arange(0.0, start_s(2 * len(experiment.pairs)) + SCAN.frame_time_s, 5.0)
    drift = experiment.world.column.drift.at(time_s)
    x_px, y_px = (np.arange(0.0, size + EVERY_PX, EVERY_PX) for size in (WIDTH_PX, HEIGHT_PX))
    bend = experiment.world.bend_px(np.stack(np.meshgrid(x_px, y_px), axis=-1))
    return {
        "youngs_modulus_gpa": 71.1,
        "poissons_ratio": 0.33,
        "centre_px": SCAN.centre_px.tolist(),
        "start_time_ns": START_NS,
        "frames": [
            {
                "file": _name(2 * taken.pair + member),
                "start_time_ns": START_NS + round(start_s(2 * taken.pair + member) * 1e9),
                "row_time_s": ROW_S,
                "stage_px": taken.shift_px.tolist(),
                "gradient": taken.observed[-1].gradient.tolist(),
            }
            for taken in experiment.pairs
            for member in (0, 1)
        ],
        "drift": {"time_ns": [START_NS + round(t * 1e9) for t in time_s], "dx_px": drift[:, 0].tolist(), "dy_px": drift[:, 1].tolist()},
        "distortion": {"x_px": x_px.tolist(), "y_px": y_px.tolist(), "ex_px": bend[..., 0].tolist(), "ey_px": bend[..., 1].tolist()},
    }
