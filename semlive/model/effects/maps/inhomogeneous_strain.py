"""Inhomogeneous strain of the specimen by grains, yielding or a crack: the measured quantity, never corrected."""

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, Values
from semlive.model.effects.run_geometry import RunGeometry, xy_columns

WAVES = 9


def basis_field(scene: RunGeometry, values: Values) -> BasisField | None:
    """A smooth field that grows with the load: cosines over the material points, finer ones smaller."""
    del values
    if not scene.load.any():
        return None
    at = scene.address_px - scene.disparity_px
    low, high = at.min(axis=(0, 1)), at.max(axis=(0, 1))
    x, y = np.moveaxis((at - low) / (high - low), -1, 0)
    columns = []
    for i in range(WAVES):
        for j in range(WAVES - i):
            if i + j >= 2:
                size = 1.0 / (1.0 + (i * i + j * j) / 8.0)
                columns.append(xy_columns(size * np.cos(np.pi * i * x) * np.cos(np.pi * j * y) * scene.load))
    return BasisField(np.concatenate(columns, axis=-1), random_amplitude=("rms_px", "px", 1.0))


FAMILY = EffectClass(
    "inhomogeneous_strain",
    "the specimen deforms inhomogeneously with the load: the measured signal, not corrected",
    basis_field,
    group="G11",
    discriminating_experiment="unload: the residual is plastic; a fresh field",
    strain_like=True,
)
