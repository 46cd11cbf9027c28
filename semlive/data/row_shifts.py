"""Row shifts: what one scan line of a pair moved against the smooth field, raw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class RowShifts:
    """Displacement of every row of the reference beyond the smooth disparity: the second data channel of a pair.

    A row's shift is a property of the row of the reference and of the row (or, at fractional disparity, the few rows) of the
    current frame that it is compared with: the current frame's shift minus the reference's. Where `valid` is False the numbers
    are meaningless (zero), never a code.

    Attributes:
        reference: number of the reference frame.
        current: number of the current frame.
        row_px: (n,) rows of the reference.
        current_row_px: (n,) mean position in the current frame of what lies in each row.
        edges_px: (s + 1,) columns where the x-segments begin, and where the last ends.
        u_px: (n,) shift along x of the whole row.
        v_px: (n,) shift along y of the whole row.
        sigma_u_px: (n,) standard uncertainty of u from image noise.
        sigma_v_px: (n,) standard uncertainty of v from image noise.
        valid: (n,) whether the row could be registered.
        segment_u_px: (n, s) shift along x of each segment.
        segment_v_px: (n, s) shift along y of each segment.
        segment_sigma_u_px: (n, s) standard uncertainty of a segment's u.
        segment_sigma_v_px: (n, s) standard uncertainty of a segment's v.
        segment_valid: (n, s) whether the segment could be registered.
        noise_grey: standard deviation of one frame's noise, from what registration left over.
        interpolation_noise_gain: share of white jitter variance of the current frame's rows after interpolation, 0.6 to 1.
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
    """White row jitter of one frame, as `RowShifts` show it: noise taken off, both frames' jitter taken as equal.

    Attributes:
        sd_u_px: standard deviation along x; 0 if no more is seen than noise explains.
        sd_v_px: standard deviation along y.
        sigma_u_px: standard uncertainty of sd_u_px.
        sigma_v_px: standard uncertainty of sd_v_px.
    """

    sd_u_px: float
    sd_v_px: float
    sigma_u_px: float
    sigma_v_px: float
