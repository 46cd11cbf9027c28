"""High voltage, lens current or working distance wander (dM/M = dV/2V, dz/WD)."""

from semlive.model.effects.family import Again, Family, Slow
from semlive.model.effects.scene import plane

FAMILY = Family(
    "magnification_drift",
    "the magnification wanders slowly: (u, v) = s(T) (x - xc, y - yc)",
    Slow(lambda scene: plane(scene.x, scene.y), "change", "1"),
    group="G1",
    decides="a series of an hour at zero load, with focus and working distance read back: only the law in time tells the causes apart",
    again=Again.GOING_ON,
)
