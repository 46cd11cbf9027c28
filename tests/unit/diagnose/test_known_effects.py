"""Effects of a model are taken out of maps, and strain that was injected is still there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blind.experiment import Conditions, hidden
from blind.hiding import PROTOTYPE_PX, hidden_effect
from blind.observing import observed

from semlive.data.diagnosis.effects import ModelEffect
from semlive.data.grid import Grid
from semlive.diagnose.baseline.model_effects import EffectDisplacement, effect_displacement, interpolate_to_grid
from semlive.diagnose.baseline.observation import Observation
from semlive.errors import BadInput

GRID = Grid(101, 101, 25, 30, 24, 43)
CONDITIONS = Conditions(611, calibration=6, tension=5, noise_px=0.005)
BENDING = ModelEffect("bending_misalignment", (), 0.1)
PEAK_PX = 16.0 * PROTOTYPE_PX["bending_misalignment"]


@pytest.fixture(scope="module")
def bent() -> Observation:
    """A run in which the specimen bends."""
    return observed(CONDITIONS, hidden_effect("bending_misalignment", PEAK_PX, 1), GRID)


@pytest.fixture(scope="module")
def moved(bent: Observation) -> EffectDisplacement:
    """What bending moves in it."""
    return effect_displacement(bent, [BENDING])


def test_what_an_effect_moves_is_what_it_moved(bent: Observation, moved: EffectDisplacement) -> None:
    fields = interpolate_to_grid(bent, moved.field_px, GRID)
    with_it = hidden(CONDITIONS, hidden_effect("bending_misalignment", PEAK_PX, 1), GRID)[-1].maps[-1]
    without = hidden(CONDITIONS, (), GRID)[-1].maps[-1]
    both = with_it.valid & without.valid
    true = np.stack((with_it.u_px - without.u_px, with_it.v_px - without.v_px), axis=-1)[both]
    residual = true - fields[with_it.current][both]

    assert moved.not_corrected == ()
    assert np.max(np.hypot(*true.T)) > 0.5 * PEAK_PX
    # What is like strain or motion is left to those: only the rest counts.
    x, y = (item[both] for item in GRID.mesh())
    affine = np.stack((np.ones_like(x), x, y), axis=-1)
    rest, was = (item - affine @ np.linalg.lstsq(affine, item, rcond=None)[0] for item in (residual, true))
    assert np.sqrt(np.mean(rest**2)) < 0.1 * np.sqrt(np.mean(was**2))


def test_an_injected_strain_is_preserved(bent: Observation, moved: EffectDisplacement) -> None:
    strain = 1e-4
    scene = bent.geometry
    more = np.zeros_like(bent.disparity_px)
    more[scene.steps.loaded, :, 1] = strain * scene.half_px * scene.y[scene.steps.loaded]
    injected = replace(bent, disparity_px=bent.disparity_px + more)
    change = effect_displacement(injected, [BENDING]).field_px - moved.field_px
    y_px = scene.y * scene.half_px
    taken = [np.polyfit(y_px[frame], change[frame, :, 1], 1)[0] for frame in np.flatnonzero(scene.steps.loaded)]
    assert np.max(np.abs(taken)) < 0.02 * strain


def test_strain_is_not_corrected_for_an_effect_that_is_inseparable_from_it(bent: Observation) -> None:
    moved = effect_displacement(bent, [ModelEffect("refocus_magnification_step", (), 0.3), ModelEffect("inhomogeneous_strain", (), 0.1)])
    assert set(moved.not_corrected) == {"refocus_magnification_step", "inhomogeneous_strain"}
    assert not moved.field_px.any()


def test_an_effect_without_a_name_is_refused(bent: Observation) -> None:
    with pytest.raises(BadInput, match="no effect is called warp"):
        effect_displacement(bent, [ModelEffect("warp", (), 0.1)])
