"""Decaying motion after each load step by seating of the grips and settling of the load frame."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, NonlinearParameter, Values, xy_parameters
from semlive.model.effects.run_geometry import RunGeometry, exponential_decay, xy_columns

BETWEEN_S, COUNT = (8.0, 400.0), 9


def basis_field(scene: RunGeometry, values: Values) -> BasisField | None:
    """D += dF A exp(-(T - T_k) / tau)."""
    largest_n = float(np.abs(scene.load_change_n).max())
    if largest_n == 0.0:
        return None
    fall = exponential_decay(scene, scene.load_change_n[:, None] / largest_n, values["time_constant_s"])
    return BasisField(xy_columns(fall[..., 0]), xy_parameters("px/N", 1.0 / largest_n))


def grid(scene: RunGeometry) -> Iterable[Values]:
    """Time constants."""
    del scene
    return ({"time_constant_s": float(value)} for value in np.geomspace(*BETWEEN_S, COUNT))


FAMILY = EffectClass(
    "load_step_transient",
    "the image creeps after each load step with an exponential decay",
    basis_field,
    grid,
    nonlinear_parameters=(NonlinearParameter("time_constant_s", "s", 1.63, ratio=True),),
    discriminating_experiment="a step without a change of load, and a longer hold",
    sizes_px=(0.003, 10.0),
)
