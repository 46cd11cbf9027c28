"""The stage's guides turn the specimen a little with each move."""

import numpy as np

from semlive.model.effects.family import Again, Family, Law, Values
from semlive.model.effects.scene import Scene, in_time, plane


def law(scene: Scene, values: Values) -> Law | None:
    """A rotation of its own for each pair of the calibration but the first; later the gradient is free anyway."""
    del values
    pairs = [pair for pair in np.unique(scene.pair)[1:] if not scene.free[scene.pair == pair].any()]
    if not pairs:
        return None
    each = (scene.pair[:, None] == np.array(pairs)[None]).astype(np.float64)[:, None, :]
    return Law(in_time(plane(-scene.y, scene.x), each), scatter=("sd_rad", "rad", 1.0 / scene.half_px))


FAMILY = Family(
    "stage_yaw",
    "each move turns the specimen a little",
    law,
    group="G2",
    decides="an hour of pairs with the stage parked: what turns with the moves alone is the stage",
    again=Again.BY_MOVES,
)
