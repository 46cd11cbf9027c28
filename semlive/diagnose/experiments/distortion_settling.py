"""Settling at the start of rows and frames in the distortion of one run, and the scans that separate its laws.

One pixel size and one dwell time show the same field for settling in time, settling in position and a distortion of the scan generator.
The field is part of the estimated distortion, and no effect is missing. A run at another magnification or dwell has another field.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from semlive.data.diagnosis.effects import ModelEffect
from semlive.data.diagnosis.verdict import Diagnosis, ExperimentForecast, StartSettling
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.baseline.model_effects import add_model_effects, observable_effects
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.experiments.forecast import planned_run
from semlive.diagnose.experiments.proposals import ExperimentKind
from semlive.diagnose.maps.effect_selection import SIGNIFICANT_LOG_FACTOR
from semlive.diagnose.row_start.laws import RowStartLaw, possible_settings
from semlive.diagnose.row_start.profile import FittedProfile, RowStartProfile
from semlive.diagnose.two_runs.decide import shared_effect
from semlive.diagnose.two_runs.join import join_runs
from semlive.diagnose.two_runs.joint_evidence import joint_evidence
from semlive.model.effects import (
    EFFECT_CLASSES,
    FLYBACK_SETTLING,
    FRAME_START_SETTLING,
    FRAME_START_SETTLING_IN_POSITION,
    ROW_START_SETTLING_IN_POSITION,
    BasisField,
    EffectClass,
    RunGeometry,
)
from semlive.model.effects.effect_class import Values

LAWS = {"row": (FLYBACK_SETTLING, ROW_START_SETTLING_IN_POSITION), "frame": (FRAME_START_SETTLING, FRAME_START_SETTLING_IN_POSITION)}
"""Laws in time and in position of each start."""
CONSTANT_IN_PIXELS = "distortion"
MIN_AMPLITUDE_SIGMAS = 4.0
_NO_POINTS = np.zeros(0)


def settling_of_run(observation: Observation, verdict: Diagnosis, model_effects: Sequence[ModelEffect] = ()) -> tuple[StartSettling, ...]:
    """Settling that the distortion of a diagnosed run contains, with forecasts of experiments that separate its laws.

    Args:
        observation: observation of the run.
        verdict: the verdict; its effects are part of the baseline.
        model_effects: effects of the model before the diagnosis.
    """
    known = {family.name for family in EFFECT_CLASSES}
    effects = [effect for effect in (*model_effects, *(effect.model_effect for effect in verdict.effects)) if effect.name in known]
    run = add_model_effects(noise_scaled_baseline(observation), observable_effects(observation, effects))[0]
    return tuple(replace(found, forecasts=settling_forecasts(observation, found)) for found in settling_in_distortion(run))


def settling_in_distortion(run: HyperparameterGrid) -> tuple[StartSettling, ...]:
    """Settling that the distortion of a run contains, without forecasts.

    Evidence is that of an exponential at the start, in addition to a distortion with the most likely smoothness. The same exponential at
    the end of rows or frames must be less likely by as much, so that a distortion with fine detail elsewhere gives no settling.

    Args:
        run: baseline of the run with all identified effects.
    """
    joint = join_runs([run])
    found = []
    for start, (in_time, in_position) in LAWS.items():
        evidence = joint_evidence(joint, in_position)
        if evidence is None or evidence.log_factor < SIGNIFICANT_LOG_FACTOR:
            continue
        at_end = joint_evidence(joint, _at_end(in_position))
        if at_end is not None and at_end.log_factor > evidence.log_factor - SIGNIFICANT_LOG_FACTOR:
            continue
        effect = shared_effect(evidence)
        in_px = tuple(parameter for parameter in effect.parameters if parameter.unit == "px")
        if max(abs(value.value) / value.sigma for value in in_px if value.name != "length_px") > MIN_AMPLITUDE_SIGMAS:
            found.append(StartSettling(start, (in_time.name, in_position.name), in_px, evidence.log_factor))
    return tuple(found)


def _at_end(family: EffectClass) -> EffectClass:
    """The class mirrored to the end of rows and frames."""

    def basis_field(scene: RunGeometry, values: Values) -> BasisField | None:
        return family.basis_field(replace(scene, address_px=-scene.address_px), values)

    return replace(family, basis_field=basis_field)


def settling_forecasts(observation: Observation, settling: StartSettling) -> tuple[ExperimentForecast, ...]:
    """Forecasts of calibrations with other pixel sizes and scan times that separate the laws of settling, largest log-odds first.

    Args:
        observation: observation of the run.
        settling: settling in its distortion.
    """
    fit = _fitted(observation, settling)
    names = {RowStartLaw.TIME: settling.between[0], RowStartLaw.POSITION: settling.between[1], RowStartLaw.PIXELS: CONSTANT_IN_PIXELS}
    forecasts = []
    for experiment in possible_settings([fit], tuple(RowStartLaw)):
        pixel_ratio = experiment.setting.pixel_nm / fit.profile.pixel_nm
        dwell_ratio = experiment.setting.pixel_s / fit.profile.pixel_s
        kind = ExperimentKind.CHANGED_SCAN_TIMES if pixel_ratio == 1.0 else ExperimentKind.CHANGED_PIXEL_SIZE
        minutes = planned_run(observation, kind, dwell_ratio).duration_s / 60.0
        true = names[experiment.hardest]
        other = names[experiment.rival]
        forecasts.append(ExperimentForecast(kind.value, dwell_ratio, minutes, experiment.log_odds, true, other, pixel_ratio))
    return tuple(forecasts)


def _fitted(observation: Observation, settling: StartSettling) -> FittedProfile:
    """Amplitude and length as a fitted profile, the larger of both amplitudes."""
    values = {parameter.name: parameter for parameter in settling.parameters}
    length = values.pop("length_px")
    amplitude = max(values.values(), key=lambda value: abs(value.value))
    timing = observation.state.frame_time(int(observation.geometry.frame[0])).timing
    pixel_s = (timing.dwell_time_s if settling.start == "row" else timing.row_time_s).value
    pixel_nm = 1e3 * (observation.pixel_um or 1e-3)
    covariance = np.diag([(amplitude.sigma / amplitude.value) ** 2, (length.sigma / length.value) ** 2])
    profile = RowStartProfile(pixel_nm, pixel_s, _NO_POINTS, _NO_POINTS, _NO_POINTS)
    return FittedProfile(profile, np.array([abs(amplitude.value)]), np.array([length.value]), covariance, 0.0)
