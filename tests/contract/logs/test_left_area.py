"""A specimen that moves out of the calibrated area is reported with the pair that shows it, and not only at the end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numexp.asrun import decision_of
from numexp.cases import CASES
from numexp.experiment import make_experiment

from semlive import pipeline
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.results import PairResult
from semlive.data.settings import AnalysisSettings
from semlive.formats.log.messages import DriftMessage, FaultMessage, from_json
from semlive.service.analysis.messages import is_output
from semlive.service.analysis.results import result_messages


def loaded(beyond_px: float) -> PairResult:
    """The first load step after three pairs, its field carried away."""
    experiment, settings, started = make_experiment(CASES["tension"], 5, Grid(101, 101, 50, 15, 12, 43), 4), AnalysisSettings(), None
    for taken in experiment.pairs:
        decision, maps = decision_of(taken, taken.pair, settings), taken.maps
        started = started or pipeline.start_from_maps(settings, decision.first, experiment.grid)
        if taken.phase is Phase.TENSION:
            away = tuple(replace(item, v_px=np.asarray(item.v_px) + beyond_px) if item.reference == 0 else item for item in maps)
            return pipeline.add_pair(started, decision, away)[1]
        started = pipeline.accumulate(started, decision, maps)
    raise AssertionError("it has load steps")


def test_a_frame_beyond_the_calibrated_area_is_reported_at_once() -> None:
    reported = list(result_messages(loaded(120.0), 0.1))
    (fault,) = (from_json(item.topic, item.payload) for item in reported if item.topic == "/fault")
    assert isinstance(fault, FaultMessage)
    assert "of the points of frame 8 lie beyond the area that the calibration covered" in fault.what
    assert all(is_output(item) for item in reported)
    assert not [item for item in result_messages(loaded(0.0), 0.1) if item.topic == "/fault"]


def test_the_calibration_is_reported_with_every_pair() -> None:
    (drift,) = (from_json(item.topic, item.payload) for item in result_messages(loaded(0.0), 0.1) if item.topic == "/drift/estimate")
    assert isinstance(drift, DriftMessage)
    assert drift.calibration is not None
    assert min(drift.calibration.lever_px) > 10.0
    assert drift.calibration.wave_sigma_px is not None
