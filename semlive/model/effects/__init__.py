"""Dictionary of effects: each effect with its confounded effects and the experiment that separates them."""

from semlive.model.effects.effect_class import BasisField, EffectClass, NonlinearParameter, ReportedParameter
from semlive.model.effects.maps.apparent_motion import CHARGING_FRAME_RAMP, CHARGING_LOCAL_LENS, DIC_SUBPIXEL_BIAS
from semlive.model.effects.maps.image_field import (
    ASPECT_DRIFT,
    DISTORTION_SCALE_DRIFT,
    MAGNIFICATION_DRIFT,
    MAGNIFICATION_FRAME_INSTABILITY,
    RASTER_ROTATION_DRIFT,
    REFOCUS_MAGNIFICATION_STEP,
    SCAN_SHEAR_DRIFT,
)
from semlive.model.effects.maps.image_motion import DRIFT_JUMP, JUMP_WITHIN_PAIR, THERMAL_OSCILLATION
from semlive.model.effects.maps.scan import LINE_SYNC_HUM, WRONG_ROW_TIME
from semlive.model.effects.maps.settling import (
    FLYBACK_SETTLING,
    FRAME_START_SETTLING,
    FRAME_START_SETTLING_IN_POSITION,
    ROW_START_SETTLING_IN_POSITION,
    SETTLING_CLASSES,
    TWO_TERM_CLASSES,
)
from semlive.model.effects.maps.specimen import (
    BENDING_MISALIGNMENT,
    CREEP_IN_HOLD,
    INHOMOGENEOUS_STRAIN,
    LOAD_STEP_TRANSIENT,
    STAGE_STEP_TRANSIENT,
    STAGE_YAW,
    TILT_WITH_LOAD,
)
from semlive.model.effects.run_geometry import RunGeometry

EFFECT_CLASSES: tuple[EffectClass, ...] = (
    WRONG_ROW_TIME,
    MAGNIFICATION_DRIFT,
    MAGNIFICATION_FRAME_INSTABILITY,
    REFOCUS_MAGNIFICATION_STEP,
    RASTER_ROTATION_DRIFT,
    SCAN_SHEAR_DRIFT,
    ASPECT_DRIFT,
    DISTORTION_SCALE_DRIFT,
    TILT_WITH_LOAD,
    CREEP_IN_HOLD,
    LOAD_STEP_TRANSIENT,
    STAGE_STEP_TRANSIENT,
    STAGE_YAW,
    DRIFT_JUMP,
    JUMP_WITHIN_PAIR,
    BENDING_MISALIGNMENT,
    INHOMOGENEOUS_STRAIN,
    THERMAL_OSCILLATION,
    CHARGING_FRAME_RAMP,
    CHARGING_LOCAL_LENS,
    DIC_SUBPIXEL_BIAS,
)
"""All effect classes of the disparity maps, ordered by groups: scan, field, specimen, drift, charging and correlation."""

TWO_RUN_EFFECT_CLASSES: tuple[EffectClass, ...] = (FLYBACK_SETTLING, FRAME_START_SETTLING, LINE_SYNC_HUM, WRONG_ROW_TIME)
"""Effects that two runs with different scan times separate from distortion; of these, one run shows only the last, and weakly."""

PIXEL_SIZE_EFFECT_CLASSES: tuple[EffectClass, ...] = (ROW_START_SETTLING_IN_POSITION, FRAME_START_SETTLING_IN_POSITION)
"""Effects that two runs with different pixel sizes separate from distortion, in addition to those of different scan times."""

__all__ = [
    "EFFECT_CLASSES",
    "PIXEL_SIZE_EFFECT_CLASSES",
    "SETTLING_CLASSES",
    "TWO_RUN_EFFECT_CLASSES",
    "TWO_TERM_CLASSES",
    "BasisField",
    "EffectClass",
    "NonlinearParameter",
    "ReportedParameter",
    "RunGeometry",
]
