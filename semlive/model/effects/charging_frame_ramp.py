"""Charge builds up in every frame and pushes the beam aside, more with every dose."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.family import Family, Law, Theta, Values, along_each
from semlive.model.effects.scene import Scene, both_ways

CHARGING_S, DOSE_S = (5.0, 10.0, 20.0, 40.0, 80.0), (600.0, 1800.0, 6000.0)


def law(scene: Scene, values: Values) -> Law:
    """A (1 - exp(-tau / tau_c)) (1 - exp(-T_f / T_d))."""
    charge = np.expm1(-scene.in_frame_s / values["charging_s"]) * np.expm1(-scene.start_s / values["dose_s"])[:, None]
    return Law(both_ways(charge), along_each("px"))


def grid(scene: Scene) -> Iterable[Values]:
    """Time constants within a frame and over the run."""
    del scene
    return ({"charging_s": one, "dose_s": other} for one in CHARGING_S for other in DOSE_S)


FAMILY = Family(
    "charging_frame_ramp",
    "the picture is pushed aside in the course of every frame, more with every frame",
    law,
    grid,
    thetas=(Theta("charging_s", "s", 2.0, ratio=True), Theta("dose_s", "s", 3.0, ratio=True)),
    group="G9",
    decides="five minutes with the beam blanked; the mean grey level ramps with it",
    sizes_px=(0.003, 10.0),
)
