"""The correlation's interpolation is wrong by a wave over each pixel."""

import numpy as np

from semlive.model.effects.family import Family, Law, Reported, Values
from semlive.model.effects.scene import Scene


def law(scene: Scene, values: Values) -> Law:
    """A sin(2 pi U)."""
    del values
    wave = np.sin(2.0 * np.pi * scene.disparity_px)[..., None]
    return Law(wave, (Reported("amplitude_px", "px", np.ones(1)),))


FAMILY = Family(
    "dic_subpixel_bias",
    "displacements are wrong by a wave over each pixel: A sin(2 pi U)",
    law,
    decides="the same pictures with another interpolant: no beam time",
    sizes_px=(0.001, 0.1),
)
