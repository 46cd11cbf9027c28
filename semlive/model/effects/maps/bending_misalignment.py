"""In-plane bending of the specimen by an eccentric load."""

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, ReportedParameter, Values
from semlive.model.effects.run_geometry import RunGeometry, field_column

POISSON = 0.33


def basis_field(scene: RunGeometry, values: Values) -> BasisField | None:
    """U = -k F (y^2 + nu x^2) / 2, v = k F x y."""
    del values
    if not scene.load.any():
        return None
    shape = field_column(-0.5 * (scene.y**2 + POISSON * scene.x**2) * scene.load, scene.x * scene.y * scene.load)
    return BasisField(shape, (ReportedParameter("curvature_per_n", "1/(px N)", np.array([1.0 / (scene.half_px**2 * scene.highest_n)])),))


FAMILY = EffectClass(
    "bending_misalignment",
    "the specimen bends in its plane as the load grows",
    basis_field,
    group="G11",
    discriminating_experiment="the specimen turned over in the grips, or a strain gage on either edge",
)
