"""Shift of the complete frame: candidates from the peaks of a low-passed phase correlation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from semlive.dic.initial_guess.fft_windows import hann, low_pass

LOW_PASS = 0.15  # width of the low pass in cycles per binned pixel: above it noise, below it speckle
CANDIDATES = 3


def padded_shape(shape: tuple[int, ...]) -> tuple[int, int]:
    """(height, width) of at least this shape for which the Fourier transform is fast."""
    height, width = shape
    return int(fft.next_fast_len(height) or height), int(fft.next_fast_len(width, real=True) or width)


def frame_spectrum(image: NDArray[np.float32]) -> NDArray[np.complex64]:
    """Half spectrum of the frame without its mean, windowed, because edges of frames would correlate at zero shift."""
    height, width = image.shape
    padded = padded_shape(image.shape)
    windowed = np.zeros(padded, dtype=np.float32)
    inside = windowed[:height, :width]
    np.subtract(image, image.mean(), out=inside)
    inside *= hann(width)
    inside *= hann(height)[:, None]
    return np.asarray(fft.rfft2(windowed, overwrite_x=True))


def candidate_shifts(spectrum: NDArray[np.complex64], current: NDArray[np.float32]) -> Iterator[tuple[tuple[int, int], float]]:
    """Yield candidates of the frame shift (x, y) in binned pixels and their correlation, best first; zero shift is the last."""
    height, width = padded_shape(current.shape)
    cross = frame_spectrum(current) * np.conj(spectrum)
    passed = low_pass(height, LOW_PASS)[:, None] * low_pass(width, LOW_PASS, half=True)
    # np.abs of complex numbers prevents overflow, but takes eight times as long
    cross *= passed / (np.sqrt(cross.real**2 + cross.imag**2) + np.float32(1e-20))
    surface = np.asarray(fft.irfft2(cross, s=(height, width), overwrite_x=True))
    for _ in range(CANDIDATES):
        y, x = divmod(int(np.argmax(surface)), width)
        yield (x - width * (x > width // 2), y - height * (y > height // 2)), float(surface[y, x])
        rows = np.arange(y - 4, y + 5) % height
        columns = np.arange(x - 4, x + 5) % width
        surface[np.ix_(rows, columns)] = -np.inf
    yield (0, 0), 0.0
