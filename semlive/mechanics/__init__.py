"""From corrected displacement to strain and elastic constants."""

from semlive.mechanics.displacement import displacement
from semlive.mechanics.elastic import elastic_constants
from semlive.mechanics.false_strain import false_strain, typical_distortion
from semlive.mechanics.gauge_noise import expected_mean_sigma, expected_sigma
from semlive.mechanics.strain import strain
from semlive.mechanics.strain_gage import compare_with_gage, gage_notes
from semlive.mechanics.strain_gauge_fits import butterworth, noise_curve, strain_field
from semlive.mechanics.summary import average_of_pair, mean_gradient, summary

__all__ = [
    "average_of_pair",
    "butterworth",
    "compare_with_gage",
    "displacement",
    "elastic_constants",
    "expected_mean_sigma",
    "expected_sigma",
    "false_strain",
    "gage_notes",
    "mean_gradient",
    "noise_curve",
    "strain",
    "strain_field",
    "summary",
    "typical_distortion",
]
