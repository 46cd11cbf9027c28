"""Coordinates, scan time and gauge length, on the numbers of Sutton 2007 (x200, DOI 10.1007/s11340-007-9041-0)."""

from __future__ import annotations

import numpy as np
import pytest

from semlive.data.grid import Grid
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import DicSettings, EstimateSettings

WIDTH_PX, HEIGHT_PX = 1024, 884
DWELL_S, FRAME_S = 1e-4, 94.67
PAPER_GRID = Grid(x0_px=101, y0_px=101, step_px=5, nx=150, ny=120, subset_px=43)


def timing(integrations: int = 1) -> ScanTiming:
    return ScanTiming(
        dwell_time_s=Sourced(DWELL_S, Provenance.CONFIG),
        row_time_s=Sourced(FRAME_S / HEIGHT_PX, Provenance.DERIVED),
        frame_time_s=Sourced(FRAME_S, Provenance.CONFIG),
        integrations=Sourced(integrations, Provenance.CONFIG),
    )


def test_row_time_is_a_tenth_of_a_second_not_ten() -> None:
    """The scanned text has t_R = 1.071 x 10; equations 1 and 2 have 0.10709 s, of which 4.7 ms are fly-back."""
    row_s = timing().row_time_s.value
    assert row_s == pytest.approx(0.10709, abs=5e-6)
    assert row_s - WIDTH_PX * DWELL_S == pytest.approx(4.7e-3, abs=5e-5)


@pytest.mark.parametrize(
    ("x_px", "y_px", "time_s"),
    [(0, 0, 0.0), (1, 0, 1e-4), (0, 1, 0.1070928), (1023, 0, 0.1023), (0, 883, 94.5629), (1023, 883, 94.6652), (0.5, 10.5, 1.1245242)],
)
def test_time_in_frame_is_equation_3(x_px: float, y_px: float, time_s: float) -> None:
    """A column costs a dwell time, a row a row time: x is fast, y is slow, pixel (0, 0) comes first."""
    assert float(timing().time_in_frame_s(x_px, y_px)) == pytest.approx(time_s, abs=5e-5)


def test_time_in_frame_follows_the_shape_of_its_positions() -> None:
    x_px, y_px = PAPER_GRID.mesh()
    time_s = timing().time_in_frame_s(x_px, y_px)
    assert time_s.shape == PAPER_GRID.shape
    assert np.all(np.diff(time_s, axis=0) > 100 * np.diff(time_s, axis=1).max())


def test_frame_integration_is_the_mean_over_the_visits() -> None:
    once, often = timing(), timing(integrations=16)
    visits_s = [float(once.time_in_frame_s(7, 11)) + m * FRAME_S for m in range(16)]
    assert float(often.time_in_frame_s(7, 11)) == pytest.approx(np.mean(visits_s))
    assert often.duration_s == pytest.approx(16 * FRAME_S)


def test_a_time_must_be_positive() -> None:
    with pytest.raises(ValueError, match="integrations"):
        timing(integrations=0)


def test_maps_are_row_by_column_and_positions_column_first() -> None:
    x_px, y_px = PAPER_GRID.mesh()
    assert PAPER_GRID.shape == x_px.shape == y_px.shape == (120, 150)
    assert (x_px[0, 1], y_px[0, 1]) == (106.0, 101.0)
    assert (x_px[1, 0], y_px[1, 0]) == (101.0, 106.0)


def test_the_default_grid_is_the_papers() -> None:
    assert PAPER_GRID.nx * PAPER_GRID.ny == 18_000
    roi_px = (int(PAPER_GRID.x_px[0]), int(PAPER_GRID.y_px[0]), int(PAPER_GRID.x_px[-1]), int(PAPER_GRID.y_px[-1]))
    dic = DicSettings()
    assert (dic.roi_px, dic.step_px, dic.subset_px) == (roi_px, PAPER_GRID.step_px, PAPER_GRID.subset_px)


def test_gauge_length_counts_the_subset() -> None:
    """9 points, 5 px apart, of 43 px: 83 px, and not 45."""
    assert PAPER_GRID.vsg_px(9) == 83
    assert PAPER_GRID.vsg_px(EstimateSettings().window_points) == 83
