"""From disparity maps to drift, distortion and motion, with uncertainty."""

from semlive.estimate.accumulate import update
from semlive.estimate.follow import follow, newest, solve
from semlive.estimate.publish import checks, correction, correction_strain_sigma, estimate, live_rate, mean_strain_covariance
from semlive.estimate.solve import Solution
from semlive.estimate.state import EstimatorState, init

__all__ = [
    "EstimatorState",
    "Solution",
    "checks",
    "correction",
    "correction_strain_sigma",
    "estimate",
    "follow",
    "init",
    "live_rate",
    "mean_strain_covariance",
    "newest",
    "solve",
    "update",
]
