"""Change of the magnification by refocusing after a step."""

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, Recurrence, Values
from semlive.model.effects.run_geometry import RunGeometry, field_column, times_time_columns


def basis_field(scene: RunGeometry, values: Values) -> BasisField:
    """An independent magnification of each pair except the first."""
    del values
    each = (scene.pair[:, None] == np.unique(scene.pair)[None, 1:]).astype(np.float64)[:, None, :]
    return BasisField(times_time_columns(field_column(scene.x, scene.y), each), random_amplitude=("sd", "1", 1.0 / scene.half_px))


FAMILY = EffectClass(
    "refocus_magnification_step",
    "the magnification jumps with every step, as after refocusing; under load it resembles strain",
    basis_field,
    group="G1",
    discriminating_experiment="the log of focus changes, or some steps without refocusing",
    recurrence=Recurrence.NEW_DRAW,
)
