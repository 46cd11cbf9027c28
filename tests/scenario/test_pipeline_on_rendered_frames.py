"""The pipeline alone, on frames that the simulator renders at the paper's size: no daemon, no folder, no clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from semlive import dic, pipeline
from semlive.data.experiment import Phase, Step
from semlive.data.frame import Frame, FrameInfo
from semlive.data.loading import FrameLoad
from semlive.data.pair import Pair, PairDecision
from semlive.data.results import RunResult
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import AnalysisSettings, DicSettings, SpecimenSettings
from semlive.errors import IllPosed
from semlive.formats.log.maps import encode_map
from semlive_simulators.microscope.render import render_frame
from semlive_simulators.scenario import Scenario, load_scenario
from semlive_simulators.specimen.specimen import at_rest

SHIFTS = [(0.0, 0.0), (25.3, 0.8), (-7.6, -20.9), (0.4, 28.7), (-27.8, 6.3)]
LOADS_N = [100.0, 1100.0, 2100.0]
PERIOD_S, PAIR_S = 95.07, 285.2
AREA_MM2, E_GPA, NU = 10.0, 71.1, 0.33


def frame(scenario: Scenario, number: int, start_s: float, shift_px: tuple[float, float], load_n: float) -> Frame:
    eyy = load_n / (AREA_MM2 * E_GPA * 1e3)
    motion = at_rest(shift_px, ((-NU * eyy, 0.0), (0.0, eyy)))
    image = render_frame(scenario, start_s, motion, number)
    file = Provenance.FILE
    timing = ScanTiming(Sourced(1e-4, file), Sourced(94.67 / 884, file), Sourced(94.67, file), Sourced(1, file))
    start = Sourced(round(start_s * 1e9), file)
    info = FrameInfo(number, f"{number}.tif", "fei", 1024, 884, 0, timing, start, 0.01, Sourced(1.25e-6, file))
    return Frame(info, image)


def pairs(scenario: Scenario) -> Sequence[Pair]:
    stops = [(Phase.CALIBRATION, shift, 0.0) for shift in SHIFTS] + [(Phase.TENSION, (0.0, 0.0), load) for load in LOADS_N]
    made = []
    for number, (phase, shift, load) in enumerate(stops):
        # Load also moves the field of view, as grips do.
        observed = (shift[0] + 0.0007 * load, shift[1] - 0.0019 * load)
        first, second = (frame(scenario, 2 * number + m, 60.0 + number * PAIR_S + m * PERIOD_S, observed, load) for m in (0, 1))
        held = FrameLoad(load, load, load, 0.0)
        step = Step(number, phase, shift, shift, load)
        made.append(Pair(PairDecision(number, step, first.info, second.info, (held, held)), first, second))
    return made


@pytest.fixture(scope="module")
def analysed() -> tuple[RunResult, Scenario]:
    scenario = load_scenario("paper_x200")
    settings = AnalysisSettings(specimen=SpecimenSettings("AL2024-T4", AREA_MM2, "y"))
    started = None
    for pair in pairs(scenario):
        started, result = pipeline.analyse(settings, started, pair)
        assert min(item.valid.mean() for item in result.maps) > 0.999
    assert started is not None
    return pipeline.finalise(started), scenario


def test_drift_within_each_frame_is_right(analysed: tuple[RunResult, Scenario]) -> None:
    result, scenario = analysed
    drift = result.estimate.drift
    true = scenario.drift.at(60.0 + drift.time_s)
    for number in np.unique(drift.frame):
        inside = drift.frame == number
        error = drift.drift_px[inside] - true[inside]
        assert np.sqrt(np.mean((error - error.mean(axis=0)) ** 2)) < 0.005


def test_unloaded_frames_keep_their_strain_at_zero(analysed: tuple[RunResult, Scenario]) -> None:
    for item in analysed[0].frames[: 2 * len(SHIFTS)]:
        mean = item.summary.mean
        assert max(abs(mean.exx), abs(mean.eyy), abs(mean.exy)) < 3e-5


def test_the_elastic_constants_come_out(analysed: tuple[RunResult, Scenario]) -> None:
    elastic = analysed[0].elastic
    assert elastic is not None
    assert elastic.youngs_modulus_gpa.value == pytest.approx(E_GPA, rel=0.01)
    assert elastic.poissons_ratio.value == pytest.approx(NU, abs=0.01)


def test_what_was_predicted_of_its_frames_gives_a_pair_the_same_maps_sooner() -> None:
    first, second = pairs(load_scenario("paper_x200"))[:2]
    started, _ = pipeline.analyse(AnalysisSettings(), None, first)
    precorrelated = {
        item.info.export: pipeline.precorrelate(started, item, first=expected)
        for item, expected in ((second.first, True), (second.second, False))
    }
    assert [item.prepared_reference is None for item in precorrelated.values()] == [False, True]
    plain, sooner = pipeline.correlate(started, second), pipeline.correlate(started, second, precorrelated)
    assert [encode_map(item) for item in sooner] == [encode_map(item) for item in plain]
    astray = {second.first.info.export: precorrelated[second.second.info.export]}
    assert encode_map(pipeline.correlate(started, second, astray)[1]) != encode_map(plain[1])


def test_integrated_scans_are_compared_when_the_pair_is_complete() -> None:
    first, second = pairs(load_scenario("paper_x200"))[:2]
    started, _ = pipeline.analyse(AnalysisSettings(), None, first)
    timing = replace(second.first.info.timing, integrations=Sourced(16, Provenance.FILE))
    precorrelation = pipeline.precorrelate(started, replace(second.first, info=replace(second.first.info, timing=timing)), first=True)
    assert precorrelation.prepared_reference is not None
    assert precorrelation.from_frame_0 is None


def test_two_stationary_frames_determine_the_drift_between_them() -> None:
    scenario = load_scenario("paper_x200")
    item = pairs(scenario)[1]
    observed = dic.hold_drift(item.first, item.second, DicSettings())
    start_s = np.array([info.start_time_ns.value / 1e9 for info in (item.first.info, item.second.info)])
    rows_s = np.linspace(0.0, 94.67, 200)
    before, after = (scenario.drift.at(begin_s + rows_s).mean(axis=0) for begin_s in start_s)
    true = (after - before) / (start_s[1] - start_s[0])
    assert max(observed.sigma_px_s) < 1e-4
    assert np.abs(np.array(observed.rate_px_s) - true).max() < 3 * max(observed.sigma_px_s) + 0.02 * np.abs(true).max()
    blank = replace(item.second, image=np.full_like(item.second.image, 90))
    with pytest.raises(IllPosed, match="less than half of the points"):
        dic.hold_drift(item.first, blank, DicSettings())


def test_a_pair_without_points_states_the_cause() -> None:
    item = pairs(load_scenario("paper_x200"))[0]
    mirrored = replace(item, second=replace(item.second, image=np.ascontiguousarray(item.second.image[:, ::-1])))
    with pytest.raises(
        IllPosed, match=r"no point of pair 0 was correlated, so it has no information: the current frame is mirrored .*left"
    ):
        pipeline.analyse(AnalysisSettings(), None, mirrored)
