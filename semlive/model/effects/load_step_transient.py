"""Grips seat and the frame settles after each load step."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.family import Family, Law, Theta, Values, along_each
from semlive.model.effects.scene import Scene, both_ways, dying_away

BETWEEN_S, COUNT = (8.0, 400.0), 9


def law(scene: Scene, values: Values) -> Law | None:
    """D += dF A exp(-(T - T_k) / tau)."""
    largest_n = float(np.abs(scene.load_change_n).max())
    if largest_n == 0.0:
        return None
    fall = dying_away(scene, scene.load_change_n[:, None] / largest_n, values["time_constant_s"])
    return Law(both_ways(fall[..., 0]), along_each("px/N", 1.0 / largest_n))


def grid(scene: Scene) -> Iterable[Values]:
    """Time constants."""
    del scene
    return ({"time_constant_s": float(one)} for one in np.geomspace(*BETWEEN_S, COUNT))


FAMILY = Family(
    "load_step_transient",
    "the picture creeps after each load step and comes to rest",
    law,
    grid,
    thetas=(Theta("time_constant_s", "s", 1.63, ratio=True),),
    decides="a dummy step at the same load, and a longer hold",
    sizes_px=(0.003, 10.0),
)
