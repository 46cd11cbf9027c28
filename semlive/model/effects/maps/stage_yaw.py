"""The stage's guides turn the specimen a little with each move."""

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, Recurrence, Values
from semlive.model.effects.run_geometry import RunGeometry, field_column, times_time_columns


def basis_field(scene: RunGeometry, values: Values) -> BasisField | None:
    """A rotation of its own for each pair of the calibration but the first; later the gradient is free anyway."""
    del values
    pairs = [pair for pair in np.unique(scene.pair)[1:] if not scene.gradient_free[scene.pair == pair].any()]
    if not pairs:
        return None
    each = (scene.pair[:, None] == np.array(pairs)[None]).astype(np.float64)[:, None, :]
    return BasisField(times_time_columns(field_column(-scene.y, scene.x), each), random_amplitude=("sd_rad", "rad", 1.0 / scene.half_px))


FAMILY = EffectClass(
    "stage_yaw",
    "each move turns the specimen a little",
    basis_field,
    group="G2",
    discriminating_experiment="an hour of pairs with the stage parked: what turns with the moves alone is the stage",
    recurrence=Recurrence.FOLLOWS_MOVES,
)
