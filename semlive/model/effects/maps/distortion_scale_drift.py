"""Drift of the scale of the distortion by working distance or high voltage."""

from functools import partial

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, NonlinearParameter, Recurrence, SlowDriftLaw, Values
from semlive.model.effects.run_geometry import Array, RunGeometry

# Affine part of the distortion, which pairs do not determine (gauges F1, F2): displacements half a width right of the centre, and as far
# below. Without it a distortion drift of eight times the detection limit was identified together with a raster rotation and further
# effects.
AFFINE = ("affine_xx_px", "affine_yx_px", "affine_xy_px", "affine_yy_px")


def _shape(scene: RunGeometry, values: Values) -> Array:
    """The distortion without its mean, and an affine part."""
    centred = scene.distortion_px - scene.distortion_px.mean(axis=(0, 1))
    along = np.reshape([values.get(name, 0.0) for name in AFFINE], (2, 2))
    return (centred + scene.x[..., None] * along[0] + scene.y[..., None] * along[1])[..., None]


def basis_field(scene: RunGeometry, values: Values) -> BasisField:
    """(u, v) = eta(T) E."""
    return SlowDriftLaw(partial(_shape, values=values), "change", "1", per_px=lambda _: 1.0)(scene, values)


FAMILY = EffectClass(
    "distortion_scale_drift",
    "the distortion grows or shrinks slowly: (u, v) = eta(T) E",
    basis_field,
    nonlinear_parameters=tuple(NonlinearParameter(name, "px", 1.0) for name in AFFINE),
    discriminating_experiment="a second calibration at the end of the run",
    recurrence=Recurrence.CONTINUES,
    linear_in_parameters=True,
)
