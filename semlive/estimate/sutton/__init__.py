"""The procedure as published: M. A. Sutton et al., Experimental Mechanics (2007), equations 1-10 and Fig. 3.

Velocity of drift at every position from the two frames of each pair by central difference; a B-spline of few coefficients
in time at every position; integration, the first frame along the beam's way; then a B-spline distortion and all motions at
once from the first frames of the pairs (bundle adjustment); and again with the distortion taken out, until it settles.
A batch and a reference for comparison: the second frames tell of drift alone, and there is no covariance but a plain estimate.

What the paper leaves open is stated in `Options` and in the settings. Its figures on its own numerical experiment are not
reached without a smoothing of the local drift over positions, which it does not mention: 60 px, Gaussian, by default.
"""

from semlive.estimate.sutton.procedure import Options, SuttonSolution, follow, solve
from semlive.estimate.sutton.publish import (
    checks,
    correction,
    correction_sigmas,
    correction_strain_sigma,
    correction_strains,
    estimate,
    live_rate,
    mean_strain_covariance,
    strain_moved,
)
from semlive.estimate.sutton.state import SuttonState, init, kept_elsewhere, update

live = follow
"""A batch has no shorter way."""

__all__ = [
    "Options",
    "SuttonSolution",
    "SuttonState",
    "checks",
    "correction",
    "correction_sigmas",
    "correction_strain_sigma",
    "correction_strains",
    "estimate",
    "follow",
    "init",
    "kept_elsewhere",
    "live",
    "live_rate",
    "mean_strain_covariance",
    "solve",
    "strain_moved",
    "update",
]
