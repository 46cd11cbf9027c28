"""Independent magnification of every frame by high voltage or lens noise slower than a frame."""

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, Recurrence, Values
from semlive.model.effects.run_geometry import RunGeometry, field_column, times_time_columns


def basis_field(scene: RunGeometry, values: Values) -> BasisField:
    """An independent magnification of each frame."""
    del values
    each = np.eye(len(scene.frame))[:, None, :]
    return BasisField(times_time_columns(field_column(scene.x, scene.y), each), random_amplitude=("sd", "1", 1.0 / scene.half_px))


FAMILY = EffectClass(
    "magnification_frame_instability",
    "every frame has an independent random magnification",
    basis_field,
    group="G1",
    discriminating_experiment="a long series of frames at one position and zero load: only the time course separates the causes",
    recurrence=Recurrence.NEW_DRAW,
)
