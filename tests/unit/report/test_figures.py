"""Bounds of figures: samples of a curve, frames of a mean; a sheet that is drawn again shows the new frame."""

from __future__ import annotations

import numpy as np

from semlive.data.grid import Grid
from semlive.data.results import FrameResult
from semlive.data.strain import Displacement, StrainField, StrainSummary, Tensor2
from semlive.report.figures import MAX_SAMPLES, FieldSheet, field_maps, png, thinned
from semlive.report.paper_figures import spread

GRID = Grid(50, 50, 10, 12, 9, 21)


def frame(number: int, scale: float) -> FrameResult:
    rng = np.random.default_rng(number)
    u, v, exx, eyy, exy = scale * rng.standard_normal((5, *GRID.shape))
    valid = rng.random(GRID.shape) > 0.1
    sigma, zero = np.full(GRID.shape, 0.01), Tensor2(0.0, 0.0, 0.0)
    moved = Displacement(number, GRID, u, v, sigma, sigma, valid)
    return FrameResult(moved, StrainField(number, GRID, 3, exx, eyy, exy, valid), StrainSummary(number, zero, zero, zero, 41.0))


def test_a_curve_keeps_its_extremes_when_it_is_thinned() -> None:
    values = np.zeros(50 * MAX_SAMPLES)
    values[[777, 99_999]] = 5.0, -3.0
    samples = thinned(values)
    assert samples.size <= MAX_SAMPLES
    assert {777, 99_999} <= set(samples.tolist())
    assert np.all(np.diff(samples) > 0)
    assert thinned(values[:100]).size == 100


def test_a_spread_has_first_and_last() -> None:
    assert spread(range(100), 4) == [0, 33, 66, 99]
    assert spread([3, 5], 4) == [3, 5]
    assert spread([], 4) == []


def test_a_sheet_that_is_drawn_again_shows_the_new_frame() -> None:
    sheet, first, second = FieldSheet(), frame(0, 0.5), frame(1, 0.5)
    before = png(sheet.draw(first, "frame 0"))
    again = sheet.draw(second, "frame 1")
    fresh = field_maps(second, "frame 1")
    assert png(again) != before
    for old, new in zip(again.axes[:6], fresh.axes[:6], strict=True):
        shown, expected = old.images[0], new.images[0]
        values, others = shown.get_array(), expected.get_array()
        assert values is not None
        assert others is not None
        assert np.ma.allequal(values, others)
        assert (shown.get_clim(), shown.get_cmap().name) == (expected.get_clim(), expected.get_cmap().name)
