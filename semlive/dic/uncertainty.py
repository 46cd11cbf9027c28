"""Standard uncertainty of u and v at each POI from the residual of the correlation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from semlive.kernels.subset_matching.subpixel_phases import phases

TINY = np.finfo(np.float32).eps
ROUNDING_VARIANCE = 1.0 / 12.0  # of one grey level


def _cardinal(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cubic cardinal spline: interpolation weight of a sample at distance x."""
    pole = np.sqrt(3.0) - 2.0
    k = np.arange(-40, 41)
    distance = np.abs(x[..., None] - k)
    inner = 2.0 / 3.0 - distance**2 + distance**3 / 2.0
    outer = np.maximum(2.0 - distance, 0.0) ** 3 / 6.0
    return np.sqrt(3.0) * np.sum(pole ** np.abs(k) * np.where(distance < 1.0, inner, outer), axis=-1)


def _quintic_cardinal(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quintic cardinal spline: interpolation weight of a sample at distance x (spline through a unit pulse)."""
    count = 161
    pulse = np.zeros(count)
    pulse[count // 2] = 1.0
    return np.asarray(make_interp_spline(np.arange(count) - count // 2, pulse, k=5)(x))


def _noise_harmonics(cardinal: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> tuple[float, float, float]:
    """Fourier coefficients of h(t), the fraction of the variance of white noise that interpolation passes at sub-pixel phase t."""
    phase = np.arange(32) / 32.0
    gain = np.sum(cardinal(phase[:, None] - np.arange(-30, 31)) ** 2, axis=1)
    return tuple(float(np.mean(gain * np.cos(2.0 * np.pi * k * phase))) * (1.0 if k == 0 else 2.0) for k in range(3))  # type: ignore[return-value]


HARMONICS = {"cubic": _noise_harmonics(_cardinal), "quintic": _noise_harmonics(_quintic_cardinal)}
# h is 1 at integer positions; cubic: 0.76 at half a pixel, mean 0.87; quintic: 0.84 and 0.92


def interpolation_noise_gain(
    shift_px: NDArray[np.float64],
    along_x: NDArray[np.float64],
    along_y: NDArray[np.float64],
    subset_px: int,
    interpolation: str = "cubic",
) -> NDArray[np.float32]:
    """Fraction of the noise variance of the current image that interpolation passes along one axis, mean over a subset.

    Args:
        shift_px: displacement of the centre of the subset along this axis.
        along_x: derivative of the displacement with respect to x.
        along_y: derivative of the displacement with respect to y.
        subset_px: edge of the subset.
        interpolation: ``cubic`` or ``quintic``.
    """
    # float32 is ten times faster and accurate to 1e-7
    phase = (2.0 * np.pi * (shift_px - np.round(shift_px))).astype(np.float32)
    return _passed(phase, (np.stack([along_x, along_y]) * subset_px).astype(np.float32), interpolation)


def _passed(phase: NDArray[np.float32], change_px: NDArray[np.float32], interpolation: str) -> NDArray[np.float32]:
    """`interpolation_noise_gain` for phases (2 pi per pixel) and changes of the displacement across a subset along x and y."""
    constant, *harmonics = (np.float32(h) for h in HARMONICS[interpolation])
    gain = np.full(phase.shape, constant)
    for k, harmonic in enumerate(harmonics, start=1):
        angle = np.float32(np.pi) * (k * change_px)
        angle[angle == 0.0] = TINY
        across, down = np.sin(angle) / angle
        gain += harmonic * np.cos(k * phase) * across * down
    return gain


def noise_variance(
    parameters: NDArray[np.float64],
    zncc: NDArray[np.float64],
    norm: NDArray[np.float64],
    subset_px: int,
    *,
    interpolation: str = "cubic",
    fitted: int = 6,
    pixels: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Return (ny, nx) noise variance of one frame in grey^2 from the residual, assuming equal noise in both frames.

    The residual contains the noise of the reference and that of the current frame after interpolation: (1 + h_x h_y) times the variance
    of one frame, between 1.57 and 2. Division by 2 would understate sigma by up to 11 % at half-pixel shifts. The complete noise affects
    the displacement at every phase, because gradients of speckle have low frequencies, which interpolation passes. Rounding to grey
    levels is the smallest noise, also for two identical frames.

    Args:
        parameters: (ny, nx, 6) affine solutions.
        zncc: (ny, nx) ZNCC of the solutions.
        norm: (ny, nx) root of the centred sum of squares of each reference subset.
        subset_px: edge of the subset.
        interpolation: ``cubic`` or ``quintic``.
        fitted: number of parameters of the shape function.
        pixels: (ny, nx) number of valid pixels of each subset; None: all.
    """
    each = _passed(*phases(parameters, subset_px), interpolation)  # u and v at once: for few points the calls dominate the time
    gain = each[0] * each[1]
    degrees = np.maximum((subset_px**2 if pixels is None else pixels) - fitted - 2, 1.0)  # offset and contrast are fitted too
    residual = 2.0 * np.maximum(1.0 - zncc, 0.0) * norm**2 / degrees
    return np.maximum(residual / (1.0 + gain), ROUNDING_VARIANCE)
