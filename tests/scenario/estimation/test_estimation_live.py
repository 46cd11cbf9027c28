"""A run followed pair by pair: the immediate report uses all pairs, and earlier reports are revised where they moved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from semlive import estimate as estimating
from semlive import pipeline
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase, Step
from semlive.data.frame import FrameInfo
from semlive.data.loading import FrameLoad
from semlive.data.pair import PairDecision
from semlive.data.results import PairResult
from semlive.data.scan import Provenance, Sourced
from semlive.data.settings import AnalysisSettings
from semlive.estimate.joint.elimination.smoother import LIVE_WINDOW_PAIRS
from semlive.estimate.joint.solution.solver import selection_due

E_GPA = 71.1
COMPONENTS = ("exx", "eyy", "exy")


def settings(method: str = "joint") -> AnalysisSettings:
    plain = AnalysisSettings()
    return replace(plain, specimen=replace(plain.specimen, area_mm2=1.0), estimate=replace(plain.estimate, method=method))


def info(when: FrameTime) -> FrameInfo:
    source = Provenance.CONFIG
    start = Sourced(10**18 + round(when.start_s * 1e9), source)
    return FrameInfo(when.frame, f"{when.frame}.tif", "plain", 1024, 884, 0, when.timing, start, 0.01, Sourced(1e-6, source))


def decision(taken: Any) -> PairDecision:
    load_n = 1e3 * E_GPA * taken.step.strain
    held = FrameLoad(load_n, load_n, load_n, 0.0)
    step = Step(taken.pair, taken.step.phase, (0.0, 0.0), (0.0, 0.0), load_n)
    return PairDecision(taken.pair, step, info(taken.times[0]), info(taken.times[1]), (held, held))


def followed(taken: list[Any], method: str = "joint") -> tuple[pipeline.AnalysisState, list[PairResult]]:
    started, printed = None, []
    for item in taken:
        named = decision(item)
        started = started or pipeline.start_from_maps(settings(method), named.first, item.maps[0].grid)
        started, result = pipeline.add_pair(started, named, item.maps)
        started, reviewed = pipeline.review_hyperparameters(started)
        printed += [result, reviewed] if reviewed else [result]
    assert started is not None
    return started, printed


@pytest.fixture(scope="module")
def early_load(world: Callable[..., Any], plans: dict[str, list[Any]]) -> list[Any]:
    """Three load steps after one translation; the calibration that shows the distortion comes when they have been corrected."""
    cross, loaded = plans["short"][:5], plans["short"][6:]
    return list(world(230, step_px=45).pairs([*cross[:2], *loaded, *cross[2:]]))


def test_frames_that_moved_by_more_than_their_sigma_are_revised(early_load: list[Any]) -> None:
    started, printed = followed(early_load)
    reported: dict[int, Any] = {}
    revisions = 0
    for result in printed:
        own = {item.summary.frame for item in result.frames}
        assert not own & {item.summary.frame for item in result.revised_frames}
        for item in result.revised_frames:
            before, now = reported[item.summary.frame], item.summary
            moved = max(abs(getattr(now.mean, name) - getattr(before.mean, name)) / getattr(before.mean_sigma, name) for name in COMPONENTS)
            assert moved > 0.9  # found from a part of the points
            revisions += 1
        reported |= {item.summary.frame: item.summary for item in (*result.frames, *result.revised_frames)}
    assert revisions
    # The other frames keep their reported values: the last report of each is no further from the end than its stated uncertainty.
    last = pipeline.finalise(started)
    for item in last.frames:
        before = reported[item.summary.frame]
        assert all(
            abs(getattr(item.summary.mean, name) - getattr(before.mean, name)) <= 1.1 * getattr(before.mean_sigma, name)
            for name in COMPONENTS
        )


def test_live_constants_are_those_of_the_end(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    taken = list(world(232, step_px=60).pairs(plans["short"][:8]))
    started, printed = followed(taken)
    end = pipeline.finalise(started).elastic
    live = printed[-1].elastic
    assert live is not None
    assert end is not None
    assert live.youngs_modulus_gpa.value == pytest.approx(end.youngs_modulus_gpa.value, abs=0.1 * end.youngs_modulus_gpa.sigma)
    assert live.poissons_ratio.value == pytest.approx(end.poissons_ratio.value, abs=0.1 * end.poissons_ratio.sigma)


def test_the_published_procedure_is_followed_too(early_load: list[Any]) -> None:
    started, printed = followed(early_load[:4], "sutton2007")
    assert [item.summary for item in printed[-2].frames] == [item.summary for item in pipeline.finalise(started).frames[-2:]]


def test_a_long_run_reports_at_once_the_estimate_of_all_pairs_for_the_newest(
    world: Callable[..., Any], plans: dict[str, list[Any]]
) -> None:
    """35 pairs: between choices only the newest are smoothed, and they are what they would be had all been."""
    cross = plans["short"][:5]
    plan = [*cross, *(replace(cross[1 + n % 4], phase=Phase.CALIBRATION) for n in range(30))]
    taken = list(world(231, step_px=60).pairs(plan))
    state = estimating.init(settings().estimate, taken[0].maps[0].grid, 1024, 884)
    before = reviewed_solution = None
    for item in taken:
        state = estimating.update(state, item.pair, item.step.phase, item.times, item.maps)
        before, due = reviewed_solution, reviewed_solution is None or (selection_due(len(state.phases)) and len(state.phases) > 30)
        reviewed_solution = estimating.solve_live(state, reviewed_solution) if due or len(state.phases) > 32 else reviewed_solution
    assert before is not None
    assert reviewed_solution is not None
    whole = estimating.solve_incremental(state, before)
    newest_only_estimate, all_of_it = estimating.to_estimate(reviewed_solution, 35, newest_only=True), estimating.to_estimate(whole, 35)
    assert [item.pair for item in newest_only_estimate.motions] == list(range(35 - LIVE_WINDOW_PAIRS, 35))
    newest = len(newest_only_estimate.drift.time_s)
    np.testing.assert_allclose(newest_only_estimate.drift.drift_px, all_of_it.drift.drift_px[-newest:], atol=1e-9)
    np.testing.assert_allclose(newest_only_estimate.drift.sigma_px, all_of_it.drift.sigma_px[-newest:], rtol=1e-9)
    np.testing.assert_array_equal(newest_only_estimate.distortion.ex_px, all_of_it.distortion.ex_px)
    dmap = taken[-1].maps[-1]
    of_live, of_whole = estimating.correction(reviewed_solution, dmap), estimating.correction(whole, dmap)
    np.testing.assert_allclose(of_live.u_px, of_whole.u_px, atol=1e-9)
    reported = estimating.correction_strain(before, taken[-2].maps[-1])
    assert estimating.correction_strain(whole, dmap).sigma == pytest.approx(estimating.correction_strain(reviewed_solution, dmap).sigma)
    moved = estimating.strain_change(whole, reported)
    now = estimating.correction_strain(whole, taken[-2].maps[-1])
    np.testing.assert_allclose([moved.exx, moved.eyy, moved.exy], reported.value - now.value, atol=1e-12)
