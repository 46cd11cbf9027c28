"""Points that were correlated wrongly and look converged: alone, or as many as in a complete subset, side by side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from semlive import estimate as estimating
from semlive.data.disparity import DisparityMap
from semlive.data.settings import EstimateSettings

WIDTH_PX, HEIGHT_PX = 1024, 884
SHARE, ERROR_PX = 0.01, 1.0


def spoilt(dmap: DisparityMap, width: int) -> DisparityMap:
    """One point in a hundred off by 1 px, in squares `width` points wide."""
    rng = np.random.default_rng((dmap.reference, dmap.current, width))
    u, v = dmap.u_px.copy(), dmap.v_px.copy()
    rows, columns = u.shape
    for _ in range(max(1, round(SHARE * u.size / width**2))):
        at = np.s_[(row := rng.integers(rows - width + 1)) : row + width, (column := rng.integers(columns - width + 1)) : column + width]
        turn = rng.uniform(0.0, 2.0 * np.pi)
        u[at] += ERROR_PX * np.cos(turn)
        v[at] += ERROR_PX * np.sin(turn)
    return replace(dmap, u_px=u, v_px=v)


def worst_px(world: Any, steps: list[Any], width: int | None) -> float:
    """Largest rms error of a frame's correction at the places where the true maps have the points, its mean removed."""
    state, taken = estimating.init(EstimateSettings(), world.grid, WIDTH_PX, HEIGHT_PX), list(world.pairs(steps))
    for item in taken:
        maps = item.maps if width is None else tuple(spoilt(dmap, width) for dmap in item.maps)
        state = estimating.update(state, item.pair, item.step.phase, item.times, maps)
    solution = estimating.solve(state)
    return max(item.worst_px(partial(estimating.correction, solution)) for item in taken[1:])


@pytest.mark.parametrize("width", [1, 4])
def test_one_point_in_a_hundred_off_by_a_pixel_costs_little(world: Callable[..., Any], plans: dict[str, list[Any]], width: int) -> None:
    """The bar of a sound run; squares fill a block of a subset's size partly or completely, and no neighbour gives them away there."""
    steps = [item for item in plans["short"] if item.strain == 0.0][:5]
    sound, found = (worst_px(world(3), steps, item) for item in (None, width))
    assert found < 0.006
    assert found < 1.3 * sound
