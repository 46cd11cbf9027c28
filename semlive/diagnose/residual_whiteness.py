"""Live test of the diagnosis after each pair: whether the residual of the maps is consistent with white noise.

The contrasts are those of the domain tests. Under the null hypothesis the residual of a contrast after marginalising the baseline is
Gaussian with a known covariance. Its squared norm is chi-squared distributed, so no draws are needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from semlive.data.diagnosis.effects import DomainTest
from semlive.data.notes import Note, NoteCode, warning
from semlive.data.pair import PairDecision
from semlive.diagnose.baseline.baseline import HyperparameterGrid, with_free_distortion
from semlive.diagnose.baseline.bayes_factor import project
from semlive.diagnose.baseline.design_matrix import design
from semlive.diagnose.baseline.noise_scale import residual_scale, rough_modes
from semlive.diagnose.baseline.observation import MIN_PAIRS, Observation, make_observation, step_conditions
from semlive.diagnose.baseline.whitening import make_whitener, most_likely_window
from semlive.diagnose.maps.domain_tests import MIN_RELATIVE_EIGENVALUE, domain_contrasts
from semlive.errors import IllPosed
from semlive.estimate.joint.observations.accumulation import dense_limit
from semlive.estimate.joint.solution.posterior import Solution

FALSE_ALARM_RATE = 0.01
"""Fraction of runs without a hidden effect, of any length, in which at least one test is significant; the tests share it."""


@dataclass(frozen=True, slots=True)
class Whiteness:
    """Result of the residual test of a run so far.

    Attributes:
        pairs: number of pairs.
        where: test of each domain; p-values are corrected for the number of domains of this test.
    """

    pairs: int
    where: tuple[DomainTest, ...]

    @property
    def significance_level(self) -> float:
        """Significance level of this test: the k-th test spends the fraction 1 / (k (k + 1)) of the total false-alarm probability."""
        test_number = self.pairs - MIN_PAIRS + 1
        return FALSE_ALARM_RATE / (test_number * (test_number + 1))

    @property
    def most_significant(self) -> DomainTest | None:
        """The domain with the smallest p-value if it is significant; else None."""
        least = min(self.where, key=lambda candidate: (candidate.p_value, -candidate.rms_px))  # p-values end at 0
        return least if least.p_value <= self.significance_level else None

    def notes(self) -> tuple[Note, ...]:
        """Warning for the operator; empty if no domain is significant."""
        test = self.most_significant
        if test is None:
            return ()
        chance = f"p = {test.p_value:.1g}" if test.p_value >= 1e-99 else "p < 1e-99"
        text = (
            f"the residual of the maps after {self.pairs} pairs is not white, test over {_DOMAIN_TEXT[test.domain]}: {chance}, "
            f"{test.rms_px:.4f} px rms; an effect is missing in the model"
        )
        return (warning(NoteCode.RESIDUAL, text),)


_DOMAIN_TEXT = {
    "space": "the position in the field",
    "row": "the row",
    "row_start": "the distance from the start of rows and frames",
    "scan_time": "the time within each frame",
    "frame": "the frame",
    "load": "the load",
    "fraction": "the fraction of a pixel",
}


def whiteness_test(solution: Solution, decisions: Sequence[PairDecision]) -> Whiteness | None:
    """Test the residual; None with too few pairs or points, or more pairs than one matrix holds.

    Args:
        solution: solution of the joint method after the newest pair.
        decisions: decisions of all pairs.
    """
    if len(decisions) < MIN_PAIRS or dense_limit(solution.state) < len(decisions):
        return None
    try:
        return Whiteness(len(decisions), _domain_tests(_noise_scaled(make_observation(solution, step_conditions(decisions)))))
    except (IllPosed, np.linalg.LinAlgError):  # the run continues; `semlive diagnose` reports the reason
        return None


def _noise_scaled(observation: Observation) -> HyperparameterGrid:
    """The baseline in units of the noise, with one pass for the noise, one drift prior and a free distortion."""
    residual, rough = observation.residual_px(), rough_modes(observation)
    length_px, gaussian = most_likely_window(observation.grid, observation.valid_blocks, residual - residual.mean(axis=0), rough)
    sigma_px = float(residual.std()) or 1e-6
    columns = design(observation, make_whitener(observation.grid, observation.valid_blocks, length_px, sigma_px, gaussian))
    return with_free_distortion(columns.rescaled(residual_scale(with_free_distortion(columns), rough)))


def _domain_tests(baseline: HyperparameterGrid) -> tuple[DomainTest, ...]:
    contrasts = domain_contrasts(baseline.design.observation.geometry)
    f, b, _ = baseline.whitened_residual.shape
    tests = []
    for domain, field in contrasts:
        projection = project(baseline, field)
        values, gradient = projection.values[0], projection.gradient[0]
        observed = values > MIN_RELATIVE_EIGENVALUE * values[-1]
        power, count = float(np.sum(gradient[observed] ** 2 / values[observed])), int(observed.sum())
        rms_px = baseline.design.whiten.sigma_px * float(np.sqrt(max(power - count, 0.0) / (2 * f * b)))
        p_value = float(chdtrc(count, power)) if count else 1.0
        tests.append(DomainTest(domain, min(1.0, len(contrasts) * p_value), rms_px))
    return tuple(tests)
