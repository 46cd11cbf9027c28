"""Consistency checks: halves of the data agree unless something is wrong; areas without calibration are reported and flagged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from semlive import estimate as estimating
from semlive import mechanics
from semlive.data.disparity import DisparityMap
from semlive.data.experiment import Phase
from semlive.data.settings import EstimateSettings
from semlive.estimate.joint.outputs.calibration_quality import calibration, support
from semlive.estimate.joint.outputs.consistency import FIELD, PAIRS, WARN_SIGMAS, consistency

Spoil = Callable[[DisparityMap], DisparityMap]


def untouched(dmap: DisparityMap) -> DisparityMap:
    return dmap


def solved(world: Any, steps: list[Any], spoil: Spoil = untouched) -> tuple[estimating.Solution, list[Any]]:
    state, taken = estimating.init(EstimateSettings(), world.grid, 1024, 884), list(world.pairs(steps))
    for item in taken:
        state = estimating.update(state, item.pair, item.step.phase, item.times, tuple(spoil(dmap) for dmap in item.maps))
    return estimating.solve(state), taken


def test_halves_of_a_sound_run_agree(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    """Over seeds the differences are as large as expected, neither more nor less: their sigmas are those of chance."""
    found = [item for seed in range(200, 203) for item in consistency(solved(world(seed, step_px=30), plans["short"])[0])]
    sigmas = np.array([item.sigmas for item in found])
    assert np.abs(sigmas).max() < 3.5, sigmas
    assert abs(sigmas.mean()) < 1.3, sigmas
    assert max(check.sigmas for check in found) <= WARN_SIGMAS


def test_a_sliding_part_of_the_field_is_detected(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    """The left half creeps by 0.2 px from the top to the bottom of every second frame."""

    def slide(dmap: DisparityMap) -> DisparityMap:
        x, y = dmap.grid.mesh()
        creep = np.where((x < 470) & (dmap.current % 2 == 1), 0.2 * (y - 101) / 600, 0.0)
        return replace(dmap, v_px=dmap.v_px + creep)

    field, _ = consistency(solved(world(210, step_px=30), plans["short"], slide)[0])
    assert field.name == FIELD
    assert field.sigmas > 4.0
    assert field.note().message.startswith("WARNING: drifts from the left and right half")


def test_a_changing_distortion_is_detected(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    """Every second pair is shifted with another distortion, a wave of 0.15 px more, as when beam and stage take turns."""

    def wave(at: np.ndarray) -> np.ndarray:
        return 0.15 * np.cos(2 * np.pi * at / 300)

    def otherwise(dmap: DisparityMap) -> DisparityMap:
        x, _ = dmap.grid.mesh()
        return replace(dmap, u_px=dmap.u_px + wave(x + dmap.u_px) - wave(x)) if dmap.current // 2 % 2 == 1 else dmap

    _, pairs = consistency(solved(world(211, step_px=30), plans["full"][:9], otherwise)[0])
    assert pairs.name == PAIRS
    assert pairs.sigmas > 4.0, pairs
    assert "WARNING" in pairs.note().message


def line(step: Any, shifts: list[tuple[float, float]]) -> list[Any]:
    return [step(Phase.CALIBRATION, shift, 0.0) for shift in shifts]


@pytest.mark.parametrize(
    ("shifts", "advice"),
    [
        ([(0.0, 0.0), (24.0, 0.0), (-24.0, 0.0), (12.0, 0.0)], "translations along y"),
        ([(0.0, 0.0), (0.0, 24.0), (0.0, -24.0), (0.0, 12.0)], "translations along x"),
        ([(0.0, 0.0), (2.0, 0.0), (-2.0, 0.0), (0.0, 2.0), (0.0, -2.0)], "larger translations"),
    ],
)
def test_a_poor_calibration_is_reported_with_its_figures(
    world: Callable[..., Any], plans: dict[str, list[Any]], shifts: list[tuple[float, float]], advice: str
) -> None:
    solution, _ = solved(world(220, step_px=30), line(type(plans["short"][0]), shifts))
    found = calibration(solution)
    assert not found.sufficient
    printed = estimating.to_estimate(solution, 0).notes[0].text
    assert advice in printed
    assert f"{found.lever_px[0]:.3g} px along x" in printed
    assert found.poor
    assert found.quality().refused == found.message()


def test_load_steps_on_a_poor_calibration_are_warned_of(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    step = type(plans["short"][0])
    plan = [*line(step, [(0.0, 0.0), (24.0, 0.0), (-24.0, 0.0)]), step(Phase.TENSION, (0.0, 0.0), 1e-3)]
    assert estimating.to_estimate(solved(world(221, step_px=30), plan)[0], 0).notes[0].message.startswith("WARNING, the load steps")


def test_a_point_beyond_the_calibrated_area_gets_no_displacement(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    """80 px after a calibration within +-24 px: what lies beyond is flagged, what lies within is right, other frames keep all points."""
    far = type(plans["short"][0])(Phase.TENSION, (80.0, 80.0), 3e-3)
    solution, taken = solved(world(222, step_px=30), [*plans["short"], far])
    area = support(solution.state)
    assert area is not None
    across = [item for item in taken[-1].maps if item.reference == 0]
    for dmap in across:
        moved = mechanics.displacement(dmap, estimating.correction(solution, dmap))
        x, y = dmap.grid.mesh()
        np.testing.assert_array_equal(moved.valid, area.holds(x + dmap.u_px, y + dmap.v_px))
        assert 0.7 < moved.valid.mean() < 0.97
        assert not moved.u_px[~moved.valid].any()
    near = [item for item in taken[-2].maps if item.reference == 0]
    assert all(mechanics.displacement(item, estimating.correction(solution, item)).valid.all() for item in near)
    printed = [item.message for item in estimating.to_estimate(solution, 0).notes]
    printed = [item for item in printed if item.startswith("WARNING: the specimen left the area")]
    assert len(printed) == 1
    assert "2 frames" in printed[0]
