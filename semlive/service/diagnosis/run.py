"""Diagnosis of a log: joint estimate from its disparity maps, and verdict over all channels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from semlive import pipeline
from semlive.data.diagnosis.effects import EMPTY_MODEL, HeldOutMisfit, IdentifiedEffect, ModelEffect, ParameterEstimate
from semlive.data.diagnosis.verdict import Diagnosis, ExperimentForecast, ExperimentProposal
from semlive.diagnose.baseline.model_effects import observable_effects
from semlive.diagnose.baseline.observation import HOLD_S, Observation, StepConditions, baseline_solution, make_observation, step_conditions
from semlive.diagnose.combine import add_intensity_verdict, add_row_verdict
from semlive.diagnose.experiments.forecast import forecast_experiments
from semlive.diagnose.experiments.proposals import ranked
from semlive.diagnose.intensity.verdict import diagnose_intensity
from semlive.diagnose.maps.verdict import diagnose
from semlive.diagnose.rows.verdict import diagnose_rows
from semlive.diagnose.scalars.load_cell import add_clock_evidence, add_load_cell_evidence, load_readings
from semlive.diagnose.scalars.stage import add_stage_evidence, stage_moves
from semlive.diagnose.scalars.strain_gage import add_gage_evidence, gage_readings
from semlive.errors import BadLog, IllPosed
from semlive.estimate import EstimatorState
from semlive.formats.log.messages import RunMessage
from semlive.model.effects.intensity import intensity_effect
from semlive.model.effects.rows import row_effect
from semlive.model.effects.stage import non_map_effect
from semlive.service.diagnosis.images import ImageData, channels_of_log
from semlive.service.log.pairs import LogNotes, first_run, pairs_with_maps
from semlive.service.log.settings import settings_of
from semlive.service.runtime.blas import limit_blas_threads


def diagnose_log(
    log: Path, seed: int = 0, watch: Callable[[str, int, int], None] | None = None, model_effects: Sequence[ModelEffect] = ()
) -> Diagnosis:
    """Identify the effects missing in the model of a run, from the disparity maps and, if present, the images of its log.

    Args:
        log: a log file or a run folder.
        seed: seed of the null draws.
        watch: called with the name of the task, the finished part and the total.
        model_effects: effects already in the model.

    Raises:
        BadInput: the log cannot be read, or its data are too few to identify an effect.
    """
    notes = LogNotes()
    observation, steps = _observed(log, notes, watch)
    verdict = diagnose(
        observation,
        seed,
        model_effects=observable_effects(observation, [effect for effect in model_effects if non_map_effect(effect.name) is None]),
    )
    verdict = add_stage_evidence(replace(verdict, model_effects=tuple(model_effects)), stage_moves(observation, steps))
    if verdict.experiment is not None:
        verdict = replace(verdict, experiment=ranked(verdict.experiment, forecast_experiments(observation, verdict, model_effects)))
    assert notes.run is not None  # `_observed` has read it
    settings = settings_of(notes.run)
    readings = load_readings(observation, steps, settings.specimen.loading_axis)
    verdict = add_load_cell_evidence(verdict, readings)
    verdict = add_gage_evidence(verdict, gage_readings(readings, steps, settings.specimen.gage_factor_sigma))
    if notes.sem_clock is not None:
        verdict = add_clock_evidence(verdict, notes.sem_clock.offset_s - settings.scan.clock_offset_s, notes.sem_clock.sigma_s)
    images = channels_of_log(log, settings.scan, watch)
    return _with_intensity(_with_rows(verdict, images, seed), images)


def _with_rows(verdict: Diagnosis, images: ImageData, seed: int) -> Diagnosis:
    if not images.rows:
        return replace(verdict, rows_unavailable=images.no_rows)
    try:
        rows = diagnose_rows(images.rows, seed, [effect for effect in verdict.model_effects if row_effect(effect.name) is not None])
    except IllPosed as error:
        return replace(verdict, rows_unavailable=str(error))
    return add_row_verdict(verdict, rows)


def _with_intensity(verdict: Diagnosis, images: ImageData) -> Diagnosis:
    if images.grey is None:
        return replace(verdict, intensity_unavailable=images.no_grey)
    try:
        grey = diagnose_intensity(images.grey, [effect for effect in verdict.model_effects if intensity_effect(effect.name) is not None])
    except IllPosed as error:
        return replace(verdict, intensity_unavailable=str(error))
    return add_intensity_verdict(verdict, grey)


def propose_next_experiments(
    log: Path, verdict: Diagnosis, watch: Callable[[str, int, int], None] | None = None, model_effects: Sequence[ModelEffect] = ()
) -> tuple[ExperimentForecast, ...]:
    """Forecasts of further experiments for a verdict, in descending order of log odds per minute; for one effect, against none.

    Args:
        log: the diagnosed log.
        verdict: the verdict.
        watch: called with the name of the task, the finished part and the total.
        model_effects: effects of the model before the diagnosis.
    """
    if verdict.experiment is not None:
        return verdict.experiment.forecasts
    return forecast_experiments(load_observation(log, watch), verdict, model_effects) if verdict.effects else ()


def load_observation(log: Path, watch: Callable[[str, int, int], None] | None = None) -> Observation:
    """Observation of a run from its disparity maps, estimated jointly without further effects.

    Raises:
        BadInput: the log cannot be read, or its data are too few to identify an effect.
    """
    return _observed(log, LogNotes(), watch)[0]


def _observed(log: Path, notes: LogNotes, watch: Callable[[str, int, int], None] | None) -> tuple[Observation, tuple[StepConditions, ...]]:
    limit_blas_threads()
    notes.run = first_run(log)
    settings = settings_of(notes.run)
    settings = replace(settings, estimate=replace(settings.estimate, method="joint"), model=EMPTY_MODEL)
    state = None
    pairs = ((decision, pipeline.complete_maps(decision.pair, maps)) for decision, maps in pairs_with_maps(log, notes))
    for state in pipeline.follow(settings, pairs):
        if watch is not None:
            watch("pair", len(state.pairs), len(state.pairs))
    if state is None:
        raise BadLog(f"{log}: contains no disparity maps; replay it from its images first.")
    assert isinstance(state.estimator_state, EstimatorState)  # of the joint method
    steps = step_conditions(state.pairs, _hold_s(notes.run))
    solution, alternative = baseline_solution(state.estimator_state)
    return make_observation(solution, steps, alternative), steps


def _hold_s(run: RunMessage) -> float:
    """Configured hold time before the pairs of a run, s, or that of Sutton et al. (2007)."""
    protocol = run.config.get("protocol")
    hold = protocol.get("hold_s") if isinstance(protocol, dict) else None
    return float(hold) if isinstance(hold, int | float) else HOLD_S


def diagnosis_json(verdict: Diagnosis) -> dict[str, Any]:
    """JSON object of the verdict (`semlive diagnose LOG --json`); it is only extended."""
    return {
        "outcome": verdict.outcome.value,
        "effects": [effect_json(item) for item in verdict.effects],
        "ambiguous": list(verdict.ambiguous),
        "group": verdict.group,
        "experiment": None if verdict.experiment is None else _experiment_json(verdict.experiment),
        "gap": None if verdict.gap is None else gap_json(verdict.gap),
        "where": [asdict(item) for item in verdict.where],
        "noise_px": verdict.noise_px,
        "evidence": dict(verdict.evidence),
        "overlap": dict(verdict.overlap),
        "coarse": list(verdict.coarse),
        "rows": _rows_json(verdict),
        "grey": _grey_json(verdict),
    }


def _experiment_json(proposal: ExperimentProposal) -> dict[str, Any]:
    return {
        "between": list(proposal.between),
        "about": proposal.about,
        "foretold": [forecast_json(forecast) for forecast in proposal.forecasts],
    }


def forecast_json(forecast: ExperimentForecast) -> dict[str, Any]:
    """JSON object of a forecast."""
    return {**asdict(forecast), "log_odds_per_minute": forecast.log_odds_per_minute}


def _rows_json(verdict: Diagnosis) -> dict[str, Any]:
    rows = verdict.rows
    if rows is None:
        return {"looked_at": False, "why_not": verdict.rows_unavailable}
    return {
        "looked_at": True,
        "outcome": rows.outcome.value,
        "pairs": rows.pairs,
        "rows": rows.rows,
        "noise_px": rows.noise_px,
        "gap": None if rows.gap is None else gap_json(rows.gap),
    }


def _grey_json(verdict: Diagnosis) -> dict[str, Any]:
    grey = verdict.grey
    if grey is None:
        return {"looked_at": False, "why_not": verdict.intensity_unavailable}
    return {
        "looked_at": True,
        "outcome": grey.outcome.value,
        "frames": grey.frames,
        "blocks": grey.blocks,
        "noise": parameters_json(grey.noise),
        "mean_levels": grey.mean_levels,
        "contrast_levels": grey.contrast_levels,
        "clipped": grey.clipped,
        "left": grey.unexplained,
    }


def gap_json(gap: HeldOutMisfit) -> dict[str, Any]:
    """JSON object of a held-out misfit."""
    return {
        "before_px": gap.before_px,
        "after_px": gap.after_px,
        "floor_px": gap.floor_px,
        "closure": gap.closure,
        "closure_interval": list(gap.closure_interval),
    }


def effect_json(effect: IdentifiedEffect) -> dict[str, Any]:
    """JSON object of an effect."""
    return {
        "name": effect.name,
        "parameters": parameters_json(effect.parameters),
        "peak_px": effect.peak_px,
        "log_bayes_factor": effect.log_bayes_factor,
        "p_value": effect.p_value,
        "looks_like_strain": effect.strain,
        "strain_eaten": effect.strain_attenuation,
    }


def parameters_json(parameters: Sequence[ParameterEstimate]) -> dict[str, Any]:
    """JSON object of parameters by name."""
    return {parameter.name: {"value": parameter.value, "sigma": parameter.sigma, "unit": parameter.unit} for parameter in parameters}
