"""From disparity maps to the state of the estimator and to a solution; the effect model is subtracted before."""

from __future__ import annotations

from dataclasses import replace

from semlive import dic
from semlive.data.disparity import DisparityMap
from semlive.data.drift import FrameTime
from semlive.data.experiment import Phase
from semlive.data.frame import Frame, FrameInfo
from semlive.data.grid import Grid
from semlive.data.pair import PairDecision
from semlive.data.settings import AnalysisSettings
from semlive.estimate.method import METHODS, MethodSolution
from semlive.pipeline import effect_correction
from semlive.pipeline.correlation import complete_maps, maps_from_reference
from semlive.pipeline.effect_correction import MeasuredPair, fit_effect_correction, unavailable_for_long_run
from semlive.pipeline.state import AnalysisState


def start(settings: AnalysisSettings, first: Frame) -> AnalysisState:
    """A run with its reference frame and no pairs."""
    grid = dic.grid_for(settings.dic, first.info.width_px, first.info.height_px)
    height, width = first.image.shape
    reference = dic.prepare(first.image, grid, settings.dic, dic.mask_of(settings.dic, (height, width)))
    return replace(start_from_maps(settings, first.info, grid), reference=reference)


def start_from_maps(settings: AnalysisSettings, first: FrameInfo, grid: Grid) -> AnalysisState:
    """A run without pairs whose disparity maps come from a log or from another DIC engine."""
    estimator = METHODS[settings.estimate.method].init(settings.estimate, grid, first.width_px, first.height_px)
    return AnalysisState(settings, grid, None, estimator, (), ())


def accumulate(state: AnalysisState, decision: PairDecision, maps: tuple[DisparityMap, ...]) -> AnalysisState:
    """Add a pair's maps, from images or from a log, without a solution."""
    if state.pairs:
        decision = _with_shared_values(decision, state.pairs[-1])
    pairs = state.storage.append(state.pairs, (decision,))
    loaded = (*state.loaded_pairs, len(state.pairs)) if decision.step.phase is Phase.TENSION else state.loaded_pairs
    estimator = state.method.update(state.estimator_state, decision.pair, decision.step.phase, frame_times(pairs[0], decision), maps)
    found = maps_from_reference(decision.pair, maps)
    new = (disparity if disparity in maps else state.storage.store_map(disparity) for disparity in found)
    from_frame_0 = state.storage.append(state.maps_from_reference, new)
    with_model = state.settings.model.effects and len(state.pairs) <= effect_correction.MAX_PAIRS
    raw_maps = (*state.raw_maps, maps) if with_model else ()
    return replace(state, estimator_state=estimator, pairs=pairs, loaded_pairs=loaded, maps_from_reference=from_frame_0, raw_maps=raw_maps)


def apply_effect_model(state: AnalysisState) -> AnalysisState:
    """Fit the effect model to all pairs and subtract it from all maps; the same state without a model.

    Call it before `solve`, `correct_frame` and `finalise` where pairs were only accumulated.
    """
    settings, pairs = state.settings, state.pairs
    if not settings.model.effects or state.model_correction.pairs == len(pairs):
        return state
    if len(pairs) > effect_correction.MAX_PAIRS and not state.model_correction.displacement_by_frame:
        return replace(state, model_correction=unavailable_for_long_run(len(pairs)))
    measured = [
        MeasuredPair(decision, frame_times(pairs[0], decision), complete_maps(decision.pair, maps))
        for decision, maps in zip(pairs, state.raw_maps, strict=True)
    ]
    correction = fit_effect_correction(settings.model, settings.estimate, settings.specimen.loading_axis, measured)
    if not correction.displacement_by_frame and not state.model_correction.displacement_by_frame:
        return replace(state, model_correction=correction)
    corrected = start_from_maps(settings, pairs[0].first, state.grid)
    for decision, maps in zip(pairs, state.raw_maps, strict=True):
        corrected = accumulate(corrected, decision, tuple(correction.apply(disparity) for disparity in maps))
    return replace(
        state,
        estimator_state=corrected.estimator_state,
        maps_from_reference=corrected.maps_from_reference,
        solution=None,
        model_correction=correction,
    )


def solve(state: AnalysisState) -> MethodSolution:
    """The solution of all pairs together, with all hyperparameters and terms selected again."""
    return state.method.solve(state.estimator_state)


def solve_live(state: AnalysisState) -> AnalysisState:
    """Solve with the hyperparameters selected before, so the cost of a pair does not grow with their number."""
    return _with_solution(state, state.method.solve_live(state.estimator_state, state.solution))


def solve_incremental(state: AnalysisState) -> AnalysisState:
    """Solve with hyperparameters and terms selected again where that is due."""
    return _with_solution(state, state.method.solve_incremental(state.estimator_state, state.solution))


def _with_solution(state: AnalysisState, solution: MethodSolution) -> AnalysisState:
    return replace(state, solution=solution, revision=state.revision + 1)


def frame_times(reference: PairDecision, decision: PairDecision) -> tuple[FrameTime, FrameTime]:
    """Scan times of a pair's frames, in seconds after the start of frame 0."""
    zero_ns = reference.first.start_time_ns.value
    infos = (decision.first, decision.second)
    first, second = (
        FrameTime(2 * decision.pair + member, (info.start_time_ns.value - zero_ns) / 1e9, info.timing, info.start_sigma_s)
        for member, info in enumerate(infos)
    )
    return first, second


def _with_shared_values(decision: PairDecision, previous: PairDecision) -> PairDecision:
    """The same decision; values equal to those of the previous pair are shared with it, which halves its memory."""

    def shared(info: FrameInfo, other: FrameInfo) -> FrameInfo:
        values = {
            name: getattr(other, name) for name in ("timing", "pixel_size_m", "column") if getattr(info, name) == getattr(other, name)
        }
        return replace(info, **values)

    first = shared(decision.first, previous.first)
    return replace(decision, first=first, second=shared(decision.second, first))
