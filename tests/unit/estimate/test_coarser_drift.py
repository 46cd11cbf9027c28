"""Drift knots of a run with a pause, where effects are compared in one matrix."""

from __future__ import annotations

import dataclasses

import numpy as np

from semlive import estimate as estimating
from semlive.estimate.joint.observations.accumulation import DENSE_KNOTS, dense_limit, with_coarser_drift
from semlive.estimate.joint.observations.state import EstimatorState

from .incremental_runs import GRID, PHASES, SETTINGS, exact_times, maps


def run(pause_s: float) -> EstimatorState:
    """Four pairs with a pause before the last two."""
    state = estimating.init(SETTINGS, GRID, 280, 240)
    for pair in range(4):
        later_s = pause_s if pair >= 2 else 0.0
        first, second = (dataclasses.replace(one, start_s=one.start_s + later_s) for one in exact_times(pair))
        state = estimating.update(state, pair, PHASES[pair], (first, second), maps(pair))
    return state


def test_a_pause_does_not_exceed_one_matrix() -> None:
    paused = run(8 * 3600.0)
    assert dense_limit(paused) == 2
    coarse = with_coarser_drift(paused)
    assert dense_limit(coarse) == 4
    assert coarse.drift is not None
    assert 0.98 * DENSE_KNOTS < coarse.drift.spline.size <= DENSE_KNOTS
    assert coarse.drift.spline.intervals * coarse.drift.spline.spacing >= paused.frames[-1].start_s + 12.0
    assert [one.size for one in coarse.raster] < [one.size for one in paused.raster]
    assert (coarse.frames, coarse.phases, coarse.motions) == (paused.frames, paused.phases, paused.motions)
    for one, other in zip(coarse.rows, paused.rows, strict=True):
        assert np.array_equal(one.disparity_px, other.disparity_px)
        assert np.array_equal(one.weight, other.weight)
    assert len(coarse.information) == coarse.layout.size


def test_a_pause_beyond_the_limit_changes_no_knot() -> None:
    paused = run(40 * 3600.0)
    assert with_coarser_drift(paused) is paused


def test_a_run_that_one_matrix_contains_is_the_same() -> None:
    state = run(0.0)
    assert with_coarser_drift(state) is state
