"""Working distance or high voltage scale the distortion."""

from functools import partial

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, NonlinearParameter, Recurrence, SlowDriftLaw, Values
from semlive.model.effects.run_geometry import Array, RunGeometry

# The distortion's affine part, which pairs do not tell (gauges F1, F2): displacements half a width right of the centre, and as far below.
# Without it a distortion that drifts was found at eight times what can be detected, and a turning raster and others beside it.
AFFINE = ("affine_xx_px", "affine_yx_px", "affine_xy_px", "affine_yy_px")


def _shape(scene: RunGeometry, values: Values) -> Array:
    """The distortion without its mean, and an affine part."""
    bent = scene.distortion_px - scene.distortion_px.mean(axis=(0, 1))
    along = np.reshape([values.get(name, 0.0) for name in AFFINE], (2, 2))
    return (bent + scene.x[..., None] * along[0] + scene.y[..., None] * along[1])[..., None]


def basis_field(scene: RunGeometry, values: Values) -> BasisField:
    """(u, v) = eta(T) E."""
    return SlowDriftLaw(partial(_shape, values=values), "change", "1", per_px=lambda _: 1.0)(scene, values)


FAMILY = EffectClass(
    "distortion_scale_drift",
    "the distortion as a whole grows or shrinks slowly: (u, v) = eta(T) E",
    basis_field,
    nonlinear_parameters=tuple(NonlinearParameter(name, "px", 1.0) for name in AFFINE),
    discriminating_experiment="the calibration once more at the end of the run",
    recurrence=Recurrence.CONTINUES,
    linear_in_parameters=True,
)
