"""What is computed once per reference frame and kept."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from semlive.data.disparity import PoiStatus
from semlive.data.grid import Grid
from semlive.data.settings import DicSettings
from semlive.dic.initial_guess import InitialGuessReference, prepare_coarse
from semlive.errors import BadInput
from semlive.kernels import interface
from semlive.kernels.threads import run_pair_in_parallel
from semlive.kernels.warp import AFFINE, QUADRATIC

SOBEL_VARIANCE = 0.1875  # sum of squares of the Sobel stencil / 8
SOBEL_SPLINE_COVARIANCE = 0.40192  # its scalar product with the cubic spline's derivative stencil
TRAITS_PIXELS = 50_000  # that noise and gains are told from, to 0.6 %; twice as many cost a hundredth of a pair's time
TRAITS_EDGE_PX = 2048  # noise and gains of larger frames are told from their middle, so that parts of them agree
MIN_SIGNAL_TO_NOISE = 1.0  # variance of the speckle in a subset, in noise variances; below, ZNCC cannot pass 0.5
MAX_SIGMA_PX = 0.25  # a subset whose predicted uncertainty is worse has no contrast in some direction


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """A reference frame ready for correlation with any number of current frames.

    Attributes:
        grid: the POI.
        shape: (height, width) of the frame.
        sums: the image, its gradients, and each subset's sums and factored Gauss-Newton matrix.
        status: (ny, nx) uint8, PoiStatus: CONVERGED where a POI can be correlated, else LOW_CONTRAST or MASKED.
        noise_grey: standard deviation of the frame's white noise in grey levels.
        coarse: half-resolution image and spectrum for first guesses.
    """

    grid: Grid
    shape: tuple[int, int]
    sums: interface.SubsetSums
    status: NDArray[np.uint8]
    noise_grey: float
    coarse: InitialGuessReference

    def __post_init__(self) -> None:
        for holder in (self.sums, self.coarse):
            for field in fields(holder):
                value = getattr(holder, field.name)
                if isinstance(value, np.ndarray):
                    value.setflags(write=False)
        self.status.setflags(write=False)


def noise_of(image: NDArray[np.float32]) -> float:
    """Standard deviation of white noise in an image, from a second difference both ways (Immerkaer 1996, doi:10.1006/cviu.1996.0060).

    The stencil passes only 0.3 grey of speckle of 40 grey contrast and 6.7 px size, 5 grey of 3.3 px. Constant areas
    (saturated, masked) are left out; the median spares scratches. Rows with TRAITS_PIXELS are enough.
    """
    return interface.median_stencil(image, _line_step(image)) / (6.0 * 0.6745)


def _line_step(image: NDArray[np.float32]) -> int:
    """Every so many lines of an image hold at most TRAITS_PIXELS."""
    return max(1, -(-image.size // TRAITS_PIXELS))


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
    overlap, energy = interface.gradient_products(image, _line_step(image), axis, usable)
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
        mask: (height, width) True where the frame may be used; None uses all of it. Subsets are measured with the pixels they
            have left, and are MASKED where fewer than `min_valid_fraction` are.

    Raises:
        BadInput: grid and settings disagree about the subset, or the mask has another size than the frame.
        ValueError: not such an image, or a grid that leaves it.
    """
    if mask is not None and mask.shape != image.shape:
        (h0, w0), (h1, w1) = mask.shape, image.shape
        raise BadInput(f"the mask is {w0} x {h0} px but the frame {w1} x {h1} px: give a mask of its size")
    if grid.subset_px != settings.subset_px:
        raise BadInput(f"the grid was made for subsets of {grid.subset_px} px, the settings say {settings.subset_px}: make a new grid")
    usable = None if mask is None or mask.all() else usable_mask(mask)
    f = interface.to_float32_grey(image, None if usable is None else mask)
    used = 1.0 if usable is None else np.count_nonzero(usable) / usable.size
    part = central_region(f.shape)
    coarse, traits = run_pair_in_parallel(
        lambda: prepare_coarse(f, grid, settings.search_px),
        lambda: frame_statistics(np.ascontiguousarray(f[part]), None if usable is None else np.ascontiguousarray(usable[part]), used),
        worth=f.size >= interface.PIXEL_CHUNK,
    )
    return prepare_part(f, usable, grid, settings, traits, coarse)


@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """What holds for a whole frame.

    Attributes:
        noise_grey: standard deviation of the frame's white noise.
        gain_x: of the Sobel derivative along x.
        gain_y: along y.
    """

    noise_grey: float
    gain_x: float
    gain_y: float


def central_region(shape: tuple[int, ...]) -> tuple[slice, slice]:
    """The part of a frame that its traits are told from: all of it, or the middle of a large one."""
    first = [max(0, (n - TRAITS_EDGE_PX) // 2) for n in shape]
    return slice(first[0], first[0] + TRAITS_EDGE_PX), slice(first[1], first[1] + TRAITS_EDGE_PX)


def frame_statistics(f: NDArray[np.float32], usable: NDArray[np.float32] | None, used: float = 1.0) -> FrameStatistics:
    """Noise and gains from the `central_region` of a frame; `usable` as in `prepare_part`, `used`: the part that is not masked."""
    noise = noise_of(f)
    return FrameStatistics(noise, gradient_gain(f, 1, noise, usable, used), gradient_gain(f, 0, noise, usable, used))


def prepare_part(
    f: NDArray[np.float32],
    usable: NDArray[np.float32] | None,
    grid: Grid,
    settings: DicSettings,
    traits: FrameStatistics,
    coarse: InitialGuessReference,
) -> Reference:
    """Prepare a frame or a part of one, given what holds for the whole.

    Args:
        f: (height, width) grey levels, the frame's mean subtracted.
        usable: 1 where a pixel may be used, None for all.
        grid: points in this part.
        settings: as for the grid.
        traits: of the frame.
        coarse: for first guesses in this part.
    """
    sums = interface.subset_sums(
        f,
        x0_px=grid.x0_px,
        y0_px=grid.y0_px,
        step_px=grid.step_px,
        shape=grid.shape,
        half_px=grid.subset_px // 2,
        parameters=AFFINE if settings.shape_function == "affine" else QUADRATIC,
        gains=(traits.gain_x, traits.gain_y),
        valid=usable,
    )
    status = _judge(sums, traits.noise_grey, max(traits.gain_x, traits.gain_y))
    status[sums.pixels < settings.min_valid_fraction * grid.subset_px**2] = PoiStatus.MASKED
    return Reference(grid=grid, shape=f.shape, sums=sums, status=status, noise_grey=traits.noise_grey, coarse=coarse)


def usable_mask(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """1 where a pixel and the eight around it, which its derivative needs, may be used, else 0."""
    return ndimage.binary_erosion(mask, np.ones((3, 3)), border_value=1).astype(np.float32)


def _judge(sums: interface.SubsetSums, noise_grey: float, gain: float) -> NDArray[np.uint8]:
    """CONVERGED where a subset has contrast enough in both directions, else LOW_CONTRAST."""
    pixels = np.maximum(sums.pixels, 1.0)
    variance = noise_grey * noise_grey
    signal = sums.norm**2 / pixels - variance
    sssig = sums.sssig - SOBEL_VARIANCE * gain**2 * variance * pixels
    enough = (signal > MIN_SIGNAL_TO_NOISE * variance) & (sums.variance_u > 0.0) & (sums.variance_v > 0.0)
    enough &= sssig * MAX_SIGMA_PX**2 > 2.0 * variance
    return np.where(enough, PoiStatus.CONVERGED, PoiStatus.LOW_CONTRAST).astype(np.uint8)
