"""Reducers of the messages of the estimate for the page: drift, strain, elastic constants."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from semlive.formats.log.messages import DriftForecastMessage, DriftMessage, ElasticMessage, StrainMessage
from semlive.web.page_state import Drift, DriftFrame, ElasticRow, PageState, StrainPoint

# Largest number of frames that are drawn in full; older ones are drawn by their middle only.
_WHOLE_FRAMES = 200
_KEPT_FRAMES = 5000


def _drift(view: PageState, told: DriftMessage) -> PageState:
    rows: dict[int, list[tuple[float, ...]]] = defaultdict(list)
    for frame, time_s, place, sigma in zip(told.frame, told.time_s, told.drift_px, told.sigma_px, strict=True):
        rows[frame].append((time_s, *place, *sigma))
    known = {one.frame: one for one in view.drift.frames} | {frame: DriftFrame(frame, tuple(own)) for frame, own in rows.items()}
    frames = [known[number] for number in sorted(known)][-_KEPT_FRAMES:]
    older = [one if len(one.rows) == 1 else replace(one, rows=(one.rows[len(one.rows) // 2],)) for one in frames[:-_WHOLE_FRAMES]]
    frames = [*older, *frames[-_WHOLE_FRAMES:]]
    drift = replace(view.drift, frames=tuple(frames))
    if told.forecast is not None and frames and frames[-1].rows:
        drift = _foreseen(drift, told.forecast, frames[-1].rows[-1])
    return replace(view, drift=_judged(drift, view))


def _foreseen(drift: Drift, told: DriftForecastMessage, last: tuple[float, ...]) -> Drift:
    """Integrate the forecast rates from the newest row; the uncertainty assumes a constant rate error of one sigma."""
    rows, time_s, place, spread = [last], last[0], [last[1], last[2]], [last[3], last[4]]
    for begin_s, rate, sigma in zip(told.time_s, told.rate_px_s, told.sigma_px_s, strict=True):
        lasts_s = begin_s + told.duration_s - time_s
        time_s = begin_s + told.duration_s
        for axis in (0, 1):
            place[axis] += rate[axis] * lasts_s
            spread[axis] += sigma[axis] * lasts_s
        rows.append((time_s, *place, *spread))
    first = (math.hypot(*told.rate_px_s[0]), math.hypot(*told.sigma_px_s[0])) if told.rate_px_s else None
    return replace(drift, forecast=tuple(rows), rate_px_s=first)


def _judged(drift: Drift, view: PageState) -> Drift:
    """Return the verdict without a gate; the verdict of a gate is not changed."""
    gate = None if view.run is None else view.run.warm_up_rate_px_s
    if drift.rate_px_s is None:
        return replace(drift, verdict="no forecast yet")
    rate, sigma = drift.rate_px_s
    told = f"forecast {60 * rate:.2g} ± {60 * sigma:.1g} px/min"
    if gate is None:
        return replace(drift, verdict=f"{told}; no warm-up gate is configured")
    if drift.warm is None:
        return replace(drift, verdict=f"{told}, {60 * gate:.2g} px/min wanted before the first load")
    return drift


def _strain(view: PageState, told: StrainMessage) -> PageState:
    axial, transverse = ("exx", "eyy") if view.run is not None and view.run.loading_axis == "x" else ("eyy", "exx")
    pair = told.frame // 2
    area_mm2 = None if view.run is None else view.run.area_mm2
    load_n = view.frame_loads.get(told.frame)
    point = StrainPoint(
        told.frame,
        view.schedule.done[pair].phase.value if pair < len(view.schedule.done) else "",
        load_n,
        None if load_n is None or area_mm2 is None else load_n / area_mm2,
        getattr(told.mean, axial),
        getattr(told.mean_sigma, axial),
        getattr(told.mean, transverse),
        getattr(told.mean_sigma, transverse),
        getattr(told.sd, axial),
    )
    points = {one.frame: one for one in view.strength.points} | {told.frame: point}
    ordered = tuple(points[number] for number in sorted(points))[-_KEPT_FRAMES:]
    return replace(view, strength=replace(view.strength, points=ordered, vsg_px=told.vsg_px))


def _elastic(view: PageState, told: ElasticMessage) -> PageState:
    modulus, ratio = told.youngs_modulus_gpa, told.poissons_ratio
    row = ElasticRow(
        told.pairs or told.revision,
        None if modulus is None else modulus.value,
        None if modulus is None else modulus.sigma,
        None if ratio is None else ratio.value,
        None if ratio is None else ratio.sigma,
    )
    gage = None if told.gage is None else (told.gage.dic_over_gage.value, told.gage.dic_over_gage.sigma)
    earlier = (one for one in view.strength.elastic if one.pairs != row.pairs)
    elastic = (*earlier, row)[-_KEPT_FRAMES:]
    return replace(view, strength=replace(view.strength, elastic=elastic, dic_over_gage=gage))


RESULT_REDUCERS: Mapping[str, Callable[[PageState, Any], PageState]] = {
    "/drift/estimate": _drift,
    "/strain/summary": _strain,
    "/elastic": _elastic,
}
