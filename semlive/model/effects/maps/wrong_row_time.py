"""Wrong row time: fly-back omitted, a wrong digit, or integrated or interlaced scans."""

import math
from collections.abc import Sequence

import numpy as np

from semlive.data.diagnosis.effects import ParameterEstimate
from semlive.model.effects.effect_class import BasisField, EffectClass, ReportedParameter, Values
from semlive.model.effects.run_geometry import RunGeometry


def basis_field(scene: RunGeometry, values: Values) -> BasisField:
    """T += delta tau, so the drift is evaluated at the wrong instant: e = v(T) delta tau."""
    del values
    shape = scene.drift_rate_px_s * scene.time_in_frame_s[..., None]
    largest_px = float(np.abs(shape).max()) or 1.0
    return BasisField(shape[..., None] / largest_px, (ReportedParameter("row_time_error", "1", np.array([1.0 / largest_px])),))


SCANS = (2, 4, 8, 16, 32, 64)
"""Numbers of integrated scans that microscopes offer."""
ROW_TIME_ERROR_RANGE = 2.0
"""Width of the uniform prior of the row time error, -1 to 1."""
MIN_LOG_ODDS = math.log(20.0)


def alias_names(parameters: Sequence[ParameterEstimate]) -> tuple[str, ...]:
    """Special cases: a row time of 1/M of the configured one indicates M integrated scans or, for M = 2, interlaced fields.

    The decision uses the odds: an arbitrary row time error equal to this factor is less likely by its Occam factor.
    """
    error = next(parameter for parameter in parameters if parameter.name == "row_time_error")
    if not error.sigma > 0.0:
        return ()
    away = {scans: abs(error.value - (1.0 / scans - 1.0)) / error.sigma for scans in SCANS}
    scans = min(away, key=lambda count: away[count])
    odds = math.log(ROW_TIME_ERROR_RANGE / (error.sigma * math.sqrt(2.0 * math.pi) * len(SCANS))) - 0.5 * away[scans] ** 2
    options = ("frame_integration", "interlaced_scan") if scans == 2 else ("frame_integration",)
    if odds < -MIN_LOG_ODDS:
        return ()
    if odds > MIN_LOG_ODDS:
        return options
    return (*options, FAMILY.name) if odds > 0.0 else (FAMILY.name, *options)


FAMILY = EffectClass(
    "wrong_row_time",
    "rows take longer or shorter than configured: e = v(T) y t_R delta",
    basis_field,
    group="G3",
    discriminating_experiment="pairs with another row time, and the duration of a frame by the "
    "clock: 1 + delta = 1/M is integration of M scans",
    alias_rule=alias_names,
)
