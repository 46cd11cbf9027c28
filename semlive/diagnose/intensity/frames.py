"""Grey levels of frames relative to frame 1 at equal material points, with frame 0 as instrumental variable.

A frame is I_f = m + c (t0 + t1 J + t2 (J^2 - 1) + t3 (G J - J)). J = (P - m) / c is frame 1 without noise, and G the blur of the probe. In
a regression on the measured frame 1 its noise would attenuate t1 (errors in variables). Therefore all terms are multiplied with fields of
frame 0, whose noise is independent, and summed: Z'I_f = Z'B t.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from semlive.data.disparity import DisparityMap
from semlive.data.frame import Frame
from semlive.diagnose.intensity.blocks import (
    Array,
    BlockPositions,
    Blocks,
    Grey,
    Spectra,
    aligned_spectra,
    block_positions,
    blocks_of,
    gather_blocks,
    reference_positions,
    window,
)

INTENSITY_TERMS = 4
BLUR_PX = 0.7
"""Standard deviation of the blur in the fourth term."""
BLURS_PX2 = np.array([0.0, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 2.2, 3.2, 4.5, 6.5])
SMOOTH_PX = 1.0
FLAT_FRACTION = 0.5
"""Fraction of the pixels, those with the smallest gradients, that the noise is measured on."""
MIN_BLOCKS = 12
BLACK_LEVEL, WHITE_LEVEL = 1.0, 254.0
MAX_CLIPPED_FRACTION = 0.2
"""Largest fraction of clipped pixels in the neighbourhood of a pixel; smaller fractions are clipped noise, equal in all frames."""


@dataclass(frozen=True, slots=True, eq=False)
class IntensityReference:
    """Reference for the comparison of frames: frames 0 and 1.

    Attributes:
        blocks: blocks of frame 0.
        mean: m, grey levels.
        contrast: c, grey levels.
        darkest: grey level exceeded by 99 % of the smoothed pixels.
        fields: (b, TERMS, edge, edge // 2 + 1) conjugate spectra of the fields of frame 0, weighted so that real parts of products add
            up to sums.
        basis: (b, TERMS, TERMS) products of these fields with the terms of frame 1.
        noise: (b, TERMS, TERMS) covariance of the products by the measured noise.
        blurred: (len(BLURS_PX2), b, TERMS) products of the fields with the blurred frame 1.
        smooth: (b, edge, edge) smoothed grey levels of frame 0.
        measured: (b,) blocks measured in both frames.
    """

    blocks: Blocks
    mean: float
    contrast: float
    darkest: float
    fields: Spectra
    basis: Array
    noise: Array
    blurred: Array
    smooth: Grey
    measured: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class IntensityFrame:
    """Intensity data of one frame.

    Attributes:
        frame: number of the frame.
        start_s: start of the scan, seconds after the start of frame 0.
        row_time_s: time from row to row, s.
        products: (b, TERMS) Z'(I - m) / c.
        measured: (b,) blocks that are measured and completely in the frame.
        block_row: (b,) first rows of the blocks in frame 0.
        row_px: (b,) middle rows of the blocks in the frame.
        row_levels: (height,) mean grey level of each row over the columns of the blocks.
        clipped: fraction of black or white pixels.
    """

    frame: int
    start_s: float
    row_time_s: float
    products: Array
    measured: NDArray[np.bool_]
    block_row: NDArray[np.int64]
    row_px: Array
    row_levels: Array
    clipped: float


@dataclass(frozen=True, slots=True, eq=False)
class IntensityFrames:
    """Intensity data of a run.

    Attributes:
        reference: frames 0 and 1.
        frames: frames in order, beginning with frame 1.
        noise: (n, 2) for each pair, a and b of the variance a + b I of a pixel, grey levels squared and grey levels.
    """

    reference: IntensityReference
    frames: tuple[IntensityFrame, ...]
    noise: Array


def to_8bit_levels(frame: Frame) -> Grey:
    """Pixels scaled to 8-bit grey levels, independent of the bit depth of the file."""
    return frame.image.astype(np.float32) / np.float32(1.0 if frame.image.dtype == np.uint8 else 257.0)


def intensity_reference(first: Grey, second: Grey, second_map: DisparityMap) -> IntensityReference | None:
    """Reference from frames 0 and 1; None if they have too few blocks.

    Args:
        first: (height, width) grey levels of frame 0.
        second: (height, width) grey levels of frame 1.
        second_map: map from frame 0 to frame 1.
    """
    blocks = blocks_of(second_map.grid)
    if len(blocks.x_px) < MIN_BLOCKS:
        return None
    at, static = block_positions(blocks, second_map, second.shape), reference_positions(blocks)
    used = at.measured.copy()
    if used.sum() < MIN_BLOCKS:
        return None
    smooth = gather_blocks(gaussian_filter(first, SMOOTH_PX), blocks, static)
    mean = float(smooth[used].mean())
    contrast = max(float(smooth[used].std()), 1.0)
    each = _fields(first, smooth, blocks, static, mean, contrast)
    fields = _conjugate(each, blocks)
    ones = aligned_spectra(np.ones_like(smooth), blocks, at)
    observed = gather_blocks(second, blocks, at)
    straight = aligned_spectra((observed - mean) / contrast, blocks, at)
    intercept, slope = pair_noise(blocks, first, second, second_map)
    squares = ((observed - mean) ** 2 - np.maximum(intercept + slope * observed, 0.0)) / contrast**2 - 1.0
    wave2 = blocks.waves[0][:, None] ** 2 + blocks.waves[1] ** 2
    terms = [ones, straight, aligned_spectra(squares, blocks, at), straight * np.expm1(-0.5 * BLUR_PX**2 * wave2)]
    basis = np.stack([products(fields, term) for term in terms], axis=-1)
    blurred = np.stack([products(fields, straight * np.exp(-0.5 * blur * wave2)) for blur in BLURS_PX2])
    variance = np.maximum(intercept + slope * smooth, 0.1) * (window(blocks, static) / contrast) ** 2
    noise = np.einsum("bixy,bjxy->bij", each * variance[:, None], each).astype(np.float64)
    darkest = float(np.quantile(smooth[used], 0.01))
    return IntensityReference(blocks, mean, contrast, darkest, fields, basis, noise, blurred, smooth, used)


def _fields(first: Grey, smooth: Grey, blocks: Blocks, static: BlockPositions, mean: float, contrast: float) -> Grey:
    """(b, TERMS, edge, edge) constant, grey level, its square and its curvature in frame 0; zero at clipped pixels."""
    clipped = gaussian_filter(((first < BLACK_LEVEL) | (first > WHITE_LEVEL)).astype(np.float32), 2.0 * SMOOTH_PX)
    weight = (gather_blocks(clipped, blocks, static) < MAX_CLIPPED_FRACTION).astype(np.float32)
    grey = (smooth - mean) / contrast
    bend = (gather_blocks(gaussian_filter(first, 2.0 * SMOOTH_PX), blocks, static) - smooth) / contrast
    return np.stack([weight, weight * grey, weight * (grey**2 - 1.0), weight * bend], axis=1)


def _conjugate(each: Grey, blocks: Blocks) -> Spectra:
    """(b, TERMS, edge, edge // 2 + 1) conjugate spectra of fields, weighted so that real parts of products add up to sums."""
    edge = blocks.edge_px
    spectra = np.conj(np.fft.rfft2(each).astype(np.complex64))
    twice = np.full(edge // 2 + 1, 2.0, dtype=np.float32)
    twice[0] = 1.0
    if edge % 2 == 0:
        twice[-1] = 0.0  # a subpixel shift is undefined at the Nyquist frequency
        spectra[:, :, edge // 2] = 0.0
    return np.asarray(spectra * (twice / edge**2), dtype=np.complex64)


def products(fields: Spectra, spectra: Spectra) -> Array:
    """(b, TERMS) sums over the pixels of each block, of each field times the windowed image."""
    flat = spectra.reshape(len(spectra), -1, 1)
    return np.real(np.matmul(fields.reshape(len(fields), INTENSITY_TERMS, -1), flat.astype(np.complex64)))[..., 0].astype(np.float64)


def intensity_frame(
    reference: IntensityReference, image: Grey, disparity: DisparityMap, start_s: float, row_time_s: float
) -> IntensityFrame:
    """Intensity data of a frame.

    Args:
        reference: frames 0 and 1.
        image: (height, width) grey levels.
        disparity: map from frame 0 to this frame.
        start_s: start of the scan, seconds after that of frame 0.
        row_time_s: time from row to row, s.
    """
    blocks = reference.blocks
    at = block_positions(blocks, disparity, image.shape)
    spectra = aligned_spectra((gather_blocks(image, blocks, at) - reference.mean) / reference.contrast, blocks, at)
    right = round(float(at.shift_px[at.measured, 0].mean())) if at.measured.any() else 0
    begin, end = max(0, int(blocks.x_px.min()) + right), min(image.shape[1], int(blocks.x_px.max()) + blocks.edge_px + right)
    return IntensityFrame(
        disparity.current, start_s, row_time_s, products(reference.fields, spectra), at.measured, blocks.y_px,
        blocks.y_px + 0.5 * (blocks.edge_px - 1) + at.shift_px[:, 1], image[:, begin:end].mean(axis=1, dtype=np.float64),
        float(np.mean((image < BLACK_LEVEL) | (image > WHITE_LEVEL))),
    )  # fmt: skip


def pair_noise(blocks: Blocks, first: Grey, second: Grey, within: DisparityMap) -> tuple[float, float]:
    """Terms a and b of the variance a + b I of a pixel, from the two frames of a pair at equal material points.

    Half the squared difference is regressed on the grey level of the second frame, with the smoothed grey level of the first as instrument:
    noise in the regressor would bias b low, smoothing would bias it high. Blocks keep their position of frame 0, because stage moves shift
    both frames equally.

    Args:
        blocks: blocks of frame 0.
        first: (height, width) grey levels of the first frame.
        second: (height, width) grey levels of the second frame.
        within: map from the first to the second frame, on the grid of all maps.
    """
    at, static = block_positions(blocks, within, second.shape), reference_positions(blocks)
    used, edge = at.measured, blocks.edge_px
    spectra = [
        aligned_spectra(gather_blocks(image, blocks, place), blocks, place)[used] for image, place in ((first, static), (second, at))
    ]
    first_blocks, second_blocks, observed = (
        np.fft.irfft2(spectrum, s=(edge, edge)) for spectrum in (*spectra, spectra[1] * _noise_transfer(blocks, at)[used])
    )
    smooth = gaussian_filter(first, SMOOTH_PX)
    down, along = np.gradient(smooth)
    grey, steep = (gather_blocks(value, blocks, static)[used] for value in (smooth, np.hypot(down, along)))
    # At edges, a displacement error of 0.01 px changes the difference, too.
    weight = window(blocks, static)[used] * (steep <= np.quantile(steep, FLAT_FRACTION))
    total = float(np.sum(weight**2))
    square, observed = 0.5 * (second_blocks - first_blocks) ** 2 * (weight > 0.0), weight * observed
    lever = grey - float(np.sum(weight**2 * grey)) / total
    slope = float(np.sum(lever * square)) / max(float(np.sum(lever * observed)), 1e-9)
    return float(np.sum(square)) / total - slope * float(np.sum(observed)) / total, slope


def _noise_transfer(blocks: Blocks, at: BlockPositions) -> Grey:
    """(b, edge, edge // 2 + 1) smoothing of the grey level equal to that of the noise variance of the second frame by its shift.

    A shift by a fraction t of a pixel is a sum over neighbours with weights sinc(x - t). The variance has the squared weights, with the
    spectrum 1 - |k| (1 - cos 2 pi t) / 2 pi, apart from the shift. The first frame is not shifted.
    """
    down, along = blocks.waves
    attenuation = (1.0 - np.cos(2.0 * np.pi * at.shift_px)) / (2.0 * np.pi)
    passed_x = 1.0 - attenuation[:, 0, None] * np.abs(along)
    passed_y = 1.0 - attenuation[:, 1, None] * np.abs(down)
    return 0.5 + 0.5 * passed_y[:, :, None] * passed_x[:, None, :]
