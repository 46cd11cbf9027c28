"""Comparison of two runs, the second with a rotated scan: scan axes, and whether the distortion rotates with the scan.

A distortion E1 fixed in the column becomes E2(R) = T E1(T^-1 R) after the rotation, where T maps image motion of the first run to that of
the second. A distortion fixed in the scan is equal in both runs. The third hypothesis is a distortion of the column with nonlinear scan
ramps, each along its axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, cho_factor, cho_solve

from semlive.data.diagnosis.effects import Outcome, ParameterEstimate
from semlive.data.diagnosis.two_runs import ScanRotation, SharedEffect, TwoRunVerdict
from semlive.diagnose.baseline.baseline import HyperparameterGrid
from semlive.diagnose.maps.effect_selection import SIGNIFICANCE_LEVEL, SIGNIFICANT_LOG_FACTOR
from semlive.diagnose.two_runs.disc_basis import AFFINE, DiscDistortion, disc_radius_px, distortion_on_disc, modes
from semlive.diagnose.two_runs.scan_axes import ScanAxes, scan_axes
from semlive.errors import IllPosed

Array = NDArray[np.float64]
RAMP_EFFECT_NAME = "scan_nonlinearity"
SCAN_TIME_TOLERANCE = 0.01  # relative difference of dwell or row time below which scan times count as equal
SIZES_PX = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)  # prior size of second-order polynomials; half of it for each further order
RAMP_SIZES_PX = (0.03, 0.1, 0.3, 1.0, 3.0)  # at the edge of the frame
CENTRE_PX = 5.0  # prior distance of the centre of rotation from the frame centre
MIN_DISC_RADIUS_PX = 50.0
_STEP = 1e-4
_RAMPS = ("quadratic_x_px", "cubic_x_px", "quadratic_y_px", "cubic_y_px")


@dataclass(frozen=True, slots=True, eq=False)
class DistortionPair:
    """The distortions of two runs on one disc.

    Attributes:
        value_px: (4 k,) polynomials along x and y of the first run, then of the second.
        covariance_px2: (4 k, 4 k) covariance of the values.
        column_fixed_map: (2 k, 2 k) map from the first run to the second for a distortion fixed in the column.
        nuisance_covariance_px2: (2 k, 2 k) covariance by the uncertainty of rotation, axes and centre.
        ramps: (2 k, 4) nonlinear ramps of 1 px at the edge of the frame.
    """

    value_px: Array
    covariance_px2: Array
    column_fixed_map: Array
    nuisance_covariance_px2: Array
    ramps: Array


@dataclass(frozen=True, slots=True, eq=False)
class _HypothesisFit:
    """Log likelihood of a hypothesis at its most likely size, and amplitudes of the scan ramps with their covariance."""

    log: float
    part_px: Array
    covariance_px2: Array


def analyse_scan_rotation(runs: Sequence[HyperparameterGrid]) -> TwoRunVerdict | None:
    """Verdict of two runs with a rotated scan in the second; None if it was not rotated or the data do not determine it.

    Args:
        runs: baselines of the runs, with the given effects.
    """
    if len(runs) != 2:
        return None
    radius_px = min(disc_radius_px(run) for run in runs)
    if radius_px < MIN_DISC_RADIUS_PX:
        return None
    observed = [distortion_on_disc(run, radius_px) for run in runs]
    axes = scan_axes(runs, [entry.slope for entry in observed])
    if axes is None:
        return None
    _require_comparable(runs, axes)
    half_px = np.asarray(runs[0].design.observation.state.centre_px)
    return verdict(axes, fields_of(observed, axes, radius_px, half_px), half_px)


def scan_times_s(runs: Sequence[HyperparameterGrid]) -> Array:
    """(n, 2) dwell and row time of each run."""
    scans = [run.design.observation.state.frame_time(0).timing for run in runs]
    return np.array([[scan.dwell_time_s.value, scan.row_time_s.value] for scan in scans])


def same_scan_times(times_s: Array) -> bool:
    """Whether dwell and row times (n, 2) are equal."""
    return float(np.ptp(np.log(times_s), axis=0).max()) < SCAN_TIME_TOLERANCE


def _require_comparable(runs: Sequence[HyperparameterGrid], axes: ScanAxes) -> None:
    degrees = math.degrees(axes.turn.value)
    if not same_scan_times(scan_times_s(runs)):
        raise IllPosed(
            f"the scan was rotated by {degrees:.0f} degrees and has another dwell or row time, too: the two changes cannot be separated; "
            "change one of them at a time"
        )
    centres = [run.design.observation.state.centre_px for run in runs]
    if not np.array_equal(centres[0], centres[1]):
        raise IllPosed(f"the scan was rotated by {degrees:.0f} degrees and the frame sizes differ: record both runs with one size")


def fields_of(observed: Sequence[DiscDistortion], axes: ScanAxes, radius_px: float, half_px: Array) -> DistortionPair:
    """Distortions of two runs, prepared for comparison.

    Args:
        observed: distortions of the runs.
        axes: scan axes of the second run relative to the first.
        radius_px: radius of the disc.
        half_px: (2,) distance from the frame centre to its edges.
    """
    first, second = observed
    value_px = first.value_px.ravel()
    fixed = _column_fixed_map(axes.matrix, np.zeros(2))
    scale = np.concatenate((np.sqrt(np.linalg.eigvalsh(axes.covariance).clip(0.0)), np.full(2, CENTRE_PX / radius_px)))
    ways = np.linalg.eigh(axes.covariance)[1]
    slopes = []
    for way, size in zip((*ways.T, None, None), scale, strict=True):
        at = len(slopes)
        turn = np.zeros((2, 2)) if way is None else way.reshape(2, 2)
        aside = np.eye(2)[at - 4] if way is None else np.zeros(2)
        ahead, behind = (_column_fixed_map(axes.matrix + sign * _STEP * turn, sign * _STEP * aside) for sign in (1.0, -1.0))
        slopes.append((ahead - behind) @ value_px * (size / (2.0 * _STEP)))
    loose = np.stack(slopes, axis=1)
    covariance = np.asarray(block_diag(first.covariance_px2, second.covariance_px2))
    value = np.concatenate((value_px, second.value_px.ravel()))
    return DistortionPair(value, covariance, fixed, loose @ loose.T, _ramps(radius_px, half_px))


def _column_fixed_map(between: Array, aside: Array) -> Array:
    """Map of E1 to T E1(T^-1 (R - a)) in polynomials on the disc; a in radii."""
    basis = modes()
    return np.asarray(np.kron(between, basis.moved((basis.at - aside) @ np.linalg.inv(between).T)), dtype=np.float64)


def _ramps(radius_px: float, half_px: Array) -> Array:
    basis = modes()
    from_centre = basis.at * radius_px / half_px
    parts = [basis.project(np.stack((value**2, value**3), axis=-1))[AFFINE:] for value in from_centre.T]
    return np.asarray(block_diag(*parts))


def _prior_variances() -> Array:
    """(2 k,) prior variances of the polynomials for 1 px at second order."""
    return np.asarray(np.tile(4.0 ** -(modes().order[AFFINE:] - 2.0), 2), dtype=np.float64)


def _fit_hypothesis(fields: DistortionPair, field: Array, ramp_px: float, loose: bool) -> _HypothesisFit:
    """Log likelihood of one hypothesis.

    Args:
        fields: distortions of both runs.
        field: (4 k, 4 k) prior covariance of the distortions.
        ramp_px: prior size of additional scan ramps.
        loose: whether the uncertainty of the rotation contributes.
    """
    spread = field + fields.covariance_px2
    if loose:
        spread[len(fields.column_fixed_map) :, len(fields.column_fixed_map) :] += fields.nuisance_covariance_px2
    ramps = np.concatenate((fields.ramps, fields.ramps)) * ramp_px
    factor = cho_factor(spread + ramps @ ramps.T, lower=True)
    gradient = cho_solve(factor, fields.value_px)
    log = -0.5 * float(fields.value_px @ gradient) - float(np.sum(np.log(np.diag(factor[0]))))
    inner = ramps.T @ cho_solve(factor, ramps)
    return _HypothesisFit(log, ramp_px * (ramps.T @ gradient), ramp_px**2 * (np.eye(inner.shape[0]) - inner))


def rotation_hypotheses(fields: DistortionPair) -> dict[str, _HypothesisFit]:
    """Most likely size of each hypothesis: fixed in the `column`, in the `scan`, in `both`, or separate for each run (`neither`)."""
    prior = np.diag(_prior_variances())
    column_fixed, scan_fixed = np.concatenate((np.eye(len(prior)), fields.column_fixed_map)), np.concatenate((np.eye(len(prior)),) * 2)
    kinds = {"column": (column_fixed @ prior @ column_fixed.T, True), "scan": (scan_fixed @ prior @ scan_fixed.T, False),
             "neither": (block_diag(prior, prior), False)}  # fmt: skip
    fits = {
        name: _most_likely([_fit_hypothesis(fields, size**2 * field, 0.0, loose) for size in SIZES_PX])
        for name, (field, loose) in kinds.items()
    }
    column, _ = kinds["column"]
    ramped = [_most_likely([_fit_hypothesis(fields, size**2 * column, ramp, True) for size in SIZES_PX]) for ramp in RAMP_SIZES_PX]
    best_ramp = _most_likely(ramped)
    mean = float(np.logaddexp.reduce([hypothesis.log for hypothesis in ramped])) - math.log(len(ramped))
    return fits | {"both": _HypothesisFit(mean, best_ramp.part_px, best_ramp.covariance_px2)}


def _most_likely(fits: Sequence[_HypothesisFit]) -> _HypothesisFit:
    return max(fits, key=lambda candidate: candidate.log)


def verdict(axes: ScanAxes, fields: DistortionPair, half_px: Array) -> TwoRunVerdict:
    """Verdict on scan axes, scan ramps and the frame in which the distortion is fixed.

    A distortion that changes between the runs also changes its affine part, which would be attributed to the axes (2 of 25 runs). In this
    case no effect of the axes is reported.

    Args:
        axes: scan axes of the second run relative to the first.
        fields: distortions of both runs.
        half_px: (2,) distance from the frame centre to its edges.
    """
    hypotheses, axis_factors = rotation_hypotheses(fields), axes.log_bayes_factors()
    logs = {name: candidate.log for name, candidate in hypotheses.items()}
    of_scan = max(logs["scan"], logs["both"]) - logs["column"]
    neither_log_odds = logs["neither"] - max(logs["column"], logs["scan"], logs["both"])
    follows = _follows(logs)
    factors = {name: factor for name, (_, _, factor) in axis_factors.items()} | {RAMP_EFFECT_NAME: of_scan}
    effects = [
        SharedEffect(name, (name,), abs(value.value) * float(half), (value,))
        for half, (name, (value, p_value, factor)) in zip(half_px, axis_factors.items(), strict=True)
        if follows != "neither" and factor >= SIGNIFICANT_LOG_FACTOR and len(axis_factors) * p_value <= SIGNIFICANCE_LEVEL
    ]
    if follows in ("scan", "both"):
        effects.append(_ramped(fields, hypotheses["both"], follows))
    effects.sort(key=lambda candidate: -factors[candidate.name])
    outcome = Outcome.UNKNOWN if follows == "neither" else Outcome.IDENTIFIED if effects else Outcome.NONE
    evidence = tuple(sorted(factors.items(), key=lambda item: -item[1]))
    rotation = ScanRotation(axes.turn, axes.x_excess, axes.skew, follows, of_scan)
    return TwoRunVerdict(outcome, effects[0] if effects else None, (), evidence, neither_log_odds, tuple(effects), rotation)


def _follows(logs: dict[str, float]) -> str:
    """Frame in which the distortion is fixed: ``column``, ``scan``, ``both``, ``neither``; empty if undetermined."""
    candidates = {name: logs[name] for name in ("column", "scan", "both")}
    best = max(candidates, key=lambda name: candidates[name])
    if logs["neither"] > candidates[best] + SIGNIFICANT_LOG_FACTOR:
        return "neither"
    rival = max(candidates["scan"], candidates["both"]) if best == "column" else candidates["column"]
    if best == "column":
        return "column" if candidates["column"] > candidates["scan"] + SIGNIFICANT_LOG_FACTOR else ""
    return best if candidates[best] > rival + SIGNIFICANT_LOG_FACTOR else ""


def _ramped(fields: DistortionPair, screening: _HypothesisFit, follows: str) -> SharedEffect:
    """Effect of the scan ramps: the complete distortion if it is fixed in the scan, otherwise the fitted ramps."""
    k = len(fields.ramps)
    part = fields.value_px[:k] if follows == "scan" else fields.ramps @ screening.part_px
    moved = part.reshape(2, -1) @ modes().values(modes().at)[:, AFFINE:].T
    sigma = np.sqrt(np.diag(screening.covariance_px2).clip(0.0))
    parameters = [ParameterEstimate(*value, "px") for value in zip(_RAMPS, map(float, screening.part_px), map(float, sigma), strict=True)]
    return SharedEffect(
        RAMP_EFFECT_NAME, (RAMP_EFFECT_NAME,), float(np.max(np.hypot(*moved))), tuple(parameters) if follows == "both" else ()
    )
