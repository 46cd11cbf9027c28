"""Comparison of two runs with different scan times or pixel sizes: scan effects change with the scan, the distortion in px does not.

The baselines of both runs are joined with a common distortion; all other parameters are separate. Effects have the same nonlinear
parameters and the same amplitudes in both runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semlive.data.diagnosis.effects import Outcome, ParameterEstimate
from semlive.data.diagnosis.two_runs import SharedEffect, TwoRunVerdict
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.fit_tests.adequacy import negligible_px
from semlive.diagnose.maps.effect_selection import MIN_LOG_ODDS, SIGNIFICANT_LOG_FACTOR
from semlive.diagnose.maps.parameter_search import optimise_parameters, parameter_spread
from semlive.diagnose.maps.refinement import reported_parameters
from semlive.diagnose.two_runs.join import join_runs
from semlive.diagnose.two_runs.joint_evidence import (
    AMPLITUDE_POWER,
    JointEvidence,
    JointObjective,
    joint_evidence,
    refined,
    with_refitted_smoothness,
    with_second_term,
)
from semlive.diagnose.two_runs.scan_rotation import SCAN_TIME_TOLERANCE, analyse_scan_rotation, same_scan_times, scan_times_s
from semlive.diagnose.two_runs.separate_effects import separate_evidence
from semlive.errors import IllPosed
from semlive.model.effects import (
    PIXEL_SIZE_EFFECT_CLASSES,
    TWO_RUN_EFFECT_CLASSES,
    BasisField,
    EffectClass,
    RunGeometry,
)
from semlive.model.effects.effect_class import Values

Array = NDArray[np.float64]
CANDIDATES = 3
"""Number of the most likely effects whose evidence is refined where the pixel sizes differ: laws in time and in position are compared at
their most likely constants, because the distance of a grid value from the true constant counts more than the difference of the laws."""
TWO_TERM_CANDIDATES = 1
"""Number of the most likely laws that are tried with two exponentials; the scan separates laws more than the number of terms."""


def compare_runs(runs: Sequence[HyperparameterGrid]) -> TwoRunVerdict:
    """Identify the effect common to runs with different scans; several effects if the scan of the second run was rotated.

    Args:
        runs: baselines of the runs, with the given effects.

    Raises:
        IllPosed: the runs cannot be joined, or have equal scan times and equal or unknown pixel sizes.
    """
    by_turn = analyse_scan_rotation(runs)
    if by_turn is not None:
        return by_turn
    ratios = pixel_ratios(runs)
    runs = [run if ratio == 1.0 else _with_pixel_ratio(run, ratio) for run, ratio in zip(runs, ratios, strict=True)]
    _require_comparable(runs)
    families = TWO_RUN_EFFECT_CLASSES if len(set(ratios)) == 1 else (*TWO_RUN_EFFECT_CLASSES, *PIXEL_SIZE_EFFECT_CLASSES)
    joint = join_runs(runs)
    separate_log_odds = sum(join_runs([run]).point.evidence for run in runs) - joint.point.evidence
    screening = [tested for family in families if (tested := joint_evidence(joint, family)) is not None]
    if len(set(ratios)) == 1:
        screening = [with_refitted_smoothness(candidate, runs) for candidate in screening]
    else:
        likely = _most_likely(screening, CANDIDATES)
        screening = [refined(with_refitted_smoothness(value, runs)) if value in likely else value for value in screening]
    if max([separate_log_odds, *(candidate.log_factor for candidate in screening)]) > SIGNIFICANT_LOG_FACTOR:
        likely = _most_likely(screening, TWO_TERM_CANDIDATES)
        screening = [(with_second_term(value) if value in likely else None) or value for value in screening]
    verdict = _verdict(runs, screening, separate_log_odds)
    return verdict if len(set(ratios)) == 1 else replace(verdict, pixel_ratio=ratios[-1])


def _most_likely(candidates: Sequence[JointEvidence], count: int) -> list[JointEvidence]:
    return sorted(candidates, key=lambda candidate: -candidate.log_factor)[:count]


def _verdict(runs: Sequence[HyperparameterGrid], screening: Sequence[JointEvidence], separate_log_odds: float) -> TwoRunVerdict:
    separate = separate_evidence(runs)
    evidence = {name: item.log_factor for name, item in separate.items()} | {item.family.name: item.log_factor for item in screening}
    ranked = tuple(sorted(evidence.items(), key=lambda item: -item[1]))
    effect, largest, rivals = None, 0.0, ranked
    while effect is None and rivals and rivals[0][1] >= SIGNIFICANT_LOG_FACTOR:
        (name, largest), *rest = rivals
        found = next((shared_effect(item) for item in screening if item.family.name == name), None) or separate[name].effect()
        negligible = max(negligible_px(name, run.design.observation.geometry) for run in runs)
        effect, rivals = found if found.peak_px > negligible else None, tuple(rest)
    if effect is None:
        return TwoRunVerdict(
            Outcome.UNKNOWN if separate_log_odds > SIGNIFICANT_LOG_FACTOR else Outcome.NONE, None, (), ranked, separate_log_odds
        )
    names = (*effect.aliases, *(name for name, factor in rivals if factor > largest - MIN_LOG_ODDS))
    if separate_log_odds > largest + SIGNIFICANT_LOG_FACTOR:
        return TwoRunVerdict(Outcome.UNKNOWN, effect, (), ranked, separate_log_odds)
    if len(names) > 1:
        return TwoRunVerdict(Outcome.AMBIGUOUS, effect, names, ranked, separate_log_odds)
    return TwoRunVerdict(Outcome.IDENTIFIED, effect, (), ranked, separate_log_odds, (effect,))


def pixel_ratios(runs: Sequence[HyperparameterGrid]) -> tuple[float, ...]:
    """Pixel size of each run relative to that of the first; 1 where a size is unknown, or equal within rounding."""
    first_um, *_ = sizes_um = [run.design.observation.pixel_um for run in runs]
    if first_um is None:
        return (1.0,) * len(runs)
    ratios = [1.0 if size_um is None else size_um / first_um for size_um in sizes_um]
    return tuple(1.0 if abs(ratio - 1.0) < SCAN_TIME_TOLERANCE else ratio for ratio in ratios)


def _with_pixel_ratio(run: HyperparameterGrid, ratio: float) -> HyperparameterGrid:
    observation = run.design.observation
    scaled = replace(observation, geometry=replace(observation.geometry, pixel_ratio=ratio))
    return replace(run, design=replace(run.design, observation=scaled))


def _require_comparable(runs: Sequence[HyperparameterGrid]) -> None:
    states = [run.design.observation.state for run in runs]
    if any(state.distortion != states[0].distortion or state.grid != states[0].grid for state in states[1:]):
        raise IllPosed(
            "the runs have different grids or frame sizes: their distortions cannot be compared; replay one run with the grid of the other"
        )
    times = scan_times_s(runs)
    if same_scan_times(times) and all(run.design.observation.geometry.pixel_ratio == 1.0 for run in runs):
        raise IllPosed(
            f"the runs have equal scan times, dwell {times[0, 0]:g} s and rows of {times[0, 1]:g} s: they separate no effects; "
            "record the second with half or twice the dwell, at another magnification (with pixel sizes in both logs), or with the scan "
            "rotated by 90 degrees and with moves along both axes"
        )


def shared_effect(screening: JointEvidence) -> SharedEffect:
    """The effect with its most likely parameters, in px of the first run, and their uncertainty."""
    gradient = JointObjective(screening.joined, screening.family, screening.size_px)
    values = optimise_parameters(
        gradient, {nonlinear_parameter.name: 0.0 for nonlinear_parameter in screening.family.nonlinear_parameters} | screening.values
    )
    basis_fields, against = gradient.basis_fields(values), gradient.evaluate(values)
    assert basis_fields is not None  # it was observable on the grid
    assert against is not None
    mean, covariance = against.amplitudes(0, screening.size_px)
    spread = parameter_spread(gradient, values, mean)
    own = [
        ParameterEstimate(nonlinear_parameter.name, values[nonlinear_parameter.name], sigma, nonlinear_parameter.unit)
        for nonlinear_parameter, sigma in zip(screening.family.nonlinear_parameters, spread.sigmas, strict=True)
    ]
    parameters = (*reported_parameters(basis_fields[0], mean, covariance + spread.amplitude_covariance), *own, *_lengths_um(screening, own))
    scenes, power = [run.design.observation.geometry for run in screening.joined.runs], values.get(AMPLITUDE_POWER, 0.0)
    peak_px = max(scene.pixel_ratio**-power * _largest_px(screening.family, scene, values, basis_fields[0], mean) for scene in scenes)
    return SharedEffect(screening.family.name, screening.family.alias_rule(parameters) or (screening.family.name,), peak_px, parameters)


def _lengths_um(screening: JointEvidence, own: Sequence[ParameterEstimate]) -> list[ParameterEstimate]:
    """Lengths on the specimen, of parameters in px of the first run."""
    pixel_um = screening.joined.runs[0].design.observation.pixel_um
    return [
        ParameterEstimate(length.name.replace("_px", "_um"), length.value * pixel_um, length.sigma * pixel_um, "um")
        for length in own
        if pixel_um is not None and length.unit == "px"
    ]


def _largest_px(family: EffectClass, scene: RunGeometry, values: Values, like: BasisField, amplitudes: Array) -> float:
    basis_field = family.basis_field(scene, values)
    return 0.0 if basis_field is None else float(np.max(np.hypot(*np.moveaxis(basis_field.rescaled_to(like).field_px @ amplitudes, -1, 0))))
