"""The grid of points of interest (POI)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


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
