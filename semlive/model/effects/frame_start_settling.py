"""The beam has not come to rest when a frame begins; another row time moves the rows where it has."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.family import Family, Law, Theta, Values, along_each
from semlive.model.effects.scene import Scene, both_ways

BETWEEN_S, COUNT = (0.3, 30.0), 10


def law(scene: Scene, values: Values) -> Law:
    """(u, v) = A exp(-y t_R / tau)."""
    return Law(both_ways(np.exp(-scene.row_start_s / values["settling_s"])), along_each("px"))


def grid(scene: Scene) -> Iterable[Values]:
    """Time constants."""
    del scene
    return ({"settling_s": float(one)} for one in np.geomspace(*BETWEEN_S, COUNT))


FAMILY = Family(
    "frame_start_settling",
    "frames begin before the beam has come to rest",
    law,
    grid,
    thetas=(Theta("settling_s", "s", 1.67, ratio=True),),
    group="G4",
    decides="the calibration again with half or twice the row time: what settles moves, the distortion stays",
    sizes_px=(0.003, 10.0),
)
