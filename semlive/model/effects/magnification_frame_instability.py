"""High voltage or lens noise, slower than a frame."""

import numpy as np

from semlive.model.effects.family import Again, Family, Law, Values
from semlive.model.effects.scene import Scene, in_time, plane


def law(scene: Scene, values: Values) -> Law:
    """A magnification of its own for each frame."""
    del values
    each = np.eye(len(scene.frame))[:, None, :]
    return Law(in_time(plane(scene.x, scene.y), each), scatter=("sd", "1", 1.0 / scene.half_px))


FAMILY = Family(
    "magnification_frame_instability",
    "every frame has a magnification of its own, at random",
    law,
    group="G1",
    decides="a long series of frames of one place at zero load: only the law in time tells the causes apart",
    again=Again.ANEW,
)
