"""Runs with pauses of hours: the drift continues through the pause, the cost and the choices do not change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from semlive import estimate as estimating
from semlive.data.notes import NoteLevel
from semlive.data.settings import EstimateSettings
from semlive.estimate.joint.observations import accumulation
from semlive.estimate.joint.observations.accumulation import dense_limit
from semlive.estimate.joint.selection.long_run import sampled_pairs
from semlive.estimate.joint.solution.subset import sampled_pair_numbers

NIGHT_S = 15 * 3600.0


def rested(world: Any, plan: list[Any], before: int, pause_s: float) -> list[Any]:
    """The pairs of a plan, with a pause before one of them in which the drift hardly grows beyond what it was."""
    world.rate_px_s, world.bend_px_s2 = 0.1 * world.rate_px_s, 0.0 * world.bend_px_s2
    return list(world.pairs(plan, [4 * 94.67 * pair + (pause_s if pair >= before else 0.0) for pair in range(len(plan))]))


def solved(world: Any, taken: list[Any]) -> estimating.Solution:
    state = estimating.init(EstimateSettings(), world.grid, 1024, 884)
    for item in taken:
        state = estimating.update(state, item.pair, item.step.phase, item.times, item.maps)
    return estimating.solve(state)


@pytest.mark.parametrize("before", [1, 3])
def test_a_night_s_pause_costs_nothing_and_spoils_nothing(world: Callable[..., Any], plans: dict[str, list[Any]], before: int) -> None:
    item = world(7, step_px=30)
    taken = rested(item, plans["short"], before, NIGHT_S)
    solution = solved(item, taken)
    assert dense_limit(solution.state) == len(taken)
    assert solution.state.layout.size < 1500  # all its knots are 4,700
    assert max(pair.worst_px(lambda dmap: estimating.correction(solution, dmap)) for pair in taken[1:]) <= 0.02
    for pair in taken[1:]:
        for dmap in pair.maps[1:]:
            reported, g = estimating.correction_strain(solution, dmap), pair.gradient
            plane = np.column_stack((np.ones(item.grid.nx * item.grid.ny), *(axis.ravel() for axis in item.grid.mesh())))
            u, v = (np.linalg.lstsq(plane, field.ravel(), rcond=None)[0] for field in (dmap.u_px, dmap.v_px))
            error = np.array([u[1], v[2]]) - reported.value[:2] - [g[0, 0], g[1, 1]]
            assert np.all(np.abs(error) < 4.0 * np.hypot([reported.sigma.exx, reported.sigma.eyy], 1e-5))  # and the frame's own noise
    assert len(estimating.consistency_notes(solution)) == 2
    assert len(estimating.to_estimate(solution, len(taken)).motions) == len(taken)


def test_choices_are_those_of_one_matrix(world: Callable[..., Any], plans: dict[str, list[Any]], monkeypatch: pytest.MonkeyPatch) -> None:
    item = world(8, step_px=30)
    taken = rested(item, plans["short"], 5, 5 * 3600.0)
    together = solved(item, taken)
    monkeypatch.setattr(accumulation, "DENSE_KNOTS", 60)
    separate = solved(item, taken)
    assert (separate.state.summed, together.state.summed) == (False, True)
    assert separate.hyper.noise_scale == pytest.approx(together.hyper.noise_scale, rel=0.05)
    assert [test.included for test in separate.terms] == [test.included for test in together.terms]
    maps = [dmap for pair in taken[1:] for dmap in pair.maps[1:]]
    for item, other in zip(*(estimating.correction_strains(each, maps) for each in (separate, together)), strict=True):
        sigma = np.array([other.sigma.exx, other.sigma.eyy, other.sigma.exy])
        assert np.abs(item.value - other.value).max() < 0.5 * sigma.max()
        np.testing.assert_allclose([item.sigma.exx, item.sigma.eyy, item.sigma.exy], sigma, rtol=0.3)


def test_a_pause_after_many_pairs(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    """Of pairs before and after it halves are compared apart: in one band those before lost all digits."""
    item, still = world(9, step_px=40), plans["short"][0]
    rng = np.random.default_rng(2)
    plan = [*plans["short"][:5], *(replace(still, shift_px=tuple(rng.uniform(-28, 28, 2))) for _ in range(31))]
    solution = solved(item, rested(item, plan, 20, NIGHT_S))
    assert [len(part) for part in sampled_pairs(solution.state)] == [20, 16]
    assert len(sampled_pair_numbers(solution.state, 24)) == 32
    assert not [note for note in estimating.consistency_notes(solution) if note.level is NoteLevel.WARNING]
