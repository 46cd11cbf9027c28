"""Mains hum with row scans triggered by the mains: a pattern of columns, with a period that depends on the dwell time."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, NonlinearParameter, ReportedParameter, Values
from semlive.model.effects.run_geometry import RunGeometry, field_column

MAINS_HZ = (50.0, 60.0, 100.0, 120.0)


def basis_field(scene: RunGeometry, values: Values) -> BasisField:
    """Along x, A sin(2 pi f x t_D + phi) as a sine and a cosine."""
    phase = 2.0 * np.pi * values["frequency_hz"] * scene.time_in_row_s
    nothing = np.zeros_like(phase)
    waves = np.concatenate((field_column(np.sin(phase), nothing), field_column(np.cos(phase), nothing)), axis=-1)
    return BasisField(
        waves, tuple(ReportedParameter(f"{name}_px", "px", row) for name, row in zip(("sine", "cosine"), np.eye(2), strict=True))
    )


def grid(scene: RunGeometry) -> Iterable[Values]:
    """The mains frequencies and their first overtones."""
    del scene
    return ({"frequency_hz": value} for value in MAINS_HZ)


FAMILY = EffectClass(
    "line_sync_hum",
    "the mains deflect equal columns of all rows equally, because they trigger the rows",
    basis_field,
    grid,
    nonlinear_parameters=(NonlinearParameter("frequency_hz", "Hz", 5.0),),
    group="G4",
    discriminating_experiment="the calibration again with half or twice the dwell: the period "
    "in columns changes; or without synchronisation",
)
