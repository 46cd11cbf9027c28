"""Creep of the specimen at constant load."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, NonlinearParameter, ReportedParameter, Values
from semlive.model.effects.run_geometry import RunGeometry, field_column

POISSON = 0.33
ONSETS_S = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0)


def basis_field(scene: RunGeometry, values: Values) -> BasisField | None:
    """Eps = c F ln(1 + (T - T_k) / t0), across -nu eps."""
    if not scene.load.any():
        return None
    strain = scene.load * np.log1p(scene.since_step_at_s / values["onset_s"])
    reported = (ReportedParameter("strain_per_n", "1/N", np.array([1.0 / (scene.half_px * scene.highest_n)])),)
    return BasisField(field_column(-POISSON * scene.x * strain, scene.y * strain), reported)


def grid(scene: RunGeometry) -> Iterable[Values]:
    """Onsets."""
    del scene
    return ({"onset_s": value} for value in ONSETS_S)


FAMILY = EffectClass(
    "creep_in_hold",
    "the specimen creeps during the hold: eps = c F ln(1 + t / t0)",
    basis_field,
    grid,
    nonlinear_parameters=(NonlinearParameter("onset_s", "s", 3.0, ratio=True),),
    discriminating_experiment="a longer hold with a third frame; the load in displacement "
    "control falls as the strain grows in load control",
)
