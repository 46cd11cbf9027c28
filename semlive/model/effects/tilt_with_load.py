"""Grips out of line tilt the specimen with the load: perspective."""

import numpy as np

from semlive.model.effects.family import Family, Law, Reported, Values
from semlive.model.effects.scene import Scene, plane


def law(scene: Scene, values: Values) -> Law | None:
    """U = a x y, v = a y^2, a proportional to the load."""
    del values
    if not scene.load.any():
        return None
    shape = plane(scene.x * scene.y * scene.load, scene.y**2 * scene.load)
    row = np.array([1.0 / (scene.half_px**2 * scene.highest_n)])
    return Law(shape, (Reported("tilt_over_working_distance_per_n", "1/(px N)", row),))


FAMILY = Family(
    "tilt_with_load",
    "the specimen tilts as the load grows: (u, v) = a F (x y, y^2)",
    law,
    group="G11",
    decides="unload to zero and look again; working distance in focus at nine points",
)
