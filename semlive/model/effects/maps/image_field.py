"""Effects of the image field of the scan on disparity maps: magnification, rotation, shear, aspect and distortion."""

from functools import partial

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, NonlinearParameter, Recurrence, SlowDriftLaw, Values
from semlive.model.effects.run_geometry import Array, RunGeometry, field_column, times_time_columns

# Drift of the magnification by high voltage, lens current or working distance (dM/M = dV/2V, dz/WD).
MAGNIFICATION_DRIFT = EffectClass(
    "magnification_drift",
    "the magnification drifts slowly: (u, v) = s(T) (x - xc, y - yc)",
    SlowDriftLaw(lambda scene: field_column(scene.x, scene.y), "change", "1"),
    group="G1",
    discriminating_experiment="a series of an hour at zero load, with focus and working distance "
    "read back: only the time course separates the causes",
    recurrence=Recurrence.CONTINUES,
)


# Independent magnification of every frame by high voltage or lens noise slower than a frame.


def _magnification_frame_instability(scene: RunGeometry, values: Values) -> BasisField:
    """An independent magnification of each frame."""
    del values
    each = np.eye(len(scene.frame))[:, None, :]
    return BasisField(times_time_columns(field_column(scene.x, scene.y), each), random_amplitude=("sd", "1", 1.0 / scene.half_px))


MAGNIFICATION_FRAME_INSTABILITY = EffectClass(
    "magnification_frame_instability",
    "every frame has an independent random magnification",
    _magnification_frame_instability,
    group="G1",
    discriminating_experiment="a long series of frames at one position and zero load: only the time course separates the causes",
    recurrence=Recurrence.NEW_DRAW,
)


# Change of the magnification by refocusing after a step.


def _refocus_magnification_step(scene: RunGeometry, values: Values) -> BasisField:
    """An independent magnification of each pair except the first."""
    del values
    each = (scene.pair[:, None] == np.unique(scene.pair)[None, 1:]).astype(np.float64)[:, None, :]
    return BasisField(times_time_columns(field_column(scene.x, scene.y), each), random_amplitude=("sd", "1", 1.0 / scene.half_px))


REFOCUS_MAGNIFICATION_STEP = EffectClass(
    "refocus_magnification_step",
    "the magnification jumps with every step, as after refocusing; under load it resembles strain",
    _refocus_magnification_step,
    group="G1",
    discriminating_experiment="the log of focus changes, or some steps without refocusing",
    recurrence=Recurrence.NEW_DRAW,
)


# Drift of the raster rotation by lens current or scan rotation electronics.
RASTER_ROTATION_DRIFT = EffectClass(
    "raster_rotation_drift",
    "the raster rotates slowly: (u, v) = theta(T) (-(y - yc), x - xc)",
    SlowDriftLaw(lambda scene: field_column(-scene.y, scene.x), "change_rad", "rad"),
    group="G2",
    discriminating_experiment="an hour of pairs with a stationary stage: a continued rotation is that of the raster",
    recurrence=Recurrence.CONTINUES,
)


# Drift of the cross-talk from the slow to the fast scan amplifier.
SCAN_SHEAR_DRIFT = EffectClass(
    "scan_shear_drift",
    "rows shift in proportion to their distance from the centre, slowly changing: u = gamma(T) (y - yc)",
    SlowDriftLaw(lambda scene: field_column(scene.y, np.zeros_like(scene.y)), "change", "1"),
    group="G3",
    discriminating_experiment="the same field with the scan rotated by 90 degrees: the shear turns with the scan",
    recurrence=Recurrence.CONTINUES,
)


# Drift of the gain ratio of the two scan amplifiers.
ASPECT_DRIFT = EffectClass(
    "aspect_drift",
    "the image becomes slowly wider and lower: (u, v) = s(T) (x - xc, -(y - yc))",
    SlowDriftLaw(lambda scene: field_column(scene.x, -scene.y), "change", "1"),
    group="G3",
    discriminating_experiment="the same field with the scan rotated by 90 degrees: the aspect turns with the scan",
    recurrence=Recurrence.CONTINUES,
)


# Drift of the scale of the distortion by working distance or high voltage.
# Affine part of the distortion, which pairs do not determine (gauges F1, F2): displacements half a width right of the centre, and as far
# below. Without it a distortion drift of eight times the detection limit was identified together with a raster rotation and further
# effects.
AFFINE = ("affine_xx_px", "affine_yx_px", "affine_xy_px", "affine_yy_px")


def _shape(scene: RunGeometry, values: Values) -> Array:
    """The distortion without its mean, and an affine part."""
    centred = scene.distortion_px - scene.distortion_px.mean(axis=(0, 1))
    along = np.reshape([values.get(name, 0.0) for name in AFFINE], (2, 2))
    return (centred + scene.x[..., None] * along[0] + scene.y[..., None] * along[1])[..., None]


def _distortion_scale_drift(scene: RunGeometry, values: Values) -> BasisField:
    """(u, v) = eta(T) E."""
    return SlowDriftLaw(partial(_shape, values=values), "change", "1", per_px=lambda _: 1.0)(scene, values)


DISTORTION_SCALE_DRIFT = EffectClass(
    "distortion_scale_drift",
    "the distortion grows or shrinks slowly: (u, v) = eta(T) E",
    _distortion_scale_drift,
    nonlinear_parameters=tuple(NonlinearParameter(name, "px", 1.0) for name in AFFINE),
    discriminating_experiment="a second calibration at the end of the run",
    recurrence=Recurrence.CONTINUES,
    linear_in_parameters=True,
)
