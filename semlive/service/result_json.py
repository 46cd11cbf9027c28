"""A run's result as other programs read it (`semlive replay LOG --json`); only ever extended."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from semlive.data.results import FrameResult, RunResult
from semlive.data.settings import AnalysisSettings
from semlive.data.strain import GageComparison, Measured, Tensor2


def result_json(result: RunResult, settings: AnalysisSettings) -> dict[str, Any]:
    """The result as one JSON object.

    Frames are numbered 2 * pair + 0 or 1; strain and shift are relative to frame 0, corrected, engineering small strain,
    tension positive. `window_px` counts the window as points x step, `vsg_px` with the subset: (points - 1) x step + subset.
    """
    points, dic = settings.estimate.window_points, settings.dic
    elastic = result.elastic
    return {
        "pairs": len(result.decisions),
        "method": settings.estimate.method,
        "window_points": points,
        "window_px": points * dic.step_px,
        "vsg_px": (points - 1) * dic.step_px + dic.subset_px,
        "frames": [_frame(result, frame) for frame in result.frames],
        "distortion": _distortion(result),
        "noise_floor_px": result.estimate.noise_floor_px,
        "elastic": elastic
        and {
            "youngs_modulus_gpa": _measured(elastic.youngs_modulus_gpa),
            "poissons_ratio": _measured(elastic.poissons_ratio),
        },
        "strain_gage": _gage(result.gage),
        "warnings": list(result.notes),
    }


def _frame(result: RunResult, frame: FrameResult) -> dict[str, Any]:
    number = frame.summary.frame
    decision = next(one for one in result.decisions if one.pair == number // 2)
    motion = next(one for one in result.estimate.motions if one.pair == number // 2)
    drift = result.estimate.drift
    rows = np.flatnonzero(drift.frame == number)
    return {
        "frame": number,
        "pair": decision.pair,
        "phase": decision.step.phase.value,
        "load_n": decision.loads[number % 2].mean_n if decision.loads else None,
        "gage_strain": decision.loads[number % 2].gage_strain if decision.loads else None,
        "shift_px": [float(v) for v in motion.shift_px],
        "shift_sigma_px": [float(v) for v in motion.shift_sigma_px],
        "strain_mean": _tensor(frame.summary.mean),
        "strain_mean_sigma": _tensor(frame.summary.mean_sigma),
        "strain_sd": _tensor(frame.summary.sd),
        "strain_gauge_sigma": frame.summary.gauge_sigma and _tensor(frame.summary.gauge_sigma),
        "drift_start_px": [float(v) for v in drift.drift_px[rows[0]]],
        "drift_end_px": [float(v) for v in drift.drift_px[rows[-1]]],
    }


def _gage(gage: GageComparison | None) -> dict[str, Any] | None:
    """DIC beside the strain gage, null without one."""
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


def _measured(value: Measured) -> dict[str, float]:
    return {"value": value.value, "sigma": value.sigma}


def differences(before: Any, after: Any, where: str = "") -> list[str]:
    """Where two results differ, as ``frames.3.strain_mean.eyy: 1.2e-05 became 1.3e-05``; empty if they are the same."""
    if isinstance(before, dict) and isinstance(after, dict):
        keys = sorted({*before, *after})
        return [one for key in keys for one in differences(before.get(key), after.get(key), f"{where}.{key}".lstrip("."))]
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        return [one for at, (a, b) in enumerate(zip(before, after, strict=True)) for one in differences(a, b, f"{where}.{at}".lstrip("."))]
    return [] if before == after else [f"{where}: {before} became {after}"]
