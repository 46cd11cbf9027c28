"""From corrected displacement to strain and elastic constants."""

from semlive.mechanics.displacement import displacement
from semlive.mechanics.elastic import elastic_constants
from semlive.mechanics.gage import compare_with_gage, gage_notes
from semlive.mechanics.gauge_noise import expected_mean_sigma, expected_sigma
from semlive.mechanics.local_fit import butterworth, noise_curve, strain_as
from semlive.mechanics.strain import strain
from semlive.mechanics.summary import mean_gradient, pooled, summary
from semlive.mechanics.translation import false_strain, typical_distortion

__all__ = [
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
    "pooled",
    "strain",
    "strain_as",
    "summary",
    "typical_distortion",
]
