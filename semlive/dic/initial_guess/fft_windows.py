"""One-dimensional FFT windows, cached by length, because call overhead dominates for small frames."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft

CACHE_SIZE = 32  # windows; one of 8,192 samples takes 32 kB


@lru_cache(maxsize=CACHE_SIZE)
def hann(length: int) -> NDArray[np.float32]:
    """(length,) Hann window."""
    return _read_only(np.hanning(length).astype(np.float32))


@lru_cache(maxsize=CACHE_SIZE)
def low_pass(length: int, width: float, *, half: bool = False) -> NDArray[np.float32]:
    """Gaussian of a width in cycles per sample at the frequencies of a transform of this length, or of its real half spectrum."""
    frequency = (fft.rfftfreq(length) if half else fft.fftfreq(length)).astype(np.float32)
    return _read_only(np.exp(frequency**2 * np.float32(-0.5 / width**2)))


def _read_only(values: NDArray[np.float32]) -> NDArray[np.float32]:
    values.setflags(write=False)
    return values
