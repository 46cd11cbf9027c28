"""Measurements of frames: one pair after the other, then the joint estimate, and the verdict on the rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from semlive import dic, pipeline
from semlive.data.diagnosis.channels import RowDiagnosis
from semlive.data.diagnosis.effects import EMPTY_MODEL, IdentifiedEffect
from semlive.data.disparity import DisparityMap
from semlive.data.drift import EstimateRevision
from semlive.data.frame import Frame, PatternQuality
from semlive.data.pair import Pair, PairDecision
from semlive.data.scan import Provenance
from semlive.data.settings import AnalysisSettings, DicSettings
from semlive.diagnose.baseline.observation import baseline_solution, make_observation, step_conditions
from semlive.diagnose.maps.verdict import diagnose
from semlive.diagnose.rows.registration import register_pair_rows
from semlive.diagnose.rows.series import RowSeries
from semlive.diagnose.rows.verdict import diagnose_rows
from semlive.errors import BadInput, IllPosed
from semlive.estimate import EstimatorState, Solution
from semlive.pipeline import AnalysisState
from semlive.qualify.figures.intervals import Interval
from semlive.qualify.figures.noise import SUBSETS_PX, displacement_scatter, white_noise
from semlive.qualify.figures.pixel_noise import FRAME_PARTS, pixel_noise
from semlive.qualify.figures.row_response import Pattern
from semlive.qualify.figures.slow_waves import SlowWave, slow_wave
from semlive.qualify.figures.wave_amplitudes import with_response
from semlive.qualify.figures.waves import MIN_SHARE_ADJACENT, RowPairs, strongest_wave_px
from semlive.qualify.limits import MIN_EXCESS

MAX_NOISE_PAIRS = 12
"""Pairs correlated with each subset size: the scatter of 12 maps of 500 points is determined to 2 %."""
POINTS_PER_SUBSET = 3
"""Points along a subset in the maps of the noise; more have no new information about a scatter."""

UNKNOWN_TIMES = (Provenance.ASSUMED, Provenance.UNKNOWN)


@dataclass(frozen=True, slots=True, eq=False)
class PairMeasurement:
    """Measurements of one pair.

    Attributes:
        decision: the pair.
        within: map from its first to its second frame.
        scattered: the same by subsets, whose scatter is the noise: a field over the complete frame follows no motion of single rows, and
            had a twentieth of the scatter with vibration of 0.8 px. It is `within` if subsets find less than half of the points.
        by_subset: maps with other subset sizes.
        rows: row series; None if the rows cannot be registered.
    """

    decision: PairDecision
    within: DisparityMap
    scattered: DisparityMap
    by_subset: tuple[DisparityMap, ...]
    rows: RowSeries | None


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """All measurements.

    Attributes:
        settings: of the analysis.
        quality: pattern of the first frame.
        parts: pattern of equal parts of the first frame; empty if they are too small.
        pixel_noise: noise of a pixel of the first frame with its 95 % interval, grey levels.
        choice: recommended correlation for it.
        pairs: measurements of the pairs.
        solution: joint estimate of all pairs.
        estimate: drift, distortion and motions of the solution.
        rows: verdict on the rows; None without one.
        no_rows: reason for a missing verdict on the rows.
        row_pairs: rows of the pairs that could be registered row by row.
        slow_wave: wave near a multiple of the row rate that the rows do not show, if it explains the noise of the maps.
        effects: effects that the maps show beyond drift and distortion.
        no_effects: reason for a missing search of effects; empty if it was made.
    """

    settings: AnalysisSettings
    quality: PatternQuality
    parts: tuple[PatternQuality, ...]
    pixel_noise: Interval
    choice: dic.CorrelationChoice
    pairs: tuple[PairMeasurement, ...]
    solution: Solution
    estimate: EstimateRevision
    rows: RowDiagnosis | None
    no_rows: str
    row_pairs: RowPairs
    slow_wave: SlowWave | None
    effects: tuple[IdentifiedEffect, ...]
    no_effects: str


def first_settings(frame: Frame, settings: AnalysisSettings) -> tuple[AnalysisSettings, dic.CorrelationChoice]:
    """Settings with the recommended subset and step for a frame, by subsets, for the complete frame, and the recommendation.

    Raises:
        BadInput: no subset fits into the frame.
    """
    choice = dic.recommend(frame.image, replace(settings.dic, roi_px=None))
    correlation = replace(settings.dic, roi_px=None, subset_px=choice.subset_px, step_px=max(choice.step_px, 1), method=choice.method)
    return replace(settings, dic=correlation, model=EMPTY_MODEL, estimate=replace(settings.estimate, method="joint")), choice


def measure_pair(
    settings: AnalysisSettings, state: AnalysisState | None, pair: Pair, by_subset: bool
) -> tuple[AnalysisState, PairMeasurement]:
    """Correlate a pair and add it to the estimate.

    Args:
        settings: of the analysis.
        state: after the previous pair; None before the first.
        pair: the pair.
        by_subset: also correlate it with the other subset sizes.

    Raises:
        IllPosed: no point of the pair was found.
    """
    state = state or pipeline.start(settings, pair.first)
    maps = pipeline.correlate(state, pair)
    number = pair.decision.pair
    within = next(found for found in maps if (found.reference, found.current) == (2 * number, 2 * number + 1))
    sizes = SUBSETS_PX if by_subset else ()
    others = tuple(found for size in sizes if (found := _with_subset(settings.dic, pair, size)) is not None)
    rows = register_pair_rows(pair.first, pair.second, within)
    scattered = within if settings.dic.method == "subset" else _by_subsets(replace(settings.dic, method="subset"), pair) or within
    return pipeline.accumulate(state, pair.decision, maps), PairMeasurement(pair.decision, within, scattered, others, rows)


def _with_subset(settings: DicSettings, pair: Pair, subset_px: int) -> DisparityMap | None:
    """The map within a pair with another subset; None if too few subsets fit or are found."""
    return _by_subsets(replace(settings, subset_px=subset_px, step_px=max(subset_px // POINTS_PER_SUBSET, 1), method="subset"), pair)


def _by_subsets(settings: DicSettings, pair: Pair) -> DisparityMap | None:
    try:
        grid = dic.grid_for(settings, pair.first.info.width_px, pair.first.info.height_px)
    except BadInput:
        return None
    prepared = dic.prepare(pair.first.image, grid, settings)
    found = dic.correlate(prepared, pair.second.image, settings, reference_frame=0, current_frame=1)
    return found if 2 * int(found.valid.sum()) > found.valid.size else None


def conclude(
    first: Frame,
    choice: dic.CorrelationChoice,
    state: AnalysisState,
    pairs: Sequence[PairMeasurement],
    *,
    search_effects: bool = True,
    in_progress: bool = False,
) -> Evidence:
    """Solve for all pairs together, and search the rows and the maps for further effects.

    Args:
        first: first frame.
        choice: recommended correlation for it.
        state: after the last pair.
        pairs: measurements of all pairs.
        search_effects: search the maps for effects beyond drift and distortion.
        in_progress: further pairs follow; amplitudes of waves are not corrected for the response of the registration.

    Raises:
        IllPosed: the pairs do not determine an estimate.
    """
    solution = pipeline.solve(state)
    assert isinstance(solution, Solution)  # of the joint method
    estimate = state.method.to_estimate(solution, revision=len(pairs))
    rows, no_rows = _rows([pair.rows for pair in pairs if pair.rows is not None])
    effects, no_effects = _effects(state) if search_effects else ((), "the search was not requested")
    pattern = dic.quality(first.image, state.grid, state.settings.dic)
    parts = _parts(first, replace(state.settings.dic, step_px=state.settings.dic.subset_px))
    noise = pixel_noise(first.image)
    slow = None if rows is None else _slow_wave([pair for pair in pairs if pair.rows is not None], pattern, strongest_wave_px(rows.effects))
    row_pairs = _row_pairs(pairs)
    if rows is not None and not in_progress:
        correlation = replace(state.settings.dic, method=pairs[0].within.method)
        row_pairs = with_response(row_pairs, rows.effects, Pattern.of(first.image, noise[0]), first.info.timing, correlation)
    return Evidence(
        state.settings, pattern, parts, noise, choice, tuple(pairs), solution, estimate, rows, no_rows, row_pairs, slow, effects, no_effects
    )  # fmt: skip


def _parts(first: Frame, settings: DicSettings) -> tuple[PatternQuality, ...]:
    """Pattern of 4 x 4 parts of a frame; empty if a part is smaller than two subsets."""
    height, width = (size // FRAME_PARTS for size in first.image.shape)
    if min(height, width) < 2 * settings.subset_px:
        return ()
    corners = ((y * height, x * width) for y in range(FRAME_PARTS) for x in range(FRAME_PARTS))
    return tuple(dic.quality(first.image[y : y + height, x : x + width], settings=settings) for y, x in corners)


def _row_pairs(pairs: Sequence[PairMeasurement]) -> RowPairs:
    timed = pairs[0].decision.first.start_time_ns.source not in UNKNOWN_TIMES
    series, intervals, moved = list[RowSeries](), list[float](), list[tuple[float, float]]()
    for pair in pairs:
        if pair.rows is not None:
            first, second, valid = pair.decision.first, pair.decision.second, pair.within.valid
            series.append(pair.rows)
            intervals.append(1e-9 * (second.start_time_ns.value - first.start_time_ns.value) if timed else 0.0)
            moved.append((float(pair.within.u_px[valid].mean()), float(pair.within.v_px[valid].mean())))
    return RowPairs(series, np.array(intervals), np.array(moved))


def _rows(series: Sequence[RowSeries]) -> tuple[RowDiagnosis | None, str]:
    if not series:
        return None, "no pair could be registered row by row"
    try:
        return diagnose_rows(series), ""
    except IllPosed as error:
        return None, str(error)


def _slow_wave(pairs: Sequence[PairMeasurement], pattern: PatternQuality, rows_px: float) -> SlowWave | None:
    """The slow wave that explains the noise of the maps, unless the rows show a wave of more than twice its size."""
    own = [pair.scattered for pair in pairs]
    scatter, white_px = displacement_scatter(own), max(pattern.median_sigma_px) or max(white_noise(own))
    if scatter is None or scatter.worst()[0] < MIN_EXCESS * white_px:
        return None
    maps = _finest(pairs)
    # The noise of the image is inversely proportional to the subset: 0.0185 px with 21 px and 0.0062 px with 61 px.
    white_px *= own[0].grid.subset_px / maps[0].grid.subset_px
    found = slow_wave(maps, pairs[0].decision.first.timing, white_px)
    return found if found is not None and found.effect.peak_px > MIN_SHARE_ADJACENT * rows_px else None


def _finest(pairs: Sequence[PairMeasurement]) -> list[DisparityMap]:
    """Maps with the smallest subset that follows the waves in all pairs: the larger subsets average more waves."""
    own = [pair.scattered for pair in pairs]
    by_size = ([found for pair in pairs for found in pair.by_subset if found.grid.subset_px == size] for size in SUBSETS_PX)
    complete = [fine for fine in by_size if len(fine) == len(own) and fine[0].grid.subset_px < own[0].grid.subset_px]
    return complete[0] if complete else own


def _effects(state: AnalysisState) -> tuple[tuple[IdentifiedEffect, ...], str]:
    assert isinstance(state.estimator_state, EstimatorState)  # of the joint method
    try:
        solution, alternative = baseline_solution(state.estimator_state)
        return diagnose(make_observation(solution, step_conditions(state.pairs), alternative)).effects, ""
    except IllPosed as error:
        return (), str(error)
