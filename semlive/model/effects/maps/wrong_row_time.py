"""The row time is not what was stated: fly-back forgotten, a digit slipped, several scans integrated or interlaced."""

import math
from collections.abc import Sequence

import numpy as np

from semlive.data.diagnosis.effects import ParameterEstimate
from semlive.model.effects.effect_class import BasisField, EffectClass, ReportedParameter, Values
from semlive.model.effects.run_geometry import RunGeometry


def basis_field(scene: RunGeometry, values: Values) -> BasisField:
    """T += delta tau, so the drift is taken at the wrong instant: e = v(T) delta tau."""
    del values
    shape = scene.drift_rate_px_s * scene.time_in_frame_s[..., None]
    largest_px = float(np.abs(shape).max()) or 1.0
    return BasisField(shape[..., None] / largest_px, (ReportedParameter("row_time_error", "1", np.array([1.0 / largest_px])),))


SCANS = (2, 4, 8, 16, 32, 64)
"""Counts that microscopes offer to integrate over."""
ROW_TIME_ERROR_RANGE = 2.0
"""Errors of a row time lie anywhere from -1 to 1."""
MIN_LOG_ODDS = math.log(20.0)


def alias_names(parameters: Sequence[ParameterEstimate]) -> tuple[str, ...]:
    """Rows that take 1/M of what was stated are M integrated scans, or for M = 2 interlaced fields; how surely is a matter of odds.

    A row time that is stated wrongly by just that factor is less likely by the room that it had for other values.
    """
    found = next(parameter for parameter in parameters if parameter.name == "row_time_error")
    if not found.sigma > 0.0:
        return ()
    away = {scans: abs(found.value - (1.0 / scans - 1.0)) / found.sigma for scans in SCANS}
    scans = min(away, key=lambda count: away[count])
    odds = math.log(ROW_TIME_ERROR_RANGE / (found.sigma * math.sqrt(2.0 * math.pi) * len(SCANS))) - 0.5 * away[scans] ** 2
    options = ("frame_integration", "interlaced_scan") if scans == 2 else ("frame_integration",)
    if odds < -MIN_LOG_ODDS:
        return ()
    if odds > MIN_LOG_ODDS:
        return options
    return (*options, FAMILY.name) if odds > 0.0 else (FAMILY.name, *options)


FAMILY = EffectClass(
    "wrong_row_time",
    "rows take longer or shorter than stated: e = v(T) y t_R delta",
    basis_field,
    group="G3",
    discriminating_experiment="pairs with another row time, and the frame's duration by the "
    "clock: 1 + delta = 1/M is integration of M scans",
    alias_rule=alias_names,
)
