"""Duration of an adaptive hold, from the drift rate (measured in this hold, or forecast) and the rate of the load.

The result determines how long a hold lasts, never whether motion begins.
"""

from __future__ import annotations

import math

from semlive.engine.events import DriftForecastUpdated
from semlive.engine.state import EngineState


def drift_rate(forecast: DriftForecastUpdated | None, at_ns: int) -> tuple[float, float]:
    """Return the forecast drift rate and its standard uncertainty, px/s, for a scan that begins at a given time.

    Linear interpolation between the forecast scans; constant after the last one. Both values are infinite without a forecast.

    Args:
        forecast: the newest forecast; None if there is none.
        at_ns: begin of the scan, experiment time.
    """
    if forecast is None or not forecast.scans:
        return math.inf, math.inf
    index = next((i for i, scan in enumerate(forecast.scans) if scan[0] >= at_ns), len(forecast.scans) - 1)
    (begin_0, rate_0, sigma_0), (begin_1, rate_1, sigma_1) = forecast.scans[max(index - 1, 0)], forecast.scans[index]
    fraction = 1.0 if begin_1 <= begin_0 else min(max((at_ns - begin_0) / (begin_1 - begin_0), 0.0), 1.0)
    return rate_0 + fraction * (rate_1 - rate_0), sigma_0 + fraction * (sigma_1 - sigma_0)


def relaxation_n_s(state: EngineState, window_s: float) -> float:
    """Return the rate of the load, N/s: the slope of a least-squares line through the last readings.

    The rate is 0 without a load frame, and infinite with fewer than 3 readings.

    Args:
        state: state of the run.
        window_s: time span of the readings, experiment seconds.
    """
    if state.devices.load_frame is None:
        return 0.0
    points = [
        ((time_ns - state.time_ns) / 1e9, force_n)
        for time_ns, force_n, _ in state.devices.history.between(state.time_ns - round(window_s * 1e9), state.time_ns)
    ]
    if len(points) < 3:
        return math.inf
    mean_s, mean_n = (math.fsum(values) / len(points) for values in zip(*points, strict=True))
    square_sum_s2 = math.fsum((at_s - mean_s) ** 2 for at_s, _ in points)
    return math.fsum((at_s - mean_s) * (force_n - mean_n) for at_s, force_n in points) / square_sum_s2 if square_sum_s2 > 0 else math.inf


def hold_extension_reason(state: EngineState) -> str | None:
    """Return the reason for extending a hold beyond its minimum time, as a clause; None if it may end."""
    rule = state.plan.adaptive_hold
    if rule is None or state.seconds_since(state.since_ns) >= rule.max_hold_s:
        return None
    if rule.max_relaxation_n_s is not None:
        rate_n_s = relaxation_n_s(state, max(state.plan.hold.hold_s / 2, _MIN_WINDOW_S))
        if not abs(rate_n_s) <= rule.max_relaxation_n_s:
            return f"the load changes by {rate_n_s:+.2g} N/s"
    return None if rule.max_rate_px_s is None else _drift_reason(state, rule.max_rate_px_s)


def _drift_reason(state: EngineState, max_rate_px_s: float) -> str | None:
    """Return a clause if the drift rate measured in this hold, or else the forecast rate, exceeds its maximum; else None."""
    if state.analysis.hold_drift is not None and state.analysis.hold_drift.begin_ns >= state.since_ns:
        rate_px_s, text = state.analysis.hold_drift.rate_px_s, "the drift rate between frames of this hold was {:.2g} px/min"
    elif state.analysis.drift_forecast is not None:
        rate_px_s, text = drift_rate(state.analysis.drift_forecast, state.time_ns)[0], "a drift rate of {:.2g} px/min is expected"
    else:
        return None
    return None if rate_px_s <= max_rate_px_s else text.format(60 * rate_px_s)


_MIN_WINDOW_S = 5.0
"""Over a shorter window the noise of the load cell dominates the slope: 1 N at 20 readings per second gives 0.07 N/s over 5 s."""
