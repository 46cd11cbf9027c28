"""Runs that are not as planned: points and subsets that fail, maps that are missing, pairs at odd times, phases in any order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from semlive import estimate as estimating
from semlive import mechanics
from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.experiment import Phase
from semlive.data.settings import EstimateSettings

BREAK_S = 1.5 * 3600.0


@dataclass(frozen=True)
class Outcome:
    drift_error_px: np.ndarray  # (frames,) rms within each frame
    strain_error: np.ndarray  # (frames, 3)
    strain_z: np.ndarray  # (frames, 3)


def run(world: Any, taken: list[Any]) -> Outcome:
    """Estimate what was taken, and compare every frame that has a map from frame 0 with the truth."""
    state = estimating.init(EstimateSettings(), world.grid, 1024, 884)
    for item in taken:
        state = estimating.update(state, item.pair, item.step.phase, item.times, item.maps)
    solution = estimating.solve(state)
    found = estimating.to_estimate(solution, 0)
    error, sigma = [], []
    for item in taken:
        for dmap in (dmap for dmap in item.maps if dmap.reference == 0):
            moved = mechanics.displacement(dmap, estimating.correction(solution, dmap))
            systematic = estimating.correction_strain_sigma(solution, dmap)
            printed = mechanics.summary(moved, mechanics.strain(moved, 5), found.noise_floor_px, systematic)
            g = item.gradient
            error.append([printed.mean.exx - g[0, 0], printed.mean.eyy - g[1, 1], printed.mean.exy - 0.5 * (g[0, 1] + g[1, 0])])
            sigma.append([printed.mean_sigma.exx, printed.mean_sigma.eyy, printed.mean_sigma.exy])
    drift = []
    for frame in np.unique(found.drift.frame):
        inside = found.drift.frame == frame
        off = found.drift.drift_px[inside] - world.drift(found.drift.time_s[inside])
        drift.append(np.sqrt(np.mean((off - off.mean(axis=0)) ** 2)))
    assert np.isfinite(np.concatenate([motion.gradient.ravel() for motion in found.motions])).all()
    return Outcome(np.array(drift), np.array(error), np.array(error) / np.array(sigma))


def failing(dmap: DisparityMap, bad: np.ndarray, status: PoiStatus) -> DisparityMap:
    """The map where the correlation of some subsets failed; whoever reads their numbers finds nonsense."""
    u, v = (np.where(bad, 1e3, item) for item in (dmap.u_px, dmap.v_px))
    return replace(dmap, u_px=u, v_px=v, status=np.where(bad, status, dmap.status).astype(np.uint8))


def check_errors(found: Outcome) -> None:
    """The bars of a complete run, and errors as large as stated."""
    assert found.drift_error_px.max() <= 0.02
    assert 0.3 < np.sqrt(np.mean(np.clip(found.strain_z, -4, 4) ** 2)) < 1.6


@pytest.fixture(scope="module")
def taken(world: Callable[..., Any], plans: dict[str, list[Any]]) -> tuple[Any, list[Any]]:
    item = world(7)
    return item, list(item.pairs(plans["short"]))


def test_scattered_failed_points_and_an_invisible_corner(taken: tuple[Any, list[Any]]) -> None:
    """A fifth of all subsets fails in each map, others in each; a corner is masked; one map has lost its lower half."""
    world, pairs = taken
    rng, corner = np.random.default_rng(3), np.zeros(world.grid.shape, dtype=bool)
    corner[: world.grid.ny // 3, : world.grid.nx // 3] = True
    below = np.arange(world.grid.ny)[:, None] * np.ones(world.grid.nx) > world.grid.ny / 2
    broken = []
    for item in pairs:
        maps = tuple(
            failing(failing(dmap, rng.random(dmap.grid.shape) < 0.2, PoiStatus.LOW_ZNCC), corner, PoiStatus.MASKED) for dmap in item.maps
        )
        maps = (*maps[:-1], failing(maps[-1], below, PoiStatus.OUTSIDE_IMAGE)) if item.pair == 3 else maps
        broken.append(replace(item, maps=maps))
    found = run(world, broken)
    check_errors(found)
    assert np.abs(found.strain_error).max() <= 8e-5


def test_maps_that_are_missing_altogether(taken: tuple[Any, list[Any]]) -> None:
    """Pair 2 has no map within the pair, pair 4 none from frame 0 to its second frame, pair 6 none to its first."""
    world, pairs = taken
    left = {2: (1, 2), 4: (0, 1), 6: (0, 2)}
    found = run(world, [replace(item, maps=tuple(item.maps[at] for at in left.get(item.pair, range(len(item.maps))))) for item in pairs])
    check_errors(found)
    assert np.abs(found.strain_error).max() <= 6e-5


def test_pairs_at_odd_times_with_a_long_break_between_calibration_and_load(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    """Within each half pairs follow each other after 4 to 20 minutes; drift across the break is nobody's knowledge, and no harm."""
    rng, item = np.random.default_rng(5), world(8)
    gaps_s = rng.uniform(240.0, 1200.0, len(plans["short"]))
    gaps_s[0], gaps_s[5] = 0.0, BREAK_S
    found = run(item, list(item.pairs(plans["short"], list(np.cumsum(gaps_s)))))
    check_errors(found)
    assert np.abs(found.strain_error).max() <= 6e-5


def test_calibration_again_between_and_after_load_steps(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    """Two calibrations, translations and two series of load steps in turn."""
    calibration, load = plans["short"][:5], plans["short"][5:]
    translation = [replace(plans["full"][13], phase=Phase.TRANSLATION)]
    item = world(9)
    found = run(item, list(item.pairs([*calibration[:3], *load[:3], *translation, *calibration[3:], load[3]])))
    check_errors(found)
    assert np.abs(found.strain_error).max() <= 6e-5
