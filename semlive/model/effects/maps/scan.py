"""Effects of the scan on disparity maps: wrong row time, and hum in step with the rows; settling is in `settling`."""

import math
from collections.abc import Sequence

import numpy as np

from semlive.data.diagnosis.effects import ParameterEstimate
from semlive.model.effects.effect_class import (
    BasisField,
    EffectClass,
    NonlinearParameter,
    ReportedParameter,
    Values,
    values_grid,
)
from semlive.model.effects.run_geometry import RunGeometry, field_column

# Wrong row time: fly-back omitted, a wrong digit, or integrated or interlaced scans.


def _wrong_row_time(scene: RunGeometry, values: Values) -> BasisField:
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
    return (*options, WRONG_ROW_TIME.name) if odds > 0.0 else (WRONG_ROW_TIME.name, *options)


WRONG_ROW_TIME = EffectClass(
    "wrong_row_time",
    "rows take longer or shorter than configured: e = v(T) y t_R delta",
    _wrong_row_time,
    group="G3",
    discriminating_experiment="pairs with another row time, and the duration of a frame by the "
    "clock: 1 + delta = 1/M is integration of M scans",
    alias_rule=alias_names,
)


# Mains hum with row scans triggered by the mains: a pattern of columns, with a period that depends on the dwell time.
MAINS_HZ = (50.0, 60.0, 100.0, 120.0)


def _line_sync_hum(scene: RunGeometry, values: Values) -> BasisField:
    """Along x, A sin(2 pi f x t_D + phi) as a sine and a cosine."""
    phase = 2.0 * np.pi * values["frequency_hz"] * scene.time_in_row_s
    nothing = np.zeros_like(phase)
    waves = np.concatenate((field_column(np.sin(phase), nothing), field_column(np.cos(phase), nothing)), axis=-1)
    return BasisField(
        waves, tuple(ReportedParameter(f"{name}_px", "px", row) for name, row in zip(("sine", "cosine"), np.eye(2), strict=True))
    )


LINE_SYNC_HUM = EffectClass(
    "line_sync_hum",
    "the mains deflect equal columns of all rows equally, because they trigger the rows",
    _line_sync_hum,
    values_grid("frequency_hz", MAINS_HZ),
    nonlinear_parameters=(NonlinearParameter("frequency_hz", "Hz", 5.0),),
    group="G4",
    discriminating_experiment="the calibration again with half or twice the dwell: the period "
    "in columns changes; or without synchronisation",
)
