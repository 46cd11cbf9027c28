"""The global method for frames of any size: tiles that overlap, each with a field of its own.

A point is measured by the tile in whose inner part it lies. The fields of neighbouring tiles differ by their uncertainty where they meet.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid
from semlive.data.settings import DicSettings
from semlive.dic import global_method
from semlive.dic.bands.guesses import cells
from semlive.dic.bands.image_pair import ImagePair

TILE_PX = 2048  # 0.6 GB; control points are then 32 px apart
OVERLAP_PX = 192  # on each side of a tile: some distances of control points, and half a block of 48 binned px

FIELDS = ("u_px", "v_px", "sigma_u_px", "sigma_v_px", "zncc", "covariance_px2", "neighbour_share")


def measure_in_tiles(
    pair: ImagePair, grid: Grid, unusable: NDArray[np.uint8], settings: DicSettings, *, reference_frame: int, current_frame: int
) -> DisparityMap:
    """Measure the displacement at the points of a grid, tile by tile.

    Args:
        pair: the images.
        grid: the points.
        unusable: (ny, nx) PoiStatus: points with MASKED keep it.
        settings: smallest valid fraction of a subset, and search range.
        reference_frame: number of the reference frame.
        current_frame: number of the current frame.
    """
    height, width = pair.reference.shape
    values = {name: np.zeros(grid.shape) for name in FIELDS}
    status = np.zeros(grid.shape, dtype=np.uint8)
    for j, j_end in cells(grid.y_px, TILE_PX):
        top, bottom = max(0, int(grid.y_px[j]) - OVERLAP_PX), min(height, int(grid.y_px[j_end - 1]) + OVERLAP_PX + 1)
        usable = pair.usable(slice(top, bottom))
        for i, i_end in cells(grid.x_px, TILE_PX):
            left, right = max(0, int(grid.x_px[i]) - OVERLAP_PX), min(width, int(grid.x_px[i_end - 1]) + OVERLAP_PX + 1)
            f, g = (np.ascontiguousarray(a) for a in pair.grey(slice(top, bottom), slice(left, right)))
            tile = global_method.measure(
                f,
                g,
                dataclasses.replace(
                    grid, x0_px=int(grid.x_px[i]) - left, y0_px=int(grid.y_px[j]) - top, nx=i_end - i, ny=j_end - j
                ),
                unusable[j:j_end, i:i_end],
                None if usable is None else np.ascontiguousarray(usable[:, left:right]),
                reference_frame=reference_frame,
                current_frame=current_frame,
                min_valid_fraction=settings.min_valid_fraction,
                search_px=settings.search_px,
            )  # fmt: skip
            status[j:j_end, i:i_end] = tile.status
            for name, array in values.items():
                array[j:j_end, i:i_end] = getattr(tile, name)
    return DisparityMap(
        reference=reference_frame,
        current=current_frame,
        grid=grid,
        status=status,
        iterations=np.zeros(grid.shape, dtype=np.int32),
        intermediate=None,
        **values,
    )
