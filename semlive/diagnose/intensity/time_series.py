"""Intensity time series: brightness, contrast, curvature and blur of every frame, in row bands with their scan times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from semlive.diagnose.intensity.frames import BLURS_PX2, INTENSITY_TERMS, IntensityFrame, IntensityFrames
from semlive.errors import IllPosed

Array = NDArray[np.float64]
BANDS = 12
MIN_PAIRS = 4
MIN_BLOCKS = 12
OUTLIER_FACTOR = 4.0  # relative to the median: pairs with larger differences contain an event and do not measure noise


@dataclass(frozen=True, slots=True, eq=False)
class IntensityTimeSeries:
    """What is known of grey over a run.

    Attributes:
        value: (f, r, TERMS) change of the mean, grey levels, of the gain, of the curvature, grey levels at unit contrast, and blur, px^2,
            all relative to frame 1.
        time_s: (f, r) middle of the scan of a band, seconds after the start of frame 0.
        span_s: (f, r, 2) scan times of the first and the last row of a band.
        pair: (f,) number of the pair of each frame.
        covariance: (TERMS, TERMS) noise covariance of a band, from the pixel noise, scaled to the scatter within pairs.
        inflation: (TERMS,) variance of a frame mean relative to that expected from the bands, in whitened terms.
        freedom: degrees of freedom of the noise.
        local: (f, b) residual of the blocks relative to the tone of their frame, grey levels.
        mean: m, grey levels.
        contrast: c, grey levels.
        darkest: darkest grey level of the reference.
    """

    value: Array
    time_s: Array
    span_s: Array
    pair: NDArray[np.int64]
    covariance: Array
    inflation: Array
    freedom: int
    local: Array
    mean: float
    contrast: float
    darkest: float

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.value)

    @property
    def whitener(self) -> Array:
        """(TERMS, TERMS) matrix that whitens the noise of a band."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance)), dtype=np.float64)

    def white(self, values: Array) -> Array:
        """(..., f, r, TERMS) contrasts of bands in units of their noise, the first their mean; the noise of frame 1 is removed."""
        rotated = np.einsum("qr,...frp->...fqp", _contrasts(self.value.shape[1]), values @ self.whitener.T)
        rotated[..., 0, :] /= np.sqrt(self.inflation)
        return rotated - rotated.mean(axis=-3, keepdims=True)

    def frame_sigma(self) -> Array:
        """(TERMS,) standard uncertainty of the mean of a frame."""
        unwhite = np.linalg.inv(self.whitener)
        return np.sqrt(np.diag(unwhite @ np.diag(self.inflation) @ unwhite.T) / self.value.shape[1])


def intensity_time_series(series: IntensityFrames) -> IntensityTimeSeries:
    """Time series from the intensity data of all frames.

    Raises:
        IllPosed: too few pairs or blocks.
    """
    reference = series.reference
    most = max((int(frame.measured.sum()) for frame in series.frames), default=0)
    frames = [frame for frame in series.frames if frame.measured.sum() >= 0.5 * most]
    used = reference.measured & np.all([frame.measured for frame in frames], axis=0) if frames else reference.measured
    pair = np.array([frame.frame // 2 for frame in frames])
    if used.sum() < MIN_BLOCKS:
        raise IllPosed(f"intensity: fewer than {MIN_BLOCKS} blocks are in all frames")
    if sum(int(np.sum(pair == value) == 2) for value in set(pair.tolist())) < MIN_PAIRS - 1:
        raise IllPosed(f"intensity: fewer than {MIN_PAIRS} pairs have images and maps from frame 0")
    bands = _bands(reference.blocks.y_px, used)
    value = np.stack([[_terms(series, frame, blocks) for blocks in bands] for frame in frames])
    middle = np.array([[frame.row_px[blocks].mean() for blocks in bands] for frame in frames])
    half = 0.5 * reference.blocks.edge_px
    ends = np.array([[(frame.row_px[blocks].min() - half, frame.row_px[blocks].max() + half) for blocks in bands] for frame in frames])
    start_s, row_time_s = (np.array([getattr(frame, name) for frame in frames]) for name in ("start_s", "row_time_s"))
    covariance, inflation, count = _noise(value, pair, _pixel_noise(series, bands))
    return IntensityTimeSeries(
        value, start_s[:, None] + middle * row_time_s[:, None], start_s[:, None, None] + ends * row_time_s[:, None, None], pair,
        covariance, inflation, INTENSITY_TERMS * count, _local(series, frames, used),
        reference.mean, reference.contrast, reference.darkest,
    )  # fmt: skip


def _bands(y_px: NDArray[np.int64], used: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """Blocks of each band: bands have equal numbers of block rows; remaining rows belong to the last band."""
    rows = np.unique(y_px[used])
    rows_per_band = -(-len(rows) // BANDS)
    count = len(rows) // rows_per_band
    band = np.minimum(np.searchsorted(rows, y_px) // rows_per_band, count - 1)
    return [np.flatnonzero(used & (band == at)) for at in range(count)]


def _terms(series: IntensityFrames, frame: IntensityFrame, blocks: NDArray[np.int64]) -> Array:
    """(TERMS,) terms of a band with the blur in px^2; the contribution of the blur to the other terms is subtracted."""
    reference = series.reference
    basis = reference.basis[blocks].sum(axis=0)
    solved = np.linalg.solve(basis, frame.products[blocks].sum(axis=0))
    curve = np.linalg.solve(basis, reference.blurred[:, blocks].sum(axis=1).T).T
    gain = max(solved[1], 0.1)
    # Outside the tabulated blurs, and for frames sharper than frame 1, the first or last interval is extrapolated.
    at = int(np.clip(np.searchsorted(curve[:, 3], solved[3] / gain) - 1, 0, len(BLURS_PX2) - 2))
    slope = max((curve[at + 1, 3] - curve[at, 3]) / (BLURS_PX2[at + 1] - BLURS_PX2[at]), 1e-3)
    blur_px2 = BLURS_PX2[at] + (solved[3] / gain - curve[at, 3]) / slope
    share = (blur_px2 - BLURS_PX2[at]) / (BLURS_PX2[at + 1] - BLURS_PX2[at])
    blur_terms = gain * (curve[at] + share * (curve[at + 1] - curve[at]) - curve[0])
    change = solved - blur_terms
    return np.array([reference.contrast * change[0], change[1] - 1.0, reference.contrast * change[2], blur_px2])


def _pixel_noise(series: IntensityFrames, bands: list[NDArray[np.int64]]) -> Array:
    """(TERMS, TERMS) covariance of a band by pixel noise; the scatter of few pairs alone would underestimate the noise."""
    reference, total = series.reference, np.zeros((INTENSITY_TERMS, INTENSITY_TERMS))
    slope = 0.0
    for blocks in bands:
        basis = reference.basis[blocks].sum(axis=0)
        inverse = np.linalg.inv(basis)
        total += inverse @ reference.noise[blocks].sum(axis=0) @ inverse.T / len(bands)
        slope += float((inverse @ reference.blurred[2, blocks].sum(axis=0))[3] / BLURS_PX2[2]) / len(bands)
    unit = np.array([reference.contrast, 1.0, reference.contrast, 1.0 / slope])
    return np.asarray(total * np.outer(unit, unit), dtype=np.float64)


def _noise(value: Array, pair: NDArray[np.int64], pixel_covariance: Array) -> tuple[Array, Array, int]:
    """Covariance of a band and inflation of a frame mean, from the differences within pairs without outliers."""
    first = np.flatnonzero(pair[1:] == pair[:-1])
    lower = np.linalg.cholesky(pixel_covariance)
    change = (value[first + 1] - value[first]) @ np.linalg.inv(lower).T / np.sqrt(2.0)
    energy = np.mean(change**2, axis=(1, 2))
    change = change[energy <= OUTLIER_FACTOR * np.median(energy)]
    square = np.mean(change**2, axis=(0, 1)) + 1e-12
    covariance = (lower * square) @ lower.T
    inflation = np.maximum(1.0, np.mean(change.mean(axis=1) ** 2, axis=0) * change.shape[1] / square)
    return covariance, inflation, len(change)


def _local(series: IntensityFrames, frames: list[IntensityFrame], used: NDArray[np.bool_]) -> Array:
    """(f, b) change of the mean of each block minus that by the tone of its frame, grey levels."""
    reference = series.reference
    basis = reference.basis[used]
    size = np.maximum(basis[:, 0, 0], 1e-9)
    changes = []
    for frame in frames:
        solved = np.linalg.solve(basis.sum(axis=0), frame.products[used].sum(axis=0))
        changes.append(reference.contrast * (frame.products[used] - basis @ solved)[:, 0] / size)
    return np.stack(changes)


def _contrasts(count: int) -> Array:
    """(count, count) orthonormal contrasts, the first row the mean."""
    rotation, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, count), increasing=True))
    return (rotation * np.sign(rotation[0])).T
