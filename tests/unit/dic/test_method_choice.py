"""Which map the method ``auto`` keeps: limits of the texture and of the fraction of measured points."""

from dataclasses import replace

import numpy as np
import pytest

from semlive import dic
from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.dic.method_choice import choose_map, is_difficult, without_contradicted
from semlive.dic.outlier_rejection import PointMeasurements

GRID = dic.Grid(x0_px=30, y0_px=30, step_px=10, nx=10, ny=10, subset_px=43)
AUTO, SUBSET = dic.DicSettings(roi_px=None), dic.DicSettings(roi_px=None, method="subset")


def measurements(*, contrast=400.0, residual=4.0, length=0.07):
    zero, single = np.zeros(GRID.shape), np.zeros(GRID.shape, np.float32)
    return PointMeasurements(
        zero, zero, np.zeros((*GRID.shape, 4), np.float32), zero + 0.02, zero + 0.02, zero, zero + 0.99, single + np.float32(residual),
        single + np.float32(contrast), np.full(GRID.shape, PoiStatus.CONVERGED, np.uint8), np.ones(GRID.shape, np.int32),
        single + np.float32(length),
    )  # fmt: skip


def a_map(points):
    """A map of which the first `points` of 100 points are valid."""
    status = np.full(100, PoiStatus.INCONSISTENT, np.uint8)
    status[:points] = PoiStatus.CONVERGED
    zero = np.zeros(GRID.shape)
    return DisparityMap(0, 1, GRID, zero, zero, zero, zero, zero, status.reshape(GRID.shape))


def chosen(points, measured, settings=AUTO, *, confirmed=99, by_field=98):
    """Number of valid points of the chosen map, with 2 grey levels of noise."""
    m = choose_map(a_map(points), measured, 2.0, settings, lambda: a_map(confirmed), lambda: a_map(by_field), lambda: a_map(points))
    return int(m.valid.sum())


def test_a_texture_is_difficult_if_it_is_coarse_weak_or_changes():
    assert not is_difficult(measurements(), 2.0, 43)
    assert is_difficult(measurements(length=0.1), 2.0, 43)
    assert is_difficult(measurements(contrast=16.0), 2.0, 43)  # 12 of the texture and 4 of the noise
    assert is_difficult(measurements(residual=20.0), 2.0, 43)
    lost = replace(measurements(length=0.1), status=np.full(GRID.shape, PoiStatus.NOT_CONVERGED, np.uint8))
    assert not is_difficult(lost, 2.0, 43)


@pytest.mark.parametrize(
    ("points", "length", "expected"),
    [
        (40, 0.07, 99),  # half of the speckle is hidden: the doubtful points are measured again
        (8, 0.07, 98),  # subsets do not measure at all
        (40, 0.10, 98),  # less than half
        (80, 0.07, 80),  # speckle with cracks or hidden parts
        (80, 0.10, 98),
        (94, 0.10, 98),
        (96, 0.10, 96),
    ],
)
def test_the_global_method_is_taken_where_subsets_lose_points(points, length, expected):
    assert chosen(points, measurements(length=length)) == expected
    assert chosen(points, measurements(length=length), SUBSET) == (99 if points <= 40 else points)  # doubtful below 55


def test_the_map_with_more_points_is_selected():
    assert chosen(80, measurements(length=0.1), by_field=70) == 80
    assert chosen(40, measurements(length=0.1), by_field=30) == 99  # of the doubtful points most are confirmed


def test_a_field_is_refused_around_points_at_which_subsets_measured_something_else():
    subsets, field = a_map(60), replace(a_map(100), neighbour_share=np.full(GRID.shape, 0.5))
    u_px = np.zeros(GRID.shape)
    u_px[2, 3], u_px[2, 8] = 0.6, 0.4
    m = without_contradicted(field, replace(subsets, u_px=u_px))
    expected = np.zeros(GRID.shape, np.bool_)
    expected[0:5, 1:6] = True  # half a subset of 43 px is two points
    np.testing.assert_array_equal(m.status == PoiStatus.INCONSISTENT, expected)
    assert m.valid.sum() == 75
    assert m.neighbour_share is not None
    assert not m.neighbour_share[expected].any()


def test_doubtful_points_are_confirmed_before_the_method_is_changed():
    assert chosen(52, measurements(length=0.1), confirmed=96) == 96
    assert chosen(52, measurements(length=0.1), confirmed=60) == 98
