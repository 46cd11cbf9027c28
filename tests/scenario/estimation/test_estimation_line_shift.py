"""Rows that begin where they should not: found by the data, corrected, and left alone where there is nothing of the kind."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from semlive import estimate as estimating
from semlive.data.settings import EstimateSettings
from semlive.estimate.joint.solution.posterior import Solution

WIDTH_PX, HEIGHT_PX = 1024, 884
SHIFT_PX, ROWS = 0.06, 90.0  # standard deviation of a frame's shift along x, and how many rows share it


def jittering(world: Any, sd_px: float) -> Any:
    """The world with a shift along x that continues from row to row as a sum of waves, with phases of its own in every frame."""
    kind = type(world)

    class Jittering(kind):  # type: ignore[misc, valid-type]
        def error(self, at: Any, start_s: float) -> Any:
            total = super().error(at, start_s)
            rng = np.random.default_rng(round(1e3 * start_s) + self.seed)
            for period in np.geomspace(1.3, 5.0, 6) * ROWS:
                total[..., 0] += sd_px * np.sqrt(2 / 6) * np.sin(2 * np.pi * (at[..., 1] / period + rng.uniform()))
            return total

    return Jittering(world.seed, world.grid, world.noise_px)


def solved(one: Any, steps: list[Any]) -> tuple[Solution, float]:
    """The solution, and the largest rms error of a frame's correction, px."""
    state = estimating.init(EstimateSettings(), one.grid, WIDTH_PX, HEIGHT_PX)
    taken = list(one.pairs(steps))
    for pair in taken:
        state = estimating.update(state, pair.pair, pair.step.phase, pair.times, pair.maps)
    solution = estimating.solve(state)
    return solution, max(pair.worst_px(partial(estimating.correction, solution)) for pair in taken[1:])


def test_shifts_of_rows_are_found_and_corrected(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    """Taken for drift they made it rough, left three times the noise, and put 0.054 px into displacements."""
    solution, worst_px = solved(jittering(world(60), SHIFT_PX), plans["short"][:7])
    (reported,) = (one for one in solution.terms if one.name == "line_shift")
    assert reported.included
    assert reported.evidence > 100
    assert solution.hyper.row_shift_px == pytest.approx(SHIFT_PX, rel=0.5)
    assert solution.hyper.noise_scale == pytest.approx(1.0, rel=0.15)
    assert worst_px < 0.025
    assert any("rows" in note.text for note in estimating.to_estimate(solution, 0).notes)


def test_a_run_with_row_shifts_continues(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    """What comes later has shifts of its own, found from the pair itself, between choices too."""
    one, steps = jittering(world(61), SHIFT_PX), [plans["full"][at] for at in (0, 2, 8, 4, 10)]
    state, taken = estimating.init(EstimateSettings(), one.grid, WIDTH_PX, HEIGHT_PX), list(one.pairs(steps))
    previous: Solution | None = None
    for pair in taken:
        state = estimating.update(state, pair.pair, pair.step.phase, pair.times, pair.maps)
        previous = estimating.solve_live(state, previous) if pair.pair >= 3 else None
    assert previous is not None
    assert previous.hyper.row_shift_px > 0
    assert previous.state.row_shifts.frames == tuple(range(10))
    assert taken[-1].worst_px(partial(estimating.correction, previous)) < 0.025


def test_where_rows_keep_still_none_is_shifted(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    solution, _ = solved(world(62), plans["short"][:6])
    (reported,) = (one for one in solution.terms if one.name == "line_shift")
    assert not reported.included
    assert reported.evidence < 2
    assert solution.state.row_shifts.size == 0
