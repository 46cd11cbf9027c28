"""Small rotation of the specimen with each move by the guides of the stage."""

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, Recurrence, Values
from semlive.model.effects.run_geometry import RunGeometry, field_column, times_time_columns


def basis_field(scene: RunGeometry, values: Values) -> BasisField | None:
    """An independent rotation of each calibration pair except the first; in later pairs the gradient is free."""
    del values
    pairs = [pair for pair in np.unique(scene.pair)[1:] if not scene.gradient_free[scene.pair == pair].any()]
    if not pairs:
        return None
    each = (scene.pair[:, None] == np.array(pairs)[None]).astype(np.float64)[:, None, :]
    return BasisField(times_time_columns(field_column(-scene.y, scene.x), each), random_amplitude=("sd_rad", "rad", 1.0 / scene.half_px))


FAMILY = EffectClass(
    "stage_yaw",
    "each move rotates the specimen slightly",
    basis_field,
    group="G2",
    discriminating_experiment="an hour of pairs with a stationary stage: a rotation only with moves is that of the stage",
    recurrence=Recurrence.FOLLOWS_MOVES,
)
