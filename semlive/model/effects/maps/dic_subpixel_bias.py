"""Interpolation bias of the correlation, periodic in the subpixel displacement."""

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, ReportedParameter, Values
from semlive.model.effects.run_geometry import RunGeometry


def basis_field(scene: RunGeometry, values: Values) -> BasisField:
    """A sin(2 pi U)."""
    del values
    wave = np.sin(2.0 * np.pi * scene.disparity_px)[..., None]
    return BasisField(wave, (ReportedParameter("amplitude_px", "px", np.ones(1)),))


FAMILY = EffectClass(
    "dic_subpixel_bias",
    "displacements have a bias with the period of a pixel: A sin(2 pi U)",
    basis_field,
    discriminating_experiment="the same images with another interpolation: no beam time",
    sizes_px=(0.001, 0.1),
)
