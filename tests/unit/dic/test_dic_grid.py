import pytest

from semlive import dic
from semlive.data.settings import DicSettings
from semlive.errors import BadInput


def test_the_papers_grid_has_150_by_120_points():
    grid = dic.grid_for(DicSettings(), 1024, 884)
    assert (grid.nx, grid.ny) == (150, 120)
    assert (grid.x_px[0], grid.x_px[-1], grid.y_px[0], grid.y_px[-1]) == (101, 846, 101, 696)


def test_without_a_roi_subsets_reach_the_frames_edges_and_no_further():
    grid = dic.grid_for(DicSettings(subset_px=21, step_px=1, roi_px=None), 100, 80)
    assert (grid.x_px[0], grid.x_px[-1], grid.y_px[0], grid.y_px[-1]) == (10, 89, 10, 69)


def test_a_roi_beyond_the_frame_is_clipped_on_its_own_lattice():
    grid = dic.grid_for(DicSettings(subset_px=21, step_px=7, roi_px=(-3, 2, 500, 500)), 100, 80)
    assert (grid.x0_px, grid.y0_px) == (11, 16)
    assert grid.x_px[-1] <= 89 < grid.x_px[-1] + 7
    assert grid.y_px[-1] <= 69 < grid.y_px[-1] + 7


@pytest.mark.parametrize("roi", [None, (200, 10, 300, 20), (30, 30, 20, 20)])
def test_no_room_for_a_subset_is_bad_input(roi):
    with pytest.raises(BadInput, match="enlarge the roi or reduce the subset"):
        dic.grid_for(DicSettings(roi_px=roi), 42, 42)
