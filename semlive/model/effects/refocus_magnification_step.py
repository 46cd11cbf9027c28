"""Somebody, or the autofocus, focuses anew after a step."""

import numpy as np

from semlive.model.effects.family import Again, Family, Law, Values
from semlive.model.effects.scene import Scene, in_time, plane


def law(scene: Scene, values: Values) -> Law:
    """A magnification of its own for each pair but the first."""
    del values
    each = (scene.pair[:, None] == np.unique(scene.pair)[None, 1:]).astype(np.float64)[:, None, :]
    return Law(in_time(plane(scene.x, scene.y), each), scatter=("sd", "1", 1.0 / scene.half_px))


FAMILY = Family(
    "refocus_magnification_step",
    "the magnification jumps with every step, as after focusing anew; under load that is strain",
    law,
    group="G1",
    decides="the log of focus changes, or focusing forbidden for some steps",
    again=Again.ANEW,
)
