"""From mean strains and loads to elastic constants."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from semlive import mechanics
from semlive.data.strain import MeasuredValue, StrainSummary
from semlive.errors import IllPosed
from semlive.estimate.method import MethodSolution
from semlive.mechanics.strain_gage import mean_gage_strain
from semlive.pipeline.correction import current_summaries
from semlive.pipeline.state import AnalysisState, ElasticResult

LoadStep = tuple[int, float, MeasuredValue | None, StrainSummary]
"""Pair, mean load in N, mean of the strain gage if there is one, mean strain."""


def fit_elastic(state: AnalysisState, solution: MethodSolution, summaries: Mapping[int, StrainSummary]) -> ElasticResult:
    """Elastic constants and comparison with the strain gage, from one point for each load step.

    The frames of a pair share their strain gradient, so their difference carries no information on stiffness.

    Args:
        state: of the run.
        solution: that the frames were corrected with.
        summaries: mean strains of the frames under load, by number.
    """
    return fit_elastic_with_reason(state, solution, summaries)[0]


def fit_elastic_with_reason(
    state: AnalysisState, solution: MethodSolution, summaries: Mapping[int, StrainSummary]
) -> tuple[ElasticResult, str]:
    """Result of `fit_elastic`, and the reason where a known cross-section and pairs under load give no elastic constants; else empty."""
    specimen, steps = state.settings.specimen, _load_steps(state, summaries)
    if specimen.area_mm2 is None or not steps:
        return (None, None), "no pair under load has a measured load" if specimen.area_mm2 is not None and state.tension_pairs else ""
    area_mm2, axis = specimen.area_mm2, specimen.loading_axis
    elastic, comparison, count, reason = None, None, len(steps), ""

    def covariance(functions: NDArray[np.float64]) -> NDArray[np.float64]:
        return state.method.mean_strain_covariance(solution, [summary.frame for *_, summary in steps], functions)

    try:
        points = [(load_n, summary) for _, load_n, _, summary in steps]
        elastic = mechanics.elastic_constants(points, area_mm2, axis, covariance=covariance)
    except IllPosed as error:
        reason = str(error)
    gage_steps = [(pair, load_n, gage, summary) for pair, load_n, gage, summary in steps if gage is not None]
    if gage_steps:
        at = np.array([step for step, (_, _, gage, _) in enumerate(steps) if gage is not None])
        both = np.concatenate((at, at + count))

        def gage_covariance(functions: NDArray[np.float64]) -> NDArray[np.float64]:
            padded = np.zeros((len(functions), 2 * count))
            padded[:, both] = functions
            return covariance(padded)

        with suppress(IllPosed):
            comparison = mechanics.compare_with_gage(gage_steps, area_mm2, axis, specimen.gage_factor_sigma, gage_covariance)
    return (elastic, comparison), reason


def refit_elastic(state: AnalysisState) -> AnalysisState:
    """Elastic constants as the newest solution gives them, stored as reported."""
    assert state.solution is not None  # each caller solves first
    return replace(state, elastic=fit_elastic(state, state.solution, current_summaries(state, state.tension_pairs)))


def _load_steps(state: AnalysisState, summaries: Mapping[int, StrainSummary]) -> list[LoadStep]:
    """All load steps with a measured load."""
    return [
        (
            decision.pair,
            0.5 * (decision.loads[0].mean_n + decision.loads[1].mean_n) - state.model_correction.load_of(decision.pair),
            mean_gage_strain(*decision.loads),
            mechanics.average_of_pair(summaries[2 * decision.pair], summaries[2 * decision.pair + 1]),
        )
        for decision in state.tension_pairs
        if decision.loads is not None
    ]
