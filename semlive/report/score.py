"""Recovered against true, for runs on a simulator; the truth is read here and nowhere else."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from semlive.data.experiment import Phase
from semlive.data.results import RunResult
from semlive.errors import BadInput


@dataclass(frozen=True, slots=True)
class Score:
    """One recovered quantity beside its truth.

    Attributes:
        name: what it is.
        truth: true value.
        value: recovered value.
        sigma: stated standard uncertainty.
        unit: of all three.
    """

    name: str
    truth: float
    value: float
    sigma: float
    unit: str

    @property
    def error(self) -> float:
        """Recovered minus true."""
        return self.value - self.truth

    def to_json(self) -> dict[str, Any]:
        """As other programs read it."""
        z = abs(self.error) / self.sigma if self.sigma > 0 else float("inf")
        numbers = {"truth": self.truth, "value": self.value, "sigma": self.sigma, "error": self.error, "unit": self.unit}
        return {**numbers, "inside68": z <= 1.0, "inside95": z <= 1.96}


def load_truth(path: Path) -> dict[str, Any]:
    """Read a simulator's truth.

    Raises:
        BadInput: the file is missing or is not a truth file.
    """
    try:
        truth = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BadInput(f"{path}: is not a truth file ({error}); give the truth.json that the simulator wrote") from error
    if not isinstance(truth, dict) or truth.get("version") != 1:
        raise BadInput(f"{path}: is not a truth file of version 1; give the truth.json that the simulator wrote")
    return truth


def score(result: RunResult, truth: dict[str, Any]) -> tuple[Score, ...]:
    """Every recovered quantity against truth.

    Drift is compared by its change within each frame (its mean in the frame removed: drift across a motion is the same
    number as the motion), distortion after removal of its best affine map, strain relative to frame 0.

    Raises:
        BadInput: the truth lacks a frame of the run.
    """
    scores = [*_drift(result, truth), *_distortion(result, truth), *_unloaded(result), *_tension(result, truth)]
    if result.elastic is not None:
        modulus, ratio = result.elastic.youngs_modulus_gpa, result.elastic.poissons_ratio
        scores.append(Score("Young's modulus", truth["youngs_modulus_gpa"], modulus.value, modulus.sigma, "GPa"))
        scores.append(Score("Poisson's ratio", truth["poissons_ratio"], ratio.value, ratio.sigma, ""))
    return tuple(scores)


def _drift(result: RunResult, truth: dict[str, Any]) -> list[Score]:
    drift, zero_ns = result.estimate.drift, result.decisions[0].first.start_time_ns.value
    time_s = (np.asarray(truth["drift"]["time_ns"], dtype=np.int64) - zero_ns) / 1e9
    true_px = np.stack([np.interp(drift.time_s, time_s, truth["drift"][name]) for name in ("dx_px", "dy_px")], axis=1)
    scores, errors = [], np.zeros_like(true_px)
    widest = (0.0, 0, 0)
    for frame in np.unique(drift.frame):
        inside = drift.frame == frame
        errors[inside] = _centred(drift.drift_px[inside]) - _centred(true_px[inside])
        for axis in (0, 1):
            change = abs(true_px[inside][-1, axis] - true_px[inside][0, axis])
            widest = max(widest, (float(change), int(frame), axis))
    _, frame, axis = widest
    rows = np.flatnonzero(drift.frame == frame)
    first, last = rows[0], rows[-1]
    sigma = float(np.hypot(drift.sigma_px[first, axis], drift.sigma_px[last, axis]))
    name = f"drift {'xy'[axis]} across frame {frame} (the largest)"
    true_change, change = (float(values[last, axis] - values[first, axis]) for values in (true_px, drift.drift_px))
    scores.append(Score(name, true_change, change, sigma, "px"))
    rms_sigma = float(np.sqrt(np.mean(drift.sigma_px**2)))
    scores.append(Score("drift within frames, rms error", 0.0, float(np.sqrt(np.mean(errors**2))), rms_sigma, "px"))
    worst = max(float(np.sqrt(np.mean(errors[drift.frame == one] ** 2))) for one in np.unique(drift.frame))
    scores.append(Score("drift within the worst frame, rms error", 0.0, worst, rms_sigma, "px"))
    return scores


def _centred(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return values - values.mean(axis=0)


def _distortion(result: RunResult, truth: dict[str, Any]) -> list[Score]:
    field, told = result.estimate.distortion, truth["distortion"]
    x, y = field.grid.mesh()
    errors = []
    for name, recovered in (("ex_px", field.ex_px), ("ey_px", field.ey_px)):
        true = RegularGridInterpolator((told["y_px"], told["x_px"]), np.asarray(told[name]), method="cubic")(np.stack([y, x], axis=-1))
        errors.append(_affine_removed(recovered - true, field.valid, x, y))
    if not field.valid.any():
        return []
    error = np.concatenate(errors)
    sigma = float(np.sqrt(np.mean(field.sigma_px[field.valid] ** 2)))
    return [
        Score("distortion, rms error", 0.0, float(np.sqrt(np.mean(error**2))), sigma, "px"),
        Score("distortion, largest error", 0.0, float(np.abs(error).max()), sigma, "px"),
    ]


def _affine_removed(
    values: NDArray[np.float64], valid: NDArray[np.bool_], x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float64]:
    columns = np.stack([np.ones(valid.sum()), x[valid] / 1000, y[valid] / 1000], axis=1)
    return values[valid] - columns @ np.linalg.lstsq(columns, values[valid], rcond=None)[0]


def _unloaded(result: RunResult) -> list[Score]:
    phases = {decision.pair: decision.step.phase for decision in result.decisions}
    scores = []
    for phase in (Phase.CALIBRATION, Phase.TRANSLATION):
        means = [frame.summary for frame in result.frames if phases[frame.summary.frame // 2] is phase and frame.summary.frame > 0]
        if means:
            worst = max(
                ((getattr(one.mean, c), getattr(one.mean_sigma, c)) for one in means for c in ("exx", "eyy", "exy")),
                key=lambda v: abs(v[0]),
            )
            scores.append(
                Score(f"mean strain, {phase.value}, the worst of {len(means)} frames", 0.0, worst[0] * 1e6, worst[1] * 1e6, "1e-6")
            )
    return scores


def _tension(result: RunResult, truth: dict[str, Any]) -> list[Score]:
    told = {frame["file"]: frame["strain"] for frame in truth["frames"]}
    zero = _told(told, result.decisions[0].first.name)
    summaries = {frame.summary.frame: frame.summary for frame in result.frames}
    scores = []
    for decision in result.decisions:
        if decision.step.phase is not Phase.TENSION:
            continue
        true = _told(told, decision.second.name)
        summary = summaries[2 * decision.pair + 1]
        load = f"{decision.loads[1].mean_n:.0f} N" if decision.loads else f"pair {decision.pair}"
        for c in ("exx", "eyy"):
            value, sigma = getattr(summary.mean, c), getattr(summary.mean_sigma, c)
            scores.append(Score(f"strain {c} at {load}", (true[c] - zero[c]) * 1e6, value * 1e6, sigma * 1e6, "1e-6"))
    return scores


def _told(told: dict[str, dict[str, float]], name: str) -> dict[str, float]:
    if name not in told:
        raise BadInput(f"the truth says nothing of {name}; give the truth.json of this very run")
    return told[name]
