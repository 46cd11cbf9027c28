"""Response of the row registration to a wave, from pairs of random texture that contain it.

A wave along y moves neighbouring rows against each other, so that the derivative across the rows changes with the wave. Registered
amplitudes are too small then (0.47 px at 0.31 cycles per row by 30 %), and waves appear at multiples of the alias: twice that frequency
with a third of the amplitude. Slow aliases are followed by the map of the pair and by the running mean of the rows in part. All of it
depends on the texture, the noise, and the motion between both frames, so it is measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from semlive import dic
from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid
from semlive.data.scan import ScanTiming
from semlive.data.settings import DicSettings
from semlive.diagnose.rows.jitter import common_row_variance
from semlive.diagnose.rows.registration import register_image_rows
from semlive.diagnose.rows.series import RowSeries, interpolated_wave
from semlive.diagnose.rows.spectrum import MAX_FREQUENCY_HZ, MIN_AMPLITUDE_FRACTION, Wave, fit_wave
from semlive.errors import BadInput

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Image = NDArray[np.uint8] | NDArray[np.uint16]
MAX_WIDTH_PX, MAX_HEIGHT_PX = 512, 768
"""Largest texture: a response depends on the wave and the pattern, not on the size of the frame."""
TURNS = (0.15, 0.27, 0.38, 0.5)
"""Phase differences of both frames, turns."""
MIN_AMPLITUDE_PX, MIN_RATIO = 0.1, 0.02
"""Smallest amplitude in the texture, and along the weaker axis relative to the stronger one: the response to smaller waves is the same, and
noise hides it more.
"""
GAINS, FIXED_POINT_STEPS = (0.2, 3.0), 40
"""Smallest and largest relative amplitude, and steps until it fits to the difference."""
SMOOTHED_LINES = 9
"""Width of the mean over the spectrum of the pattern, lines."""
OVERSAMPLED = 2


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """Statistics of the pattern of a frame.

    Attributes:
        image: the frame, or the middle of a large one.
        amplitude: (height, width) amplitude of the pattern at each line of the transform, without the noise.
        row_weight: (height,) power of the derivative along x at each line across the rows.
        noise_grey: standard deviation of the noise of a pixel.
    """

    image: Image
    amplitude: Array
    row_weight: Array
    noise_grey: float

    @classmethod
    def of(cls, image: Image, noise_grey: float) -> Pattern:
        """The pattern of a frame whose pixels have a given noise."""
        height, width = (min(size, most) for size, most in zip(image.shape, (MAX_HEIGHT_PX, MAX_WIDTH_PX), strict=True))
        top, at = (image.shape[0] - height) // 2, (image.shape[1] - width) // 2
        middle = image[top : top + height, at : at + width]
        window = np.outer(np.hanning(height), np.hanning(width))
        grey = middle - float(middle.mean())
        power = np.abs(np.fft.fft2(grey * window)) ** 2 / float(np.sum(window**2))
        smooth = ndimage.uniform_filter(power, SMOOTHED_LINES, mode="wrap")
        amplitude = np.sqrt(np.maximum(smooth - noise_grey**2, 0.0))
        return cls(middle, amplitude, np.sum((amplitude * np.fft.fftfreq(width)) ** 2, axis=1), noise_grey)

    def turned(self, per_row: float, moved_px: float) -> float:
        """Phase of a wave of the rows at points that moved along y, turns, as the registration finds it in the interpolated rows.

        A row shows the product of the wave and of the derivative along x, whose lines are interpolated each by itself: at 0.35 cycles per
        row a motion by 0.1 px turns the wave by 0.021 turns, not by 0.035.

        Args:
            per_row: frequency of the wave, cycles per row.
            moved_px: motion along y.
        """
        along_y, row = np.asarray(np.fft.fftfreq(len(self.row_weight)), dtype=np.float64), np.floor(moved_px)
        found = interpolated_wave(per_row + along_y, np.array(moved_px - row)) * np.exp(2j * np.pi * ((per_row + along_y) * row))
        return float(np.angle(np.sum(self.row_weight * found * np.exp(-2j * np.pi * along_y * moved_px)))) / (2.0 * np.pi)

    def texture(self, rng: np.random.Generator) -> Array:
        """A periodic random texture with the spectrum of the pattern, oversampled; grey levels about 0."""
        height, width = self.amplitude.shape
        lines = np.fft.fft2(rng.standard_normal((height, width))) * self.amplitude
        fine = np.zeros((OVERSAMPLED * height, OVERSAMPLED * width), dtype=np.complex128)
        rows, columns = (np.round(np.fft.fftfreq(size) * size).astype(np.int64) for size in (height, width))
        fine[np.ix_(rows, columns)] = lines
        return np.asarray(np.fft.ifft2(fine).real) * OVERSAMPLED**2

    def frame(self, texture: Array, moved_px: Array, rng: np.random.Generator) -> Image:
        """A frame whose pixels show places (2, height, width) of a texture, px."""
        places = OVERSAMPLED * moved_px[::-1]
        grey = ndimage.map_coordinates(texture, places, order=3, mode="grid-wrap") + float(self.image.mean())
        noisy = grey + self.noise_grey * rng.standard_normal(grey.shape)
        most = np.iinfo(self.image.dtype).max
        shown = np.clip(np.round(noisy), 0, most)
        return shown.astype(np.uint8) if self.image.dtype == np.uint8 else shown.astype(np.uint16)


@dataclass(frozen=True, slots=True, eq=False)
class RowResponse:
    """Response of the row registration to one wave.

    The registered amplitude of the difference of both frames, relative to the true one, is `linear` + `square` F^2, where F is the factor
    from the amplitude of the wave to that of the difference: with 0.47 px along y at 0.31 cycles per row 0.97 at F = 1 and 0.62 at F = 2.

    Attributes:
        frequency_hz: frequency of the wave.
        wave_px: (2,) its amplitudes along x and y.
        texture_px: (2,) its amplitudes in the pairs of texture.
        linear: (2,) relative amplitude of small differences along x and y.
        square: (2,) its change with the square of the factor, for the amplitudes in the pairs of texture.
        sigma: (2,) relative standard uncertainty.
        series: rows of the pairs of texture, without the wave.
        jitter_px: (2,) jitter of the rows of these pairs, without all waves.
    """

    frequency_hz: float
    wave_px: Array
    texture_px: Array
    linear: Array
    square: Array
    sigma: Array
    series: tuple[RowSeries, ...]
    jitter_px: Array

    def is_of(self, frequency_hz: float) -> bool:
        """Whether it is the response to a wave of this frequency."""
        return bool(np.isclose(frequency_hz, self.frequency_hz, rtol=1e-9))

    def gain(self, difference_px: Array, frames: Array) -> Array:
        """(k, 2) registered differences of pairs relative to the true ones.

        Args:
            difference_px: (k, 2) registered amplitude along x and y of the difference of both frames.
            frames: (k,) number of frames whose wave power each pair contains.
        """
        axis, square = int(np.argmax(self.wave_px)), self.square * self._size2
        largest, factor = 1.0 + np.sqrt(np.maximum(frames - 1.0, 0.0)), np.zeros(len(frames))
        for _ in range(FIXED_POINT_STEPS):
            own = np.clip(self.linear[axis] + square[axis] * factor**2, *GAINS)
            factor = 0.5 * (factor + np.minimum(difference_px[:, axis] / (self.wave_px[axis] * own), largest))
        return np.clip(self.linear + square * factor[:, None] ** 2, *GAINS)

    def consequence_px(self, frequency_hz: float) -> float:
        """Largest amplitude that the wave causes at the frequencies with the alias of another one, if phases are independent.

        The part of a product of waves that changes along the rows may be found at any of them.
        """
        row_hz = 1.0 / self.series[0].row_time_s
        base = frequency_hz % row_hz
        aliases = np.concatenate([np.arange(first, MAX_FREQUENCY_HZ, row_hz) for first in (base, row_hz - base)])
        others = [fit_wave(self.series, float(alias)) for alias in aliases if self.series[0].observed_wave(alias) > MIN_AMPLITUDE_FRACTION]
        power = [np.mean(np.sum(np.abs(other.amplitude) ** 2, axis=1) / other.frames) for other in others]
        return self._size2 * float(np.sqrt(max(power, default=0.0)))

    @property
    def _size2(self) -> float:
        """Square of the amplitude relative to that in the texture, to which effects of second order are proportional."""
        return float(np.sum(self.wave_px**2) / np.sum(self.texture_px**2))


def measure_response(
    pattern: Pattern,
    timing: ScanTiming,
    settings: DicSettings,
    wave: Wave,
    wave_px: Array,
    moved_px: Array,
    others_hz: Sequence[float] = (),
) -> RowResponse | None:
    """Register pairs of texture with a wave.

    Args:
        pattern: of the first frame.
        timing: times of its scan.
        settings: correlation of the pairs.
        wave: the wave as registered.
        wave_px: (2,) its true amplitudes along x and y.
        moved_px: (k, 2) mean motion along x and y within pairs.
        others_hz: frequencies of further waves, which do not belong to the jitter.

    Returns:
        The response; None if the rows of the texture cannot be registered.
    """
    rng = np.random.default_rng(73)
    scene = _Scene(pattern, timing, settings, wave.frequency_hz)
    texture_px = np.maximum(wave_px, MIN_RATIO * float(wave_px.max())) * max(MIN_AMPLITUDE_PX / float(wave_px.max()), 1.0)
    along = np.angle(np.sum(wave.amplitude * np.conj(wave.amplitude[:, :1]), axis=0))
    size = texture_px * np.exp(1j * along)
    series, factors = list[RowSeries](), list[float]()
    for at, turn in enumerate(TURNS):
        begin = 2.0 * np.pi * rng.uniform()
        waves = size * np.exp(1j * begin), size * np.exp(1j * (begin + 2.0 * np.pi * turn))
        found = scene.registered(waves, moved_px[at % len(moved_px)], rng)
        if found is None:
            return None
        series.append(found)
        factors.append(abs(np.sqrt(found.frames(wave.frequency_hz) - 1.0) * np.exp(2j * np.pi * turn) - 1.0))
    registered = fit_wave(series, wave.frequency_hz)
    linear, square, sigma = _fitted(np.abs(registered.amplitude) / texture_px, np.array(factors))
    without = [one.without(registered.moved(at, one)) for at, one in enumerate(series)]
    return RowResponse(
        wave.frequency_hz, wave_px, texture_px, linear, square, sigma, tuple(without), _jitter_px(without, others_hz)
    )  # fmt: skip


def _fitted(differences: Array, factors: Array) -> tuple[Array, Array, Array]:
    """Linear and square part of the response with its relative uncertainty, from differences (k, 2) per amplitude of factors (k,)."""
    columns = np.column_stack((factors, factors**3))
    found = np.linalg.lstsq(columns, differences, rcond=None)[0]
    freedom = max(len(factors) - 2, 1)
    remaining = np.sqrt(np.sum((differences - columns @ found) ** 2, axis=0) / freedom)
    return found[0], found[1], remaining / (np.sqrt(len(factors)) * np.maximum(differences.mean(axis=0), 1e-9))


def _jitter_px(series: Sequence[RowSeries], others_hz: Sequence[float]) -> Array:
    for frequency_hz in others_hz:
        other = fit_wave(series, frequency_hz)
        series = [one.without(other.moved(at, one)) for at, one in enumerate(series)]
    return common_row_variance(series, 0).jitter_px()[0]


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """Pairs of texture with a wave of one frequency, scanned and correlated as the pairs of the microscope."""

    pattern: Pattern
    timing: ScanTiming
    settings: DicSettings
    frequency_hz: float

    def registered(self, waves: tuple[Complex, Complex], moved_px: Array, rng: np.random.Generator) -> RowSeries | None:
        """Rows of a pair whose frames contain waves of (2,) complex amplitudes along x and y, px."""
        shape = self.pattern.image.shape
        row_s, dwell_s = self.timing.row_time_s.value, self.timing.dwell_time_s.value
        rows, columns = np.indices(shape, dtype=np.float64)
        wave = np.exp(2j * np.pi * self.frequency_hz * (row_s * rows + dwell_s * columns))
        # The phase difference is that of points of the specimen, which are at other places in the second frame; rows sample the wave.
        per_row = float(self.frequency_hz * row_s - np.round(self.frequency_hz * row_s))
        later = np.exp(-2j * np.pi * (self.pattern.turned(per_row, float(moved_px[1])) + self.frequency_hz * dwell_s * moved_px[0]))
        texture, still = self.pattern.texture(rng), np.stack((columns, rows))
        images = [
            self.pattern.frame(texture, still - moved[:, None, None] + (amplitude[:, None, None] * wave).real, rng)
            for amplitude, moved in ((waves[0], np.zeros(2)), (waves[1] * later, moved_px))
        ]
        try:
            grid = dic.grid_for(self.settings, shape[1], shape[0])
            return register_image_rows(images[0], images[1], self._map(images, grid, moved_px), self.timing)
        except BadInput:
            return None

    def _map(self, images: Sequence[Image], grid: Grid, moved_px: Array) -> DisparityMap:
        """Map of a pair. A field of the global method, whose knots are 16 px apart or more, follows no wave that the rows show."""
        if self.settings.method == "global":
            zero, (u_px, v_px) = np.zeros(grid.shape), moved_px
            return DisparityMap(0, 1, grid, zero + u_px, zero + v_px, zero + 1e-3, zero + 1e-3, zero + 1.0, zero.astype(np.uint8))
        prepared = dic.prepare(images[0], grid, self.settings)
        return dic.correlate(prepared, images[1], self.settings, reference_frame=0, current_frame=1)
