"""Cross-talk from the slow to the fast scan amplifier wanders."""

import numpy as np

from semlive.model.effects.family import Again, Family, Slow
from semlive.model.effects.scene import plane

FAMILY = Family(
    "scan_shear_drift",
    "rows slide over each other, slowly more: u = gamma(T) (y - yc)",
    Slow(lambda scene: plane(scene.y, np.zeros_like(scene.y)), "change", "1"),
    group="G3",
    decides="the same field with the scan rotated by 90 degrees: the shear turns with the scan",
    again=Again.GOING_ON,
)
