"""From disparity maps to drift, distortion and motion, with uncertainty."""

from semlive.estimate.joint.observations.accumulation import update
from semlive.estimate.joint.observations.state import EstimatorState, init, offload
from semlive.estimate.joint.outputs.correction_strain import (
    CorrectionStrain,
    correction_strain,
    correction_strain_sigma,
    correction_strains,
    strain_change,
)
from semlive.estimate.joint.outputs.drift_forecast import forecast
from semlive.estimate.joint.outputs.point_sigma import correction_sigmas
from semlive.estimate.joint.outputs.results import consistency_notes, correction, current_drift_rate, mean_strain_covariance, to_estimate
from semlive.estimate.joint.solution.posterior import Solution
from semlive.estimate.joint.solution.solver import solve, solve_incremental, solve_live, solve_newest

__all__ = [
    "CorrectionStrain",
    "EstimatorState",
    "Solution",
    "consistency_notes",
    "correction",
    "correction_sigmas",
    "correction_strain",
    "correction_strain_sigma",
    "correction_strains",
    "current_drift_rate",
    "forecast",
    "init",
    "mean_strain_covariance",
    "offload",
    "solve",
    "solve_incremental",
    "solve_live",
    "solve_newest",
    "strain_change",
    "to_estimate",
    "update",
]
