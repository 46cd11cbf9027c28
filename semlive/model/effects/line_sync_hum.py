"""Mains hum with the rows triggered by the mains: a pattern of columns, whose period another dwell changes."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.family import Family, Law, Reported, Theta, Values
from semlive.model.effects.scene import Scene, plane

MAINS_HZ = (50.0, 60.0, 100.0, 120.0)


def law(scene: Scene, values: Values) -> Law:
    """Along x, A sin(2 pi f x t_D + phi) as a sine and a cosine."""
    phase = 2.0 * np.pi * values["frequency_hz"] * scene.in_row_s
    nothing = np.zeros_like(phase)
    waves = np.concatenate((plane(np.sin(phase), nothing), plane(np.cos(phase), nothing)), axis=-1)
    return Law(waves, tuple(Reported(f"{name}_px", "px", row) for name, row in zip(("sine", "cosine"), np.eye(2), strict=True)))


def grid(scene: Scene) -> Iterable[Values]:
    """The mains and their first overtone."""
    del scene
    return ({"frequency_hz": one} for one in MAINS_HZ)


FAMILY = Family(
    "line_sync_hum",
    "the mains push all columns aside in the same way, as rows are triggered by them",
    law,
    grid,
    thetas=(Theta("frequency_hz", "Hz", 5.0),),
    group="G4",
    decides="the calibration again with half or twice the dwell: the period in columns changes; or without synchronisation",
)
