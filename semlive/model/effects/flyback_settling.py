"""The beam has not come to rest when a row begins; another dwell moves the columns where it has."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.family import Family, Law, Reported, Theta, Values
from semlive.model.effects.scene import Scene, plane

BETWEEN_S, COUNT = (1e-4, 2e-2), 12


def law(scene: Scene, values: Values) -> Law:
    """Along x, A exp(-x t_D / tau)."""
    fall = np.exp(-scene.in_row_s / values["settling_s"])
    return Law(plane(fall, np.zeros_like(fall)), (Reported("amplitude_px", "px", np.ones(1)),))


def grid(scene: Scene) -> Iterable[Values]:
    """Time constants."""
    del scene
    return ({"settling_s": float(one)} for one in np.geomspace(*BETWEEN_S, COUNT))


FAMILY = Family(
    "flyback_settling",
    "rows begin before the beam has come to rest",
    law,
    grid,
    thetas=(Theta("settling_s", "s", 1.62, ratio=True),),
    group="G4",
    decides="the calibration again with half or twice the dwell: what settles moves, the distortion stays",
    sizes_px=(0.003, 10.0),
)
