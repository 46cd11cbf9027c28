"""Raw DIC results between two frames: disparity maps, and shifts of single scan rows."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from semlive.data.grid import Grid


class PoiStatus(IntEnum):
    """How the correlation of one POI ended."""

    CONVERGED = 0
    NOT_CONVERGED = 1
    LOW_ZNCC = 2
    OUTSIDE_IMAGE = 3
    LOW_CONTRAST = 4
    NO_SEED = 5
    AMBIGUOUS = 6
    INCONSISTENT = 7
    MASKED = 8

    @property
    def label(self) -> str:
        """The status in lower case, as in CSV output: ``converged``, ``not_converged``, ..."""
        return self.name.lower()


_CONVERGED = np.uint8(PoiStatus.CONVERGED)  # compared as bytes: with the enum they are all made int64 first


@dataclass(frozen=True, slots=True, eq=False)
class DisparityMap:
    """Disparity from one frame to another at every POI: ``x_current = x_reference + u``.

    Where `status` is not CONVERGED the numbers are meaningless (zero), never a code.

    Attributes:
        reference: number of the reference frame (2 * pair + 0 or 1).
        current: number of the current frame.
        grid: the POI, in the reference frame.
        u_px: (ny, nx) disparity along x.
        v_px: (ny, nx) disparity along y.
        sigma_u_px: (ny, nx) standard uncertainty of u from image noise.
        sigma_v_px: (ny, nx) standard uncertainty of v from image noise.
        zncc: (ny, nx) zero-normalised cross-correlation at the solution.
        status: (ny, nx) uint8, values of PoiStatus.
        covariance_px2: (ny, nx) covariance of u and v from image noise; None where it is not stored (logs, maps over several references).
        iterations: (ny, nx) IC-GN iterations of the last attempt at a POI; None likewise.
        neighbour_share: (ny, nx) part of a value that comes from neighbours and regularisation instead of the subset of the POI, from 0
            to 1; None for a map of the subset method.
        intermediate: number of the frame through which a map was composed of two; None for a map of two images, and in logs.
    """

    reference: int
    current: int
    grid: Grid
    u_px: NDArray[np.float64]
    v_px: NDArray[np.float64]
    sigma_u_px: NDArray[np.float64]
    sigma_v_px: NDArray[np.float64]
    zncc: NDArray[np.float64]
    status: NDArray[np.uint8]
    covariance_px2: NDArray[np.float64] | None = None
    iterations: NDArray[np.int32] | None = None
    neighbour_share: NDArray[np.float64] | None = None
    intermediate: int | None = None

    def __post_init__(self) -> None:
        for name in ("u_px", "v_px", "sigma_u_px", "sigma_v_px", "zncc", "status", "covariance_px2", "iterations", "neighbour_share"):
            array = getattr(self, name)
            if array is None:
                continue
            if array.shape != self.grid.shape:
                raise ValueError(f"{name} is {array.shape}, the grid is {self.grid.shape}")
            array.setflags(write=False)

    @property
    def method(self) -> Literal["subset", "global"]:
        """The method that measured the map."""
        return "subset" if self.neighbour_share is None else "global"

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(ny, nx) True where the POI converged."""
        return self.status == _CONVERGED


@dataclass(frozen=True, slots=True, eq=False)
class RowShifts:
    """Displacement of every row of the reference beyond the smooth disparity: the second data channel of a pair.

    The shift of a row is the shift of the matching row of the current frame (at fractional disparity: of its few rows) minus the shift of
    the row of the reference. Where `valid` is False the numbers are meaningless (zero), never a code.

    Attributes:
        reference: number of the reference frame.
        current: number of the current frame.
        row_px: (n,) rows of the reference.
        current_row_px: (n,) mean row coordinate in the current frame of the material points of each row.
        edges_px: (s + 1,) first columns of the x-segments, and the end of the last one.
        u_px: (n,) shift of the row along x.
        v_px: (n,) shift of the row along y.
        sigma_u_px: (n,) standard uncertainty of u from image noise.
        sigma_v_px: (n,) standard uncertainty of v from image noise.
        valid: (n,) whether the row could be registered.
        segment_u_px: (n, s) shift along x of each segment.
        segment_v_px: (n, s) shift along y of each segment.
        segment_sigma_u_px: (n, s) standard uncertainty of a segment's u.
        segment_sigma_v_px: (n, s) standard uncertainty of a segment's v.
        segment_valid: (n, s) whether the segment could be registered.
        noise_grey: standard deviation of the noise of one frame, grey levels, from the registration residual.
        interpolation_noise_gain: fraction of the white jitter variance of the current frame that remains after interpolation, 0.6 to 1.
    """

    reference: int
    current: int
    row_px: NDArray[np.int64]
    current_row_px: NDArray[np.float64]
    edges_px: NDArray[np.int64]
    u_px: NDArray[np.float64]
    v_px: NDArray[np.float64]
    sigma_u_px: NDArray[np.float64]
    sigma_v_px: NDArray[np.float64]
    valid: NDArray[np.bool_]
    segment_u_px: NDArray[np.float64]
    segment_v_px: NDArray[np.float64]
    segment_sigma_u_px: NDArray[np.float64]
    segment_sigma_v_px: NDArray[np.float64]
    segment_valid: NDArray[np.bool_]
    noise_grey: float
    interpolation_noise_gain: float

    def __post_init__(self) -> None:
        rows, segments = self.row_px.shape[0], self.edges_px.shape[0] - 1
        for name in ("current_row_px", "u_px", "v_px", "sigma_u_px", "sigma_v_px", "valid"):
            if getattr(self, name).shape != (rows,):
                raise ValueError(f"{name} is {getattr(self, name).shape}, there are {rows} rows")
        for name in ("segment_u_px", "segment_v_px", "segment_sigma_u_px", "segment_sigma_v_px", "segment_valid"):
            if getattr(self, name).shape != (rows, segments):
                raise ValueError(f"{name} is {getattr(self, name).shape}, there are {rows} rows of {segments} segments")
        for name in self.__slots__:
            value = getattr(self, name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)


@dataclass(frozen=True, slots=True)
class RowJitter:
    """White row jitter of one frame from `RowShifts`: image noise subtracted, jitter of both frames assumed equal.

    Attributes:
        sd_u_px: standard deviation along x; 0 if image noise explains the scatter.
        sd_v_px: standard deviation along y.
        sigma_u_px: standard uncertainty of sd_u_px.
        sigma_v_px: standard uncertainty of sd_v_px.
    """

    sd_u_px: float
    sd_v_px: float
    sigma_u_px: float
    sigma_v_px: float
