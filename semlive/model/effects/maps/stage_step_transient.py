"""Decaying motion of the stage after each move."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, NonlinearParameter, ReportedParameter, Values
from semlive.model.effects.run_geometry import RunGeometry, exponential_decay

BETWEEN_S, COUNT = (8.0, 400.0), 9


def basis_field(scene: RunGeometry, values: Values) -> BasisField | None:
    """D += A m_n exp(-(T - T_n) / tau) along the move."""
    largest_px = float(np.abs(scene.move_px).max())
    if largest_px == 0.0:
        return None
    fall = exponential_decay(scene, scene.move_px / largest_px, values["time_constant_s"])
    return BasisField(fall[..., None], (ReportedParameter("fraction", "1", np.array([1.0 / largest_px])),))


def grid(scene: RunGeometry) -> Iterable[Values]:
    """Time constants."""
    del scene
    return ({"time_constant_s": float(value)} for value in np.geomspace(*BETWEEN_S, COUNT))


FAMILY = EffectClass(
    "stage_step_transient",
    "the stage creeps along each move with an exponential decay",
    basis_field,
    grid,
    nonlinear_parameters=(NonlinearParameter("time_constant_s", "s", 1.63, ratio=True),),
    discriminating_experiment="a longer wait after some of the moves, or beam shifts instead",
    sizes_px=(0.003, 10.0),
)
