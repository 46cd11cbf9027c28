"""Air conditioning or a chiller moves the picture to and fro."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.family import Again, Family, Law, Theta, Values
from semlive.model.effects.scene import Scene, both_ways

LONGEST_S, SHORTEST_S = 900.0, 60.0


def law(scene: Scene, values: Values) -> Law:
    """A sine of any phase along each axis."""
    angle = 2.0 * np.pi * scene.time_s / values["period_s"]
    columns = np.concatenate((both_ways(np.sin(angle)), both_ways(np.cos(angle))), axis=-1)
    return Law(columns, scatter=("amplitude_px", "px", 2.0**0.5))


def grid(scene: Scene) -> Iterable[Values]:
    """Frequencies half a period in the run apart; lines between wider ones are lost."""
    frequencies = np.arange(1.0 / LONGEST_S, 1.0 / SHORTEST_S, 0.5 / scene.end_s)
    return ({"period_s": float(1.0 / one)} for one in frequencies)


FAMILY = Family(
    "thermal_oscillation",
    "the picture swings with one period",
    law,
    grid,
    thetas=(Theta("period_s", "s", 1.02, ratio=True),),
    group="G8",
    decides="the temperature of the room and of the chiller, logged beside",
    again=Again.ANEW,
)
