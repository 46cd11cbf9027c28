"""Deflection of the beam around a charged grain of the specimen."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, NonlinearParameter, ReportedParameter, Values
from semlive.model.effects.run_geometry import RunGeometry, field_column, times_time_columns

WIDTHS_PX = (60.0, 120.0)
SPACING_PX = 75.0
# Time constants of the charge, as fractions of the run. Their sums approximate all exponentials with time constants from 1/13 of the run,
# and stretched ones, within 1.4 %. Three columns of a slow random process had errors of 4 to 12 %, and half of the spots of 0.07 px gave
# two effects or UNKNOWN.
CHARGING = (0.05, 0.25, 1.0)


def basis_field(scene: RunGeometry, values: Values) -> BasisField:
    """q(T) 2 w (r - r_j) / (|r - r_j|^2 + w^2) around a point of the specimen; the final value of q is reported."""
    at, width_px = scene.address_px - scene.disparity_px, values["width_px"]
    dx, dy = at[..., 0] - values["x_px"], at[..., 1] - values["y_px"]
    lens = 2.0 * width_px / (dx * dx + dy * dy + width_px**2)
    charge = -np.expm1(-scene.time_s[..., None] / (scene.end_s * np.array(CHARGING)))
    last = np.unravel_index(int(np.argmax(scene.time_s)), scene.time_s.shape)
    return BasisField(times_time_columns(field_column(lens * dx, lens * dy), charge), (ReportedParameter("peak_px", "px", charge[last]),))


def grid(scene: RunGeometry) -> Iterable[Values]:
    """Positions over the field, relative to the image centre, and two widths."""
    at = scene.address_px - scene.disparity_px
    low, high = at.min(axis=(0, 1)) - 0.5 * SPACING_PX, at.max(axis=(0, 1)) + 0.5 * SPACING_PX
    for width_px in WIDTHS_PX:
        for x_px in np.arange(low[0], high[0] + 1.0, SPACING_PX):
            for y_px in np.arange(low[1], high[1] + 1.0, SPACING_PX):
                yield {"x_px": float(x_px), "y_px": float(y_px), "width_px": width_px}


FAMILY = EffectClass(
    "charging_local_lens",
    "a charged spot of the specimen deflects the beam around it",
    basis_field,
    grid,
    nonlinear_parameters=(
        NonlinearParameter("x_px", "px", 37.5),
        NonlinearParameter("y_px", "px", 37.5),
        NonlinearParameter("width_px", "px", 1.4, ratio=True),
    ),
    group="G11",
    discriminating_experiment="a move of the specimen (the spot moves with it), a fresh field, grey levels around the spot",
)
