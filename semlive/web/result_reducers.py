"""Reducers of the messages of the estimate for the page: drift, strain, elastic constants."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from semlive.formats.log.messages import DriftForecastMessage, DriftMessage, ElasticMessage, StrainMessage
from semlive.web.page_state import Drift, DriftFrame, ElasticRow, PageState, StrainPoint

# Number of newest frames that are drawn with all rows; of older frames only the middle row is drawn.
_DETAILED_FRAMES = 200
_MAX_FRAMES = 5000


def _drift(view: PageState, message: DriftMessage) -> PageState:
    rows: dict[int, list[tuple[float, ...]]] = defaultdict(list)
    for frame, time_s, place, sigma in zip(message.frame, message.time_s, message.drift_px, message.sigma_px, strict=True):
        rows[frame].append((time_s, *place, *sigma))
    by_frame = {entry.frame: entry for entry in view.drift.frames} | {
        frame: DriftFrame(frame, tuple(samples)) for frame, samples in rows.items()
    }
    frames = [by_frame[number] for number in sorted(by_frame)][-_MAX_FRAMES:]
    older = [
        entry if len(entry.rows) == 1 else replace(entry, rows=(entry.rows[len(entry.rows) // 2],)) for entry in frames[:-_DETAILED_FRAMES]
    ]
    frames = [*older, *frames[-_DETAILED_FRAMES:]]
    drift = replace(view.drift, frames=tuple(frames))
    if message.forecast is not None and frames and frames[-1].rows:
        drift = _with_forecast(drift, message.forecast, frames[-1].rows[-1])
    return replace(view, drift=_with_verdict(drift, view))


def _with_forecast(drift: Drift, message: DriftForecastMessage, last: tuple[float, ...]) -> Drift:
    """Integrate the forecast rates from the newest row; the uncertainty assumes a constant rate error of one sigma."""
    rows, time_s, place, spread = [last], last[0], [last[1], last[2]], [last[3], last[4]]
    for begin_s, rate, sigma in zip(message.time_s, message.rate_px_s, message.sigma_px_s, strict=True):
        lasts_s = begin_s + message.duration_s - time_s
        time_s = begin_s + message.duration_s
        for axis in (0, 1):
            place[axis] += rate[axis] * lasts_s
            spread[axis] += sigma[axis] * lasts_s
        rows.append((time_s, *place, *spread))
    first = (math.hypot(*message.rate_px_s[0]), math.hypot(*message.sigma_px_s[0])) if message.rate_px_s else None
    return replace(drift, forecast=tuple(rows), rate_px_s=first)


def _with_verdict(drift: Drift, view: PageState) -> Drift:
    """Set the verdict if there is no gate, or before its first decision; later verdicts of the gate stay unchanged."""
    required = "" if view.run is None else view.run.warm_up_required
    if drift.rate_px_s is None:
        return replace(drift, verdict="no forecast yet")
    rate, sigma = drift.rate_px_s
    forecast = f"forecast {60 * rate:.2g} ± {60 * sigma:.1g} px/min"
    if not required:
        return replace(drift, verdict=f"{forecast}; no warm-up gate is configured")
    if drift.warm is None:
        return replace(drift, verdict=f"{forecast}, {required} before the run continues")
    return drift


def _strain(view: PageState, message: StrainMessage) -> PageState:
    axial, transverse = ("exx", "eyy") if view.run is not None and view.run.loading_axis == "x" else ("eyy", "exx")
    pair = message.frame // 2
    area_mm2 = None if view.run is None else view.run.area_mm2
    load_n = view.earlier.frame_loads.get(message.frame)
    point = StrainPoint(
        message.frame,
        view.schedule.done[pair].phase.value if pair < len(view.schedule.done) else "",
        load_n,
        None if load_n is None or area_mm2 is None else load_n / area_mm2,
        getattr(message.mean, axial),
        getattr(message.mean_sigma, axial),
        getattr(message.mean, transverse),
        getattr(message.mean_sigma, transverse),
        getattr(message.sd, axial),
        None if message.gauge_sigma is None else (message.gauge_sigma.exx, message.gauge_sigma.eyy, message.gauge_sigma.exy),
    )
    points = {earlier.frame: earlier for earlier in view.strength.points} | {message.frame: point}
    ordered = tuple(points[number] for number in sorted(points))[-_MAX_FRAMES:]
    return replace(view, strength=replace(view.strength, points=ordered, vsg_px=message.vsg_px))


def _elastic(view: PageState, message: ElasticMessage) -> PageState:
    modulus, ratio = message.youngs_modulus_gpa, message.poissons_ratio
    row = ElasticRow(
        message.pairs or message.revision,
        None if modulus is None else modulus.value,
        None if modulus is None else modulus.sigma,
        None if ratio is None else ratio.value,
        None if ratio is None else ratio.sigma,
    )
    gage = None if message.gage is None else (message.gage.dic_over_gage.value, message.gage.dic_over_gage.sigma)
    earlier = (constants for constants in view.strength.elastic if constants.pairs != row.pairs)
    elastic = (*earlier, row)[-_MAX_FRAMES:]
    return replace(view, strength=replace(view.strength, elastic=elastic, dic_over_gage=gage))


RESULT_REDUCERS: Mapping[str, Callable[[PageState, Any], PageState]] = {
    "/drift/estimate": _drift,
    "/strain/summary": _strain,
    "/elastic": _elastic,
}
