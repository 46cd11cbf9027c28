"""The raster turns: lens current, scan rotation electronics."""

from semlive.model.effects.family import Again, Family, Slow
from semlive.model.effects.scene import plane

FAMILY = Family(
    "raster_rotation_drift",
    "the raster turns slowly: (u, v) = theta(T) (-(y - yc), x - xc)",
    Slow(lambda scene: plane(-scene.y, scene.x), "change_rad", "rad"),
    group="G2",
    decides="an hour of pairs with the stage parked: what goes on turning is the raster",
    again=Again.GOING_ON,
)
