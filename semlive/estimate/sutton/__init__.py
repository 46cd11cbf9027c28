"""The published procedure: M. A. Sutton et al., Experimental Mechanics (2007), equations 1-10 and Fig. 3.

The drift velocity at every position follows from the two frames of each pair by central differences. A B-spline of few coefficients in time
is fitted at every position and integrated, in the first frame along the path of the beam. A B-spline distortion and all motions are then
estimated together from the first frames of the pairs (bundle adjustment). The steps are repeated with corrected distortion until they
converge. This batch method is a reference for comparison: the second frames determine only the drift, and the covariance is approximate.

`SuttonOptions` and the settings state what the paper does not specify. The figures of its numerical experiment are reached only with
a smoothing of the local drift over positions, which the paper does not mention: Gaussian, 60 px by default.
"""

from semlive.estimate.sutton.procedure import SuttonOptions, SuttonSolution, solve, solve_incremental
from semlive.estimate.sutton.results import (
    consistency_notes,
    correction,
    correction_sigmas,
    correction_strain_sigma,
    correction_strains,
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
