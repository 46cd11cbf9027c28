"""Reference frame prepared for correlation: computed once, used with any number of current frames."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from semlive.data.disparity import PoiStatus
from semlive.data.grid import Grid
from semlive.data.settings import DicSettings
from semlive.dic.initial_guess.search import InitialGuessReference, prepare_coarse
from semlive.dic.shot_noise import NoiseFactors, ShotNoise, estimate_shot_noise, noise_factors
from semlive.errors import BadInput
from semlive.kernels import arrays, images
from semlive.kernels.subset_matching import interface
from semlive.kernels.subset_matching.fourth_order_matrix import QUARTIC
from semlive.kernels.subset_matching.warp import AFFINE, QUADRATIC
from semlive.kernels.threads import run_pair_in_parallel

PARAMETERS = {"affine": AFFINE, "quadratic": QUADRATIC, "quartic": QUARTIC}  # of a shape function
SOBEL_VARIANCE = 0.1875  # sum of squares of the Sobel stencil / 8
SOBEL_SPLINE_COVARIANCE = 0.40192  # scalar product of this stencil with the derivative stencil of the cubic spline
STATISTICS_PIXELS = 50_000  # for noise and gains, to 0.6 %; twice as many take a hundredth of the time of a pair
STATISTICS_EDGE_PX = 2048  # noise and gains of larger frames are those of their central part, so that all bands agree
MIN_SIGNAL_TO_NOISE = 1.0  # variance of the speckle in a subset, in noise variances; below, ZNCC cannot pass 0.5
MAX_SIGMA_PX = 0.25  # a subset with a larger predicted uncertainty lacks contrast in some direction


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """A reference frame ready for correlation with any number of current frames.

    Attributes:
        grid: grid of the POI.
        shape: (height, width) of the frame.
        sums: image, gradients, and sums and factored Gauss-Newton matrix of each subset.
        status: (ny, nx) uint8, PoiStatus: CONVERGED where a POI can be correlated, else LOW_CONTRAST or MASKED.
        noise_grey: standard deviation of the white noise of the frame in grey levels.
        gain: larger gain of the Sobel derivatives.
        coarse: half-resolution image and spectrum for initial guesses.
        factors: effect of noise that grows with the grey level; None for noise that does not.
    """

    grid: Grid
    shape: tuple[int, int]
    sums: interface.SubsetSums
    status: NDArray[np.uint8]
    noise_grey: float
    gain: float
    coarse: InitialGuessReference
    factors: NoiseFactors | None = None

    def __post_init__(self) -> None:
        for holder in (self.coarse, *(() if self.factors is None else (self.factors,))):
            for field in fields(holder):
                value = getattr(holder, field.name)
                if isinstance(value, np.ndarray):
                    value.setflags(write=False)
        self.status.setflags(write=False)


def noise_of(image: NDArray[np.float32]) -> float:
    """Standard deviation of white noise in an image, from second differences along both axes (Immerkaer 1996, doi:10.1006/cviu.1996.0060).

    Of speckle with a contrast of 40 grey levels the stencil passes 0.3 grey levels at a size of 6.7 px and 5 at 3.3 px. Constant areas
    (saturated, masked) are left out; the median is robust against scratches. Rows with STATISTICS_PIXELS are sufficient.
    """
    return images.median_stencil(image, _line_step(image)) / (6.0 * 0.6745)


def _line_step(image: NDArray[np.float32]) -> int:
    """Step between lines of an image such that they have at most STATISTICS_PIXELS."""
    return max(1, -(-image.size // STATISTICS_PIXELS))


def gradient_gain(
    image: NDArray[np.float32], axis: int, noise_grey: float, usable: NDArray[np.float32] | None = None, used: float = 1.0
) -> float:
    """Factor that makes the Sobel derivative along an axis the best guess of the true one (regression, noise taken out).

    The derivative of the interpolating spline is the true one, but passes 7 times the noise: used in IC-GN it raises the
    displacement noise by 18 % at 7 grey of noise on 40 of contrast, and the steps fall short by 30 %. Sobel smooths instead;
    the gain makes its steps the right length and its covariance honest.

    Args:
        image: (height, width) float32 grey levels.
        axis: 1 for x, 0 for y.
        noise_grey: standard deviation of the image's noise.
        usable: 1 where a pixel may be used, else 0; None for all.
        used: part of the image that is not masked; the Sobel derivative is zero elsewhere.
    """
    overlap, energy = images.gradient_products(image, _line_step(image), axis, usable)
    overlap -= used * SOBEL_SPLINE_COVARIANCE * noise_grey**2
    return min(max(overlap / energy, 0.1), 3.0) if energy > 0.0 else 1.0


def prepare(
    image: NDArray[np.uint8] | NDArray[np.uint16], grid: Grid, settings: DicSettings, mask: NDArray[np.bool_] | None = None
) -> Reference:
    """Prepare a reference frame.

    Args:
        image: (height, width) uint8 or uint16.
        grid: the POI, from `grid_for`.
        settings: as for the grid.
        mask: (height, width) True where the frame may be used; None: everywhere. Subsets are measured with their unmasked pixels,
            and are MASKED if the fraction of these is below `min_valid_fraction`.

    Raises:
        BadInput: grid and settings have different subsets, or the mask has another size than the frame.
        ValueError: the image has another form, or subsets lie outside it.
    """
    if mask is not None and mask.shape != image.shape:
        (h0, w0), (h1, w1) = mask.shape, image.shape
        raise BadInput(f"the mask is {w0} x {h0} px but the frame {w1} x {h1} px: give a mask of its size")
    if grid.subset_px != settings.subset_px:
        raise BadInput(f"the grid was made for subsets of {grid.subset_px} px, the settings have {settings.subset_px}: make a new grid")
    usable = None if mask is None or mask.all() else usable_mask(mask)
    f = images.to_float32_grey(image, None if usable is None else mask)
    used = 1.0 if usable is None else np.count_nonzero(usable) / usable.size
    part = central_region(f.shape)
    coarse, statistics = run_pair_in_parallel(
        lambda: prepare_coarse(f, grid, settings.search_px),
        lambda: frame_statistics(np.ascontiguousarray(f[part]), None if usable is None else np.ascontiguousarray(usable[part]), used),
        worth=f.size >= arrays.PIXEL_CHUNK,
    )
    return prepare_part(f, usable, grid, settings, statistics, coarse)


@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """Statistics of a complete frame.

    Attributes:
        noise_grey: standard deviation of the white noise, grey levels.
        gain_x: gain of the Sobel derivative along x.
        gain_y: gain of the Sobel derivative along y.
        shot_noise: noise that grows with the grey level; None where it does not.
    """

    noise_grey: float
    gain_x: float
    gain_y: float
    shot_noise: ShotNoise | None = None


def central_region(shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Part of a frame for its statistics: the complete frame, or the central part of a large one."""
    first = [max(0, (n - STATISTICS_EDGE_PX) // 2) for n in shape]
    return slice(first[0], first[0] + STATISTICS_EDGE_PX), slice(first[1], first[1] + STATISTICS_EDGE_PX)


def frame_statistics(f: NDArray[np.float32], usable: NDArray[np.float32] | None, used: float = 1.0) -> FrameStatistics:
    """Noise and gains from the `central_region` of a frame.

    Args:
        f: grey levels of the region.
        usable: as in `prepare_part`.
        used: fraction of the frame that is not masked.
    """
    noise = noise_of(f)
    gains = gradient_gain(f, 1, noise, usable, used), gradient_gain(f, 0, noise, usable, used)
    return FrameStatistics(noise, *gains, estimate_shot_noise(f))


def prepare_part(
    f: NDArray[np.float32],
    usable: NDArray[np.float32] | None,
    grid: Grid,
    settings: DicSettings,
    statistics: FrameStatistics,
    coarse: InitialGuessReference,
) -> Reference:
    """Prepare a frame, or a part of it, with the statistics of the complete frame.

    Args:
        f: (height, width) grey levels without the mean of the frame.
        usable: 1 where a pixel may be used, else 0; None: everywhere.
        grid: grid of the points in this part.
        settings: as for the grid.
        statistics: statistics of the frame.
        coarse: binned reference for initial guesses in this part.
    """
    sums = interface.subset_sums(
        f,
        x0_px=grid.x0_px,
        y0_px=grid.y0_px,
        step_px=grid.step_px,
        shape=grid.shape,
        half_px=grid.subset_px // 2,
        parameters=PARAMETERS[settings.shape_function],
        gains=(statistics.gain_x, statistics.gain_y),
        valid=usable,
    )
    status = _contrast_status(sums, statistics.noise_grey, max(statistics.gain_x, statistics.gain_y))
    status[sums.pixels < settings.min_valid_fraction * grid.subset_px**2] = PoiStatus.MASKED
    factors = None if statistics.shot_noise is None else noise_factors(sums, statistics.shot_noise)
    return Reference(
        grid=grid,
        shape=f.shape,
        sums=sums,
        status=status,
        noise_grey=statistics.noise_grey,
        gain=max(statistics.gain_x, statistics.gain_y),
        coarse=coarse,
        factors=factors,
    )


def usable_mask(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """1 where a pixel and its eight neighbours, which its derivative needs, may be used, else 0."""
    return ndimage.binary_erosion(mask, np.ones((3, 3)), border_value=1).astype(np.float32)


def texture_length(reference: Reference) -> NDArray[np.float64]:
    """(ny, nx) length of the texture relative to the subset: standard deviation over smallest root mean square derivative.

    Noise is subtracted from both; 0 where a subset contains noise only.
    """
    sums, variance = reference.sums, reference.noise_grey**2
    contrast = sums.norm**2 - variance * sums.pixels
    slope = sums.sssig / reference.gain**2 - SOBEL_VARIANCE * variance * sums.pixels
    length = np.sqrt(np.maximum(contrast, 0.0) / np.maximum(slope, 1e-9)) / (2 * sums.half_px + 1)
    return np.where(slope > 0.0, length, 0.0)


def _contrast_status(sums: interface.SubsetSums, noise_grey: float, gain: float) -> NDArray[np.uint8]:
    """CONVERGED where a subset has sufficient contrast in both directions, else LOW_CONTRAST."""
    pixels = np.maximum(sums.pixels, 1.0)
    variance = noise_grey * noise_grey
    signal = sums.norm**2 / pixels - variance
    sssig = sums.sssig - SOBEL_VARIANCE * gain**2 * variance * pixels
    sufficient = (signal > MIN_SIGNAL_TO_NOISE * variance) & (sums.variance_u > 0.0) & (sums.variance_v > 0.0)
    sufficient &= sssig * MAX_SIGMA_PX**2 > 2.0 * variance
    return np.where(sufficient, PoiStatus.CONVERGED, PoiStatus.LOW_CONTRAST).astype(np.uint8)
