"""The gains of the two scan amplifiers wander apart."""

from semlive.model.effects.family import Again, Family, Slow
from semlive.model.effects.scene import plane

FAMILY = Family(
    "aspect_drift",
    "the picture becomes slowly wider and lower: (u, v) = s(T) (x - xc, -(y - yc))",
    Slow(lambda scene: plane(scene.x, -scene.y), "change", "1"),
    group="G3",
    decides="the same field with the scan rotated by 90 degrees: the aspect turns with the scan",
    again=Again.GOING_ON,
)
