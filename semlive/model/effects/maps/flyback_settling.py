"""Settling of the beam at the start of rows; its extent in columns depends on the dwell time."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, NonlinearParameter, ReportedParameter, Values
from semlive.model.effects.run_geometry import RunGeometry, field_column

BETWEEN_S, COUNT = (1e-4, 2e-2), 12


def basis_field(scene: RunGeometry, values: Values) -> BasisField:
    """Along x, A exp(-x t_D / tau)."""
    fall = np.exp(-scene.time_in_row_s / values["settling_s"])
    return BasisField(field_column(fall, np.zeros_like(fall)), (ReportedParameter("amplitude_px", "px", np.ones(1)),))


def grid(scene: RunGeometry) -> Iterable[Values]:
    """Time constants."""
    del scene
    return ({"settling_s": float(value)} for value in np.geomspace(*BETWEEN_S, COUNT))


FAMILY = EffectClass(
    "flyback_settling",
    "rows begin before the beam has settled",
    basis_field,
    grid,
    nonlinear_parameters=(NonlinearParameter("settling_s", "s", 1.62, ratio=True),),
    group="G4",
    discriminating_experiment="the calibration again with half or twice the dwell: settling changes its extent, the distortion does not",
    sizes_px=(0.003, 10.0),
)
