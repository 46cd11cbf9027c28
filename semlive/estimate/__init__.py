"""From disparity maps to drift, distortion and motion, with uncertainty."""

from semlive.estimate.accumulate import update
from semlive.estimate.outlook import forecast
from semlive.estimate.point_sigma import correction_sigma, correction_sigmas
from semlive.estimate.posterior import Solution
from semlive.estimate.publish import checks, correction, estimate, live_rate, mean_strain_covariance
from semlive.estimate.sequence import follow, live, newest, solve
from semlive.estimate.state import EstimatorState, init, kept_elsewhere
from semlive.estimate.told_strain import CorrectionStrain, correction_strain, correction_strain_sigma, correction_strains, strain_moved

__all__ = [
    "CorrectionStrain",
    "EstimatorState",
    "Solution",
    "checks",
    "correction",
    "correction_sigma",
    "correction_sigmas",
    "correction_strain",
    "correction_strain_sigma",
    "correction_strains",
    "estimate",
    "follow",
    "forecast",
    "init",
    "kept_elsewhere",
    "live",
    "live_rate",
    "mean_strain_covariance",
    "newest",
    "solve",
    "strain_moved",
    "update",
]
