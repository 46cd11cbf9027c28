"""Second and third estimate of the doubtful points of a map that was correlated in bands."""

from __future__ import annotations

import dataclasses

import numpy as np

from semlive.data.disparity import PoiStatus
from semlive.data.grid import Grid
from semlive.data.settings import DicSettings
from semlive.dic.bands.image_pair import MARGIN_PX, ImagePair, bands, prepare_cut, rows_of
from semlive.dic.outlier_rejection import PointMeasurements
from semlive.dic.reference import FrameStatistics
from semlive.dic.second_estimate import BANDS, SecondEstimates, second_estimates
from semlive.kernels.subset_matching import interface


def banded_second_estimates(
    pair: ImagePair,
    grid: Grid,
    measured: PointMeasurements,
    statistics: FrameStatistics,
    settings: DicSettings,
    band_px: int,
    band_points: int,
) -> SecondEstimates:
    """`second_estimates` of a complete map, band by band; the filters of a band have their data within its margin.

    Args:
        pair: the images.
        grid: the points.
        measured: their measurements.
        statistics: of the reference.
        settings: of the correlation.
        band_px: pixels of a band.
        band_points: points of a band.
    """
    p = np.zeros((*grid.shape, 6))
    p[..., 0], p[..., 3] = measured.u_px, measured.v_px
    p[..., [1, 2, 4, 5]] = measured.gradient
    height, half = pair.reference.shape[0], grid.subset_px // 2
    filtered = int(np.ceil(4.0 * max(coarse for _, coarse in BANDS) * grid.subset_px))
    out = SecondEstimates(np.zeros((len(BANDS), *grid.shape, 2)), np.zeros((len(BANDS), *grid.shape), dtype=np.bool_))
    for first, last in bands(grid, pair.reference.shape, band_px, band_points):
        rows = rows_of(grid, first, last)
        valid = measured.status[first:last] == PoiStatus.CONVERGED
        margin = MARGIN_PX + filtered + int(np.abs(p[first:last, :, 3][valid]).max(initial=0.0))
        top, bottom = max(0, int(rows.y_px[0]) - half - margin), min(height, int(rows.y_px[-1]) + half + margin + 1)
        f, g = (np.ascontiguousarray(a) for a in pair.grey(slice(top, bottom), slice(None)))
        cut = dataclasses.replace(rows, y0_px=rows.y0_px - top)
        reference = prepare_cut(f, pair.usable(slice(top, bottom)), cut, settings, statistics, np.zeros(cut.shape, dtype=bool))
        solutions = interface.Solutions(
            p[first:last], measured.zncc[first:last], measured.status[first:last], measured.iterations[first:last]
        )
        part = second_estimates(reference, g, solutions, settings)
        out.difference_px[:, first:last], out.found[:, first:last] = part.difference_px, part.found
    return out
