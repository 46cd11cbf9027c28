"""Diagnosis of a log: its disparity maps, the joint estimate of them, and what is missing."""

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
from semlive.model.effects.intensity import intensity_effect
from semlive.model.effects.rows import row_effect
from semlive.model.effects.stage import non_map_effect
from semlive.service.diagnosis.images import ImageData, channels_of_log
from semlive.service.log.pairs import LogNotes, first_run, log_settings, pairs_with_maps
from semlive.service.runtime.blas import limit_blas_threads


def diagnose_log(
    log: Path, seed: int = 0, watch: Callable[[str, int, int], None] | None = None, model_effects: Sequence[ModelEffect] = ()
) -> Diagnosis:
    """What is missing from the model of a run, by the disparity maps in its log and, where it holds images, their rows and grey levels.

    Args:
        log: one file, or a run folder.
        seed: of the draws of the null.
        watch: told what is done, how much of it, of how much.
        known: effects that the model has already.

    Raises:
        BadInput: the log cannot be read, or its data are too few to name anything.
    """
    words = LogNotes()
    seen, steps = _observed(log, words, watch)
    found = diagnose(seen, seed, model_effects=observable_effects(seen, [one for one in model_effects if non_map_effect(one.name) is None]))
    found = add_stage_evidence(replace(found, model_effects=tuple(model_effects)), stage_moves(seen, steps))
    if found.experiment is not None:
        found = replace(found, experiment=ranked(found.experiment, forecast_experiments(seen, found, model_effects)))
    settings = log_settings(log)
    readings = load_readings(seen, steps, settings.specimen.loading_axis)
    found = add_load_cell_evidence(found, readings)
    found = add_gage_evidence(found, gage_readings(readings, steps, settings.specimen.gage_factor_sigma))
    if words.sem_clock is not None:
        found = add_clock_evidence(found, words.sem_clock.offset_s - settings.scan.clock_offset_s, words.sem_clock.sigma_s)
    seen_beside = channels_of_log(log, watch)
    return _beside_grey(_beside_rows(found, seen_beside, seed), seen_beside)


def _beside_rows(found: Diagnosis, seen: ImageData, seed: int) -> Diagnosis:
    if not seen.rows:
        return replace(found, rows_unavailable=seen.no_rows)
    try:
        rows = diagnose_rows(seen.rows, seed, [one for one in found.model_effects if row_effect(one.name) is not None])
    except IllPosed as error:
        return replace(found, rows_unavailable=str(error))
    return add_row_verdict(found, rows)


def _beside_grey(found: Diagnosis, seen: ImageData) -> Diagnosis:
    if seen.grey is None:
        return replace(found, intensity_unavailable=seen.no_grey)
    try:
        grey = diagnose_intensity(seen.grey, [one for one in found.model_effects if intensity_effect(one.name) is not None])
    except IllPosed as error:
        return replace(found, intensity_unavailable=str(error))
    return add_intensity_verdict(found, grey)


def propose_next_experiments(
    log: Path, found: Diagnosis, watch: Callable[[str, int, int], None] | None = None, model_effects: Sequence[ModelEffect] = ()
) -> tuple[ExperimentForecast, ...]:
    """What further experiments are expected to decide of a verdict, the most for a minute first; of one effect against nothing.

    Args:
        log: that was diagnosed.
        found: the verdict.
        watch: told what is done, how much of it, of how much.
        known: effects that the model had before.
    """
    if found.experiment is not None:
        return found.experiment.forecasts
    return forecast_experiments(load_observation(log, watch), found, model_effects) if found.effects else ()


def load_observation(log: Path, watch: Callable[[str, int, int], None] | None = None) -> Observation:
    """What a run's disparity maps show, estimated jointly without further effects.

    Raises:
        BadInput: the log cannot be read, or its data are too few to name anything.
    """
    return _observed(log, LogNotes(), watch)[0]


def _observed(log: Path, words: LogNotes, watch: Callable[[str, int, int], None] | None) -> tuple[Observation, tuple[StepConditions, ...]]:
    limit_blas_threads()
    settings = log_settings(log)
    settings = replace(settings, estimate=replace(settings.estimate, method="joint"), model=EMPTY_MODEL)
    state = None
    pairs = ((decision, pipeline.complete_maps(decision.pair, maps)) for decision, maps in pairs_with_maps(log, words))
    for state in pipeline.follow(settings, pairs):
        if watch is not None:
            watch("pair", len(state.pairs), len(state.pairs))
    if state is None:
        raise BadLog(f"{log}: holds no disparity maps; replay it from its images first.")
    assert isinstance(state.estimator_state, EstimatorState)  # of the joint method
    steps = step_conditions(state.pairs, _hold_s(log))
    solution, other = baseline_solution(state.estimator_state)
    return make_observation(solution, steps, other), steps


def _hold_s(log: Path) -> float:
    """The hold before the pairs of a log's run: as configured, or the paper's where nothing tells."""
    protocol = first_run(log).config.get("protocol")
    hold = protocol.get("hold_s") if isinstance(protocol, dict) else None
    return float(hold) if isinstance(hold, int | float) else HOLD_S


def diagnosis_json(found: Diagnosis) -> dict[str, Any]:
    """The verdict as other programs read it (`semlive diagnose LOG --json`); only ever extended."""
    return {
        "outcome": found.outcome.value,
        "effects": [effect_json(one) for one in found.effects],
        "ambiguous": list(found.ambiguous),
        "group": found.group,
        "experiment": None if found.experiment is None else _experiment_json(found.experiment),
        "gap": None if found.gap is None else gap_json(found.gap),
        "where": [asdict(one) for one in found.where],
        "noise_px": found.noise_px,
        "evidence": dict(found.evidence),
        "overlap": dict(found.overlap),
        "coarse": list(found.coarse),
        "rows": _rows_json(found),
        "grey": _grey_json(found),
    }


def _experiment_json(found: ExperimentProposal) -> dict[str, Any]:
    return {"between": list(found.between), "about": found.about, "foretold": [forecast_json(one) for one in found.forecasts]}


def forecast_json(one: ExperimentForecast) -> dict[str, Any]:
    """What an experiment is expected to decide, as other programs read it."""
    return {**asdict(one), "log_odds_per_minute": one.log_odds_per_minute}


def _rows_json(found: Diagnosis) -> dict[str, Any]:
    rows = found.rows
    if rows is None:
        return {"looked_at": False, "why_not": found.rows_unavailable}
    return {
        "looked_at": True,
        "outcome": rows.outcome.value,
        "pairs": rows.pairs,
        "rows": rows.rows,
        "noise_px": rows.noise_px,
        "gap": None if rows.gap is None else gap_json(rows.gap),
    }


def _grey_json(found: Diagnosis) -> dict[str, Any]:
    grey = found.grey
    if grey is None:
        return {"looked_at": False, "why_not": found.intensity_unavailable}
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
    """A gap as other programs read it."""
    return {
        "before_px": gap.before_px,
        "after_px": gap.after_px,
        "floor_px": gap.floor_px,
        "closure": gap.closure,
        "closure_interval": list(gap.closure_interval),
    }


def effect_json(one: IdentifiedEffect) -> dict[str, Any]:
    """An effect as other programs read it."""
    return {
        "name": one.name,
        "parameters": parameters_json(one.parameters),
        "peak_px": one.peak_px,
        "log_bayes_factor": one.log_bayes_factor,
        "p_value": one.p_value,
        "looks_like_strain": one.strain,
        "strain_eaten": one.strain_attenuation,
    }


def parameters_json(parameters: Sequence[ParameterEstimate]) -> dict[str, Any]:
    """Parameters by name."""
    return {one.name: {"value": one.value, "sigma": one.sigma, "unit": one.unit} for one in parameters}
