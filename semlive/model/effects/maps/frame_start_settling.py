"""Settling of the beam at the start of frames; its extent in rows depends on the row time."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, NonlinearParameter, Values, xy_parameters
from semlive.model.effects.run_geometry import RunGeometry, xy_columns

BETWEEN_S, COUNT = (0.3, 30.0), 10


def basis_field(scene: RunGeometry, values: Values) -> BasisField:
    """(u, v) = A exp(-y t_R / tau)."""
    return BasisField(xy_columns(np.exp(-scene.row_start_s / values["settling_s"])), xy_parameters("px"))


def grid(scene: RunGeometry) -> Iterable[Values]:
    """Time constants."""
    del scene
    return ({"settling_s": float(value)} for value in np.geomspace(*BETWEEN_S, COUNT))


FAMILY = EffectClass(
    "frame_start_settling",
    "frames begin before the beam has settled",
    basis_field,
    grid,
    nonlinear_parameters=(NonlinearParameter("settling_s", "s", 1.67, ratio=True),),
    group="G4",
    discriminating_experiment="the calibration again with half or twice the row time: settling changes its extent, the distortion does not",
    sizes_px=(0.003, 10.0),
)
