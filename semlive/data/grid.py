"""The grid of points of interest (POI) of a frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.settings import DicSettings
from semlive.errors import BadInput


@dataclass(frozen=True, slots=True)
class Grid:
    """A regular grid of POI in the reference frame.

    Attributes:
        x0_px: column of the first POI.
        y0_px: row of the first POI.
        step_px: distance of neighbouring POI.
        nx: number of columns of POI.
        ny: number of rows of POI.
        subset_px: edge of the square subset around each POI, odd.
    """

    x0_px: int
    y0_px: int
    step_px: int
    nx: int
    ny: int
    subset_px: int

    @property
    def shape(self) -> tuple[int, int]:
        """(ny, nx), the shape of every map on this grid."""
        return self.ny, self.nx

    @property
    def x_px(self) -> NDArray[np.float64]:
        """(nx,) columns of the POI."""
        return self.x0_px + self.step_px * np.arange(self.nx, dtype=np.float64)

    @property
    def y_px(self) -> NDArray[np.float64]:
        """(ny,) rows of the POI."""
        return self.y0_px + self.step_px * np.arange(self.ny, dtype=np.float64)

    def mesh(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(ny, nx) columns and rows of all POI."""
        x, y = np.meshgrid(self.x_px, self.y_px)
        return x, y

    def vsg_px(self, window_points: int) -> int:
        """Edge of a virtual strain gauge of `window_points` x `window_points` POI, subset included."""
        return (window_points - 1) * self.step_px + self.subset_px


def grid_for(settings: DicSettings, width_px: int, height_px: int) -> Grid:
    """Return the grid of all POI with centres in the region of interest and subsets in the frame.

    The first POI is the first corner of the region, moved inwards by multiples of the step until its subset lies in the frame.

    Args:
        settings: subset, step and region.
        width_px: frame width.
        height_px: frame height.

    Raises:
        BadInput: no POI fits.
    """
    half = settings.subset_px // 2
    step = settings.step_px
    x0, y0, x1, y1 = settings.roi_px or (half, half, width_px - 1 - half, height_px - 1 - half)
    x0 += max(0, -((x0 - half) // step)) * step
    y0 += max(0, -((y0 - half) // step)) * step
    nx = (min(x1, width_px - 1 - half) - x0) // step + 1
    ny = (min(y1, height_px - 1 - half) - y0) // step + 1
    if nx < 1 or ny < 1:
        region = "the complete frame" if settings.roi_px is None else f"roi {','.join(map(str, settings.roi_px))}"
        raise BadInput(
            f"no subset of {settings.subset_px} px fits into {region} of a {width_px} x {height_px} px frame: "
            "enlarge the roi or reduce the subset"
        )
    return Grid(x0_px=x0, y0_px=y0, step_px=step, nx=nx, ny=ny, subset_px=settings.subset_px)
