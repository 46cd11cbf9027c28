"""Drift knots of a run with many short pauses, where effects are compared in one matrix."""

from __future__ import annotations

import numpy as np
import pytest

from semlive.estimate.joint.observations import accumulation
from semlive.estimate.joint.observations.accumulation import dense_limit, with_coarser_drift

from .incremental_runs import accumulated


def test_pauses_do_not_exceed_one_matrix(monkeypatch: pytest.MonkeyPatch) -> None:
    paused = accumulated((0, 1, 2, 3), 600.0)
    monkeypatch.setattr(accumulation, "DENSE_KNOTS", 40)
    assert dense_limit(paused) == 2
    coarse = with_coarser_drift(paused)
    assert dense_limit(coarse) == 4
    assert coarse.drift is not None
    assert paused.drift is not None
    assert 30 < coarse.drift.spline.size <= 40 < paused.drift.spline.size
    assert coarse.drift.spline.intervals * coarse.drift.spline.spacing >= paused.frames[-1].start_s + 12.0
    assert [one.size for one in coarse.raster] < [one.size for one in paused.raster]
    assert (coarse.frames, coarse.phases, coarse.motions) == (paused.frames, paused.phases, paused.motions)
    for one, other in zip(coarse.rows, paused.rows, strict=True):
        assert np.array_equal(one.disparity_px, other.disparity_px)
        assert np.array_equal(one.weight, other.weight)
    assert len(coarse.information) == coarse.layout.size


def test_pauses_beyond_the_limit_change_no_knot(monkeypatch: pytest.MonkeyPatch) -> None:
    paused = accumulated((0, 1, 2, 3), 600.0)
    monkeypatch.setattr(accumulation, "DENSE_KNOTS", 8)
    assert with_coarser_drift(paused) is paused


def test_a_run_that_one_matrix_contains_is_the_same() -> None:
    state = accumulated((0, 1, 2, 3))
    assert with_coarser_drift(state) is state
