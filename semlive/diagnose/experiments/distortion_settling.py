"""Settling at the start of rows and frames in the distortion of one run, and the scans that separate its laws.

One pixel size and one dwell time show the same field for settling in time, settling in position and a distortion of the scan generator.
The field is part of the estimated distortion, and no effect is missing. A run at another magnification or dwell has another field.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.effects import ModelEffect
from semlive.data.diagnosis.verdict import Diagnosis, ExperimentForecast, StartSettling
from semlive.diagnose.baseline.baseline import HyperparameterGrid, build_grid, point_like
from semlive.diagnose.baseline.design_matrix import BaselineEffect
from semlive.diagnose.baseline.model_effects import add_model_effects, observable_effects
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.observation import Observation, sample_within_blocks
from semlive.diagnose.experiments.forecast import planned_run
from semlive.diagnose.experiments.proposals import ExperimentKind
from semlive.diagnose.maps.effect_selection import SIGNIFICANT_LOG_FACTOR
from semlive.diagnose.two_runs.decide import shared_effect
from semlive.diagnose.two_runs.join import JointBaseline, join_runs
from semlive.diagnose.two_runs.joint_evidence import joint_evidence, relative_to_reference
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
TYPICAL_LENGTH_PX, TYPICAL_SIZE_PX = 60.0, 1.0
PIXEL_RATIOS = (0.5, 1.0, 2.0)
DWELL_RATIOS = (0.25, 0.5, 1.0, 2.0, 4.0)
Array = NDArray[np.float64]


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
    joint = _with_smooth_distortion(run)
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


def _with_smooth_distortion(run: HyperparameterGrid) -> JointBaseline:
    """The baseline with the smoothness that the distortion has beside settling; without settling, the two do not differ.

    The smoothness that is most likely without settling is that of its steepest part, and such a distortion absorbs it.
    """
    observation, effects = run.design.observation, run.design
    scenes = sample_within_blocks(observation)
    for _, family in LAWS.values():
        like = family.basis_field(scenes[0][0], {"length_px": TYPICAL_LENGTH_PX})
        basis_field = None if like is None else relative_to_reference(family, scenes, {"length_px": TYPICAL_LENGTH_PX}, like)
        if basis_field is not None:
            effects = effects.with_effects(BaselineEffect(effects.whiten(basis_field.field_px), TYPICAL_SIZE_PX))
    return join_runs([point_like(run.design, build_grid(effects))])


def _at_end(family: EffectClass) -> EffectClass:
    """The class mirrored to the end of rows and frames."""

    def basis_field(scene: RunGeometry, values: Values) -> BasisField | None:
        return family.basis_field(replace(scene, address_px=-scene.address_px), values)

    return replace(family, basis_field=basis_field)


def settling_forecasts(observation: Observation, settling: StartSettling) -> tuple[ExperimentForecast, ...]:
    """Forecasts of calibrations with other pixel sizes and scan times that separate the laws of settling, largest log-odds first.

    Two runs have a free common distortion, so only the difference of their settling is observed. A change of pixel size and dwell by one
    factor leaves the laws in time and in position equal, and by inverse factors they differ in the sign of the amplitude only.

    Args:
        observation: observation of the run.
        settling: settling in its distortion.
    """
    profile = _Profile.of(observation, settling)
    forecasts = []
    for pixel_size, dwell in product(PIXEL_RATIOS, DWELL_RATIOS):
        if pixel_size == dwell == 1.0:
            continue
        kind = ExperimentKind.CHANGED_SCAN_TIMES if pixel_size == 1.0 else ExperimentKind.CHANGED_PIXEL_SIZE
        minutes = planned_run(observation, kind, dwell).duration_s / 60.0
        odds, true, other = min(profile.log_odds(pixel_size, dwell, law) for law in (0, 1))
        names = (*settling.between, CONSTANT_IN_PIXELS)
        forecasts.append(ExperimentForecast(kind.value, dwell, minutes, odds, names[true], names[other], pixel_size))
    return tuple(sorted(forecasts, key=lambda forecast: -forecast.log_odds))


@dataclass(frozen=True, slots=True, eq=False)
class _Profile:
    """Settling along one axis.

    Attributes:
        distance_px: (b,) distance of the blocks from the start.
        length_px: length.
        size: amplitude over the standard deviation of the distortion at a block.
    """

    distance_px: Array
    length_px: float
    size: float

    @classmethod
    def of(cls, observation: Observation, settling: StartSettling) -> _Profile:
        """Profile with the noise of the distortion by which the run determined the amplitude."""
        values = {parameter.name: parameter for parameter in settling.parameters}
        length_px = values.pop("length_px").value
        amplitude = max(values.values(), key=lambda value: abs(value.value))
        distance_px = observation.geometry.pixel_px[0, :, 0 if settling.start == "row" else 1]
        unit = cls(distance_px, length_px, 1.0)
        norm = float(np.linalg.norm(unit.beyond_slope(unit.decay(1.0))))
        return replace(unit, size=abs(amplitude.value) / (amplitude.sigma * norm))

    def decay(self, ratio: float, length_px: float | None = None) -> Array:
        """(b,) exponential decay over a length times a ratio."""
        return np.asarray(np.exp(-self.distance_px / (ratio * (self.length_px if length_px is None else length_px))))

    def beyond_slope(self, field: Array) -> Array:
        """(b,) field without offset and slope, which no run determines."""
        base = np.linalg.qr(np.stack([np.ones_like(self.distance_px), self.distance_px], axis=-1))[0]
        return np.asarray(field - base @ (base.T @ field))

    def log_odds(self, pixel_size: float, dwell: float, law: int) -> tuple[float, int, int]:
        """Expected log odds of a law (0: time, 1: position) against its closest rival (2: equal in both runs), and both laws.

        The smaller value of an amplitude that is the same in pixels, and on the specimen. The noise of the second run decreases with the
        square root of its dwell.
        """
        ratios, powers = (1.0 / dwell, 1.0 / pixel_size), {1.0, 1.0 / pixel_size}
        squares = {2: 0.0, 1 - law: 0.0}
        lengths_px = self.length_px * np.geomspace(0.1, 10.0, 41)
        rivals = [
            self.beyond_slope(power * self.decay(ratios[1 - law], length) - self.decay(1.0, length))
            for power in powers
            for length in lengths_px
        ]
        results = []
        for power in powers:
            field = self.size * self.beyond_slope(power * self.decay(ratios[law]) - self.decay(1.0))
            squares[1 - law] = max(
                (float(field @ value) ** 2 / square for value in rivals if (square := float(value @ value)) > 1e-12), default=0.0
            )
            rival = max(squares, key=lambda name: squares[name])
            results.append((0.5 * (float(field @ field) - squares[rival]) / (1.0 + 1.0 / dwell), law, rival))
        return min(results)
