"""Pattern quality of one frame before any correlation: noise, speckle and predicted displacement noise."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from semlive.data.disparity import PoiStatus
from semlive.data.frame import PatternQuality
from semlive.data.grid import Grid, grid_for
from semlive.data.settings import DicSettings
from semlive.dic.image_quality.grey_scale import grey_scale
from semlive.dic.reference import prepare
from semlive.dic.row_registration import gradient_scales, smoothed_gradients
from semlive.errors import BadInput
from semlive.kernels import images

# Fourth difference along both axes: of speckle of 3.3 px it passes 0.6 grey levels, the usual second difference 5.
FOURTH = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
FOURTH_GAIN = 70.0  # root of the sum of squares of the separable stencil
LOCAL_PX = 65  # edge of the area around a POI for the noise, which has an uncertainty of 2 %
MEDIAN_OF_ABSOLUTE, MEAN_OF_ABSOLUTE = 0.6745, 0.7979  # of a standard normal distribution
GRADIENT_HALF_WIDTH = 3  # pixels on each side in a smoothed derivative
CORRELATION_PX = 256  # half the largest tile from which the speckle's autocorrelation is taken

GOOD_SIGMA_PX = 0.02  # displacement noise in the paper of the method; strain of 1e-4 over 83 px takes 18,000 such points
MIN_SPECKLE_PX = 3.0  # finer speckle is undersampled, and interpolation is biased
MIN_SPECKLES_PER_SUBSET = 9.0  # three by three
MAX_SATURATED = 0.01
MIN_CONTRAST_GREY = 10.0  # of 255; below, rounding is more than a hundredth of the contrast
MIN_USABLE = 0.95
MAX_SUBSET_PX = 151


def quality(
    image: NDArray[np.uint8] | NDArray[np.uint16],
    grid: Grid | None = None,
    settings: DicSettings | None = None,
    *,
    mask: NDArray[np.bool_] | None = None,
) -> PatternQuality:
    """Evaluate the pattern of a frame: noise, speckle, and the displacement noise of a pair of such frames.

    The prediction is the Gauss-Newton covariance of each subset for noise of both frames; for 8-bit speckle with noise of
    2, 5 and 10 grey levels it agrees with repeated exposures within 10 %.

    Args:
        image: (height, width) uint8 or uint16.
        grid: grid of the POI; None: made from `settings`.
        settings: subset and step; None: those of the grid, or the defaults for the complete frame.
        mask: (height, width) True where the frame may be used; all figures refer to that part. None: everywhere.

    Raises:
        BadInput: the image has another form, the mask has another size or excludes every pixel, or no subset fits.
    """
    if not isinstance(image, np.ndarray) or image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
        raise BadInput("the image is no two-dimensional array of uint8 or uint16: give one channel of the grey levels of the detector")
    if settings is None:
        settings = DicSettings(roi_px=None) if grid is None else DicSettings(subset_px=grid.subset_px, step_px=grid.step_px, roi_px=None)
    grid = grid or grid_for(settings, image.shape[1], image.shape[0])
    reference = prepare(image, grid, settings, mask)
    mask = None if mask is None or mask.all() else mask
    if mask is not None and not mask.any():
        raise BadInput("the mask excludes every pixel of the frame: it must be True where the frame may be used")
    grey = images.to_float32_grey(image, mask)
    used = 1.0 if mask is None else float(mask.mean())
    pixels = image if mask is None else image[mask]
    noise, local = _noise(grey, grid, mask)
    contrast = float(np.sqrt(max(float(np.mean(grey**2)) / used - noise**2, 0.0)))
    speckle_x, speckle_y = _speckle_size(grey, noise, mask)
    full_scale = grey_scale(pixels).full_scale
    factor_u, factor_v = (1.0, 1.0) if reference.factors is None else (reference.factors.u, reference.factors.v)
    usable = np.asarray(reference.status == PoiStatus.CONVERGED)
    sums = reference.sums
    facts = PatternQuality(
        grid=grid,
        noise_grey=noise,
        contrast_grey=contrast,
        mean_grey=float(pixels.mean()),
        saturated_fraction=float(np.mean((pixels == 0) | (pixels == full_scale))),
        speckle_x_px=speckle_x,
        speckle_y_px=speckle_y,
        speckles_per_subset=grid.subset_px**2 / (speckle_x * speckle_y) if speckle_x * speckle_y > 0.0 else 0.0,
        mean_intensity_gradient_grey_px=_mean_gradient(grey, noise, mask),
        sssig=np.where(usable, sums.sssig, 0.0),
        sigma_u_px=np.where(usable, np.sqrt(2.0 * sums.variance_u * factor_u) * local, 0.0),
        sigma_v_px=np.where(usable, np.sqrt(2.0 * sums.variance_v * factor_v) * local, 0.0),
        usable=usable,
        warnings=(),
    )
    shown = int(np.count_nonzero(reference.status != PoiStatus.MASKED))
    return _with_warnings(facts, full_scale, int(np.count_nonzero(usable)) / max(shown, 1))


def _inner(mask: NDArray[np.bool_], margin: int) -> NDArray[np.bool_]:
    """Where a pixel and all pixels within `margin` along both axes may be used; the edge of the frame does not count."""
    return np.asarray(ndimage.binary_erosion(mask, np.ones((2 * margin + 1, 2 * margin + 1)), border_value=1), dtype=bool)


def noise_stencil(grey: NDArray[np.float32]) -> NDArray[np.float32]:
    """Absolute fourth difference along both axes in units of noise, (height - 4, width - 4); zero where the image is constant."""
    difference = cv2.sepFilter2D(grey, cv2.CV_32F, FOURTH, FOURTH)[2:-2, 2:-2]
    return np.asarray(np.abs(difference) / FOURTH_GAIN, dtype=np.float32)


def _noise(grey: NDArray[np.float32], grid: Grid, mask: NDArray[np.bool_] | None) -> tuple[float, NDArray[np.float64]]:
    """White noise: median of the frame, and (ny, nx) around each POI, without constant (saturated, masked) areas."""
    if min(grey.shape) < 5:
        return 0.0, np.zeros(grid.shape)
    stencil = noise_stencil(grey)
    # Differences of equal float32 numbers are exact, so that a constant area is exactly zero.
    varied = stencil > 1e-3
    if mask is not None:
        varied &= _inner(mask, 2)[2:-2, 2:-2]
        stencil = np.where(varied, stencil, np.float32(0.0))
    if not varied.any():
        return 0.0, np.zeros(grid.shape)
    noise = float(np.median(stencil[varied][::3])) / MEDIAN_OF_ABSOLUTE
    size = (LOCAL_PX, LOCAL_PX)
    total = cv2.boxFilter(stencil, cv2.CV_32F, size, borderType=cv2.BORDER_REFLECT)
    count = cv2.boxFilter(varied.astype(np.float32), cv2.CV_32F, size, borderType=cv2.BORDER_REFLECT)
    rows = np.clip(grid.y_px.astype(int) - 2, 0, stencil.shape[0] - 1)
    columns = np.clip(grid.x_px.astype(int) - 2, 0, stencil.shape[1] - 1)
    at = np.ix_(rows, columns)
    local = total[at] / np.maximum(count[at], 1e-3) / MEAN_OF_ABSOLUTE
    return noise, np.where(count[at] > 0.1, local, noise).astype(np.float64)


def _speckle_size(grey: NDArray[np.float32], noise: float, mask: NDArray[np.bool_] | None) -> tuple[float, float]:
    """Full widths at half maximum of the autocorrelation along x and y; zero without a pattern.

    With a mask the tile is centred in the used area, and each lag is the mean over the pairs of used pixels.
    """
    height, width = grey.shape
    y, x = (height // 2, width // 2) if mask is None else (int(np.mean(k)) for k in np.nonzero(mask))
    top = min(max(y - CORRELATION_PX, 0), max(height - 2 * CORRELATION_PX, 0))
    left = min(max(x - CORRELATION_PX, 0), max(width - 2 * CORRELATION_PX, 0))
    part = np.s_[top : top + 2 * CORRELATION_PX, left : left + 2 * CORRELATION_PX]
    tile = grey[part]
    if mask is None:
        surface = _autocorrelation(tile - tile.mean()) / tile.size
    else:
        used = mask[part].astype(np.float32)
        centred = (tile - tile.sum() / max(float(used.sum()), 1.0)) * used
        surface = _autocorrelation(centred) / np.maximum(_autocorrelation(used), 1.0)
    peak = float(surface[0, 0]) - noise**2  # white noise correlates at zero shift only
    if peak <= 0.25 * noise**2 or peak <= 0.0:
        return 0.0, 0.0
    return _full_width(surface[0, : tile.shape[1]], peak), _full_width(surface[: tile.shape[0], 0], peak)


def _autocorrelation(tile: NDArray[np.float32]) -> NDArray[np.float64]:
    """Sums of products at each lag of the tile, padded with zeros."""
    spectrum = np.asarray(fft.rfft2(tile, s=(2 * tile.shape[0], 2 * tile.shape[1])))
    return np.asarray(fft.irfft2(np.abs(spectrum) ** 2))


def _full_width(line: NDArray[np.floating], peak: float) -> float:
    """Twice the distance at which an autocorrelation falls to half its peak."""
    values = np.concatenate([[peak], np.asarray(line[1:], dtype=np.float64)])
    below = np.nonzero(values < 0.5 * peak)[0]
    if not below.size:
        return 2.0 * line.size
    k = int(below[0])
    return 2.0 * (k - 1 + (values[k - 1] - 0.5 * peak) / (values[k - 1] - values[k]))


def _mean_gradient(grey: NDArray[np.float32], noise: float, mask: NDArray[np.bool_] | None) -> float:
    """Mean length of the gradient (Pan, Lu, Xie 2010, doi:10.1016/j.optlaseng.2009.08.010), of smoothed, rescaled derivatives."""
    if min(grey.shape) < 12:
        return 0.0
    along_x, along_y = smoothed_gradients(grey)
    used = 1.0 if mask is None else float(mask.mean())
    scale_x, scale_y = gradient_scales(grey, along_x, along_y, noise * np.sqrt(used))  # masked pixels have no noise
    length = np.hypot(scale_x * along_x, scale_y * along_y)
    if mask is None:
        return float(np.mean(length))
    inner = _inner(mask, GRADIENT_HALF_WIDTH)
    return float(np.mean(length[inner])) if inner.any() else 0.0


def _with_warnings(q: PatternQuality, full_scale: int, usable: float) -> PatternQuality:
    """Add warnings about figures that are too poor.

    Args:
        q: figures without warnings.
        full_scale: largest grey level of the detector (`grey_scale`).
        usable: fraction of the unmasked points that can be correlated.
    """
    messages: list[str] = []
    subset = q.grid.subset_px
    if q.saturated_fraction > MAX_SATURATED:
        messages.append(
            f"{100 * q.saturated_fraction:.1f} % of the pixels are saturated (at most {100 * MAX_SATURATED:.0f} % are harmless): "
            "reduce the contrast of the detector, or move its brightness to the middle"
        )
    required_grey = MIN_CONTRAST_GREY * full_scale / 255.0
    if q.contrast_grey < required_grey:
        messages.append(
            f"the contrast of the pattern is {q.contrast_grey:.1f} grey levels (at least {required_grey:.0f} are needed): "
            "increase the contrast of the detector"
        )
    speckle = (q.speckle_x_px, q.speckle_y_px)
    if 0.0 < min(speckle) < MIN_SPECKLE_PX:
        messages.append(
            f"the speckle is {min(speckle):.1f} px wide (at least {MIN_SPECKLE_PX:.0f} px are needed): magnify more, or defocus slightly"
        )
    if 0.0 < q.speckles_per_subset < MIN_SPECKLES_PER_SUBSET:
        required = _odd(float(np.sqrt(MIN_SPECKLES_PER_SUBSET * speckle[0] * speckle[1])))
        messages.append(
            f"a subset of {subset} px contains {q.speckles_per_subset:.1f} speckles of {speckle[0]:.0f} x {speckle[1]:.0f} px "
            f"(at least {MIN_SPECKLES_PER_SUBSET:.0f} are needed): use a subset of {required} px, or reduce the magnification"
        )
    if usable < MIN_USABLE:
        messages.append(
            f"{100 * (1 - usable):.0f} % of the points have too little contrast to be correlated: "
            "mask areas without a pattern, use a larger subset, or a longer dwell time"
        )
    sigma = max(q.median_sigma_px)
    if sigma > GOOD_SIGMA_PX:
        ratio = sigma / GOOD_SIGMA_PX
        required = _odd(subset * ratio)
        larger = f"use a subset of {required} px, or " if required <= MAX_SUBSET_PX else ""
        messages.append(
            f"displacements have an expected noise of {sigma:.3f} px ({GOOD_SIGMA_PX} px is good): "
            f"{larger}increase the dwell time {ratio**2:.1f} times, or the contrast"
        )
    return PatternQuality(**{name: getattr(q, name) for name in q.__slots__ if name != "warnings"}, warnings=tuple(messages))


def _odd(value: float) -> int:
    """Smallest odd integer that is not below a value."""
    return 2 * int(np.ceil((value - 1.0) / 2.0)) + 1
