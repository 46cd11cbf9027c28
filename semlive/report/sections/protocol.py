"""Section on the protocol: prose from the run, a diagram of load and position over time with the pairs, and a table of the pairs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from semlive.data.experiment import Phase
from semlive.data.pair import PairDecision
from semlive.report.document.blocks import FigureBlock, Paragraph, Section, Table
from semlive.report.figures import draw_load, shade_scans, zero_time_ns
from semlive.report.paper_figures import spread
from semlive.report.run_data import RunData
from semlive.report.sections.wording import NOT_RECORDED, counted, fixed, joined
from semlive.report.style import PAGE_INCH, SOFT, X_COLOUR, Y_COLOUR, plain_axes

_MOST_NUMBERS = 20
"""Largest number of pairs with their number in the diagram."""
MANY_ROWS = 40
"""Number of rows above which a table is folded on the page."""


def protocol_section(data: RunData) -> Section:
    """Protocol.

    Args:
        data: of the run.
    """
    decisions = data.result.decisions
    rows = tuple(_pair_row(decision, zero_time_ns(data.result)) for decision in decisions)
    headings = ("pair", "phase", "x µm", "y µm", "load set, N", "load measured, N", "start, min", "first file", "second file")
    caption = "Pairs with the commanded position of the stage and load, the mean load over both frames, and the image files."
    blocks = (
        Paragraph(_steps_text(decisions, data.settings.specimen.area_mm2)),
        Paragraph(_conditions_text((data.facts.config or {}).get("protocol") or {}, data)),
        _diagram(data),
        Table(caption, headings, rows, folded=len(rows) > MANY_ROWS),
    )
    return Section("Protocol", blocks)


def _steps_text(decisions: tuple[PairDecision, ...], area_mm2: float | None) -> str:
    by_phase = {phase: [decision for decision in decisions if decision.step.phase is phase] for phase in Phase}
    parts = [counted(len(found), f"{phase.value} pair") for phase, found in by_phase.items() if found]
    minutes = (decisions[-1].second.end_time_ns - decisions[0].first.start_time_ns.value) / 60e9
    text = (
        f"The run took {minutes:.1f} min from the first to the last frame and has {joined(parts)}. The specimen does not move between the "
        "two frames of a pair, so their difference shows drift alone."
    )
    unloaded = [decision.step.shift_um for decision in decisions if decision.step.phase is not Phase.TENSION]
    if unloaded and np.ptp(unloaded, axis=0).any():
        x, y = np.ptp(unloaded, axis=0)
        text += (
            f" Before the load the field of view was translated to {len(set(unloaded))} positions that extend over {x:.4g} µm along x and "
            f"{y:.4g} µm along y: a pattern that moves through the image shows the distortion."
        )
    elif unloaded:
        text += " No commanded translation is recorded."
    loads = [decision.step.load_n for decision in by_phase[Phase.TENSION] if decision.step.load_n is not None]
    if loads:
        stress = "" if area_mm2 is None else f" ({min(loads) / area_mm2:.4g} to {max(loads) / area_mm2:.4g} MPa)"
        text += f" The specimen was then loaded in {counted(len(loads), 'step')} from {min(loads):g} N to {max(loads):g} N{stress}."
    return text


def _conditions_text(protocol: Mapping[str, Any], data: RunData) -> str:
    if not protocol:
        return f"Holds, tolerances and ramp rate of the protocol are {NOT_RECORDED}."
    settle, load, share, stage, hold, ramp = (
        protocol.get(key)
        for key in ("settle_s", "load_tolerance_n", "load_tolerance_fraction", "stage_tolerance_um", "hold_s", "ramp_rate_n_s")
    )
    sem = (data.facts.config or {}).get("sem") or {}
    triggered = isinstance(sem, Mapping) and sem.get("trigger") is not None
    sentences = [
        f"The load was changed at {ramp} N/s and then held.",
        f"A step began when load and position had stayed within their tolerances for {settle} s (load: the larger of {load} N and "
        f"{100 * (share or 0.0):g} %; stage: {stage} µm), followed by a hold of {hold} s.",
        "Each frame was triggered." if triggered else "The microscope scanned continuously and exported every frame; a pair is "
        "two complete scans within the hold.",
        "Drift was compensated by moving the field of view back"
        f" beyond {protocol['recentre_beyond_px']} px." if protocol.get("recentre_beyond_px") is not None else "The field of "
        "view was not moved back after drift.",
    ]  # fmt: skip
    warm_up, adaptive = protocol.get("warm_up"), protocol.get("adaptive_hold")
    if isinstance(warm_up, Mapping):
        sentences.append(_warm_up_sentence(warm_up))
    if isinstance(adaptive, Mapping):
        sentences.append(f"Holds were extended up to {adaptive.get('max_hold_s')} s while drift or load changed too fast.")
    if data.facts.files:
        used = 2 * len(data.result.decisions)
        sentences.append(f"Of {data.facts.files} exported files {used} form the pairs.")
    return " ".join(sentences)


def _warm_up_sentence(warm_up: Mapping[str, object]) -> str:
    rate, change = warm_up.get("max_rate_px_s"), warm_up.get("max_change_px_s")
    maxima = [] if rate is None else [f"the drift rate was below {rate} px/s"]
    maxima += [] if change is None else [f"its change from pair to pair was below {change} px/s"]
    follows = "The specimen was moved" if warm_up.get("before") == "calibration" else "The load was applied"
    wait = f", or after {warm_up.get('max_wait_s')} s" if warm_up.get("after_wait") == "continue" else ""
    return f"{follows} only after {' and '.join(maxima)}{wait}."


def _diagram(data: RunData) -> FigureBlock:
    result, series = data.result, data.series
    zero_ns = zero_time_ns(result)
    loaded = series is not None and series.time_ns.size > 0
    figure = Figure(figsize=(PAGE_INCH, 3.2 if loaded else 1.9), layout="constrained")
    panels = list(figure.subplots(2 if loaded else 1, 1, sharex=True, squeeze=False)[:, 0])
    plain_axes(*panels)
    lower = panels[-1]
    if loaded and series is not None:
        draw_load(panels[0], series, result)
    shade_scans(lower, result.decisions, zero_ns)
    for axis, (name, colour) in enumerate((("x", X_COLOUR), ("y", Y_COLOUR))):
        minutes = [_middle_min(decision, zero_ns) for decision in result.decisions]
        shift = [decision.step.shift_um[axis] for decision in result.decisions]
        lower.step(minutes, shift, where="mid", color=colour, linewidth=1.0, marker=".", label=f"along {name}")
    lower.set(xlabel="time since the start of frame 0 (min)", ylabel="position set (µm)")
    lower.legend(frameon=False, ncols=2, loc="best")
    for at in spread(range(len(result.decisions)), _MOST_NUMBERS):
        decision = result.decisions[at]
        place = (_middle_min(decision, zero_ns), 1.0)
        panels[0].annotate(
            str(decision.pair), place, xycoords=("data", "axes fraction"), ha="center", va="bottom", fontsize=6.5, color=SOFT
        )
    what = "Upper panel: load as sampled by the load frame. Lower panel: position" if loaded else "The log holds no load. Position"
    caption = (
        f"{what} of the stage or of the beam shift as commanded, relative to the start of the run. Shaded: the scans of "
        f"accepted frames, two "
        "for each pair; the numbers at the top are those of the pairs."
    )
    return FigureBlock("protocol", "Protocol of the run", caption, figure)


def _middle_min(decision: PairDecision, zero_ns: int) -> float:
    return (0.5 * (decision.first.start_time_ns.value + decision.second.end_time_ns) - zero_ns) / 60e9


def _pair_row(decision: PairDecision, zero_ns: int) -> tuple[str, ...]:
    step = decision.step
    mean = "" if decision.loads is None else fixed(0.5 * sum(load.mean_n for load in decision.loads), 1)
    return (
        str(decision.pair),
        step.phase.value,
        *(f"{shift:.4g}" for shift in step.shift_um),
        "" if step.load_n is None else f"{step.load_n:g}",
        mean,
        f"{(decision.first.start_time_ns.value - zero_ns) / 60e9:.2f}",
        decision.first.name,
        decision.second.name,
    )
