"""Noise of correlation engines: white noise of the pixels of each frame, seen through the weights of a subset.

Nothing here is shared with the estimator, the diagnosis or the simulators.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SUBSET_PX = 43


@dataclass(frozen=True, slots=True)
class Shape:
    """How an engine's noise is shared.

    Attributes:
        weights: weights of a subset: ``square``, ``gaussian``, ``round``, or ``point`` for independent points.
        smooth_px: standard deviation of a Gaussian by which the maps were smoothed afterwards, px; 0 without.
        own: noise belongs to each map instead of to each frame.
        composed: maps exist within pairs and from frame 0 to first frames only.
        unequal: ratio of the noise along y to that along x, log standard deviation over frames, and largest ratio over the field.
        lost: fraction of the points that is lost, half of it singly, half of it in one region of each map.
        heavy: degrees of freedom of a t distribution of the pixels' noise; 0 for a normal distribution.
        white: fraction of the variance that is each point's own, such as rounding in the text.
    """

    weights: str = "square"
    smooth_px: float = 0.0
    own: bool = False
    composed: bool = False
    unequal: tuple[float, float, float] = (1.0, 0.0, 1.0)
    lost: float = 0.0
    heavy: int = 0
    white: float = 0.0


SHAPES = {
    "square": Shape(),
    "gaussian": Shape("gaussian"),
    "round": Shape("round"),
    "independent": Shape("point"),
    "smoothed": Shape("square", smooth_px=25.0),
    "smoothed gaussian": Shape("gaussian", smooth_px=15.0),
    "own noise of maps": Shape("gaussian", own=True),
    "composed": Shape("square", composed=True),
    "composed, own": Shape("gaussian", own=True, composed=True),
    "unequal": Shape("square", unequal=(1.6, 0.25, 1.8)),
    "lost points": Shape("square", lost=0.15),
    "heavy tails, rounded": Shape("round", heavy=3, white=0.2),
}


def noise_of(shape: Shape, size: tuple[int, int], frames: int, sigma_px: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """(frames, 2, height, width) noise of displacement at each pixel of a frame, px."""
    transfer = _transfer(shape, size)
    height, width = size
    scale = sigma_px * np.exp(rng.normal(0.0, shape.unequal[1], frames))
    x = np.linspace(0.0, 1.0, width)
    over_field = np.sqrt(shape.unequal[2]) ** (2.0 * x - 1.0)
    out = np.empty((frames, 2, height, width), dtype=np.float32)
    for frame in range(frames):
        for axis in (0, 1):
            white = rng.standard_t(shape.heavy, size) if shape.heavy else rng.normal(size=size)
            noise = np.fft.irfft2(np.fft.rfft2(white) * transfer, size) if shape.weights != "point" or shape.smooth_px else white
            noise = noise / noise.std() * np.sqrt(1.0 - shape.white) + np.sqrt(shape.white) * rng.normal(size=size)
            out[frame, axis] = scale[frame] * (shape.unequal[0] if axis else 1.0) * over_field * noise
    return out


def _transfer(shape: Shape, size: tuple[int, int]) -> NDArray[np.complex128]:
    """Transfer function of the weights; the frame is wrapped round."""
    y, x = (np.minimum(np.arange(n), n - np.arange(n)) for n in size)
    square = x[None, :] ** 2 + y[:, None] ** 2
    half = SUBSET_PX // 2
    if shape.weights == "square":
        weights = ((x[None, :] <= half) & (y[:, None] <= half)).astype(float)
    elif shape.weights == "round":
        weights = (square <= half**2).astype(float)
    elif shape.weights == "gaussian":
        weights = np.exp(-0.5 * square / (SUBSET_PX / 5.0) ** 2)
    else:
        weights = (square == 0).astype(float)
    total = np.fft.rfft2(weights)
    if shape.smooth_px:
        total = total * np.fft.rfft2(np.exp(-0.5 * square / shape.smooth_px**2))
    return total
