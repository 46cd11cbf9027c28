"""Grey levels of frames made here: each effect by its own model, correct uncertainties, no finding without an effect."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import fourier_gaussian, gaussian_filter

from semlive.data.diagnosis.channels import IntensityDiagnosis
from semlive.data.diagnosis.effects import IdentifiedEffect, ModelEffect, Outcome, ParameterEstimate
from semlive.data.diagnosis.verdict import Diagnosis
from semlive.data.disparity import DisparityMap
from semlive.data.grid import Grid
from semlive.diagnose.combine import add_intensity_verdict
from semlive.diagnose.intensity.frames import IntensityFrames, intensity_frame, intensity_reference, pair_noise
from semlive.diagnose.intensity.models import DRIFT, IntensityRegression
from semlive.diagnose.intensity.time_series import intensity_time_series
from semlive.diagnose.intensity.verdict import diagnose_intensity
from semlive.errors import IllPosed

Image = NDArray[np.float64]
Changed = Callable[[Image, Image], Image]
"""Grey levels (height, width) and the seconds (height, 1) at which their rows are scanned, to what the frame shows of them."""
EDGE_PX, ROW_S, PAIR_S = 256, 0.1, 150.0
GRID = Grid(30, 30, 7, 29, 29, 21)
DARK, PER_LEVEL = 9.0, 0.25


def pattern(seed: int = 7) -> Image:
    """Periodic blobs of all grey levels between 40 and 200."""
    rough = np.random.default_rng(seed).standard_normal((EDGE_PX, EDGE_PX))
    smooth = gaussian_filter(rough, 2.0, mode="wrap")
    return 120.0 + 80.0 * np.tanh(1.5 * smooth / smooth.std())


def shifted(image: Image, u_px: float, v_px: float) -> Image:
    """The picture moved by parts of pixels, exactly."""
    down, along = np.fft.fftfreq(EDGE_PX)[:, None], np.fft.fftfreq(EDGE_PX)[None, :]
    return np.real(np.fft.ifft2(np.fft.fft2(image) * np.exp(-2j * np.pi * (down * v_px + along * u_px))))


def blurred(image: Image, sigma_px: float) -> Image:
    return np.real(np.fft.ifft2(fourier_gaussian(np.fft.fft2(image), sigma_px)))


@cache
def moved_pattern(u_px: float, v_px: float) -> Image:
    """The picture moved: every series has the same moves."""
    return shifted(pattern(), u_px, v_px)


def as_it_is(grey: Image, time_s: Image) -> Image:
    return grey


def series(seed: int, changed: Changed = as_it_is, pairs: int = 6, bits: int = 8) -> IntensityFrames:
    """Frames on the same material, which moves from pair to pair and drifts a little within."""
    rng = np.random.default_rng(seed)
    images, maps, starts_s = [], [], []
    for frame in range(2 * pairs):
        u_px, v_px = (0.0, 0.0) if frame == 0 else (3.3 * (frame // 2 % 3) + 0.13 * frame, -2.6 * (frame // 2 % 2) + 0.21 * (frame % 2))
        start_s = PAIR_S * (frame // 2) + 30.0 * (frame % 2)
        grey = changed(moved_pattern(u_px, v_px), start_s + ROW_S * np.arange(EDGE_PX)[:, None])
        noisy = grey + np.sqrt(DARK + PER_LEVEL * grey) * rng.standard_normal(grey.shape)
        scale = 1.0 if bits == 8 else 257.0
        images.append((np.clip(np.round(noisy * scale), 0, 2**bits - 1) / scale).astype(np.float32))
        maps.append(disparity(0, frame, u_px, v_px))
        starts_s.append(start_s)
    reference = intensity_reference(images[0], images[1], maps[1])
    assert reference is not None
    frames = tuple(intensity_frame(reference, images[at], maps[at], starts_s[at], ROW_S) for at in range(1, 2 * pairs))
    noise = []
    for at in range(0, 2 * pairs, 2):
        moved = maps[at + 1].u_px[0, 0] - maps[at].u_px[0, 0], maps[at + 1].v_px[0, 0] - maps[at].v_px[0, 0]
        noise.append(pair_noise(reference.blocks, images[at], images[at + 1], disparity(at, at + 1, *moved)))
    return IntensityFrames(reference, frames, np.array(noise))


def disparity(reference: int, current: int, u_px: float, v_px: float) -> DisparityMap:
    flat = np.ones(GRID.shape)
    return DisparityMap(reference, current, GRID, u_px * flat, v_px * flat, 0.01 * flat, 0.01 * flat, flat, np.zeros(GRID.shape, np.uint8))


@cache
def of_noise(seed: int) -> IntensityDiagnosis:
    """What is found where nothing changed."""
    return diagnose_intensity(series(seed))


def values_and_sigmas(found: IntensityDiagnosis, name: str) -> dict[str, tuple[float, float]]:
    (effect,) = [item for item in found.effects if item.name == name]
    return {item.name: (item.value, item.sigma) for item in effect.parameters}


def names(found: IntensityDiagnosis) -> list[str]:
    return [item.name for item in found.effects]


@pytest.mark.parametrize("seed", range(6))
def test_nothing_is_named_where_nothing_is(seed: int) -> None:
    found = of_noise(seed)
    assert (found.outcome, names(found), found.unexplained) == (Outcome.NONE, [], "")
    assert found.where[0].p_value > 0.002


def test_p_of_intensity_is_spread_evenly() -> None:
    p_values = [of_noise(seed).where[0].p_value for seed in range(40)]
    assert np.mean(np.array(p_values) < 0.3) < 0.5


def test_noise_is_reported_as_a_line_over_grey() -> None:
    dark, slope = of_noise(1).noise
    assert slope.value == pytest.approx(PER_LEVEL, abs=4.0 * slope.sigma)
    assert dark.value == pytest.approx(DARK + 1.0 / 12.0, abs=4.0 * dark.sigma)
    assert slope.sigma < 0.02


def test_gain_is_not_biased_by_noise_and_is_separated_from_blur() -> None:
    def dull(grey: Image, time_s: Image) -> Image:
        return blurred(0.9 * grey + 5.0, 0.5) if time_s[0, 0] > 400.0 else grey

    courses = intensity_time_series(series(2, dull))
    frame = courses.value[-1].mean(axis=0)
    assert frame[0] == pytest.approx(-0.1 * courses.mean + 5.0, abs=0.3)
    assert frame[1] == pytest.approx(-0.1, abs=0.01)
    assert frame[2] == pytest.approx(0.0, abs=0.5)
    assert frame[3] == pytest.approx(0.25, abs=0.05)


@pytest.mark.parametrize("bits", [8, 16])
def test_contamination_reduces_mean_and_contrast_equally(bits: int) -> None:
    found = diagnose_intensity(series(3, lambda grey, time_s: grey * (1.0 - 5e-5 * time_s), bits=bits))
    assert (found.outcome, names(found)) == (Outcome.IDENTIFIED, ["contamination"])
    value, sigma = values_and_sigmas(found, "contamination")["loss_per_s"]
    assert value == pytest.approx(5e-5, abs=4.0 * sigma)
    assert sigma < 5e-6


def test_contamination_is_reported_with_its_black_level() -> None:
    found = diagnose_intensity(series(4, lambda grey, time_s: 25.0 + (grey - 25.0) * (1.0 - 1e-4 * time_s)))
    assert names(found) == ["contamination"]
    value, sigma = values_and_sigmas(found, "contamination")["black_level"]
    assert value == pytest.approx(25.0, abs=4.0 * sigma)
    assert sigma < 10.0


def test_brightness_that_drifts_is_no_contamination() -> None:
    found = diagnose_intensity(series(5, lambda grey, time_s: grey + 0.01 * time_s))
    assert (found.outcome, names(found)) == (Outcome.UNKNOWN, [])
    assert "frames" in found.unexplained
    assert max(found.evidence, key=lambda item: item[1])[0] == DRIFT


def test_an_image_that_brightens_with_dose_is_no_contamination() -> None:
    found = diagnose_intensity(series(5, lambda grey, time_s: grey * (1.0 + 5e-5 * time_s)))
    assert (found.outcome, names(found)) == (Outcome.UNKNOWN, [])


def test_defocus_preserves_the_mean() -> None:
    found = diagnose_intensity(series(6, lambda grey, time_s: blurred(grey, 1e-3 * float(time_s.mean()))))
    assert (found.outcome, names(found)) == (Outcome.IDENTIFIED, ["defocus"])
    value, sigma = values_and_sigmas(found, "defocus")["blur_px_per_s"]
    assert value == pytest.approx(1e-3, abs=4.0 * sigma)
    assert sigma < 5e-5


def test_focus_that_wanders_through_its_best_is_defocus_too() -> None:
    found = diagnose_intensity(series(6, lambda grey, time_s: blurred(grey, 2e-3 * abs(float(time_s.mean()) - 400.0))))
    assert names(found) == ["defocus"]
    assert values_and_sigmas(found, "defocus")["sharpest_s"][0] == pytest.approx(400.0, abs=40.0)


@pytest.mark.parametrize("at_s", [420.0, 463.0])
def test_another_curve_has_its_instant_between_frames_or_in_one(at_s: float) -> None:
    def curve(grey: Image, time_s: Image) -> Image:
        return np.where(time_s >= at_s, 255.0 * 1.04 * (np.maximum(grey, 0.0) / 255.0) ** 0.9 - 6.0, grey)

    found = diagnose_intensity(series(8, curve))
    assert (found.outcome, names(found)) == (Outcome.IDENTIFIED, ["gamma_change"])
    parameters = values_and_sigmas(found, "gamma_change")
    for name, truth, within in (("gain", 1.04, 0.01), ("gamma", 0.9, 0.03), ("offset_levels", -6.0, 4.0)):
        assert parameters[name][0] == pytest.approx(truth, abs=4.0 * parameters[name][1])
        assert parameters[name][1] < within
    assert abs(parameters["at_s"][0] - at_s) <= parameters["at_s"][1] < 80.0


def test_what_the_model_has_is_not_found_again() -> None:
    rows = series(3, lambda grey, time_s: grey * (1.0 - 5e-5 * time_s))
    (effect,) = diagnose_intensity(rows).effects
    assert names(diagnose_intensity(rows, model_effects=[effect.model_effect])) == []
    assert diagnose_intensity(rows, model_effects=[effect.model_effect]).outcome is Outcome.NONE


def test_a_flash_is_reported_with_its_time_and_height() -> None:
    found = diagnose_intensity(series(9, lambda grey, time_s: grey + 20.0 * ((time_s >= 460.0) & (time_s < 460.35))))
    assert names(found) == ["charging_jump"]
    parameters = values_and_sigmas(found, "charging_jump")
    assert parameters["flash_at_s"][0] == pytest.approx(460.2, abs=0.2)
    assert parameters["flash_levels"][0] == pytest.approx(20.0, abs=4.0 * parameters["flash_levels"][1])


def test_a_flash_in_all_blocks_is_reported() -> None:
    found = diagnose_intensity(series(9, lambda grey, time_s: grey + 20.0 * ((time_s >= 450.6) & (time_s < 450.95))))
    assert (found.outcome, names(found)) == (Outcome.IDENTIFIED, ["charging_jump"])
    assert values_and_sigmas(found, "charging_jump")["flash_at_s"][0] == pytest.approx(450.8, abs=0.2)


def test_rows_that_jump_are_no_flash() -> None:
    def slip(grey: Image, time_s: Image) -> Image:
        return np.where(time_s >= 470.0, shifted(grey, 2.0, 3.0), grey)

    assert names(diagnose_intensity(series(9, slip))) == []


def test_few_percent_of_clipped_pixels_do_no_harm() -> None:
    def bright(grey: Image, time_s: Image) -> Image:
        return np.where(grey > 196.0, 300.0, grey) * (1.0 - 5e-5 * time_s)

    found = diagnose_intensity(series(10, bright))
    assert names(found) == ["contamination"]
    assert 0.01 < found.clipped < 0.2
    value, sigma = values_and_sigmas(found, "contamination")["loss_per_s"]
    assert value == pytest.approx(5e-5, abs=5.0 * sigma)


def test_a_weak_change_that_two_laws_would_do_for_is_ambiguous() -> None:
    """Seen in few frames, with as much of a curve as of a loss."""
    outcomes = []
    for size in (0.012, 0.014, 0.016, 0.018, 0.02, 0.022, 0.024):

        def partly(grey: Image, time_s: Image, size: float = size) -> Image:
            return grey * (1.0 - size * np.clip((time_s - 200.0) / 500.0, 0.0, 1.0))

        outcomes.append(diagnose_intensity(series(11, partly)))
    assert all(set(names(item)) <= {"contamination", "gamma_change"} for item in outcomes)
    for item in outcomes:
        assert (item.outcome is Outcome.AMBIGUOUS) == bool(item.ambiguous)


def test_few_pairs_are_reported() -> None:
    with pytest.raises(IllPosed, match="fewer than 4 pairs"):
        diagnose_intensity(series(1, pairs=3))


def test_laws_next_to_each_other_share_nothing_that_one_explains() -> None:
    courses = intensity_time_series(series(3, lambda grey, time_s: grey * (1.0 - 5e-5 * time_s)))
    alone = IntensityRegression(courses).all_fits()
    best = max(alone, key=lambda item: item.odds)
    assert best.model.name == "contamination"
    assert max(item.odds for item in IntensityRegression(courses, (best.model,)).all_fits()) < 7.0


def of_maps(outcome: Outcome, *effects: IdentifiedEffect) -> Diagnosis:
    return Diagnosis(outcome, effects, (), None, None, None, (), 0.01)


def effect(name: str, *parameters: tuple[str, float, float]) -> IdentifiedEffect:
    stated = tuple(ParameterEstimate(key, value, sigma, "s") for key, value, sigma in parameters)
    return IdentifiedEffect(name, stated, 0.5, 50.0, 0.003, False, ModelEffect(name, (), 0.1))


@pytest.fixture(scope="module")
def without_effect() -> IntensityDiagnosis:
    return of_noise(1)


FLASH = effect("charging_jump", ("flash_levels", 20.0, 1.0), ("flash_at_s", 903.0, 0.2))


def test_a_flash_makes_a_jump_a_charges(without_effect: IntensityDiagnosis) -> None:
    flashing = replace(without_effect, outcome=Outcome.IDENTIFIED, effects=(FLASH,))
    jump = effect("drift_jump", ("x_px", 0.5, 0.01), ("at_s", 900.0, 4.0))

    found = add_intensity_verdict(of_maps(Outcome.IDENTIFIED, jump), flashing)
    assert (found.outcome, found.group) == (Outcome.IDENTIFIED, "G9")
    (only,) = found.effects
    assert (only.name, only.model_effect, only.peak_px) == ("charging_jump", jump.model_effect, jump.peak_px)
    assert {"x_px", "at_s", "flash_at_s"} <= {item.name for item in only.parameters}

    elsewhen = add_intensity_verdict(of_maps(Outcome.IDENTIFIED, effect("drift_jump", ("at_s", 300.0, 4.0))), flashing)
    assert [item.name for item in elsewhen.effects] == ["drift_jump", "charging_jump"]


def test_a_flash_decides_between_jumps(without_effect: IntensityDiagnosis) -> None:
    jump = effect("drift_jump", ("at_s", 900.0, 4.0))
    maps = replace(of_maps(Outcome.AMBIGUOUS, jump), ambiguous=("drift_jump", "jump_within_pair"))
    found = add_intensity_verdict(maps, replace(without_effect, outcome=Outcome.IDENTIFIED, effects=(FLASH,)))
    assert (found.outcome, found.ambiguous, found.experiment) == (Outcome.IDENTIFIED, (), None)


@pytest.mark.parametrize(
    ("outcome", "name", "joint"),
    [
        (Outcome.IDENTIFIED, "charging_frame_ramp", Outcome.IDENTIFIED),
        (Outcome.IDENTIFIED, "charging_local_lens", Outcome.IDENTIFIED),
        (Outcome.IDENTIFIED, "magnification_drift", Outcome.UNKNOWN),
        (Outcome.REJECTED, "magnification_drift", Outcome.REJECTED),
    ],
)
def test_unexplained_intensity_is_attributed_only_to_a_charge(
    without_effect: IntensityDiagnosis, outcome: Outcome, name: str, joint: Outcome
) -> None:
    strange = replace(without_effect, outcome=Outcome.UNKNOWN, unexplained="frames differ by 2 grey levels")
    found = add_intensity_verdict(of_maps(outcome, effect(name)), strange)
    assert found.outcome is joint
    assert found.images.grey is strange


def test_two_equally_likely_effects_come_with_an_experiment(without_effect: IntensityDiagnosis) -> None:
    either = replace(
        without_effect, outcome=Outcome.AMBIGUOUS, effects=(effect("contamination"),), ambiguous=("contamination", "gamma_change")
    )
    found = add_intensity_verdict(of_maps(Outcome.NONE), either)
    assert (found.outcome, found.group, found.ambiguous) == (Outcome.AMBIGUOUS, "G12", ("contamination", "gamma_change"))
    assert found.experiment is not None
    assert "fresh field" in found.experiment.about
