"""JSON objects of the verdict of a diagnosis; they are only extended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from semlive.data.diagnosis.effects import HeldOutMisfit, IdentifiedEffect, ParameterEstimate
from semlive.data.diagnosis.verdict import (
    SETTLING_DECISION,
    SETTLING_LAWS,
    Diagnosis,
    ExperimentForecast,
    ExperimentProposal,
    settling_text,
)


def diagnosis_json(verdict: Diagnosis) -> dict[str, object]:
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
        "truncated": verdict.truncated,
        "adequacy": None if verdict.adequacy is None else {**asdict(verdict.adequacy), "passed": verdict.adequacy.passed},
        "closest": dict(verdict.closest),
        "unexplained": [{**asdict(reason), "about": reason.text} for reason in verdict.unexplained],
        "outside": None if verdict.outside is None else asdict(verdict.outside),
        "pairs": {"used": verdict.run.pairs[0], "of": verdict.run.pairs[1]},
        "rows": _rows_json(verdict),
        "grey": _grey_json(verdict),
        "settling": [
            {"start": start, "between": list(laws), "about": settling_text(start), "decides": SETTLING_DECISION}
            for start, laws in SETTLING_LAWS.items()
        ],
    }


def _experiment_json(proposal: ExperimentProposal) -> dict[str, object]:
    return {
        "between": list(proposal.between),
        "about": proposal.about,
        "foretold": [forecast_json(forecast) for forecast in proposal.forecasts],
    }


def forecast_json(forecast: ExperimentForecast) -> dict[str, object]:
    """JSON object of a forecast."""
    return {**asdict(forecast), "log_odds_per_minute": forecast.log_odds_per_minute}


def _rows_json(verdict: Diagnosis) -> dict[str, object]:
    rows = verdict.images.rows
    if rows is None:
        return {"looked_at": False, "why_not": verdict.images.no_rows}
    return {
        "looked_at": True,
        "outcome": rows.outcome.value,
        "pairs": rows.pairs,
        "rows": rows.rows,
        "noise_px": rows.noise_px,
        "gap": None if rows.gap is None else gap_json(rows.gap),
    }


def _grey_json(verdict: Diagnosis) -> dict[str, object]:
    grey = verdict.images.grey
    if grey is None:
        return {"looked_at": False, "why_not": verdict.images.no_grey}
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


def gap_json(gap: HeldOutMisfit) -> dict[str, object]:
    """JSON object of a held-out misfit."""
    return {
        "before_px": gap.before_px,
        "after_px": gap.after_px,
        "floor_px": gap.floor_px,
        "closure": gap.closure,
        "closure_interval": list(gap.closure_interval),
    }


def effect_json(effect: IdentifiedEffect) -> dict[str, object]:
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


def parameters_json(parameters: Sequence[ParameterEstimate]) -> dict[str, object]:
    """JSON object of parameters by name; ``alternatives`` only where the data do not exclude other values."""
    return {parameter.name: _parameter_json(parameter) for parameter in parameters}


def _parameter_json(parameter: ParameterEstimate) -> dict[str, object]:
    own: dict[str, object] = {"value": parameter.value, "sigma": parameter.sigma, "unit": parameter.unit}
    others = [{"value": value, "sigma": sigma} for value, sigma in parameter.alternatives]
    return own | ({"alternatives": others} if others else {})
