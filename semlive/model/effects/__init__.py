"""Dictionary of effects: each module describes one effect, its confounded effects and the experiment that separates them."""

from semlive.model.effects.effect_class import BasisField, EffectClass, NonlinearParameter, ReportedParameter
from semlive.model.effects.maps import (
    aspect_drift,
    bending_misalignment,
    charging_frame_ramp,
    charging_local_lens,
    creep_in_hold,
    dic_subpixel_bias,
    distortion_scale_drift,
    drift_jump,
    flyback_settling,
    frame_start_settling,
    inhomogeneous_strain,
    jump_within_pair,
    line_sync_hum,
    load_step_transient,
    magnification_drift,
    magnification_frame_instability,
    raster_rotation_drift,
    refocus_magnification_step,
    scan_shear_drift,
    stage_step_transient,
    stage_yaw,
    thermal_oscillation,
    tilt_with_load,
    wrong_row_time,
)
from semlive.model.effects.run_geometry import RunGeometry

_FILES = (
    wrong_row_time,
    magnification_drift,
    magnification_frame_instability,
    refocus_magnification_step,
    raster_rotation_drift,
    scan_shear_drift,
    aspect_drift,
    distortion_scale_drift,
    tilt_with_load,
    creep_in_hold,
    load_step_transient,
    stage_step_transient,
    stage_yaw,
    drift_jump,
    jump_within_pair,
    bending_misalignment,
    inhomogeneous_strain,
    thermal_oscillation,
    charging_frame_ramp,
    charging_local_lens,
    dic_subpixel_bias,
)
EFFECT_CLASSES: tuple[EffectClass, ...] = tuple(effect.FAMILY for effect in _FILES)
"""All effect classes of the disparity maps, ordered by groups: scan, field, specimen, drift, charging and correlation."""

TWO_RUN_EFFECT_CLASSES: tuple[EffectClass, ...] = tuple(
    value.FAMILY for value in (flyback_settling, frame_start_settling, line_sync_hum, wrong_row_time)
)
"""Effects that two runs with different scans separate from distortion; of these, one run shows only the last, and weakly."""

__all__ = [
    "EFFECT_CLASSES",
    "TWO_RUN_EFFECT_CLASSES",
    "BasisField",
    "EffectClass",
    "NonlinearParameter",
    "ReportedParameter",
    "RunGeometry",
]
