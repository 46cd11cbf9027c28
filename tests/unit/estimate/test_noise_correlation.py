"""What neighbouring blocks share is read from their residuals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from semlive.data.grid import Grid
from semlive.estimate.joint.observations.block_means import Blocks
from semlive.estimate.joint.solution.residual_noise import block_scatter

GRID = Grid(101, 101, 5, 150, 120, 43)


def residuals(seed: int, overlap_points: int) -> list[np.ndarray]:
    """Block means of noise that `overlap_points` points along each axis share, as many maps as ten pairs have."""
    rng, blocks, every = np.random.default_rng(seed), Blocks.of(GRID), np.ones(GRID.nx * GRID.ny, dtype=bool)
    fields = []
    for _ in range(20):
        noise = [uniform_filter(rng.normal(size=GRID.shape), overlap_points, mode="wrap").ravel() for _ in range(2)]
        fields.append(blocks.mean(np.stack(noise, axis=1), every))
    return fields


def test_blocks_of_white_noise_are_independent() -> None:
    assert block_scatter(Blocks.of(GRID), residuals(1, 1), np.inf) == pytest.approx(1.0, abs=0.06)


def test_overlapping_subsets_share_what_they_overlap() -> None:
    blocks = Blocks.of(GRID)
    assert block_scatter(blocks, residuals(2, 9), np.inf) == pytest.approx(blocks.block_variance_ratio, rel=0.15)
