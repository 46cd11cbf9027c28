"""Waves near multiples of the row rate are found in the maps within pairs; drift, distortion and noise are none."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from blind.experiment import Conditions
from blind.observing import QUICK, observed
from scipy.ndimage import gaussian_filter1d, uniform_filter

from semlive.data.diagnosis.effects import Outcome
from semlive.data.diagnosis.verdict import AdequacyTest, Diagnosis
from semlive.data.grid import Grid
from semlive.diagnose.baseline.noise_scale import noise_scaled_baseline
from semlive.diagnose.baseline.observation import Observation
from semlive.diagnose.combine import add_map_wave_verdict
from semlive.diagnose.fit_tests.adequacy import adequacy_of
from semlive.diagnose.fit_tests.spatial_lines import spatial_line_test
from semlive.diagnose.rows.map_series import make_map_series, map_series, wave_fields
from semlive.diagnose.rows.map_waves import _taper, diagnose_map_waves
from semlive_simulators.effects.interfaces import Effect, PixelVisits, Plane

GRID = Grid(101, 101, 20, 38, 30, 43)
FIVE_PAIRS = Conditions(61, calibration=5, tension=0, subset_px=43)


@dataclass(frozen=True, slots=True)
class SampledVibration(Effect):
    """A vibration, 0.05 px, as complete rows sample it: between rows it continues with its alias, so that addresses are unique.

    With more cycles over 740 px it is a wave over the field, such as moire, and none of the beam.
    """

    name = "vibration"
    frequency_hz: float
    extra_cycles: float = 0.0

    def offset_px(self, at: PixelVisits) -> Plane:
        """Equal waves in both axes, with a phase of its own in every frame."""
        row_time_s = at.scan.frame_time_s / at.scan.height_px
        cycles = self.frequency_hz * row_time_s
        phase = (cycles - round(cycles)) * at.y_px + (self.frequency_hz * at.scan.dwell_time_s + self.extra_cycles / 740.0) * at.x_px
        wave = 0.05 * np.sin(2.0 * np.pi * (phase + np.random.default_rng(at.frame).uniform()))
        return wave, wave


def run(*effects: Effect, seed: int = 61) -> Observation:
    return observed(replace(FIVE_PAIRS, seed=seed), effects, GRID, QUICK)


@pytest.fixture(scope="module")
def shaken() -> Observation:
    """A wave of 4 times the row rate of 9.34 Hz, less 0.05 Hz."""
    return run(SampledVibration(37.3))


def test_a_wave_near_a_multiple_of_the_row_rate_is_identified(shaken: Observation) -> None:
    found = diagnose_map_waves(map_series(shaken))
    assert found is not None
    assert found.outcome is Outcome.IDENTIFIED
    (effect,) = found.effects
    assert effect.name == "vibration"
    values = {parameter.name: parameter for parameter in effect.parameters}
    assert abs(values["frequency_hz"].value - 37.3) < 2e-3
    for name in ("amplitude_x_px", "amplitude_y_px"):
        assert abs(values[name].value - 0.05) < 3.0 * values[name].sigma
        assert values[name].sigma < 0.015


def test_a_wave_that_turns_less_than_once_over_the_columns_is_not_named_at_the_next_multiple() -> None:
    found = diagnose_map_waves(map_series(run(SampledVibration(9.5))))
    assert found is not None
    assert found.outcome is Outcome.IDENTIFIED
    (frequency,) = [parameter for parameter in found.effects[0].parameters if parameter.name == "frequency_hz"]
    assert (found.effects[0].name, frequency.value) == ("vibration", pytest.approx(9.5, abs=4e-3))


def test_a_wave_over_the_field_between_two_multiples_is_not_named() -> None:
    found = diagnose_map_waves(map_series(run(SampledVibration(37.3, 0.45))))
    assert found is not None
    assert (found.outcome, found.effects) == (Outcome.UNKNOWN, ())


def test_drift_distortion_and_noise_are_no_wave() -> None:
    found = diagnose_map_waves(map_series(run()))
    assert found is not None
    assert (found.outcome, found.effects) == (Outcome.NONE, ())
    assert max(factor for _, factor in found.evidence) < 5.0


def test_many_pairs_of_smoothed_noise_are_no_wave() -> None:
    """With so many pairs the level of the noise over frequency matters to a few percent: a wrong one had ln B of 15 and was a vibration."""
    rng, rows, columns = np.random.default_rng(5), np.arange(85, 799, 16), np.arange(85, 939, 16)
    series = []
    for _ in range(28):
        # Filtered along x only in the rows of the points, which takes half the time.
        along_y = [gaussian_filter1d(uniform_filter(rng.normal(size=(884, 1024)), 43), 25.0, axis=0)[rows] for _ in "xy"]
        noise = [gaussian_filter1d(field, 25.0, axis=1) for field in along_y]
        values = [0.028 * field[:, columns] / field.std() for field in noise]
        series.append(make_map_series(values, np.ones(values[0].shape, np.bool_), (rows, columns), 72.0, (94.67 / 884, 1e-4)))
    found = diagnose_map_waves(series)
    assert found is not None
    assert found.outcome is Outcome.NONE
    assert max(factor for _, factor in found.evidence) < 5.0


def test_a_residual_that_is_noise_with_the_wave_is_explained_by_it(shaken: Observation) -> None:
    found = diagnose_map_waves(map_series(shaken))
    assert found is not None
    without, with_wave = adequacy_of(shaken), adequacy_of(shaken, effects=[(wave_fields(shaken, 37.3), 0.05)], modelled_hz=(37.3,))
    assert with_wave.most_significant is None
    unknown = Diagnosis(Outcome.UNKNOWN, (), (), None, None, None, (), 0.02, adequacy=without.test)
    assert add_map_wave_verdict(unknown, found, with_wave.test).outcome is Outcome.IDENTIFIED
    failed = AdequacyTest("space", 0.0, 0.1, 1e-4)
    assert add_map_wave_verdict(unknown, found, failed).outcome is Outcome.UNKNOWN
    none = replace(unknown, outcome=Outcome.NONE)
    assert add_map_wave_verdict(none, found, None).outcome is Outcome.IDENTIFIED


def test_a_wave_in_a_frame_has_its_own_phase(shaken: Observation) -> None:
    fields = wave_fields(shaken, 37.3)
    f, b = shaken.geometry.time_s.shape
    assert fields.shape == (f, b, 2, 4 * f)
    assert np.count_nonzero(fields[3].any(axis=(0, 1))) == 4
    assert np.allclose(np.sum(fields**2, axis=-1), 1.0)


def test_half_of_a_taper_is_constant() -> None:
    assert _taper(9) == pytest.approx([0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 0.0])


def test_a_wave_of_the_beam_is_a_line_over_the_field_unless_it_is_modelled(shaken: Observation) -> None:
    baseline = noise_scaled_baseline(shaken)
    assert spatial_line_test(baseline).p_value < 1e-6
    assert spatial_line_test(baseline, (37.3,)).p_value == 1.0
    assert spatial_line_test(baseline, (28.0,)).p_value < 1e-6
