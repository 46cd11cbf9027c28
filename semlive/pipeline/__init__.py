"""The path of a pair from images to strain: correlate, accumulate, solve, correct, fit the elastic constants.

    Frame, Frame --> Pair --> DisparityMap --> Estimate --> Displacement --> StrainField --> ElasticConstants

A state goes in, a new state and a result come out. A reported result is never edited; a later pair gives a revision.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace

from semlive.data.disparity import DisparityMap
from semlive.data.experiment import Phase
from semlive.data.pair import Pair, PairDecision
from semlive.data.results import PairResult
from semlive.data.settings import AnalysisSettings
from semlive.estimate.joint.elimination.smoother import LIVE_WINDOW_PAIRS
from semlive.estimate.joint.solution.solver import selection_due
from semlive.pipeline.accumulation import accumulate, apply_effect_model, solve, solve_incremental, solve_live, start, start_from_maps
from semlive.pipeline.conclusion import calibration_refusal, estimate_revision, finalise, residual_notes, term_rival
from semlive.pipeline.correction import correct_changed, correct_frame, correct_frames
from semlive.pipeline.correlation import complete_maps, correlate, correlation_notes, frame_mask, maps_from_reference, precorrelate
from semlive.pipeline.elastic import refit_elastic
from semlive.pipeline.state import NO_PRECORRELATION, AnalysisState, PrecorrelatedFrame, frames_of

__all__ = ["NO_PRECORRELATION", "AnalysisState", "PairResult", "PrecorrelatedFrame"]
__all__ += ["accumulate", "add_pair", "analyse", "apply_effect_model", "calibration_refusal", "complete_maps", "correct_frame", "correlate"]
__all__ += [
    "finalise",
    "follow",
    "frame_mask",
    "maps_from_reference",
    "precorrelate",
    "residual_notes",
    "review_hyperparameters",
    "solve",
]
__all__ += ["start", "start_from_maps", "term_rival"]

MAX_REVISIONS_PER_PAIR = 2  # earlier frames that are corrected again with a pair
MAX_REVISIONS_PER_REVIEW = 64  # earlier frames that are corrected again with a selection of hyperparameters
MAX_LOAD_STEPS_LIVE = 32  # with more, the constants are fitted in reviews only: their covariance joins all load steps

Maps = tuple[DisparityMap, ...]


def analyse(
    settings: AnalysisSettings, state: AnalysisState | None, pair: Pair, precorrelated: Mapping[int, PrecorrelatedFrame] = NO_PRECORRELATION
) -> tuple[AnalysisState, PairResult]:
    """Correlate one pair, update the estimate, correct the pair's frames.

    Args:
        settings: of the analysis.
        state: after the previous pair; None before the first, whose first frame is frame 0, the reference of the run.
        pair: the next pair.
        precorrelated: results of `precorrelate` for its frames, by number of export; they only save time.

    Raises:
        BadInput: the pair does not fit the earlier ones, or no point of interest fits the frame.
    """
    state = state or start(settings, pair.first)
    maps = tuple(state.storage.store_map(disparity) for disparity in correlate(state, pair, precorrelated))
    return add_pair(state, pair.decision, maps)


def add_pair(state: AnalysisState, decision: PairDecision, maps: Maps) -> tuple[AnalysisState, PairResult]:
    """All steps after correlation, with the hyperparameters selected before: the cost does not grow with the pairs."""
    state = solve_live(apply_effect_model(accumulate(state, decision, maps)))
    state, frames = correct_frames(state, frames_of(decision))
    state, revised = correct_changed(state, state.pairs[-LIVE_WINDOW_PAIRS:], MAX_REVISIONS_PER_PAIR)
    if len(state.loaded_pairs) <= MAX_LOAD_STEPS_LIVE and (revised or decision.step.phase is Phase.TENSION):
        state = refit_elastic(state)
    newest = estimate_revision(state, state.solution, checked=False, newest_only=True)
    newest = replace(newest, notes=(*newest.notes, *correlation_notes(maps, state.settings.dic)))
    return state, PairResult(decision, len(state.pairs), maps, newest, frames, *state.elastic, revised)


def review_hyperparameters(state: AnalysisState) -> tuple[AnalysisState, PairResult | None]:
    """Select hyperparameters and terms again, run the checks, and correct all frames that this changes.

    It runs after the pair's own result is reported. The result has no maps; it is None where no selection is due.
    """
    if not selection_due(len(state.pairs)):
        return state, None
    state, revised = correct_changed(solve_incremental(state), state.pairs, MAX_REVISIONS_PER_REVIEW)
    state = refit_elastic(state)
    newest = estimate_revision(state, state.solution, checked=True)
    return state, PairResult(state.pairs[-1], len(state.pairs), (), newest, (), *state.elastic, revised)


def follow(
    settings: AnalysisSettings,
    pairs: Iterable[tuple[PairDecision, Maps]],
    step: Callable[[AnalysisState, PairDecision, Maps], AnalysisState] = accumulate,
) -> Iterator[AnalysisState]:
    """The state after each of a run's pairs, whose disparity maps are already made.

    Args:
        settings: of the analysis.
        pairs: decisions with their maps, in order.
        step: adds a pair to the state.
    """
    state: AnalysisState | None = None
    for decision, maps in pairs:
        state = step(state or start_from_maps(settings, decision.first, maps[0].grid), decision, maps)
        yield state
