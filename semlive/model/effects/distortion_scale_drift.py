"""Working distance or high voltage scale the distortion."""

from semlive.model.effects.family import Family, Slow
from semlive.model.effects.scene import Array, Scene


def _shape(scene: Scene) -> Array:
    """The distortion without its mean; its affine part is not known (gauges F1, F2)."""
    return (scene.distortion_px - scene.distortion_px.mean(axis=(0, 1)))[..., None]


FAMILY = Family(
    "distortion_scale_drift",
    "the distortion as a whole grows or shrinks slowly: (u, v) = eta(T) E",
    Slow(_shape, "change", "1", per_px=lambda scene: 1.0),
    decides="the calibration once more at the end of the run",
)
