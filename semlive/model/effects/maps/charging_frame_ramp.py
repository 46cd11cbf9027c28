"""Charging in every frame deflects the beam, more with increasing dose."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, NonlinearParameter, Values, xy_parameters
from semlive.model.effects.run_geometry import RunGeometry, xy_columns

CHARGING_S, DOSE_S = (5.0, 10.0, 20.0, 40.0, 80.0), (600.0, 1800.0, 6000.0)


def basis_field(scene: RunGeometry, values: Values) -> BasisField:
    """A (1 - exp(-tau / tau_c)) (1 - exp(-T_f / T_d))."""
    charge = np.expm1(-scene.time_in_frame_s / values["charging_s"]) * np.expm1(-scene.start_s / values["dose_s"])[:, None]
    return BasisField(xy_columns(charge), xy_parameters("px"))


def grid(scene: RunGeometry) -> Iterable[Values]:
    """Time constants within a frame and over the run."""
    del scene
    return ({"charging_s": charging_s, "dose_s": dose_s} for charging_s in CHARGING_S for dose_s in DOSE_S)


FAMILY = EffectClass(
    "charging_frame_ramp",
    "the image shifts during every frame, more with every frame",
    basis_field,
    grid,
    nonlinear_parameters=(NonlinearParameter("charging_s", "s", 2.0, ratio=True), NonlinearParameter("dose_s", "s", 3.0, ratio=True)),
    group="G9",
    discriminating_experiment="five minutes with the beam blanked; the mean grey level changes in proportion",
    sizes_px=(0.003, 10.0),
)
