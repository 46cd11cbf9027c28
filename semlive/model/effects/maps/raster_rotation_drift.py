"""Drift of the raster rotation by lens current or scan rotation electronics."""

from semlive.model.effects.effect_class import EffectClass, Recurrence, SlowDriftLaw
from semlive.model.effects.run_geometry import field_column

FAMILY = EffectClass(
    "raster_rotation_drift",
    "the raster rotates slowly: (u, v) = theta(T) (-(y - yc), x - xc)",
    SlowDriftLaw(lambda scene: field_column(-scene.y, scene.x), "change_rad", "rad"),
    group="G2",
    discriminating_experiment="an hour of pairs with a stationary stage: a continued rotation is that of the raster",
    recurrence=Recurrence.CONTINUES,
)
