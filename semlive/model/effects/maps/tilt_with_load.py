"""Perspective by tilt of the specimen under load with misaligned grips."""

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, ReportedParameter, Values
from semlive.model.effects.run_geometry import RunGeometry, field_column


def basis_field(scene: RunGeometry, values: Values) -> BasisField | None:
    """U = a x y, v = a y^2, a proportional to the load."""
    del values
    if not scene.load.any():
        return None
    shape = field_column(scene.x * scene.y * scene.load, scene.y**2 * scene.load)
    row = np.array([1.0 / (scene.half_px**2 * scene.highest_n)])
    return BasisField(shape, (ReportedParameter("tilt_over_working_distance_per_n", "1/(px N)", row),))


FAMILY = EffectClass(
    "tilt_with_load",
    "the specimen tilts with the load: (u, v) = a F (x y, y^2)",
    basis_field,
    group="G11",
    discriminating_experiment="unload to zero and repeat; working distance in focus at nine points",
)
