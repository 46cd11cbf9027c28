"""From measurements to the result of a qualification."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from semlive.data.diagnosis.effects import IdentifiedEffect
from semlive.data.grid import Grid
from semlive.qualify.evidence import UNKNOWN_TIMES, Evidence
from semlive.qualify.figures.distortion import DistortionDraws, distortion_results
from semlive.qualify.figures.drift import DriftRates, decay_results, drift_rates, rate_results
from semlive.qualify.figures.intervals import mean_interval
from semlive.qualify.figures.noise import WINDOWS, Scatter, displacement_scatter, rotation_sigma_rad, strain_scatter, white_noise
from semlive.qualify.figures.row_start import RowStart
from semlive.qualify.figures.scan import STATED_TIMES, effect_figures, interval_results, peak_figure, row_results, slowest_row_time
from semlive.qualify.figures.stage import stage_results
from semlive.qualify.figures.waves import RowMotion, certain_effects, row_motion_px
from semlive.qualify.limits import REFERENCE_SHIFT_PX, Sources, largest_corrected, limits_of
from semlive.qualify.protocol import GAUGE_PX, recommend_protocol
from semlive.qualify.values import (
    FORMAT_VERSION,
    Conditions,
    Figure,
    GaugeResolution,
    Qualification,
    Result,
    Trend,
    Undetermined,
)

AS_STATED = (1.0, 0.0)
"""True over stated row time, and its standard uncertainty, where nothing shows that they differ."""
PATTERN = "pattern of the first frame"


def assess(
    evidence: Evidence, source: str, not_paired: Sequence[str] = (), commands: Sequence[tuple[float, float] | None] = ()
) -> Qualification:
    """Derive figures, resolution, limits and protocol.

    Args:
        evidence: measurements.
        source: name of the folder or log.
        not_paired: frames without a pair, each with the reason.
        commands: commanded shift of each pair, px; None where it is not given; empty if none is.
    """
    conditions = _conditions(evidence, source, not_paired)
    frames, within = [(pair.decision.first, pair.decision.second) for pair in evidence.pairs], [pair.within for pair in evidence.pairs]
    timed, stretch = conditions.timed, _stretch(evidence)
    rows = row_results(evidence.rows, evidence.no_rows, evidence.row_pairs, evidence.slow_wave)
    motion = RowMotion.of(rows, conditions.height_px)
    rates = drift_rates(frames, within, motion.mean_sigma_px)
    intervals = interval_results(frames)
    slowest = slowest_row_time(intervals) if stretch == AS_STATED else 1.0
    bends, draws = distortion_results(
        evidence.solution, evidence.estimate.distortion, evidence.estimate.calibration, GAUGE_PX, motion.mean_sigma_px
    )
    settling = None if draws is None else draws.settling
    results: list[Result] = [
        *_pattern(evidence),
        *_noise(evidence),
        *rate_results(rates, conditions.row_s, conditions.pixel_nm, timed=timed, stretch=stretch, slowest=slowest),
        *(decay_results(replace(rates, frame_s=stretch[0] * rates.frame_s), slowest, stretch[1] / stretch[0]) if timed else ()),
        *intervals,
        *rows,
        *bends,
        *_settling(settling, draws is not None),
        *stage_results(
            list(commands) or [None] * len(evidence.pairs),
            evidence.estimate.motions,
            motion,
            rates.spacing,
            rotation_sigma_rad([pair.scattered for pair in evidence.pairs]),
            evidence.estimate.raster,
        ),
        *_effects(evidence),
    ]
    figures = tuple(result for result in results if isinstance(result, Figure))
    undetermined = tuple(result for result in results if isinstance(result, Undetermined))
    by_name = {figure.name: figure for figure in figures}
    # The error of the drift by motion of the rows is a strain of that motion, not of the drift.
    sources = _sources(evidence, drift_rates(frames, within), draws, settling, by_name)
    resolution = tuple(_resolution(evidence, conditions, sources))
    limits = limits_of(sources)
    return Qualification(
        FORMAT_VERSION, conditions, figures, undetermined, resolution, limits, limits[0].name if limits else "", largest_corrected(limits),
        recommend_protocol(conditions, by_name, evidence.choice),
    )  # fmt: skip


def _conditions(evidence: Evidence, source: str, not_paired: Sequence[str]) -> Conditions:
    first = evidence.pairs[0].decision.first
    timing, pairs = first.timing, len(evidence.pairs)
    return Conditions(
        source, first.start_time_ns.value, 2 * pairs + len(not_paired), pairs, first.width_px, first.height_px, timing.dwell_time_s.value,
        timing.row_time_s.value, timing.duration_s, 1e9 * first.pixel_size_m.value, first.vendor,
        first.start_time_ns.source not in UNKNOWN_TIMES, tuple(not_paired), first.start_time_ns.source in STATED_TIMES,
    )  # fmt: skip


def _pattern(evidence: Evidence) -> Iterator[Figure]:
    quality = evidence.quality
    along_x = quality.speckle_x_px <= quality.speckle_y_px
    yield Figure("image_noise", "noise of a pixel", *evidence.pixel_noise, "grey levels", Trend.LARGER, PATTERN)
    for name, title, value_of, unit, worse in (
        ("contrast", "contrast of the pattern", lambda part: part.contrast_grey, "grey levels", Trend.SMALLER),
        ("saturated", "saturated pixels", lambda part: 100.0 * part.saturated_fraction, "%", Trend.LARGER),
        ("speckle", "speckle size", lambda part: part.speckle_x_px if along_x else part.speckle_y_px, "px", Trend.NONE),
    ):
        value = value_of(quality)
        interval = mean_interval(value, np.array([value_of(part) for part in evidence.parts]))
        yield Figure(name, title, *interval, unit, worse, PATTERN)


def _noise(evidence: Evidence) -> Iterator[Result]:
    found = False
    own = evidence.settings.dic.subset_px
    by_size = {own: [pair.scattered for pair in evidence.pairs]}
    for pair in evidence.pairs:
        for disparity in pair.by_subset:
            if disparity.grid.subset_px != own:
                by_size.setdefault(disparity.grid.subset_px, []).append(disparity)
    for size in sorted(by_size):
        scatter = displacement_scatter(by_size[size])
        if scatter is not None:
            found = True
            note = "of a displacement between the two frames of a pair, the noisier axis"
            yield Figure(f"noise_{size}", f"noise with a subset of {size} px", *scatter.worst(), "px", note=note)
    if not found:
        yield Undetermined(
            "noise", "the frames are too small for a scatter of subsets", "take frames of at least 256 x 256 px", by_pairs=False
        )


def _stretch(evidence: Evidence) -> tuple[float, float]:
    """True over stated row time with its standard uncertainty, if the maps show that they differ."""
    errors = (
        parameter
        for effect in certain_effects(evidence.effects, _row_effects(evidence))
        if effect.name == "wrong_row_time"
        for parameter in effect.parameters
    )
    return next(((1.0 + error.value, error.sigma) for error in errors if error.name == "row_time_error" and error.value > -1.0), AS_STATED)


def _row_effects(evidence: Evidence) -> tuple[IdentifiedEffect, ...]:
    slow = () if evidence.slow_wave is None else (evidence.slow_wave.effect,)
    return slow if evidence.rows is None else (*slow, *evidence.rows.effects)


def _settling(settling: RowStart | None, calibrated: bool) -> list[Result]:
    if not calibrated:
        reason = "the distortion is not determined, and settling is part of it"
        return [Undetermined("row_start_settling", reason, "take pairs at shifted positions")]
    if settling is None:
        return [Undetermined("row_start_settling", "no settling at the row start is significant", "none is needed", by_pairs=False)]
    remedy = "repeat with another dwell time and another magnification, then run `semlive experiment row-start`"
    reason = f"settling at the row start is significant, about {settling.length_px:.0f} px long, but one dwell does not determine its law"
    return [Undetermined("row_start_law", reason, remedy)]


def _effects(evidence: Evidence) -> Iterator[Result]:
    if evidence.no_effects:
        yield Undetermined("further_effects", evidence.no_effects, "take at least five pairs, some of them shifted")
    certain = certain_effects(evidence.effects, _row_effects(evidence))
    covered = [effect.name.replace("_", " ") for effect in evidence.effects if effect not in certain]
    if covered:
        reason = f"the maps show {', '.join(covered)}, which motion of the rows by {row_motion_px(_row_effects(evidence)):.2g} px may cause"
        yield Undetermined("further_effects", reason, "remove waves and jitter of the rows, and take the pairs again", by_pairs=False)
    for effect in certain:
        if effect.name != "stage_yaw":  # a figure of the stage, from the same rotations
            yield from effect_figures(effect)
            yield peak_figure(effect)


def _sources(
    evidence: Evidence, rates: DriftRates, draws: DistortionDraws | None, settling: RowStart | None, figures: dict[str, Figure]
) -> Sources:
    maps = [pair.scattered for pair in evidence.pairs]
    scatter, own = _nearest(evidence), displacement_scatter(maps)
    # The uncertainties of a map also contain what the image noise does not explain; the prediction from one frame does not.
    white = max(evidence.quality.median_sigma_px) or max(white_noise(maps))
    measured = own.worst()[0] if own is not None else white
    first = evidence.pairs[0].decision.first
    row_s = first.timing.row_time_s.value
    stage = figures.get("stage_residual")
    return Sources(
        noise=0.0 if scatter is None else scatter.worst()[0],
        image_share=white / measured if measured > 0.0 else 1.0,
        drift_strain=figures["drift_strain"].value if "drift_strain" in figures else 0.0,
        drift_strain_sigma=row_s * float(np.linalg.norm(rates.sigma_px_s[-1])),
        false_strain_per_px=0.0 if draws is None else draws.strain_per_px[0],
        false_strain_sigma_per_px=0.0 if draws is None else draws.sigma_per_px,
        row_start_per_px=0.0 if settling is None else settling.strain_per_px(GAUGE_PX),
        stage_residual_px=0.0 if stage is None else stage.value,
        half_frame_px=0.5 * min(first.width_px, first.height_px),
        row_effects=_row_effects(evidence) if evidence.slow_wave is None else (evidence.slow_wave.effect,),
        map_effects=certain_effects(evidence.effects, _row_effects(evidence)),
    )


def _nearest(evidence: Evidence) -> Scatter | None:
    """Scatter of the strain of the gauge nearest to the reference gauge."""
    found = [scatter for scatter in _gauges(evidence) if scatter is not None]
    return min(found, key=lambda scatter: abs(scatter.size_px - GAUGE_PX)) if found else None


def _gauges(evidence: Evidence) -> list[Scatter | None]:
    maps = [pair.scattered for pair in evidence.pairs]
    return [strain_scatter(maps, window) for window in _windows(maps[0].grid)]


def _windows(grid: Grid) -> tuple[int, ...]:
    """Gauges in points; one of them has the length of the reference gauge if the subset allows."""
    reference = max(2 * round((GAUGE_PX - grid.subset_px) / (2 * grid.step_px)), 2) + 1
    return tuple(sorted({*WINDOWS, reference}))


def _resolution(evidence: Evidence, conditions: Conditions, sources: Sources) -> Iterator[GaugeResolution]:
    shifted = REFERENCE_SHIFT_PX * sources.false_strain_per_px
    corrected = REFERENCE_SHIFT_PX * sources.false_strain_sigma_per_px
    systematic = float(np.hypot(shifted, sources.drift_strain))
    remaining = float(np.hypot(corrected, sources.drift_strain_sigma))
    for scatter in _gauges(evidence):
        if scatter is not None:
            length_um = 1e-3 * conditions.pixel_nm * scatter.size_px
            yield GaugeResolution(scatter.size_px, length_um, *scatter.worst(), systematic, remaining)
