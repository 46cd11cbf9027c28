"""Somebody, or the autofocus, focuses anew after a step."""

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, Recurrence, Values
from semlive.model.effects.run_geometry import RunGeometry, field_column, times_time_columns


def basis_field(scene: RunGeometry, values: Values) -> BasisField:
    """A magnification of its own for each pair but the first."""
    del values
    each = (scene.pair[:, None] == np.unique(scene.pair)[None, 1:]).astype(np.float64)[:, None, :]
    return BasisField(times_time_columns(field_column(scene.x, scene.y), each), random_amplitude=("sd", "1", 1.0 / scene.half_px))


FAMILY = EffectClass(
    "refocus_magnification_step",
    "the magnification jumps with every step, as after focusing anew; under load that is strain",
    basis_field,
    group="G1",
    discriminating_experiment="the log of focus changes, or focusing forbidden for some steps",
    recurrence=Recurrence.NEW_DRAW,
)
