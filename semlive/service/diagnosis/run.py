"""Diagnosis of a log: joint estimate from its disparity maps, and verdict over all channels."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from semlive import pipeline
from semlive.data.diagnosis.channels import IntensityDiagnosis, RowDiagnosis
from semlive.data.diagnosis.effects import EMPTY_MODEL, ModelEffect, Outcome
from semlive.data.diagnosis.verdict import Diagnosis, ExperimentForecast
from semlive.data.pair import PairDecision
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.model_effects import add_model_effects, observable_effects
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.observation import HOLD_S, Observation, StepConditions, baseline_solution, make_observation, step_conditions
from semlive.diagnose.combine import add_intensity_verdict, add_map_wave_verdict, add_row_verdict
from semlive.diagnose.experiments.forecast import forecast_experiments
from semlive.diagnose.experiments.proposals import ranked
from semlive.diagnose.fit_tests.adequacy import adequacy_of
from semlive.diagnose.fit_tests.spatial_lines import SPATIAL_LINES
from semlive.diagnose.intensity.verdict import diagnose_intensity
from semlive.diagnose.maps.relinearise import choose_coupling
from semlive.diagnose.maps.verdict import diagnose
from semlive.diagnose.rows.map_series import map_series, wave_fields
from semlive.diagnose.rows.map_waves import diagnose_map_waves
from semlive.diagnose.rows.verdict import diagnose_rows
from semlive.diagnose.scalars.load_cell import add_clock_evidence, add_load_cell_evidence, load_readings
from semlive.diagnose.scalars.stage import add_stage_evidence, stage_moves
from semlive.diagnose.scalars.strain_gage import add_gage_evidence, gage_readings
from semlive.errors import BadLog, IllPosed
from semlive.estimate import EstimatorState
from semlive.formats.log.messages import RunMessage
from semlive.model.effects.intensity import intensity_effect
from semlive.model.effects.rows import row_effect, wave_frequencies_hz
from semlive.model.effects.stage import non_map_effect
from semlive.pipeline import AnalysisState
from semlive.service.diagnosis.images import ImageChannels, ImageData
from semlive.service.diagnosis.long_runs import coarser_drift, pair_count, thinned
from semlive.service.diagnosis.model_file import pixel_size_um
from semlive.service.log.opened_log import OpenedLog
from semlive.service.log.pairs import LogNotes, Maps, pairs_with_maps, topic_counts
from semlive.service.log.settings import IMPORTED, settings_of
from semlive.service.runtime.blas import limit_blas_threads

MAX_BLOCKS = 300  # with 594, a verdict of three effects took 218 s and 2.7 GB; effects vary slowly over one in 300 parts of the field


def diagnose_log(
    log: OpenedLog, seed: int = 0, watch: Callable[[str, int, int], None] | None = None, model_effects: Sequence[ModelEffect] = ()
) -> tuple[Diagnosis, Observation]:
    """Identify the effects missing in the model of a run, from the disparity maps and, if present, the images of its log.

    The log is read once: the image channels are collected while the estimate follows the disparity maps.

    Args:
        log: a log whose messages were not read yet.
        seed: seed of the null draws.
        watch: called with the name of the task, the finished part and the total.
        model_effects: effects already in the model.

    Returns:
        The verdict, and the observation from which it follows.

    Raises:
        BadInput: the log cannot be read, or its data are too few to identify an effect.
    """
    settings = settings_of(log.run)
    channels = ImageChannels(settings.scan, (topic_counts(log.path) or {}).get("/pair", 0), watch)
    notes = LogNotes()
    state = _followed(log, notes, watch, channels)
    images = channels.data()
    with ThreadPoolExecutor(1) as pool:  # parts of the estimate use one thread
        of_images = pool.submit(lambda: (_rows(images, seed, model_effects), _intensity(images, model_effects)))
        observation, steps = _observation(log, state)
    rows, grey = of_images.result()
    waves = _map_waves(observation, model_effects)
    channel_effects = [effect for channel in (rows, waves) if isinstance(channel, RowDiagnosis) for effect in channel.effects]
    modelled_hz = wave_frequencies_hz([*model_effects, *(effect.model_effect for effect in channel_effects)])
    of_maps = observable_effects(observation, [effect for effect in model_effects if non_map_effect(effect.name) is None])
    image_effects = bool(channel_effects) or any(row_effect(effect.name) is not None for effect in model_effects)
    verdict = diagnose(observation, seed, model_effects=of_maps, modelled_hz=modelled_hz, image_effects=image_effects)
    extent = replace(verdict.run, pairs=(len(steps), max(pair_count(log.path), len(steps))))
    verdict = replace(verdict, model_effects=tuple(model_effects), run=extent)
    verdict = add_stage_evidence(verdict, stage_moves(observation, steps))
    if verdict.experiment is not None:
        verdict = replace(verdict, experiment=ranked(verdict.experiment, forecast_experiments(observation, verdict, model_effects)))
    readings = load_readings(observation, steps, settings.specimen.loading_axis, _with_effects(observation, verdict))
    verdict = add_load_cell_evidence(verdict, readings)
    verdict = add_gage_evidence(verdict, gage_readings(readings, steps, settings.specimen.gage_factor_sigma))
    if notes.sem_clock is not None:
        verdict = add_clock_evidence(verdict, notes.sem_clock.offset_s - settings.scan.clock_offset_s, notes.sem_clock.sigma_s)
    return _with_images(_with_map_waves(verdict, waves, observation), rows, grey), observation


def _with_effects(observation: Observation, verdict: Diagnosis) -> HyperparameterGrid | None:
    """Baseline with the effects of the maps, those of the model included; None without any, or without a load that they could disturb."""
    effects = [*verdict.model_effects, *(effect.model_effect for effect in verdict.effects)]
    of_maps = observable_effects(observation, [effect for effect in effects if non_map_effect(effect.name) is None])
    if not of_maps or not observation.geometry.steps.loaded.any():
        return None
    chosen = choose_coupling(observation, (), of_maps).observation
    return add_model_effects(noise_scaled_baseline(chosen), of_maps)[0]


def _map_waves(observation: Observation, model_effects: Sequence[ModelEffect]) -> RowDiagnosis | None:
    """Verdict on a wave near a multiple of the row rate; None without one, or if the model contains row effects already."""
    if any(row_effect(effect.name) is not None for effect in model_effects):
        return None
    waves = diagnose_map_waves(map_series(observation))
    return None if waves is None or waves.outcome is Outcome.NONE else waves


def _with_map_waves(verdict: Diagnosis, waves: RowDiagnosis | None, observation: Observation) -> Diagnosis:
    """The verdict with a wave near a multiple of the row rate, which is not named where the maps contain other waves over the field."""
    if waves is None:
        return verdict
    if verdict.adequacy is not None and verdict.adequacy.domain == SPATIAL_LINES and not verdict.adequacy.passed:
        return add_map_wave_verdict(verdict, replace(waves, outcome=Outcome.UNKNOWN, effects=()), None)
    adequacy = None
    if waves.effects and verdict.outcome is Outcome.UNKNOWN and not verdict.effects:
        effect = waves.effects[0]
        modelled_hz = wave_frequencies_hz([effect.model_effect])
        try:
            adequacy = adequacy_of(
                observation, effects=[(wave_fields(observation, modelled_hz[0]), effect.peak_px)], modelled_hz=modelled_hz
            ).test
        except np.linalg.LinAlgError:
            adequacy = None
    return add_map_wave_verdict(verdict, waves, adequacy)


def _rows(images: ImageData, seed: int, model_effects: Sequence[ModelEffect]) -> RowDiagnosis | str:
    """Verdict on the rows, or the reason why there is none."""
    if not images.rows:
        return images.no_rows
    try:
        return diagnose_rows(images.rows, seed, [effect for effect in model_effects if row_effect(effect.name) is not None])
    except IllPosed as error:
        return str(error)


def _intensity(images: ImageData, model_effects: Sequence[ModelEffect]) -> IntensityDiagnosis | str:
    """Verdict on the intensity, or the reason why there is none."""
    if images.grey is None:
        return images.no_grey
    try:
        return diagnose_intensity(images.grey, [effect for effect in model_effects if intensity_effect(effect.name) is not None])
    except IllPosed as error:
        return str(error)


def _with_images(verdict: Diagnosis, rows: RowDiagnosis | str, grey: IntensityDiagnosis | str) -> Diagnosis:
    """The verdict combined with those of the rows and of the intensity, or with the reasons why there are none."""
    no_rows, no_grey = (reason if isinstance(reason, str) else "" for reason in (rows, grey))
    verdict = replace(verdict, images=replace(verdict.images, no_rows=no_rows, no_grey=no_grey))
    verdict = verdict if isinstance(rows, str) else add_row_verdict(verdict, rows)
    return verdict if isinstance(grey, str) else add_intensity_verdict(verdict, grey)


def propose_next_experiments(
    observation: Observation, verdict: Diagnosis, model_effects: Sequence[ModelEffect] = ()
) -> tuple[ExperimentForecast, ...]:
    """Forecasts of further experiments for a verdict, in descending order of log odds per minute; for one effect, against none.

    Args:
        observation: observation of the diagnosed log.
        verdict: the verdict.
        model_effects: effects of the model before the diagnosis.
    """
    if verdict.experiment is not None:
        return verdict.experiment.forecasts
    return forecast_experiments(observation, verdict, model_effects) if verdict.effects else ()


def load_observation(log: OpenedLog, watch: Callable[[str, int, int], None] | None = None) -> Observation:
    """Observation of a run from its disparity maps, estimated jointly without further effects.

    Raises:
        BadInput: the log cannot be read, or its data are too few to identify an effect.
    """
    return _observation(log, _followed(log, LogNotes(), watch))[0]


def _followed(
    log: OpenedLog, notes: LogNotes, watch: Callable[[str, int, int], None] | None, channels: ImageChannels | None = None
) -> AnalysisState:
    """The state of the joint method after all pairs of a log."""
    limit_blas_threads()
    settings = settings_of(log.run)
    most = min(settings.estimate.max_blocks or MAX_BLOCKS, MAX_BLOCKS)
    settings = replace(settings, estimate=replace(settings.estimate, method="joint", max_blocks=most), model=EMPTY_MODEL)
    state, count = None, pair_count(log.path)
    settings = replace(settings, estimate=coarser_drift(settings.estimate, count))
    for state in pipeline.follow(settings, thinned(_complete_pairs(log, notes, channels), count)):
        if watch is not None:
            watch("pair", len(state.pairs), len(state.pairs))
    if state is None:
        raise BadLog(f"{log.path}: contains no disparity maps; replay it from its images first.")
    return state


def _observation(log: OpenedLog, state: AnalysisState) -> tuple[Observation, tuple[StepConditions, ...]]:
    assert isinstance(state.estimator_state, EstimatorState)  # of the joint method
    steps = step_conditions(state.pairs, _hold_s(log.run))
    solution, alternative = baseline_solution(state.estimator_state)
    return replace(make_observation(solution, steps, alternative), pixel_um=_pixel_um(log, state.pairs)), steps


def _complete_pairs(log: OpenedLog, notes: LogNotes, channels: ImageChannels | None) -> Iterator[tuple[PairDecision, Maps]]:
    """Yield the pairs with the maps of both frames; the image channels take what they need on the way."""
    stream = log.messages() if channels is None else channels.noting(log.messages())
    for decision, maps in pairs_with_maps(log.path, stream, notes):
        if channels is not None:
            channels.take(decision, maps)
        yield decision, pipeline.complete_maps(decision.pair, maps)


def _pixel_um(log: OpenedLog, pairs: Sequence[PairDecision]) -> float | None:
    """Pixel size by the configuration, or else by the file of the first frame, um; None if unknown."""
    return pixel_size_um(log) or 1e6 * pairs[0].first.pixel_size_m.value or None


def _hold_s(run: RunMessage) -> float:
    """Hold time before the pairs of a run, s, as configured or given with an import; otherwise that of Sutton et al. (2007)."""
    section = run.config.get("protocol", run.config.get(IMPORTED))
    hold = section.get("hold_s") if isinstance(section, dict) else None
    return float(hold) if isinstance(hold, int | float) else HOLD_S
