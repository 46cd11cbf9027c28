"""From disparity maps to drift, distortion and motion, with uncertainty."""

from semlive.estimate.accumulate import update
from semlive.estimate.outlook import forecast
from semlive.estimate.posterior import Solution
from semlive.estimate.publish import checks, correction, estimate, live_rate, mean_strain_covariance
from semlive.estimate.sequence import follow, live, newest, solve
from semlive.estimate.state import EstimatorState, init
from semlive.estimate.told_strain import CorrectionStrain, correction_strain, correction_strain_sigma, strain_moved

__all__ = [
    "CorrectionStrain",
    "EstimatorState",
    "Solution",
    "checks",
    "correction",
    "correction_strain",
    "correction_strain_sigma",
    "estimate",
    "follow",
    "forecast",
    "init",
    "live",
    "live_rate",
    "mean_strain_covariance",
    "newest",
    "solve",
    "strain_moved",
    "update",
]
