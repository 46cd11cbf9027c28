"""Periodic motion of the image by air conditioning or a chiller."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, NonlinearParameter, Recurrence, Values
from semlive.model.effects.run_geometry import RunGeometry, xy_columns

LONGEST_S, SHORTEST_S = 900.0, 60.0


def basis_field(scene: RunGeometry, values: Values) -> BasisField:
    """A sine of arbitrary phase along each axis."""
    angle = 2.0 * np.pi * scene.time_s / values["period_s"]
    columns = np.concatenate((xy_columns(np.sin(angle)), xy_columns(np.cos(angle))), axis=-1)
    return BasisField(columns, random_amplitude=("amplitude_px", "px", 2.0**0.5))


def grid(scene: RunGeometry) -> Iterable[Values]:
    """Frequencies half a cycle per run apart; a wider grid misses spectral lines."""
    frequencies = np.arange(1.0 / LONGEST_S, 1.0 / SHORTEST_S, 0.5 / scene.end_s)
    return ({"period_s": float(1.0 / frequency)} for frequency in frequencies)


FAMILY = EffectClass(
    "thermal_oscillation",
    "the image oscillates with one period",
    basis_field,
    grid,
    nonlinear_parameters=(NonlinearParameter("period_s", "s", 1.02, ratio=True),),
    group="G8",
    discriminating_experiment="the temperatures of laboratory and chiller, logged during the run",
    recurrence=Recurrence.NEW_DRAW,
)
