"""From a solution to the estimate with its notes, and to the result of the complete run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, replace

import numpy as np

from semlive import mechanics
from semlive.data.drift import EstimateRevision
from semlive.data.experiment import Phase
from semlive.data.frame import FrameOrigin
from semlive.data.notes import Note, NoteCode, warning
from semlive.data.results import FrameResult, RunResult
from semlive.data.settings import AnalysisSettings
from semlive.data.strain import StrainSummary
from semlive.diagnose.fit_tests.adequacy import adequacy_after
from semlive.diagnose.maps.term_rivals import TermRival, rival_after, rival_notes
from semlive.estimate import Solution
from semlive.estimate.joint.outputs.stage_path import stage_path_notes
from semlive.estimate.method import MethodSolution
from semlive.model.effects.rows import wave_frequencies_hz
from semlive.pipeline.accumulation import solve
from semlive.pipeline.correction import correct_all
from semlive.pipeline.elastic import fit_elastic_with_reason
from semlive.pipeline.state import AnalysisState

MIN_TRANSLATION_PX = 5.0  # a specimen that is not translated moves less


def estimate_revision(
    state: AnalysisState, solution: MethodSolution | None, *, checked: bool, newest_only: bool = False
) -> EstimateRevision:
    """The estimate of a solution, with the notes of the stage path and of the effect model.

    Args:
        state: of the run.
        solution: of the run.
        checked: also run the consistency tests.
        newest_only: leave out earlier pairs if the method can.
    """
    estimate = state.method.to_estimate(solution, revision=max(state.revision, len(state.pairs)), newest_only=newest_only)
    checks = state.method.consistency_notes(solution) if checked else ()
    pairs = state.pairs if len(estimate.motions) == len(state.pairs) else ()
    moves = ((pair.pair, pair.step.shift_um) for pair in pairs if pair.step.phase is not Phase.TENSION)
    path = stage_path_notes(moves, estimate.motions)
    return replace(estimate, notes=(*estimate.notes, *path, *checks, *state.model_correction.notes))


def residual_notes(state: AnalysisState, summaries: Sequence[StrainSummary] = ()) -> tuple[Note, ...]:
    """A note if the residuals of the newest solution of the joint method are not white; a warning if it exceeds the stated uncertainty.

    Args:
        state: of the run.
        summaries: mean strains of the frames; by default the newest reported ones.
    """
    modelled_hz = wave_frequencies_hz(state.settings.model.effects)
    test = adequacy_after(state.solution, state.pairs, modelled_hz) if isinstance(state.solution, Solution) else None
    if test is None:
        return ()
    reported = summaries or [frame.summary for frame in state.reported.values()]
    if not reported:
        return test.notes()
    means = np.array([astuple(summary.mean) for summary in reported])
    sigmas = np.array([astuple(summary.mean_sigma) for summary in reported])
    return test.notes(float(np.median(sigmas.max(axis=1))), float(np.ptp(means, axis=0).max()))


def term_rival(state: AnalysisState) -> TermRival | None:
    """The effect that explains the maps better than the raster terms of the newest solution of the joint method; None without one."""
    return rival_after(state.solution, state.pairs) if isinstance(state.solution, Solution) else None


def finalise(
    state: AnalysisState,
    each: Callable[[FrameResult], None] | None = None,
    solution: MethodSolution | None = None,
    evaluated: Callable[[int], None] | None = None,
    point_sigma: bool = False,
) -> RunResult:
    """The result of the complete run, every frame corrected with one solution.

    Args:
        state: of the run.
        each: called with every frame in turn, which the result then omits; None: the result holds all frames.
        solution: result of `solve`; None: solve now.
        evaluated: called with each frame's number after the first pass over its map, before any is corrected.
        point_sigma: also compute the uncertainty of the correction at every point, which takes 0.02 s a frame.
    """
    solution = solution or solve(state)
    frames: list[FrameResult] = []
    summaries: list[StrainSummary] = []
    for result in correct_all(state, solution, evaluated, point_sigma):
        summaries.append(result.summary)
        (each or frames.append)(result)
    newest = estimate_revision(state, solution, checked=True)
    (elastic, gage), reason = fit_elastic_with_reason(state, solution, {summary.frame: summary for summary in summaries})
    missing = (warning(NoteCode.ELASTIC_CONSTANTS, f"no elastic constants: {reason}"),) if reason else ()
    solved = replace(state, solution=solution)
    tests = (*residual_notes(solved, summaries), *rival_notes(term_rival(solved)))
    notes = (*newest.notes, *tests, *mechanics.gage_notes(gage), *missing)
    messages = tuple(note.message for note in notes)
    return RunResult(tuple(state.pairs), newest, tuple(frames), elastic, messages, gage, tuple(summaries))


def calibration_refusal(result: RunResult, settings: AnalysisSettings) -> str | None:
    """The reason to reject results under load: the translations do not determine the distortion. None otherwise.

    A run without translations has no distortion estimate and gets a warning only. In imported tables the commanded
    translations may be missing; the measured motion then shows whether the specimen was translated.
    """
    quality = result.estimate.calibration
    loaded = any(pair.step.phase is Phase.TENSION for pair in result.decisions)
    if not loaded or quality is None or not quality.refused or settings.estimate.accept_poor_calibration:
        return None
    unloaded = [pair for pair in result.decisions if pair.step.phase is not Phase.TENSION]
    translated = any(pair.step.shift_px != (0.0, 0.0) for pair in unloaded)
    if not translated and result.decisions[0].first.origin is FrameOrigin.IMPORTED:
        numbers = {pair.pair for pair in unloaded}
        shifts_px = [motion.shift_px for motion in result.estimate.motions if motion.pair in numbers]
        translated = len(shifts_px) > 1 and float(np.ptp(shifts_px, axis=0).max()) > MIN_TRANSLATION_PX
    return quality.refused if translated else None
