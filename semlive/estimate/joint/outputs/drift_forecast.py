"""Forecast of the drift rate by continuation of the drift spline with its prior."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from semlive.data.drift import DriftForecast
from semlive.estimate.joint.elimination.shared_parameters import SharedParameters, temporal_splines
from semlive.estimate.joint.solution.posterior import Solution

FORECAST_SCANS = (0.0, 1.0, 2.0, 4.0, 8.0)
"""Begin of the scans that are forecast, after the end of the newest frame, in durations of a scan."""


def forecast(solution: Solution, ahead_scans: tuple[float, ...] = FORECAST_SCANS) -> DriftForecast:
    """Forecast the mean drift rate over future scans of the duration of the newest one, with its uncertainty.

    New knots continue the spline with the selected smoothness prior (random differences of second or third order). The forecast therefore
    continues the last rate or curvature, and its uncertainty grows with the uncertainty of the last knots and of the prior. A change of
    the drift statistics is not forecast.

    Args:
        solution: posterior of the pairs so far.
        ahead_scans: start of the scans, in scan durations after the newest frame, see `FORECAST_SCANS`; not negative.
    """
    state = solution.state
    drift, newest = state.drift, max(state.frames, key=lambda when: when.start_s)
    assert drift is not None  # a solution has data
    duration_s = newest.timing.duration_s
    begin_s = newest.start_s + duration_s * (1.0 + np.asarray(ahead_scans, dtype=np.float64))
    count, longer = drift.spline.size, drift.until(float(begin_s.max()) + duration_s).spline
    first, rows = _mean_rate(longer.local(begin_s), longer.local(begin_s + duration_s), duration_s, longer.size)
    part = state.layout.part("drift")
    rates, variances = [], []
    for strand in temporal_splines(state, solution.hyper, SharedParameters.of(state))[:2]:
        since = min(strand.since(count), first)
        from_old, added = _continued(strand.belief(count, longer.size)[1], count - strand.since(count), rows[:, count:])
        recent_rows = rows[:, since:count].copy()
        recent_rows[:, strand.since(count) - since :] += from_old
        at = part.start + strand.offset + strand.stride * np.arange(since, count)
        joint = np.zeros((len(rows), state.layout.size))
        joint[:, at] = recent_rows
        rates.append(recent_rows @ solution.mean[at])
        variances.append(np.diag(solution.covariance_of(joint)) + added)
    return DriftForecast(begin_s, duration_s, np.stack(rates, axis=1), np.sqrt(np.clip(np.stack(variances, axis=1), 0.0, None)))


Local = tuple[NDArray[np.int64], NDArray[np.float64]]


def _mean_rate(begin: Local, end: Local, duration_s: float, size: int) -> tuple[int, NDArray[np.float64]]:
    """First knot involved, and (k, size) mean rates between two times as linear functions of the knots."""
    rows = np.zeros((len(begin[0]), size))
    line = np.arange(len(rows))[:, None]
    for sign, (index, value) in ((-1.0, begin), (1.0, end)):
        np.add.at(rows, (line, index), sign * value / duration_s)
    return int(min(begin[0].min(), end[0].min())), rows


def _continued(belief: NDArray[np.float64], old: int, rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Functions of new knots expressed by the old knots (k, old) coupled to them by the prior, and the added variance (k,)."""
    if not rows.shape[1]:
        return np.zeros((len(rows), old)), np.zeros(len(rows))
    spread = cho_solve(cho_factor(belief[old:, old:], lower=True), rows.T)
    return -spread.T @ belief[old:, :old], np.einsum("kn,nk->k", rows, spread)
