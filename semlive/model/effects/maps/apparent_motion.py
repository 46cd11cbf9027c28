"""Apparent motion in disparity maps by charging and by the bias of the correlation."""

from collections.abc import Iterable

import numpy as np

from semlive.model.effects.effect_class import BasisField, EffectClass, NonlinearParameter, ReportedParameter, Values, xy_parameters
from semlive.model.effects.run_geometry import RunGeometry, field_column, times_time_columns, xy_columns

# Charging in every frame deflects the beam, more with increasing dose.
CHARGING_S, DOSE_S = (5.0, 10.0, 20.0, 40.0, 80.0), (600.0, 1800.0, 6000.0)


def _charging_frame_ramp(scene: RunGeometry, values: Values) -> BasisField:
    """A (1 - exp(-tau / tau_c)) (1 - exp(-T_f / T_d))."""
    charge = np.expm1(-scene.time_in_frame_s / values["charging_s"]) * np.expm1(-scene.start_s / values["dose_s"])[:, None]
    return BasisField(xy_columns(charge), xy_parameters("px"))


def _charging_frame_ramp_grid(scene: RunGeometry) -> Iterable[Values]:
    """Time constants within a frame and over the run."""
    del scene
    return ({"charging_s": charging_s, "dose_s": dose_s} for charging_s in CHARGING_S for dose_s in DOSE_S)


CHARGING_FRAME_RAMP = EffectClass(
    "charging_frame_ramp",
    "the image shifts during every frame, more with every frame",
    _charging_frame_ramp,
    _charging_frame_ramp_grid,
    nonlinear_parameters=(NonlinearParameter("charging_s", "s", 2.0, ratio=True), NonlinearParameter("dose_s", "s", 3.0, ratio=True)),
    group="G9",
    discriminating_experiment="five minutes with the beam blanked; the mean grey level changes in proportion",
    sizes_px=(0.003, 10.0),
)


# Deflection of the beam around a charged grain of the specimen.
WIDTHS_PX = (60.0, 120.0, 240.0)
SPACING_PX = 75.0  # for widths up to 120 px; wider spots are as far apart relative to their width
MAX_SPOTS = 5
# Time constants of the charge, as fractions of the run. Their sums approximate all exponentials with time constants from 1/13 of the run,
# and stretched ones, within 1.4 %. Three columns of a slow random process had errors of 4 to 12 %, and half of the spots of 0.07 px gave
# two effects or UNKNOWN.
CHARGING = (0.05, 0.25, 1.0)


def _charging_local_lens(scene: RunGeometry, values: Values) -> BasisField:
    """q(T) 2 w (r - r_j) / (|r - r_j|^2 + w^2) around a point of the specimen; the final value of q is reported."""
    at, width_px = scene.address_px - scene.disparity_px, values["width_px"]
    dx, dy = at[..., 0] - values["x_px"], at[..., 1] - values["y_px"]
    lens = 2.0 * width_px / (dx * dx + dy * dy + width_px**2)
    charge = -np.expm1(-scene.time_s[..., None] / (scene.end_s * np.array(CHARGING)))
    last = np.unravel_index(int(np.argmax(scene.time_s)), scene.time_s.shape)
    return BasisField(times_time_columns(field_column(lens * dx, lens * dy), charge), (ReportedParameter("peak_px", "px", charge[last]),))


def _charging_local_lens_grid(scene: RunGeometry) -> Iterable[Values]:
    """Positions over the field, relative to the image centre, and three widths."""
    at = scene.address_px - scene.disparity_px
    low, high = at.min(axis=(0, 1)) - 0.5 * SPACING_PX, at.max(axis=(0, 1)) + 0.5 * SPACING_PX
    for width_px in WIDTHS_PX:
        spacing_px = SPACING_PX * max(1.0, width_px / 120.0)
        for x_px in np.arange(low[0], high[0] + 1.0, spacing_px):
            for y_px in np.arange(low[1], high[1] + 1.0, spacing_px):
                yield {"x_px": float(x_px), "y_px": float(y_px), "width_px": width_px}


CHARGING_LOCAL_LENS = EffectClass(
    "charging_local_lens",
    "a charged spot of the specimen deflects the beam around it",
    _charging_local_lens,
    _charging_local_lens_grid,
    nonlinear_parameters=(
        NonlinearParameter("x_px", "px", 37.5),
        NonlinearParameter("y_px", "px", 37.5),
        NonlinearParameter("width_px", "px", 2.0, ratio=True),
    ),
    group="G11",
    discriminating_experiment="a move of the specimen (the spot moves with it), a fresh field, grey levels around the spot",
    max_count=MAX_SPOTS,
)


# Interpolation bias of the correlation, periodic in the subpixel displacement.


def _dic_subpixel_bias(scene: RunGeometry, values: Values) -> BasisField:
    """A sin(2 pi U) of every measured map; a composed map has the bias of both."""
    del values
    wave = np.sum(np.sin(2.0 * np.pi * scene.measured_parts_px), axis=0)[..., None]
    return BasisField(wave, (ReportedParameter("amplitude_px", "px", np.ones(1)),))


DIC_SUBPIXEL_BIAS = EffectClass(
    "dic_subpixel_bias",
    "displacements have a bias with the period of a pixel: A sin(2 pi U)",
    _dic_subpixel_bias,
    discriminating_experiment="the same images with another interpolation: no beam time",
    sizes_px=(0.001, 0.1),
)
