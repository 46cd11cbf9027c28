"""Effects hidden in maps by a generator that shares no code with semlive: a scaling distortion, several charged spots, a bias."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from foreign.effects import Hidden, Spot, charged_spots, scaling_distortion
from foreign.noise import Shape
from foreign.world import Raster, Series, write

from semlive.data.diagnosis.effects import Outcome
from semlive.diagnose.baseline.bayes_factor import score_candidates
from semlive.diagnose.baseline.model_effects import effect_class
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.maps.refinement import refined
from semlive.diagnose.maps.verdict import diagnose
from semlive.service.diagnosis.run import load_observation
from semlive.service.log.opened_log import OpenedLog
from semlive.service.replay.import_maps import ImportRequest, import_folder

RASTER = Raster(width=480, height=414, step_px=16, margin_px=48)
FIELDS = ("distortion_scale_drift", "magnification_drift", "raster_rotation_drift", "scan_shear_drift", "aspect_drift")
AFFINE_PX = ((6.0, 3.0), (-2.0, -5.0))
SPOTS = (Spot(130.0, 130.0, 45.0, 0.15, 0.2), Spot(350.0, 280.0, 90.0, 0.15, 0.5), Spot(330.0, 100.0, 60.0, -0.12, 1.0))


def imported(series: Series, folder: Path, hidden: Hidden | None = None, shape: Shape | None = None) -> Observation:
    """Observation of a series that was written as maps and imported without a hint about the subset."""
    write(series, shape or Shape(), folder / "maps", hidden)
    import_folder(ImportRequest(folder / "maps", folder / "maps.mcap"))
    return load_observation(OpenedLog(folder / "maps.mcap"))


def test_a_distortion_scales_with_an_affine_part_that_the_run_does_not_determine(tmp_path: Path) -> None:
    series = Series(1, 5, 0, sigma_px=0.01, drift_px=3.0, raster=RASTER)
    observation = imported(series, tmp_path, scaling_distortion(0.04, AFFINE_PX, series.end_s))
    found = diagnose(observation, dictionary=[effect_class(name) for name in FIELDS], draws=99)
    assert found.outcome is Outcome.IDENTIFIED
    (effect,) = found.effects
    assert effect.name == "distortion_scale_drift"
    values = {item.name: item for item in effect.parameters}
    change = values["change"]
    assert abs(change.value - 0.04) < 3.0 * change.sigma
    assert change.sigma < 0.015
    for name, true_px in zip(("affine_xx_px", "affine_xy_px", "affine_yx_px", "affine_yy_px"), np.ravel(AFFINE_PX), strict=True):
        per_half_width = 1.0 if name.endswith("x_px") else RASTER.width / RASTER.height
        assert change.value * values[name].value == pytest.approx(0.04 * true_px * per_half_width, abs=0.03)


def test_three_charged_spots_of_different_widths_are_found_one_after_another(tmp_path: Path) -> None:
    series = Series(2, 5, 0, sigma_px=0.01, drift_px=3.0, raster=RASTER)
    observation = imported(series, tmp_path, charged_spots(SPOTS, series.end_s))
    dictionary = [effect_class(name) for name in ("charging_local_lens", "magnification_drift", "inhomogeneous_strain")]
    found = diagnose(observation, dictionary=dictionary, draws=99)
    assert found.outcome is Outcome.IDENTIFIED
    assert [effect.name for effect in found.effects] == ["charging_local_lens"] * 3
    assert found.adequacy is not None
    assert found.adequacy.passed
    spots = [{item.name: item.value for item in effect.parameters} for effect in found.effects]
    for true in SPOTS:
        at = true.x_px - 0.5 * (RASTER.width - 1), true.y_px - 0.5 * (RASTER.height - 1)
        spot = min(spots, key=lambda each: float(np.hypot(each["x_px"] - at[0], each["y_px"] - at[1])))
        assert np.hypot(spot["x_px"] - at[0], spot["y_px"] - at[1]) < 0.25 * true.width_px
        assert spot["width_px"] == pytest.approx(true.width_px, rel=0.3)
        assert spot["peak_px"] == pytest.approx(true.peak_px, rel=0.3)


def test_a_composed_map_has_the_bias_of_both_its_parts(tmp_path: Path) -> None:
    observation = imported(Series(3, 3, 3, raster=RASTER, bias_px=0.02), tmp_path, shape=Shape(composed=True))
    assert observation.geometry.composed.tolist() == [False, False, *[False, True] * 5]
    baseline = noise_scaled_baseline(observation)
    (scored,) = score_candidates(baseline, [effect_class("dic_subpixel_bias")])
    (amplitude,) = refined(baseline, scored).parameters
    assert abs(amplitude.value - 0.02) < 3.0 * amplitude.sigma
    assert amplitude.sigma < 0.003
