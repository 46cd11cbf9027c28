"""How fast things will go on: the drift by frames of this hold or by its forecast, the load by its last readings.

Decides how long to wait, never whether to move.
"""

from __future__ import annotations

import math

from semlive.engine.events import DriftForecastUpdated
from semlive.engine.state import EngineState


def drift_rate(seen: DriftForecastUpdated | None, at_ns: int) -> tuple[float, float]:
    """Forecast drift rate and its standard uncertainty, px/s, of a scan that begins at an instant.

    Between two forecast scans linear, beyond the last one that one's. Infinite where nothing is forecast.
    """
    if seen is None or not seen.scans:
        return math.inf, math.inf
    later = next((i for i, scan in enumerate(seen.scans) if scan[0] >= at_ns), len(seen.scans) - 1)
    (begin_0, rate_0, sigma_0), (begin_1, rate_1, sigma_1) = seen.scans[max(later - 1, 0)], seen.scans[later]
    part = 1.0 if begin_1 <= begin_0 else min(max((at_ns - begin_0) / (begin_1 - begin_0), 0.0), 1.0)
    return rate_0 + part * (rate_1 - rate_0), sigma_0 + part * (sigma_1 - sigma_0)


def relaxation_n_s(state: EngineState, window_s: float) -> float:
    """How fast the load changes, N/s: the slope of a line through its last readings; 0 without a load frame, infinite while unknown."""
    if state.load_frame is None:
        return 0.0
    points = [
        ((time_ns - state.time_ns) / 1e9, force_n)
        for time_ns, force_n, _ in state.history.between(state.time_ns - round(window_s * 1e9), state.time_ns)
    ]
    if len(points) < 3:
        return math.inf
    middle_s, middle_n = (math.fsum(one) / len(points) for one in zip(*points, strict=True))
    spread = math.fsum((at_s - middle_s) ** 2 for at_s, _ in points)
    return math.fsum((at_s - middle_s) * (force_n - middle_n) for at_s, force_n in points) / spread if spread > 0 else math.inf


def hold_extension_reason(state: EngineState) -> str | None:
    """Why a hold that has lasted as long as it must is to go on, as words, or None."""
    rule = state.plan.adaptive_hold
    if rule is None or state.seconds_since(state.since_ns) >= rule.max_hold_s:
        return None
    if rule.max_relaxation_n_s is not None:
        rate_n_s = relaxation_n_s(state, max(state.plan.hold.hold_s / 2, _SHORTEST_WINDOW_S))
        if not abs(rate_n_s) <= rule.max_relaxation_n_s:
            return f"the load changes by {rate_n_s:+.2g} N/s"
    return None if rule.max_rate_px_s is None else _drifts_on(state, rule.max_rate_px_s)


def _drifts_on(state: EngineState, max_rate_px_s: float) -> str | None:
    """That the drift is still too fast: as frames of this hold show it, else as it was forecast."""
    if state.hold_drift is not None and state.hold_drift.begin_ns >= state.since_ns:
        rate_px_s, words = state.hold_drift.rate_px_s, "the drift went on at {:.2g} px/min between frames of this hold"
    elif state.drift_forecast is not None:
        rate_px_s, words = drift_rate(state.drift_forecast, state.time_ns)[0], "the drift is expected to go on at {:.2g} px/min"
    else:
        return None
    return None if rate_px_s <= max_rate_px_s else words.format(60 * rate_px_s)


_SHORTEST_WINDOW_S = 5.0
"""A line through fewer seconds of readings tells the noise of the load cell: 1 N at 20 readings a second is 0.07 N/s over 5 s."""
