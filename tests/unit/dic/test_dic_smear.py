"""Frames smeared unequally by drift: separated from motion, equalised, with the correct noise of the result."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from semlive import dic
from semlive.data.settings import DicSettings
from semlive.dic.integration_blur import IntegrationBlur, blur_within_pair, blurred, correlate_with_matched_blur, missing_blur

SCANS = 8
FAST, SLOW = (0.52, 0.61), (0.05, 0.06)  # px from scan to scan
SETTINGS = DicSettings(step_px=8, roi_px=(32, 32, 228, 188))


def integrated(lab, step_px, shift_px=(0.0, 0.0)):
    """A frame made of scans on a line about a place, evaluated analytically."""
    speckle = lab.Speckle(260, 220, spot_px=3.0)
    at = np.arange(SCANS) - 0.5 * (SCANS - 1)
    return np.mean([speckle.render(lab.Affine(u=shift_px[0] + k * step_px[0], v=shift_px[1] + k * step_px[1])) for k in at], axis=0)


@pytest.fixture(scope="module")
def frames(lab):
    return integrated(lab, FAST), integrated(lab, SLOW, (3.3, -2.7))


def found(lab, frames, noise_grey, smear, seed=0):
    first, second = (lab.expose(item, noise_grey, 2 * seed + number) for number, item in enumerate(frames))
    grid = dic.grid_for(SETTINGS, first.shape[1], first.shape[0])
    reference = dic.prepare(first, grid, SETTINGS)
    return correlate_with_matched_blur(reference, second, SETTINGS, smear, reference_frame=0, current_frame=2)


def test_smearing_the_sharper_frame_makes_both_equal(lab, frames):
    smear = missing_blur(IntegrationBlur(*FAST, SCANS), IntegrationBlur(*SLOW, SCANS))
    assert smear is not None
    assert (smear.step_x_px / smear.step_y_px) == pytest.approx(FAST[0] / FAST[1], rel=0.02)
    as_they_are, equalised = (found(lab, frames, 0.0, item) for item in (None, smear))
    assert as_they_are.valid.all()
    assert equalised.valid.all()
    before, after = (np.std(item.u_px - 3.3) for item in (as_they_are, equalised))
    assert before > 0.012
    assert after < 0.25 * before
    assert abs(np.mean(equalised.u_px) - 3.3) < 2e-3
    assert abs(np.mean(equalised.v_px) + 2.7) < 2e-3


def test_sigma_is_still_what_is_found(lab, frames):
    smear = missing_blur(IntegrationBlur(*FAST, SCANS), IntegrationBlur(*SLOW, SCANS))
    drawn = [found(lab, frames, 7.0, smear, seed) for seed in range(10)]
    for name in ("u_px", "v_px"):
        values = np.array([getattr(item, name) for item in drawn])
        noise = np.sqrt(np.mean(np.var(values, axis=0, ddof=1)))
        stated = np.sqrt(np.mean([getattr(item, f"sigma_{name}") ** 2 for item in drawn]))
        assert stated / noise == pytest.approx(1.0, abs=0.1)


def test_a_frame_that_is_smeared_as_much_or_more_stays_as_it_is(lab, frames):
    fast, slow = IntegrationBlur(*FAST, SCANS), IntegrationBlur(*SLOW, SCANS)
    assert missing_blur(slow, fast) is None
    assert missing_blur(fast, fast) is None
    assert missing_blur(None, fast) is None
    assert missing_blur(IntegrationBlur(*FAST, 1), IntegrationBlur(0.0, 0.0, 1)) is None
    same = found(lab, frames, 2.0, None)
    again = dic.match(*(lab.expose(item, 2.0, number) for number, item in enumerate(frames)), same.grid, SETTINGS)
    assert np.array_equal(same.u_px, again.u_px)


def test_smear_is_read_from_the_pair(lab, frames):
    dmap = found(lab, frames, 2.0, None)
    smear = blur_within_pair(dmap, 40.0, 5.0, SCANS)
    assert smear is not None
    assert smear.step_x_px == pytest.approx(3.3 / 40.0 * 5.0, rel=0.01)
    assert smear.step_y_px == pytest.approx(-2.7 / 40.0 * 5.0, rel=0.01)
    assert blur_within_pair(dmap, 0.0, 5.0, SCANS) is None
    lost = dataclasses.replace(dmap, status=np.full(dmap.grid.shape, dic.PoiStatus.NO_SEED, dtype=np.uint8))
    assert blur_within_pair(lost, 40.0, 5.0, SCANS) is None


def test_a_smeared_wave_is_the_mean_over_the_scans():
    y, x = np.mgrid[:64, :96]
    at = np.arange(SCANS) - 0.5 * (SCANS - 1)
    waves = [np.cos(2 * np.pi * (6 * (x - k * FAST[0]) / 96 + 5 * (y - k * FAST[1]) / 64)) for k in at]
    image = np.rint(30000 + 20000 * np.cos(2 * np.pi * (6 * x / 96 + 5 * y / 64))).astype(np.uint16)
    assert np.allclose(
        blurred(image, IntegrationBlur(*FAST, SCANS).transfer_function(image.shape)), 30000 + 20000 * np.mean(waves, axis=0), atol=1.5
    )
    assert blurred(np.full((64, 96), 200, np.uint8), IntegrationBlur(*FAST, SCANS).transfer_function((64, 96))).max() == 200 * 256


def test_a_smear_of_integer_pixels_has_no_gap_in_its_spectrum():
    passed = IntegrationBlur(2.0, 0.0, 4).transfer_function((8, 64))
    line = np.zeros(64)
    line[[61, 63, 1, 3]] = 0.25
    assert np.allclose(passed[0], np.fft.rfft(line).real, atol=1e-9)
