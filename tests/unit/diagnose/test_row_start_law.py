"""Law of the settling at the start of rows and frames, from profiles whose law is known."""

from __future__ import annotations

import numpy as np
import pytest

from semlive.data.diagnosis.effects import Outcome
from semlive.diagnose.row_start.laws import RowStartLaw, row_start_law
from semlive.diagnose.row_start.profile import RowStartProfile

ROWS = ((4.0, 400e-9), (4.0, 1600e-9), (8.0, 400e-9), (8.0, 1600e-9))
FRAMES = tuple((pixel_nm, 1e5 * pixel_s) for pixel_nm, pixel_s in ROWS)  # along y, the row time takes the place of the dwell
TERMS = {1: ((22.0, 1.0),), 2: ((60.0, 0.2), (45.0, 1.8))}


def profile(law: RowStartLaw | None, setting: tuple[float, float], terms: int, seed: int) -> RowStartProfile:
    """One setting; lengths are relative to 250 px of 4 nm at the shortest time of the settings."""
    pixel_nm, pixel_s = setting
    shortest_s = ROWS[0][1] if pixel_s < 1e-3 else FRAMES[0][1]
    rng, distance = np.random.default_rng(seed), np.arange(2.0, 1400.0, 12.0)
    shift = np.full(len(distance), 0.05)
    ratios = {RowStartLaw.TIME: shortest_s / pixel_s, RowStartLaw.POSITION: 4.0 / pixel_nm, RowStartLaw.PIXELS: 1.0}
    for amplitude, length in TERMS[terms] if law else ():
        by_position = ratios[law or RowStartLaw.TIME]
        size_px = amplitude / (4.0 if law is RowStartLaw.PIXELS else pixel_nm)
        shift += size_px * np.exp(-distance / (250.0 * length * by_position))
    sigma = np.full(len(distance), 0.02)
    return RowStartProfile(pixel_nm, pixel_s, distance, shift + rng.normal(0.0, 0.02, len(distance)), sigma)


@pytest.mark.parametrize("terms", [1, 2])
@pytest.mark.parametrize("settings", [ROWS, FRAMES], ids=["along x", "along y"])
@pytest.mark.parametrize("law", list(RowStartLaw))
def test_law_and_number_of_lengths_are_found(law: RowStartLaw, settings: tuple[tuple[float, float], ...], terms: int) -> None:
    verdict = row_start_law([profile(law, setting, terms, seed) for seed, setting in enumerate(settings)])
    assert (verdict.outcome, verdict.laws, verdict.terms) == (Outcome.IDENTIFIED, (law,), terms)


def test_length_in_position_is_measured() -> None:
    verdict = row_start_law([profile(RowStartLaw.POSITION, setting, 1, seed) for seed, setting in enumerate(ROWS)])
    assert verdict.amplitudes == pytest.approx((22.0,), rel=0.05)
    assert verdict.constants == pytest.approx((1000.0,), rel=0.05)


def test_without_settling_nothing_is_named() -> None:
    verdict = row_start_law([profile(None, setting, 1, seed) for seed, setting in enumerate(ROWS)])
    assert (verdict.outcome, verdict.laws) == (Outcome.NONE, ())


def test_one_setting_decides_nothing_and_the_best_experiment_varies_pixel_size_and_dwell() -> None:
    verdict = row_start_law([profile(RowStartLaw.POSITION, ROWS[0], 1, 0)])
    assert (verdict.outcome, set(verdict.laws)) == (Outcome.AMBIGUOUS, set(RowStartLaw))
    best = verdict.experiments[0]
    assert best.setting.pixel_nm != ROWS[0][0]
    assert best.setting.pixel_s != ROWS[0][1]
    assert best.log_odds > 3.0


def test_two_dwell_times_leave_position_and_pixels_and_the_next_experiment_varies_the_pixel_size() -> None:
    verdict = row_start_law([profile(RowStartLaw.POSITION, setting, 1, seed) for seed, setting in enumerate(ROWS[:2])])
    assert (verdict.outcome, set(verdict.laws)) == (Outcome.AMBIGUOUS, {RowStartLaw.POSITION, RowStartLaw.PIXELS})
    assert verdict.experiments[0].setting.pixel_nm != ROWS[0][0]


def test_the_forecast_odds_of_an_experiment_are_reached() -> None:
    profiles = [profile(RowStartLaw.POSITION, setting, 1, seed) for seed, setting in enumerate(ROWS[:2])]
    proposed = next(e for e in row_start_law(profiles).experiments if (e.setting.pixel_nm, e.setting.pixel_s) == ROWS[3])
    after = row_start_law([*profiles, profile(RowStartLaw.POSITION, ROWS[3], 1, 3)])
    odds = after.evidence[RowStartLaw.POSITION] - max(after.evidence[law] for law in (RowStartLaw.TIME, RowStartLaw.PIXELS))
    assert after.laws == (RowStartLaw.POSITION,)
    assert odds > 0.5 * proposed.log_odds


def test_lengths_that_follow_no_law_are_unknown() -> None:
    lengths = (1.0, 8.0, 6.0, 0.7)
    made = [profile(RowStartLaw.PIXELS, setting, 1, seed) for seed, setting in enumerate(ROWS)]
    strange = [
        RowStartProfile(one.pixel_nm, one.pixel_s, one.distance_px, 5.0 * np.exp(-one.distance_px / (100.0 * by)), one.sigma_px)
        for one, by in zip(made, lengths, strict=True)
    ]
    assert row_start_law(strange).outcome is Outcome.UNKNOWN
