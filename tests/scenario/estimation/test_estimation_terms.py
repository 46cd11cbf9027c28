"""Terms that the data ask for: magnification that drifts, distortion that the drift carries along, scans that are integrated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from semlive import estimate as estimating
from semlive.data.drift import EstimateRevision
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import EstimateSettings
from semlive.estimate.joint.elimination.elimination import eliminate_all
from semlive.estimate.joint.observations.normal_equations import without_normal_matrix
from semlive.estimate.joint.observations.reformulate import with_advected_distortion, with_static_distortion
from semlive.estimate.joint.solution import posterior as estimating_posterior
from semlive.estimate.joint.solution.advection import reestimate_advection

WIDTH_PX, HEIGHT_PX = 1024, 884
CENTRE = np.array([WIDTH_PX - 1, HEIGHT_PX - 1]) / 2


def changed(world: Any, **more: Any) -> Any:
    """The world with another error of the beam: `carried` distortion, `growth` of magnification or `turn` of the raster in 1/s, `scans`."""
    carried, growth, scans = more.get("carried", False), more.get("growth", 0.0), more.get("scans", 1)
    turn = more.get("turn", 0.0)
    kind = type(world)
    timing = scan_timing(scans)

    class Changed(kind):  # type: ignore[misc, valid-type]
        def error(self, at: Any, start_s: float) -> Any:
            first_s = start_s + at[..., 0] * timing.dwell_time_s.value + at[..., 1] * timing.row_time_s.value
            visits = [first_s + scan * timing.frame_time_s.value for scan in range(scans)]
            drift = np.mean([self.drift(time_s) for time_s in visits], axis=0)
            grown = growth * np.mean(visits, axis=0)
            bend = self.distortion(at - drift if carried else at)
            left = at - bend - CENTRE
            turned = turn * np.mean(visits, axis=0)[..., None] * np.stack((-left[..., 1], left[..., 0]), axis=-1)
            return bend + drift + grown[..., None] * (at - CENTRE) + turned

        def pairs(self, steps: Any) -> Any:
            for taken in super().pairs(steps):
                yield replace(taken, times=tuple(replace(when, timing=timing) for when in taken.times))

    return Changed(world.seed, world.grid, world.noise_px)


def scan_timing(scans: int) -> ScanTiming:
    frame_s = 94.67 / scans
    dwell, row, frame = (Sourced(item, Provenance.CONFIG) for item in (1e-4 / scans, frame_s / HEIGHT_PX, frame_s))
    return ScanTiming(dwell, row, frame, Sourced(scans, Provenance.CONFIG))


def followed(world: Any, steps: list[Any]) -> tuple[estimating.Solution, list[Any]]:
    """The solution of all pairs, and the pairs."""
    state = estimating.init(EstimateSettings(), world.grid, WIDTH_PX, HEIGHT_PX)
    taken = list(world.pairs(steps))
    for item in taken:
        state = estimating.update(state, item.pair, item.step.phase, item.times, item.maps)
    return estimating.solve(state), taken


def outcome(solution: estimating.Solution, taken: list[Any]) -> tuple[EstimateRevision, float]:
    """The estimate, and the largest rms error of a frame's correction, px, its best affine map removed."""
    return estimating.to_estimate(solution, 0), max(item.worst_px(partial(estimating.correction, solution)) for item in taken[1:])


def solved(world: Any, steps: list[Any]) -> tuple[EstimateRevision, float]:
    return outcome(*followed(world, steps))


@pytest.fixture(scope="module")
def steps(plans: dict[str, list[Any]]) -> list[Any]:
    return [item for item in plans["short"] if item.strain == 0.0][:5]


@pytest.fixture(scope="module")
def with_carried(world: Callable[..., Any], steps: list[Any]) -> tuple[estimating.Solution, list[Any]]:
    """A solution of a distortion that the drift carries along, which two tests examine and neither changes."""
    return followed(changed(world(5, noise_px=0.005), carried=True), steps)


def used(found: EstimateRevision) -> dict[str, bool]:
    return {item.name: item.included for item in found.terms}


def test_nothing_is_added_where_nothing_is_missing(world: Callable[..., Any], steps: list[Any]) -> None:
    for seed in (1, 2, 3):
        found, worst = solved(world(seed), steps)
        assert not any(used(found).values()), found.terms
        assert found.raster is not None
        assert np.abs(found.raster.magnification).max() < 1e-7
        assert worst < 0.006


def test_drifting_magnification_is_found_and_corrected(world: Callable[..., Any], steps: list[Any]) -> None:
    """5e-4 in two hours: without the term it is 0.1 px at the edge after the five pairs of this plan, and strain of 1.3e-4."""
    growth = 5e-4 / 6400.0
    found, worst = solved(changed(world(4), growth=growth), steps)
    assert used(found) == {"magnification": True, "raster_rotation": False, "coupling": False, "line_shift": False}
    assert any("the magnification drifts" in note.text for note in found.notes)
    assert found.raster is not None
    change = found.raster.magnification[-1] - found.raster.magnification[0]
    true = growth * 94.67 * (4 * 4 + 1)
    sigma = float(np.hypot(found.raster.magnification_sigma[-1], found.raster.magnification_sigma[0]))
    assert abs(change - true) < 3.5 * sigma
    assert sigma < 0.15 * true
    assert worst < 0.01


def test_rotation_of_the_raster_is_corrected_under_load_without_noise(world: Callable[..., Any], plans: dict[str, list[Any]]) -> None:
    """It absorbs the residual of the distortion, 1e-4 px outside of the model: made a rough drift, 0.05 px and more of displacement."""
    loaded = [item for item in plans["short"] if item.strain][:3]
    calibration = [item for item in plans["short"] if item.strain == 0.0][:5]
    found, worst = solved(changed(world(7, noise_px=0.0), turn=1e-7), [*calibration, *loaded])
    assert used(found)["raster_rotation"], found.terms
    assert not used(found)["coupling"]
    assert worst < 1e-3


def test_distortion_carried_by_drift_is_found(with_carried: tuple[estimating.Solution, list[Any]]) -> None:
    found, worst = outcome(*with_carried)
    assert used(found)["coupling"], found.terms
    assert worst < 0.004


def test_carried_distortion_is_found_without_noise(world: Callable[..., Any], steps: list[Any]) -> None:
    """The misfit of the wrong coupling is then all that there is: drift was made rough by hundreds of px in its place."""
    found, worst = solved(changed(world(1, noise_px=0.0), carried=True), steps)
    assert used(found) == {"magnification": False, "raster_rotation": False, "coupling": True, "line_shift": False}
    assert worst < 5e-5


@pytest.mark.parametrize("carried", [False, True])
def test_a_long_run_judges_the_coupling_again(
    world: Callable[..., Any], steps: list[Any], with_carried: tuple[estimating.Solution, list[Any]], carried: bool
) -> None:
    """Along a chain of pairs, whatever was chosen before: right or wrong, it ends with what the data have."""
    right, _ = with_carried if carried else followed(changed(world(5, noise_px=0.005), carried=False), steps)
    assert right.state.distortion.carried == carried
    other = (
        with_static_distortion(without_normal_matrix(right.state))
        if carried
        else with_advected_distortion(without_normal_matrix(right.state))
    )
    wrong = estimating_posterior.posterior_from_elimination(
        eliminate_all(other, right.hyper, right.mean), right.terms, right.noise_floor_px
    )
    assert reestimate_advection(wrong, 1).included == carried
    test = reestimate_advection(right, 1)
    assert test.included == carried
    assert test.value == pytest.approx(float(carried), abs=0.25)


@pytest.mark.parametrize("scans", [2, 16])
def test_integrated_scans_contain_the_mean_drift_of_their_visits(world: Callable[..., Any], steps: list[Any], scans: int) -> None:
    found, worst = solved(changed(world(6, noise_px=0.0), scans=scans), steps)
    assert worst < 5e-4
    assert not used(found)["coupling"]
