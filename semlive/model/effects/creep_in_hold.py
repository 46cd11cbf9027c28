"""The specimen goes on stretching while the load is held."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.family import Family, Law, Reported, Theta, Values
from semlive.model.effects.scene import Scene, plane

POISSON = 0.33
ONSETS_S = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0)


def law(scene: Scene, values: Values) -> Law | None:
    """Eps = c F ln(1 + (T - T_k) / t0), across -nu eps."""
    if not scene.load.any():
        return None
    strain = scene.load * np.log1p(scene.since_step_at_s / values["onset_s"])
    reported = (Reported("strain_per_n", "1/N", np.array([1.0 / (scene.half_px * scene.highest_n)])),)
    return Law(plane(-POISSON * scene.x * strain, scene.y * strain), reported)


def grid(scene: Scene) -> Iterable[Values]:
    """Onsets."""
    del scene
    return ({"onset_s": one} for one in ONSETS_S)


FAMILY = Family(
    "creep_in_hold",
    "the specimen goes on stretching in the hold: eps = c F ln(1 + t / t0)",
    law,
    grid,
    thetas=(Theta("onset_s", "s", 3.0, ratio=True),),
    decides="a longer hold with a third picture; the load in displacement control falls as the strain grows in load control",
)
