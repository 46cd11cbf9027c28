"""Working distance or high voltage scale the distortion."""

from functools import partial

import numpy as np

from semlive.model.effects.family import Again, Family, Law, Slow, Theta, Values
from semlive.model.effects.scene import Array, Scene

# The distortion's affine part, which pairs do not tell (gauges F1, F2): displacements half a width right of the centre, and as far below.
# Without it a distortion that drifts was found at eight times what can be detected, and a turning raster and others beside it.
AFFINE = ("affine_xx_px", "affine_yx_px", "affine_xy_px", "affine_yy_px")


def _shape(scene: Scene, values: Values) -> Array:
    """The distortion without its mean, and an affine part."""
    bent = scene.distortion_px - scene.distortion_px.mean(axis=(0, 1))
    along = np.reshape([values.get(name, 0.0) for name in AFFINE], (2, 2))
    return (bent + scene.x[..., None] * along[0] + scene.y[..., None] * along[1])[..., None]


def law(scene: Scene, values: Values) -> Law:
    """(u, v) = eta(T) E."""
    return Slow(partial(_shape, values=values), "change", "1", per_px=lambda _: 1.0)(scene, values)


FAMILY = Family(
    "distortion_scale_drift",
    "the distortion as a whole grows or shrinks slowly: (u, v) = eta(T) E",
    law,
    thetas=tuple(Theta(name, "px", 1.0) for name in AFFINE),
    decides="the calibration once more at the end of the run",
    again=Again.GOING_ON,
    sums=True,
)
