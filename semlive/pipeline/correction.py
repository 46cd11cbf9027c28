"""From a solution to corrected frames: those of the newest pair, earlier ones that changed, and all of a run."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np

from semlive import mechanics
from semlive.data.disparity import DisparityMap
from semlive.data.pair import PairDecision
from semlive.data.results import FrameResult
from semlive.data.strain import StrainSummary, Tensor2
from semlive.estimate.method import MethodCorrectionStrain, MethodSolution
from semlive.mechanics.displacement import zero_displacement
from semlive.pipeline.state import AnalysisState, ReportedFrame, frames_of

MIN_STRAIN_SIGMA = 1e-12  # a smaller uncertainty of a mean strain is rounding
COMPONENTS = ("exx", "eyy", "exy")


def correct_frame(state: AnalysisState, solution: MethodSolution, frame: int) -> FrameResult:
    """One frame, corrected with a solution.

    Args:
        state: of the run.
        solution: result of `solve`.
        frame: number of the frame, of one of the run's pairs.
    """
    return _corrected(state, solution, frame)[0]


def correct_frames(state: AnalysisState, frames: Iterable[int]) -> tuple[AnalysisState, tuple[FrameResult, ...]]:
    """Correct frames with the newest solution, and store their results as reported."""
    assert state.solution is not None  # each caller solves first
    results, reported = [], {}
    for frame in frames:
        result, correction = _corrected(state, state.solution, frame)
        results.append(result)
        reported[frame] = ReportedFrame(result.summary, correction, state.model_correction.strain_of(frame))
    return replace(state, reported=state.storage.update(state.reported, reported)), tuple(results)


def correct_changed(state: AnalysisState, pairs: Iterable[PairDecision], limit: int) -> tuple[AnalysisState, tuple[FrameResult, ...]]:
    """Correct again the frames whose mean strain the newest solution changes by more than its uncertainty.

    Args:
        state: of the run.
        pairs: to test.
        limit: greatest number of frames; those with the largest change are taken.
    """
    return correct_frames(state, _changed_frames(state, pairs)[:limit])


def current_summaries(state: AnalysisState, pairs: Iterable[PairDecision]) -> dict[int, StrainSummary]:
    """Summaries of pairs' frames by number, with the means that a correction with the newest solution gives.

    An error of the distortion that all load steps share does not change a slope. Steps that are corrected with
    different distortions would.
    """
    found: dict[int, StrainSummary] = {}
    for frame in itertools.chain.from_iterable(map(frames_of, pairs)):
        reported = state.reported[frame]
        summary = reported.summary
        if reported.correction_strain is not None:
            change = _strain_change(state, frame)
            mean = Tensor2(*(getattr(summary.mean, name) + getattr(change, name) for name in COMPONENTS))
            summary = replace(summary, mean=mean)
        found[frame] = summary
    return found


def correct_all(
    state: AnalysisState, solution: MethodSolution, evaluated: Callable[[int], None] | None, point_sigma: bool
) -> Iterator[FrameResult]:
    """Every frame in turn; the method evaluates the uncertainties of all frames together.

    Args:
        state: of the run.
        solution: result of `solve`.
        evaluated: called with each frame's number after the first pass over its map.
        point_sigma: also compute the standard uncertainty of the correction at every point.
    """
    frames = list(itertools.chain.from_iterable(map(frames_of, state.pairs)))

    def maps() -> Iterator[DisparityMap]:
        for frame in filter(None, frames):
            yield _map_to(state, frame)
            if evaluated is not None:
                evaluated(frame)

    corrections = iter(state.method.correction_strains(solution, maps()))
    again = (_map_to(state, frame) for frame in frames if frame)
    sigmas = iter(state.method.correction_sigmas(solution, again)) if point_sigma else itertools.repeat(None)
    for frame in frames:
        found = _apply_correction(state, solution, frame, next(corrections) if frame else None)
        sigma = next(sigmas) if frame else (np.zeros(state.grid.shape),) * 2 if point_sigma else None
        if sigma is not None:
            found = replace(found, displacement=replace(found.displacement, systematic_u_px=sigma[0], systematic_v_px=sigma[1]))
        yield found


def _changed_frames(state: AnalysisState, pairs: Iterable[PairDecision]) -> tuple[int, ...]:
    """Frames of pairs whose mean strain changes by more than its uncertainty in a component, largest change first."""
    found: list[tuple[float, int]] = []
    for frame in itertools.chain.from_iterable(map(frames_of, pairs)):
        reported = state.reported.get(frame)
        if reported and reported.correction_strain is not None:
            change, sigma = _strain_change(state, frame), reported.summary.mean_sigma
            ratio = max(abs(getattr(change, name)) / max(getattr(sigma, name), MIN_STRAIN_SIGMA) for name in COMPONENTS)
            found.append((ratio, frame))
    by_size = sorted((-ratio, frame) for ratio, frame in found if ratio > 1.0)
    return tuple(frame for _, frame in by_size)


def _strain_change(state: AnalysisState, frame: int) -> Tensor2:
    """Change of a frame's mean strain if it is corrected with the newest solution and effect model."""
    reported, now = state.reported[frame], state.model_correction.strain_of(frame)
    change = state.method.strain_change(state.solution, reported.correction_strain)
    return Tensor2(*(getattr(change, name) - getattr(now, name) + getattr(reported.model_strain, name) for name in COMPONENTS))


def _corrected(state: AnalysisState, solution: MethodSolution, frame: int) -> tuple[FrameResult, MethodCorrectionStrain | None]:
    """A frame, and the share of its correction in its mean strain; None for frame 0."""
    correction = state.method.correction_strains(solution, (_map_to(state, frame),))[0] if frame else None
    return _apply_correction(state, solution, frame, correction), correction


def _map_to(state: AnalysisState, frame: int) -> DisparityMap:
    usual = state.maps_from_reference[frame - 1 : frame]  # where no pair is missing
    return next(disparity for disparity in itertools.chain(usual, state.maps_from_reference) if disparity.current == frame)


def _apply_correction(state: AnalysisState, solution: MethodSolution, frame: int, correction: MethodCorrectionStrain | None) -> FrameResult:
    points, settings = state.settings.estimate.window_points, state.settings.estimate.strain
    if correction is None:
        zero = zero_displacement(state.grid)
        strain = mechanics.strain_field(zero, points, settings)
        return FrameResult(zero, strain, mechanics.summary(zero, strain))
    disparity = _map_to(state, frame)
    displacement = mechanics.displacement(disparity, state.method.correction(solution, disparity))
    strain = mechanics.strain_field(displacement, points, settings)
    return FrameResult(displacement, strain, mechanics.summary(displacement, strain, solution.noise_floor_px, correction.sigma, settings))
