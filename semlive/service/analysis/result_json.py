"""JSON result of a run for other programs (`semlive replay LOG --json`); the format is only extended."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from semlive.data.drift import PairMotion
from semlive.data.pair import PairDecision
from semlive.data.results import RunResult
from semlive.data.settings import AnalysisSettings
from semlive.data.strain import MeasuredValue, StrainGageComparison, StrainSummary, Tensor2


def result_json(result: RunResult, settings: AnalysisSettings) -> dict[str, Any]:
    """The result as one JSON object.

    Frames are numbered 2 * pair + 0 or 1; strain and shift are relative to frame 0, corrected, tension positive, strain by the
    settings' measure. `window_px` counts the window as points x step, `vsg_px` with the subset: (points - 1) x step + subset.
    """
    points, grid = settings.estimate.window_points, result.estimate.distortion.grid
    elastic = result.elastic
    return {
        "pairs": len(result.decisions),
        "method": settings.estimate.method,
        "window_points": points,
        "window_px": points * grid.step_px,
        "vsg_px": grid.vsg_px(points),
        "frames": _frames(result),
        "distortion": _distortion(result),
        "noise_floor_px": result.estimate.noise_floor_px,
        "elastic": elastic
        and {
            "youngs_modulus_gpa": _measured(elastic.youngs_modulus_gpa),
            "poissons_ratio": _measured(elastic.poissons_ratio),
        },
        "strain_gage": _gage(result.gage),
        "warnings": list(result.messages),
    }


def _frames(result: RunResult) -> list[dict[str, Any]]:
    drift = result.estimate.drift
    decisions, motions = {one.pair: one for one in result.decisions}, {one.pair: one for one in result.estimate.motions}
    numbers, first, count = np.unique(drift.frame, return_index=True, return_counts=True)  # samples of a frame lie together
    ends = {int(number): drift.drift_px[[begin, begin + many - 1]] for number, begin, many in zip(numbers, first, count, strict=True)}
    return [_frame(one, decisions[one.frame // 2], motions[one.frame // 2], ends[one.frame]) for one in result.summaries]


def _frame(summary: StrainSummary, decision: PairDecision, motion: PairMotion, drift_px: NDArray[np.float64]) -> dict[str, Any]:
    number = summary.frame
    return {
        "frame": number,
        "pair": decision.pair,
        "phase": decision.step.phase.value,
        "load_n": decision.loads[number % 2].mean_n if decision.loads else None,
        "gage_strain": decision.loads[number % 2].gage_strain if decision.loads else None,
        "shift_px": [float(v) for v in motion.shift_px],
        "shift_sigma_px": [float(v) for v in motion.shift_sigma_px],
        "strain_mean": _tensor(summary.mean),
        "strain_mean_sigma": _tensor(summary.mean_sigma),
        "strain_mean_systematic": summary.systematic_sigma and _tensor(summary.systematic_sigma),
        "strain_sd": _tensor(summary.sd),
        "strain_gauge_sigma": summary.gauge_sigma and _tensor(summary.gauge_sigma),
        "drift_start_px": [float(v) for v in drift_px[0]],
        "drift_end_px": [float(v) for v in drift_px[1]],
    }


def _gage(gage: StrainGageComparison | None) -> dict[str, Any] | None:
    """Return DIC strain with strain-gage readings; None without a gage."""
    return gage and {
        "youngs_modulus_gpa": _measured(gage.youngs_modulus_gpa),
        "poissons_ratio": _measured(gage.poissons_ratio),
        "dic_over_gage": _measured(gage.dic_over_gage),
        "steps": [asdict(one) for one in gage.steps],
    }


def _distortion(result: RunResult) -> dict[str, list[float]]:
    field = result.estimate.distortion
    inside = [values[field.valid] for values in (field.ex_px, field.ey_px)]
    if not field.valid.any():
        return {"max_px": [0.0, 0.0], "rms_px": [0.0, 0.0]}
    return {
        "max_px": [float(np.abs(values).max()) for values in inside],
        "rms_px": [float(np.sqrt(np.mean(values**2))) for values in inside],
    }


def _tensor(value: Tensor2) -> dict[str, float]:
    return {"exx": value.exx, "eyy": value.eyy, "exy": value.exy}


def _measured(value: MeasuredValue) -> dict[str, float]:
    return {"value": value.value, "sigma": value.sigma}


def json_differences(before: Any, after: Any, where: str = "") -> list[str]:
    """Where two results differ, as ``frames.3.strain_mean.eyy: 1.2e-05 became 1.3e-05``; empty if they are the same."""
    if isinstance(before, dict) and isinstance(after, dict):
        keys = sorted({*before, *after})
        return [one for key in keys for one in json_differences(before.get(key), after.get(key), f"{where}.{key}".lstrip("."))]
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        return [
            one for at, (a, b) in enumerate(zip(before, after, strict=True)) for one in json_differences(a, b, f"{where}.{at}".lstrip("."))
        ]
    return [] if before == after else [f"{where}: {before} became {after}"]
