"""What the estimator refuses, and its reports while data are still insufficient."""

from __future__ import annotations

import numpy as np
import pytest

from semlive import estimate as estimating
from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.data.grid import Grid
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import EstimateSettings
from semlive.errors import IllPosed

GRID = Grid(60, 60, 40, 12, 10, 43)


def when(frame: int, start_s: float) -> FrameTime:
    def from_config(value: float) -> Sourced[float]:
        return Sourced(value, Provenance.CONFIG)

    return FrameTime(frame, start_s, ScanTiming(from_config(1e-5), from_config(0.02), from_config(10.0), Sourced(1, Provenance.CONFIG)))


def times(pair: int, start_s: float) -> tuple[FrameTime, FrameTime]:
    return when(2 * pair, start_s), when(2 * pair + 1, start_s + 10.0)


def shifted(reference: int, current: int, x: float, y: float, grid: Grid = GRID, status: PoiStatus = PoiStatus.CONVERGED) -> DisparityMap:
    rng = np.random.default_rng(reference * 100 + current)
    u, v = x + rng.normal(0, 0.01, grid.shape), y + rng.normal(0, 0.01, grid.shape)
    item = np.full(grid.shape, 0.01)
    return DisparityMap(reference, current, grid, u, v, item, item, item, np.full(grid.shape, status, np.uint8))


def fresh() -> estimating.EstimatorState:
    return estimating.init(EstimateSettings(), GRID, 560, 480)


def first() -> estimating.EstimatorState:
    return estimating.update(fresh(), 0, Phase.CALIBRATION, times(0, 0.0), (shifted(0, 1, 0.0, 0.0),))


def moved(state: estimating.EstimatorState, pair: int, x: float, y: float) -> estimating.EstimatorState:
    n = 2 * pair
    maps = (shifted(n, n + 1, 0.0, 0.0), shifted(0, n, x, y), shifted(0, n + 1, x, y))
    return estimating.update(state, pair, Phase.CALIBRATION, times(pair, 60.0 * pair), maps)


def test_nothing_can_be_solved_before_the_first_pair() -> None:
    with pytest.raises(IllPosed, match="add pair 0"):
        estimating.solve(fresh())


def test_pair_0_comes_first() -> None:
    with pytest.raises(IllPosed, match="pair 0, the reference"):
        estimating.update(fresh(), 1, Phase.CALIBRATION, times(1, 60.0), (shifted(2, 3, 0.0, 0.0),))


def test_a_pair_is_taken_once() -> None:
    with pytest.raises(IllPosed, match="each pair once"):
        moved(moved(first(), 1, 5.0, 0.0), 1, 5.0, 0.0)


def test_a_pair_from_before_pair_0_is_refused() -> None:
    maps = (shifted(2, 3, 0.0, 0.0), shifted(0, 2, 5.0, 0.0), shifted(0, 3, 5.0, 0.0))
    with pytest.raises(IllPosed, match="earliest pair"):
        estimating.update(first(), 1, Phase.CALIBRATION, times(1, -60.0), maps)


def test_a_pair_without_points_is_refused() -> None:
    lost = shifted(0, 1, 0.0, 0.0, status=PoiStatus.LOW_ZNCC)
    with pytest.raises(IllPosed, match="focus and contrast"):
        estimating.update(fresh(), 0, Phase.CALIBRATION, times(0, 0.0), (lost,))


def test_another_grid_is_refused() -> None:
    other = shifted(0, 1, 0.0, 0.0, grid=Grid(61, 60, 40, 12, 10, 43))
    with pytest.raises(IllPosed, match="one grid"):
        estimating.update(fresh(), 0, Phase.CALIBRATION, times(0, 0.0), (other,))


def test_a_run_of_weeks_is_refused() -> None:
    with pytest.raises(IllPosed, match="start a new run"):
        estimating.update(first(), 1, Phase.CALIBRATION, times(1, 1e6), (shifted(2, 3, 0.0, 0.0),))


def test_a_correction_needs_its_frame() -> None:
    solution = estimating.solve(first())
    with pytest.raises(IllPosed, match="frame 4"):
        estimating.correction(solution, shifted(0, 4, 0.0, 0.0))


@pytest.mark.parametrize("shifts", [[], [(20.0, 0.0), (-20.0, 0.0)], [(0.0, 20.0), (0.0, -20.0)]])
def test_distortion_is_not_claimed_without_translations_in_both_directions(shifts: list[tuple[float, float]]) -> None:
    state = first()
    for pair, (x, y) in enumerate(shifts, 1):
        state = moved(state, pair, x, y)
    found = estimating.to_estimate(estimating.solve(state), 0)
    assert any("distortion not determined yet: needs translations in both directions" in note.text for note in found.notes)
    assert found.distortion.valid.mean() < 0.5
    if not shifts:
        assert np.abs(found.distortion.ex_px).max() < 0.05


def test_distortion_is_claimed_after_a_cross() -> None:
    state = first()
    for pair, (x, y) in enumerate([(20.0, 0.0), (-20.0, 0.0), (0.0, 20.0), (0.0, -20.0)], 1):
        state = moved(state, pair, x, y)
    found = estimating.to_estimate(estimating.solve(state), 0)
    assert not any("not determined yet" in note.text for note in found.notes)
    assert found.distortion.valid.all()
    np.testing.assert_allclose([item.shift_px for item in found.motions], [(0, 0), (20, 0), (-20, 0), (0, 20), (0, -20)], atol=0.05)
    assert found.motions[0].shift_sigma_px.max() == 0.0
    assert all(item.shift_sigma_px.min() > 0.0 for item in found.motions[1:])


def test_a_pair_may_come_without_some_of_its_maps() -> None:
    state = moved(first(), 1, 20.0, 0.0)
    lost = shifted(0, 5, 0.0, 0.0, status=PoiStatus.OUTSIDE_IMAGE)
    state = estimating.update(state, 2, Phase.TENSION, times(2, 120.0), (shifted(4, 5, 0.0, 0.0), lost))
    state = moved(state, 3, 0.0, 20.0)
    found = estimating.to_estimate(estimating.solve(state), 0)
    assert [item.pair for item in found.motions] == [0, 1, 2, 3]
    assert found.motions[2].shift_sigma_px.min() > 100.0
    assert np.isfinite(found.drift.drift_px).all()
