"""Test of adequacy, one for the live warning, for replay and for the verdict: whether the residual of the maps is more than noise.

The contrasts are those of the domain tests. Under the null hypothesis the residual of a contrast after marginalising the baseline is
Gaussian with a covariance known up to the size of the noise, which the rough part of the residual determines. The ratio of its squared norm
to that size is F distributed, so no draws are needed. In maps of few independent points (30 blocks of smoothed maps) the size is uncertain
by 4 %: with a chi-squared distribution 7 of 100 such runs without an effect were significant.

Three parts of a residual are not an inadequate model, so they belong to the null hypothesis:

- what the estimate corrects: changes of the raster that it uses, and effects of a model;
- the own bias of the correlation, a wave over the fraction of a pixel of at most `OWN_BIAS_PX`;
- a residual so small that it is harmless: at most `HARMLESS_STRAIN`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from semlive.data.diagnosis.effects import DomainTest
from semlive.data.diagnosis.verdict import AdequacyTest
from semlive.data.notes import Note, NoteCode, information, warning
from semlive.data.pair import PairDecision
from semlive.diagnose.baseline.baseline import HyperparameterGrid, with_free_distortion
from semlive.diagnose.baseline.bayes_factor import project
from semlive.diagnose.baseline.design_matrix import BaselineEffect, DesignMatrix, design
from semlive.diagnose.baseline.noise_scale import most_likely_whitener, noise_scale, rough_modes
from semlive.diagnose.baseline.observation import MIN_PAIRS, Observation, evaluate_estimate
from semlive.diagnose.baseline.unequal_noise import unequal_noise
from semlive.diagnose.baseline.whitening import Whitener
from semlive.diagnose.fit_tests.domain_tests import MIN_RELATIVE_EIGENVALUE, domain_contrasts, fraction_waves
from semlive.diagnose.fit_tests.spatial_lines import SPATIAL_LINES, spatial_line_test
from semlive.estimate.joint.observations.normal_equations import map_columns
from semlive.estimate.joint.solution.posterior import Solution
from semlive.model.effects import RunGeometry
from semlive.model.effects.maps.apparent_motion import DIC_SUBPIXEL_BIAS

Array = NDArray[np.float64]
AllowedField = tuple[Array, float]
FALSE_ALARM_RATE = 0.01
"""Fraction of runs without a hidden effect, of any length, in which at least one test is significant; the tests share it."""
OWN_BIAS_PX = 1e-3  # cubic spline on rendered and on independent images: 0.0008 to 0.0009 px; quintic a third of it
HARMLESS_STRAIN = 2e-6  # a thirtieth of the strain noise in Sutton et al. (2007), 6e-5
_MIN_RANGE_SIGMAS = 10.0
"""Smallest range of strain, in standard uncertainties, for which a change of Young's modulus is stated."""
RASTER_PX = 1.0  # prior standard deviation of a used raster term at a knot: much more than any drift of the raster


@dataclass(frozen=True, slots=True)
class Adequacy:
    """Result of the test for a run so far.

    Attributes:
        pairs: number of pairs.
        where: test of each domain; p-values are corrected for the number of domains of this test. The test for waves over the field comes
            last, with a correction of its own: it has no alarm that noise causes (`MIN_PROMINENCE`).
        field_px: longest edge of the measured field, px.
    """

    pairs: int
    where: tuple[DomainTest, ...]
    field_px: float

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

    @property
    def test(self) -> AdequacyTest:
        """The domain with the smallest p-value, with the significance level."""
        least = min(self.where, key=lambda candidate: (candidate.p_value, -candidate.rms_px))  # p-values end at 0
        return AdequacyTest(least.domain, least.p_value, least.rms_px, self.significance_level)

    def notes(self, mean_strain_sigma: float | None = None, strain_range: float = 0.0) -> tuple[Note, ...]:
        """Note for the operator; empty if no domain is significant.

        It is a warning, unless the residual displaces points less than a strain of the stated uncertainty does.

        Args:
            mean_strain_sigma: stated standard uncertainty of the mean strain of a frame; None if unknown.
            strain_range: range of the mean strains over the load steps.
        """
        test = self.most_significant
        if test is None:
            return ()
        strain = _strain_of(test.rms_px, self.field_px)
        chance = f"p = {test.p_value:.1g}" if test.p_value >= 1e-99 else "p < 1e-99"
        text = (
            f"the residual of the maps after {self.pairs} pairs is not white, test over {_DOMAIN_TEXT[test.domain]}: {chance}, "
            f"{test.rms_px:.4f} px rms, as much as by a strain of {strain:.0e} over the field; an effect is missing in the model"
        )
        if mean_strain_sigma is None or not strain <= mean_strain_sigma:
            return (warning(NoteCode.RESIDUAL, text),)
        text += f"; on average over the frames it is within the stated uncertainty of mean strain ({mean_strain_sigma:.0e})"
        if strain_range > _MIN_RANGE_SIGMAS * mean_strain_sigma:
            text += f" and changes Young's modulus by at most {100.0 * strain / strain_range:.1g} %"
        return (information(NoteCode.RESIDUAL, text),)


_DOMAIN_TEXT = {
    "space": "the position in the field",
    "row": "the row",
    "row_start": "the distance from the start of rows and frames",
    "scan_time": "the time within each frame",
    "frame": "the frame",
    "load": "the load",
    "fraction": "the fraction of a pixel",
    SPATIAL_LINES: "waves over the field",
}


def adequacy_after(solution: Solution, decisions: Sequence[PairDecision], modelled_hz: Sequence[float] = ()) -> Adequacy | None:
    """Test the residual of an estimate; None with too few pairs or points, or more pairs than one matrix holds.

    Args:
        solution: solution of the joint method after the newest pair.
        decisions: decisions of all pairs.
        modelled_hz: frequencies of waves in the model.
    """
    return evaluate_estimate(solution, decisions, lambda observation: adequacy_of(observation, modelled_hz=modelled_hz))


def adequacy_of(
    observation: Observation, whiten: Whitener | None = None, effects: Sequence[AllowedField] = (), modelled_hz: Sequence[float] = ()
) -> Adequacy:
    """Test the residual of an observation. Where equal noise fails, noise that differs between frames and places is tested too.

    Args:
        observation: observation of a run.
        whiten: correlation of the noise; None for the most likely one. Its size is estimated again.
        effects: fields (f, b, 2, q) of further effects, px, with the prior standard deviation of their amplitudes, px.
        modelled_hz: frequencies of identified waves of the beam, whose lines over the field are no misfit.
    """
    result, baseline = _tested(design(observation, whiten or most_likely_whitener(observation)), effects)
    return replace(result, where=(*result.where, spatial_line_test(baseline, modelled_hz)))


def adequacy_of_design(columns: DesignMatrix, effects: Sequence[AllowedField] = ()) -> Adequacy:
    """Test the residual of the columns of a baseline without effects, except for waves over the field."""
    return _tested(columns, effects)[0]


def _tested(columns: DesignMatrix, effects: Sequence[AllowedField]) -> tuple[Adequacy, HyperparameterGrid]:
    """Tests of the domains, and the baseline with the allowed fields and equal noise."""
    observation = columns.observation
    raster, waves = (_used_raster_changes(observation), RASTER_PX), (fraction_waves(observation.geometry), OWN_BIAS_PX)
    allowed = [field for field in (*effects, raster, waves) if field[0].shape[-1]]
    baseline, freedom = _noise_scaled(columns, allowed)
    result = Adequacy(len(observation.steps), _domain_tests(baseline, freedom), _edge_px(observation.geometry))
    noise = None if result.most_significant is None else unequal_noise(baseline)
    if noise is None:
        return result, baseline
    return replace(result, where=_domain_tests(*_noise_scaled(design(observation, noise.whiten), allowed))), baseline


def _noise_scaled(columns: DesignMatrix, allowed: Sequence[AllowedField]) -> tuple[HyperparameterGrid, float]:
    """The baseline with the allowed fields in units of the noise, with one pass for the noise, one drift prior and a free distortion.

    The second value is the number of independent values that determine the noise.
    """
    for field_px, size_px in allowed:
        columns = columns.with_effects(BaselineEffect(columns.whiten(field_px), size_px))
    scale = noise_scale(with_free_distortion(columns), rough_modes(columns.observation))
    return with_free_distortion(columns.rescaled(scale.ratio)), scale.freedom


def _used_raster_changes(observation: Observation) -> Array:
    """(f, b, 2, q) displacement by unit values of the raster terms that the estimate uses, px."""
    state = observation.state
    sizes_px = observation.solution.hyper.raster_px
    parts = [state.layout.part(change.name) for change, size_px in zip(state.raster, sizes_px, strict=False) if size_px]
    used = np.concatenate([np.arange(part.start, part.stop) for part in parts]) if parts else np.zeros(0, dtype=np.int64)
    fields = np.zeros((observation.frames, observation.blocks, 2, len(used)))
    for frame, rows in enumerate(observation.rows if parts else (), start=1):
        for axis, (index, value) in enumerate(map_columns(state, rows, state.linearisation_point)):
            _, own, at = np.intersect1d(index, used, return_indices=True)
            fields[frame][:, axis, at] = value[np.ix_(observation.valid_blocks, own)]
    return fields


def _domain_tests(baseline: HyperparameterGrid, freedom: float) -> tuple[DomainTest, ...]:
    scene = baseline.design.observation.geometry
    contrasts = domain_contrasts(scene)
    f, b, _ = baseline.whitened_residual.shape
    tests = []
    for domain, field in contrasts:
        projection = project(baseline, field)
        values, gradient = projection.values[0], projection.gradient[0]
        observed = values > MIN_RELATIVE_EIGENVALUE * values[-1]
        values, squares, count = values[observed], gradient[observed] ** 2, int(observed.sum())
        amplitude_px = harmless_px(scene) / float(np.sqrt(np.mean(np.sum(field**2, axis=-1)))) if count else 0.0
        power = float(np.sum(squares / (values + (values * amplitude_px) ** 2)))
        rms_px = baseline.design.whiten.sigma_px * float(np.sqrt(max(float(np.sum(squares / values)) - count, 0.0) / (2 * f * b)))
        p_value = float(fdtrc(count, freedom, power / count)) if count else 1.0
        tests.append(DomainTest(domain, min(1.0, len(contrasts) * p_value), rms_px))
    return tuple(tests)


def harmless_px(scene: RunGeometry) -> float:
    """Root mean square of the displacement by `HARMLESS_STRAIN` over the field, px."""
    return HARMLESS_STRAIN * _edge_px(scene) / float(np.sqrt(12.0))


def _edge_px(scene: RunGeometry) -> float:
    """Longest edge of the measured field, px."""
    return float(np.ptp(scene.address_px[0], axis=0).max())


def _strain_of(rms_px: float, field_px: float) -> float:
    """Uniform strain along the longest edge of the field that displaces its points by this root mean square."""
    return rms_px * float(np.sqrt(12.0)) / field_px


def negligible_px(name: str, scene: RunGeometry) -> float:
    """Largest displacement that is not reported as an effect: a harmless one, or the own bias of the correlation for its name, px."""
    own_bias_px = float(np.sqrt(2.0)) * OWN_BIAS_PX if name == DIC_SUBPIXEL_BIAS.name else 0.0
    return max(harmless_px(scene), own_bias_px)
