"""Disparity maps: what DIC measured between two frames, raw."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

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
    def word(self) -> str:
        """The status as a word, as in CSV output: ``converged``, ``not_converged``, ..."""
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
        covariance_px2: (ny, nx) covariance of u and v from image noise; None where it was not kept (logs, maps over several references).
        iterations: (ny, nx) that IC-GN spent on the last attempt at a POI; None likewise.
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

    def __post_init__(self) -> None:
        for name in ("u_px", "v_px", "sigma_u_px", "sigma_v_px", "zncc", "status", "covariance_px2", "iterations"):
            array = getattr(self, name)
            if array is None:
                continue
            if array.shape != self.grid.shape:
                raise ValueError(f"{name} is {array.shape}, the grid is {self.grid.shape}")
            array.setflags(write=False)

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(ny, nx) True where the POI converged."""
        return self.status == _CONVERGED
