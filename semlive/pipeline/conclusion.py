"""From a solution to the estimate with its notes, and to the result of the whole run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from semlive import mechanics
from semlive.data.drift import EstimateRevision
from semlive.data.experiment import Phase
from semlive.data.frame import FrameOrigin
from semlive.data.results import FrameResult, RunResult
from semlive.data.settings import AnalysisSettings
from semlive.data.strain import StrainSummary
from semlive.diagnose.residual_whiteness import whiteness_test
from semlive.estimate import Solution
from semlive.estimate.joint.outputs.stage_path import stage_path_messages
from semlive.estimate.method import MethodSolution
from semlive.pipeline.accumulation import solve
from semlive.pipeline.correction import correct_all
from semlive.pipeline.elastic import fit_elastic
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
    found = state.method.to_estimate(solution, revision=max(state.revision, len(state.pairs)), newest_only=newest_only)
    checks = state.method.consistency_messages(solution) if checked else ()
    whole = state.pairs if len(found.motions) == len(state.pairs) else ()
    moves = ((pair.pair, pair.step.shift_um) for pair in whole if pair.step.phase is not Phase.TENSION)
    path = stage_path_messages(moves, found.motions)
    return replace(found, notes=(*found.notes, *path, *checks, *state.model_correction.notes))


def residual_warning(state: AnalysisState) -> tuple[str, ...]:
    """A warning if the residuals of the newest solution of the joint method are not white."""
    found = whiteness_test(state.solution, state.pairs) if isinstance(state.solution, Solution) else None
    return () if found is None else found.messages()


def finalise(
    state: AnalysisState,
    each: Callable[[FrameResult], None] | None = None,
    solution: MethodSolution | None = None,
    evaluated: Callable[[int], None] | None = None,
    point_sigma: bool = False,
) -> RunResult:
    """The result of the whole run, every frame corrected with one solution.

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
    elastic, gage = fit_elastic(state, solution, {summary.frame: summary for summary in summaries})
    notes = (*newest.notes, *residual_warning(replace(state, solution=solution)), *mechanics.gage_notes(gage))
    return RunResult(tuple(state.pairs), newest, tuple(frames), elastic, notes, gage, tuple(summaries))


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
