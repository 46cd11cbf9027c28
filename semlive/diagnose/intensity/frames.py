"""Grey levels of frames against those of frame 1 on the same material, frame 0 being the instrument: noise of neither biases the other.

A frame is I_f = m + c (t0 + t1 J + t2 (J^2 - 1) + t3 (G J - J)), J = (P - m) / c being what frame 1 shows without noise and G the blur of a
probe. Regressed on frame 1 as it is, its noise would flatten t1 (errors in variables); so all are multiplied with fields of frame 0, whose
noise is its own, and summed: Z'I_f = Z'B t.
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
"""Of the fourth term."""
BLURS_PX2 = np.array([0.0, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 2.2, 3.2, 4.5, 6.5])
SMOOTH_PX = 1.0
FLAT = 0.5
"""Share of the pixels that noise is measured on."""
LEAST_BLOCKS = 12
CLIPPED_LEAST, CLIPPED_MOST = 1.0, 254.0
MAX_CLIPPED_FRACTION = 0.2
"""Of the pixels about one: less is noise that was cut off, and is so in all frames."""


@dataclass(frozen=True, slots=True, eq=False)
class IntensityReference:
    """What frames are compared with.

    Attributes:
        blocks: of frame 0.
        mean: m, grey levels.
        contrast: c, grey levels.
        darkest: grey level that one pixel in a hundred is below, its noise smoothed away.
        fields: (b, TERMS, edge, edge // 2 + 1) conjugate spectra of the fields of frame 0, so weighted that sums are real products.
        basis: (b, TERMS, TERMS) their products with the terms of frame 1.
        noise: (b, TERMS, TERMS) covariance that noise of the measured variance gives products.
        blurred: (len(BLURS_PX2), b, TERMS) their products with frame 1, blurred.
        smooth: (b, edge, edge) grey of frame 0, smoothed.
        known: (b,) blocks of both frames.
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
    """A frame in its blocks.

    Attributes:
        frame: its number.
        start_s: of its scan, after the start of frame 0.
        row_time_s: from row to row.
        products: (b, TERMS) Z'(I - m) / c.
        known: (b,) blocks that are wholly in the frame and measured.
        block_row: (b,) rows at which the blocks begin in frame 0.
        row_px: (b,) middle rows of the blocks in the frame.
        row_levels: (height,) mean grey of its rows, over the columns that the blocks cover.
        clipped: share of pixels that are black or white.
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
    """Frames of a run.

    Attributes:
        reference: frames 0 and 1.
        frames: from frame 1 on, in their order.
        noise: (n, 2) of each pair a and b of the variance a + b I of a pixel, grey levels squared and grey levels.
    """

    reference: IntensityReference
    frames: tuple[IntensityFrame, ...]
    noise: Array


def to_8bit_levels(frame: Frame) -> Grey:
    """Grey of 8 bit, whatever the file's depth."""
    return frame.image.astype(np.float32) / np.float32(1.0 if frame.image.dtype == np.uint8 else 257.0)


def intensity_reference(first: Grey, second: Grey, second_map: DisparityMap) -> IntensityReference | None:
    """From frames 0 and 1, (height, width) grey levels, and the map between them; None where they have too few blocks.

    Args:
        first: frame 0.
        second: frame 1.
        second_map: from frame 0 to frame 1.
    """
    blocks = blocks_of(second_map.grid)
    if len(blocks.x_px) < LEAST_BLOCKS:
        return None
    at, static = block_positions(blocks, second_map, second.shape), reference_positions(blocks)
    used = at.measured.copy()
    if used.sum() < LEAST_BLOCKS:
        return None
    smooth = gather_blocks(gaussian_filter(first, SMOOTH_PX), blocks, static)
    mean = float(smooth[used].mean())
    contrast = max(float(smooth[used].std()), 1.0)
    each = _fields(first, smooth, blocks, static, mean, contrast)
    fields = _conjugate(each, blocks)
    one = aligned_spectra(np.ones_like(smooth), blocks, at)
    observed = gather_blocks(second, blocks, at)
    straight = aligned_spectra((observed - mean) / contrast, blocks, at)
    intercept, slope = pair_noise(blocks, first, second, second_map)
    squares = ((observed - mean) ** 2 - np.maximum(intercept + slope * observed, 0.0)) / contrast**2 - 1.0
    wave2 = blocks.waves[0][:, None] ** 2 + blocks.waves[1] ** 2
    terms = [one, straight, aligned_spectra(squares, blocks, at), straight * np.expm1(-0.5 * BLUR_PX**2 * wave2)]
    basis = np.stack([products(fields, term) for term in terms], axis=-1)
    blurred = np.stack([products(fields, straight * np.exp(-0.5 * blur * wave2)) for blur in BLURS_PX2])
    variance = np.maximum(intercept + slope * smooth, 0.1) * (window(blocks, static) / contrast) ** 2
    noise = np.einsum("bixy,bjxy->bij", each * variance[:, None], each).astype(np.float64)
    darkest = float(np.quantile(smooth[used], 0.01))
    return IntensityReference(blocks, mean, contrast, darkest, fields, basis, noise, blurred, smooth, used)


def _fields(first: Grey, smooth: Grey, blocks: Blocks, static: BlockPositions, mean: float, contrast: float) -> Grey:
    """(b, TERMS, edge, edge) ones, grey, its square and its bend, all of frame 0 and zero where it is clipped."""
    bad = gaussian_filter(((first < CLIPPED_LEAST) | (first > CLIPPED_MOST)).astype(np.float32), 2.0 * SMOOTH_PX)
    weight = (gather_blocks(bad, blocks, static) < MAX_CLIPPED_FRACTION).astype(np.float32)
    grey = (smooth - mean) / contrast
    bend = (gather_blocks(gaussian_filter(first, 2.0 * SMOOTH_PX), blocks, static) - smooth) / contrast
    return np.stack([weight, weight * grey, weight * (grey**2 - 1.0), weight * bend], axis=1)


def _conjugate(each: Grey, blocks: Blocks) -> Spectra:
    """(b, TERMS, edge, edge // 2 + 1) spectra of fields, conjugate and so weighted that real parts of products add up to sums."""
    edge = blocks.edge_px
    spectra = np.conj(np.fft.rfft2(each).astype(np.complex64))
    twice = np.full(edge // 2 + 1, 2.0, dtype=np.float32)
    twice[0] = 1.0
    if edge % 2 == 0:
        twice[-1] = 0.0  # a shift by less than a pixel is not known of this wave
        spectra[:, :, edge // 2] = 0.0
    return np.asarray(spectra * (twice / edge**2), dtype=np.complex64)


def products(fields: Spectra, spectra: Spectra) -> Array:
    """(b, TERMS) sums over the pixels of blocks of each field times a windowed picture."""
    flat = spectra.reshape(len(spectra), -1, 1)
    return np.real(np.matmul(fields.reshape(len(fields), INTENSITY_TERMS, -1), flat.astype(np.complex64)))[..., 0].astype(np.float64)


def intensity_frame(
    reference: IntensityReference, image: Grey, disparity: DisparityMap, start_s: float, row_time_s: float
) -> IntensityFrame:
    """A frame in its blocks.

    Args:
        reference: frames 0 and 1.
        image: (height, width) grey levels.
        disparity: from frame 0 to this one.
        start_s: of its scan, after that of frame 0.
        row_time_s: from row to row.
    """
    blocks = reference.blocks
    at = block_positions(blocks, disparity, image.shape)
    spectra = aligned_spectra((gather_blocks(image, blocks, at) - reference.mean) / reference.contrast, blocks, at)
    right = round(float(at.shift_px[at.measured, 0].mean())) if at.measured.any() else 0
    begin, end = max(0, int(blocks.x_px.min()) + right), min(image.shape[1], int(blocks.x_px.max()) + blocks.edge_px + right)
    return IntensityFrame(
        disparity.current, start_s, row_time_s, products(reference.fields, spectra), at.measured, blocks.y_px,
        blocks.y_px + 0.5 * (blocks.edge_px - 1) + at.shift_px[:, 1], image[:, begin:end].mean(axis=1, dtype=np.float64),
        float(np.mean((image < CLIPPED_LEAST) | (image > CLIPPED_MOST))),
    )  # fmt: skip


def pair_noise(blocks: Blocks, first: Grey, second: Grey, within: DisparityMap) -> tuple[float, float]:
    """Both terms of the variance a + b I of a pixel, from a pair's two frames on the same material.

    Half the squared difference over the grey of the second, both weighted with the smoothed grey of the first: noise of a regressor
    would make b too small, smoothing too large. Blocks lie where they lie in frame 0; moves of the stage moved both frames alike.

    Args:
        blocks: of frame 0.
        first: (height, width) grey levels.
        second: likewise.
        within: from the first to the second frame, on the same grid as all maps.
    """
    at, static = block_positions(blocks, within, second.shape), reference_positions(blocks)
    used, edge = at.measured, blocks.edge_px
    both = [aligned_spectra(gather_blocks(image, blocks, place), blocks, place)[used] for image, place in ((first, static), (second, at))]
    own, other, observed = (np.fft.irfft2(model_effect, s=(edge, edge)) for model_effect in (*both, both[1] * _of_noise(blocks, at)[used]))
    smooth = gaussian_filter(first, SMOOTH_PX)
    down, along = np.gradient(smooth)
    grey, steep = (gather_blocks(value, blocks, static)[used] for value in (smooth, np.hypot(down, along)))
    # On edges a displacement that is off by a hundredth of a pixel is a difference too.
    weight = window(blocks, static)[used] * (steep <= np.quantile(steep, FLAT))
    total = float(np.sum(weight**2))
    square, observed = 0.5 * (other - own) ** 2 * (weight > 0.0), weight * observed
    lever = grey - float(np.sum(weight**2 * grey)) / total
    slope = float(np.sum(lever * square)) / max(float(np.sum(lever * observed)), 1e-9)
    return float(np.sum(square)) / total - slope * float(np.sum(observed)) / total, slope


def _of_noise(blocks: Blocks, at: BlockPositions) -> Grey:
    """(b, edge, edge // 2 + 1) what the grey has to be smoothed with, as the variance of the second frame's noise is by its shift.

    A shift by a part t of a pixel is a sum over neighbours with sinc(x - t), variance one with its square, whose spectrum is
    1 - |k| (1 - cos 2 pi t) / 2 pi beside the shift. The first frame is not shifted.
    """
    down, along = blocks.waves
    lost = (1.0 - np.cos(2.0 * np.pi * at.shift_px)) / (2.0 * np.pi)
    passed_x = 1.0 - lost[:, 0, None] * np.abs(along)
    passed_y = 1.0 - lost[:, 1, None] * np.abs(down)
    return 0.5 + 0.5 * passed_y[:, :, None] * passed_x[:, None, :]
