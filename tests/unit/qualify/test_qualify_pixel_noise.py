"""The noise of a pixel is that of the detector, whatever the pattern, motion of the rows, and constant areas."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from semlive.qualify.figures.pixel_noise import pixel_noise

NOISE_GREY, SIZE_PX, FINE, FRAMES = 4.0, 384, 4, 6
BINOMIAL = 3.0 * np.sqrt(0.95 * 0.05 * 24)


def _pattern(rng: np.random.Generator, jitter_px: float) -> NDArray[np.float64]:
    """Speckle of about 7 px with a contrast of 40 grey levels; each row is displaced along itself by jitter."""
    fine = ndimage.gaussian_filter(rng.standard_normal((SIZE_PX, SIZE_PX * FINE)), (2.5, 2.5 * FINE), mode="wrap")
    edges = ndimage.gaussian_filter((fine > 0.0).astype(np.float64), (0.8, 0.8 * FINE))
    at = (np.arange(SIZE_PX) + 0.5) * FINE
    rows = [np.interp(at + FINE * jitter_px * rng.standard_normal(), np.arange(SIZE_PX * FINE), row) for row in edges]
    return 128.0 + 80.0 * (np.array(rows) - 0.5)


def _frame(rng: np.random.Generator, jitter_px: float, noise_grey: float = NOISE_GREY) -> NDArray[np.uint8]:
    grey = _pattern(rng, jitter_px)
    return np.clip(np.rint(grey + noise_grey * rng.standard_normal(grey.shape)), 0, 255).astype(np.uint8)


def test_rows_that_move_do_not_add_the_pattern_to_the_noise() -> None:
    rng = np.random.default_rng(1)
    true = float(np.hypot(NOISE_GREY, np.sqrt(1.0 / 12.0)))
    mean = np.mean([pixel_noise(_frame(rng, 0.6))[0] for _ in range(FRAMES)])
    assert abs(mean / true - 1.0) < 0.025  # fourth differences along both axes: 0.043


def test_the_noise_is_inside_its_interval() -> None:
    rng = np.random.default_rng(2)
    true, inside = float(np.hypot(NOISE_GREY, np.sqrt(1.0 / 12.0))), 0
    for _ in range(24):
        _, low, high = pixel_noise(_frame(rng, 0.0))
        inside += low <= true <= high
    assert abs(inside - 0.95 * 24) <= BINOMIAL


def test_constant_areas_do_not_change_the_noise() -> None:
    frame = _frame(np.random.default_rng(3), 0.0)
    value, _, _ = pixel_noise(frame)
    frame[-96:] = 255
    assert abs(pixel_noise(frame)[0] / value - 1.0) < 0.02


def test_differences_of_zero_are_part_of_the_noise() -> None:
    # Fourth differences along both axes are multiples of 3 % of this noise, and one of 100 is zero: they stated 3 % too much.
    rng = np.random.default_rng(4)
    frame = np.rint(100.3 + 0.5 * rng.standard_normal((SIZE_PX, SIZE_PX))).astype(np.uint8)
    assert abs(pixel_noise(frame)[0] / float(frame.std()) - 1.0) < 0.02


def test_a_small_frame_has_no_interval_and_a_constant_one_no_noise() -> None:
    frame = _frame(np.random.default_rng(5), 0.0)[:64, :64]
    value, low, high = pixel_noise(np.ascontiguousarray(frame))
    assert low == value == high > 0.0
    assert pixel_noise(np.full((200, 200), 7, dtype=np.uint8)) == (0.0, 0.0, 0.0)
    assert pixel_noise(np.full((4, 200), 7, dtype=np.uint8)) == (0.0, 0.0, 0.0)
