"""A jump between the two frames of a pair."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.family import Again, Family, Law, Values, along_each
from semlive.model.effects.scene import Scene, both_ways


def law(scene: Scene, values: Values) -> Law:
    """(u, v) = J from the second frame of a pair on."""
    later = np.broadcast_to((scene.frame >= values["first_frame"])[:, None], scene.time_s.shape)
    return Law(both_ways(later.astype(np.float64)), along_each("px"))


def grid(scene: Scene) -> Iterable[Values]:
    """Every pair."""
    return ({"first_frame": float(frame)} for frame in scene.frame[scene.frame % 2 == 1])


FAMILY = Family(
    "jump_within_pair",
    "the picture jumps between the two frames of a pair and stays where it is",
    law,
    grid,
    group="G8",
    decides="a third picture in the pair",
    sizes_px=(0.003, 10.0),
    again=Again.ONCE,
)
