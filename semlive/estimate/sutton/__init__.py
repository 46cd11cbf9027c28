"""The procedure as published: M. A. Sutton et al., Experimental Mechanics (2007), equations 1-10 and Fig. 3.

Velocity of drift at every position from the two frames of each pair by central difference; a B-spline of few coefficients
in time at every position; integration, the first frame along the beam's way; then a B-spline distortion and all motions at
once from the first frames of the pairs (bundle adjustment); and again with the distortion taken out, until it settles.
A batch and a reference for comparison: the second frames tell of drift alone, and there is no covariance but a plain estimate.

What the paper leaves open is stated in `SuttonOptions` and in the settings. Its figures on its own numerical experiment are not
reached without a smoothing of the local drift over positions, which it does not mention: 60 px, Gaussian, by default.
"""

from semlive.estimate.sutton.procedure import SuttonOptions, SuttonSolution, solve, solve_incremental
from semlive.estimate.sutton.results import (
    consistency_notes,
    correction,
    correction_sigmas,
    correction_strain_sigma,
    correction_strains,
    current_drift_rate,
    mean_strain_covariance,
    strain_change,
    to_estimate,
)
from semlive.estimate.sutton.state import SuttonState, init, offload, update

solve_live = solve_incremental
"""A batch has no shorter way."""

__all__ = [
    "SuttonOptions",
    "SuttonSolution",
    "SuttonState",
    "consistency_notes",
    "correction",
    "correction_sigmas",
    "correction_strain_sigma",
    "correction_strains",
    "current_drift_rate",
    "init",
    "mean_strain_covariance",
    "offload",
    "solve",
    "solve_incremental",
    "solve_live",
    "strain_change",
    "to_estimate",
    "update",
]
