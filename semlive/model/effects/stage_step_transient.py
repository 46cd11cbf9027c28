"""The stage creeps after each move."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.family import Family, Law, Reported, Theta, Values
from semlive.model.effects.scene import Scene, dying_away

BETWEEN_S, COUNT = (8.0, 400.0), 9


def law(scene: Scene, values: Values) -> Law | None:
    """D += A m_n exp(-(T - T_n) / tau) along the move."""
    largest_px = float(np.abs(scene.move_px).max())
    if largest_px == 0.0:
        return None
    fall = dying_away(scene, scene.move_px / largest_px, values["time_constant_s"])
    return Law(fall[..., None], (Reported("fraction", "1", np.array([1.0 / largest_px])),))


def grid(scene: Scene) -> Iterable[Values]:
    """Time constants."""
    del scene
    return ({"time_constant_s": float(one)} for one in np.geomspace(*BETWEEN_S, COUNT))


FAMILY = Family(
    "stage_step_transient",
    "the stage creeps after each move, along it, and comes to rest",
    law,
    grid,
    thetas=(Theta("time_constant_s", "s", 1.63, ratio=True),),
    decides="a longer wait after some of the moves, or beam shifts in their stead",
    sizes_px=(0.003, 10.0),
)
