"""The raster turns: lens current, scan rotation electronics."""

from semlive.model.effects.effect_class import EffectClass, Recurrence, SlowDriftLaw
from semlive.model.effects.run_geometry import field_column

FAMILY = EffectClass(
    "raster_rotation_drift",
    "the raster turns slowly: (u, v) = theta(T) (-(y - yc), x - xc)",
    SlowDriftLaw(lambda scene: field_column(-scene.y, scene.x), "change_rad", "rad"),
    group="G2",
    discriminating_experiment="an hour of pairs with the stage parked: what goes on turning is the raster",
    recurrence=Recurrence.CONTINUES,
)
