"""What a frame promises before anything is correlated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.data.grid import Grid


@dataclass(frozen=True, slots=True, eq=False)
class PatternQuality:
    """Noise, speckle and the displacement noise to be expected of a frame.

    Where `usable` is False a POI's predictions are meaningless (zero), never a code.

    Attributes:
        grid: the POI.
        noise_grey: standard deviation of the white noise, median over the frame, rounding included.
        contrast_grey: standard deviation of the pattern, noise taken off.
        mean_grey: mean grey level.
        saturated_fraction: share of pixels at either end of the range of grey levels.
        speckle_x_px: size of speckle along x: full width at half maximum of the autocorrelation.
        speckle_y_px: the same along y.
        speckles_per_subset: how many of that size a subset has room for.
        mean_intensity_gradient_grey_px: mean length of the intensity's gradient, noise taken off.
        sssig: (ny, nx) smaller eigenvalue of a subset's sum of squared gradients, (grey/px)^2.
        sigma_u_px: (ny, nx) predicted standard deviation of u, both frames as noisy as this one.
        sigma_v_px: (ny, nx) the same of v.
        usable: (ny, nx) whether a POI has contrast enough to be correlated.
        warnings: what is too poor, with the figure and what to do; empty if all is well.
    """

    grid: Grid
    noise_grey: float
    contrast_grey: float
    mean_grey: float
    saturated_fraction: float
    speckle_x_px: float
    speckle_y_px: float
    speckles_per_subset: float
    mean_intensity_gradient_grey_px: float
    sssig: NDArray[np.float64]
    sigma_u_px: NDArray[np.float64]
    sigma_v_px: NDArray[np.float64]
    usable: NDArray[np.bool_]
    warnings: tuple[str, ...]

    def __post_init__(self) -> None:
        for name in ("sssig", "sigma_u_px", "sigma_v_px", "usable"):
            array = getattr(self, name)
            if array.shape != self.grid.shape:
                raise ValueError(f"{name} is {array.shape}, the grid is {self.grid.shape}")
            array.setflags(write=False)

    @property
    def median_sigma_px(self) -> tuple[float, float]:
        """Predicted standard deviation of u and v of the middle usable POI; zero if none is usable."""
        if not self.usable.any():
            return 0.0, 0.0
        return float(np.median(self.sigma_u_px[self.usable])), float(np.median(self.sigma_v_px[self.usable]))

    @property
    def usable_fraction(self) -> float:
        """Share of the POI that can be correlated."""
        return float(np.mean(self.usable))
