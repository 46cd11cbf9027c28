"""What a frame promises, against what repeated exposures show."""

import re

import numpy as np
import pytest

from semlive import dic
from semlive.data.settings import DicSettings
from semlive.dic.image_quality.quality import quality
from semlive.errors import BadInput

SETTINGS = DicSettings(step_px=16, roi_px=(40, 40, 260, 220))


@pytest.mark.parametrize("noise", [2.0, 5.0, 10.0])
def test_predicted_noise_is_observed_noise_within_ten_percent(lab, scene, noise):
    grid = dic.grid_for(SETTINGS, 300, 260)
    motion = lab.Affine(u=0.3, v=-0.4)
    predicted, maps = [], []
    for draw in range(25):
        first, second = lab.expose(scene(), noise, 2 * draw), lab.expose(scene(motion), noise, 2 * draw + 1)
        if draw < 5:
            predicted.append(quality(first, grid, SETTINGS))
        maps.append(dic.correlate(dic.prepare(first, grid, SETTINGS), second, SETTINGS, reference_frame=0, current_frame=1))
    for name in ("u", "v"):
        observed = np.sqrt(np.mean(np.var([getattr(m, f"{name}_px") for m in maps], axis=0, ddof=1)))
        promised = np.sqrt(np.mean([getattr(q, f"sigma_{name}_px") ** 2 for q in predicted]))
        assert promised / observed == pytest.approx(1.0, abs=0.1), name
    assert np.mean([q.noise_grey for q in predicted]) == pytest.approx(np.hypot(noise, 12**-0.5), rel=0.03)
    assert predicted[0].contrast_grey == pytest.approx(np.std(scene()), rel=0.02)


@pytest.mark.parametrize("spot_px", [1.0, 2.0, 3.5])
@pytest.mark.parametrize("noise", [0.0, 8.0])
def test_speckle_is_measured_through_noise(lab, spot_px, noise):
    image = lab.expose(lab.Speckle(260, 240, spot_px=spot_px, seed=5).render(), noise, 1)
    q = quality(image)
    # Spots of standard deviation s have an autocorrelation of standard deviation sqrt(2) s.
    expected = 2.0 * np.sqrt(2.0 * np.log(2.0)) * np.sqrt(2.0) * spot_px
    assert q.speckle_x_px == pytest.approx(expected, rel=0.12)
    assert q.speckle_y_px == pytest.approx(expected, rel=0.12)
    assert q.noise_grey == pytest.approx(np.hypot(noise, 12**-0.5), rel=0.05, abs=0.7)
    assert q.speckles_per_subset == pytest.approx(43**2 / expected**2, rel=0.25)


def test_noise_that_varies_over_the_frame_is_local(lab, scene):
    grey = scene()
    noisy = grey + np.linspace(1.0, 9.0, 300) * np.random.default_rng(3).standard_normal(grey.shape)
    q = quality(np.clip(np.round(noisy), 0, 255).astype(np.uint8), settings=SETTINGS)
    assert np.mean(q.sigma_u_px[:, -1]) / np.mean(q.sigma_u_px[:, 0]) > 3.0
    assert 3.5 < q.noise_grey < 5.0  # the median pixel's: less than the mean of 1 ... 9
    floor = np.sqrt(2.0) * (1.0 + 8.0 * q.grid.x_px / 299.0) / np.sqrt(170.0 * 43**2)
    assert np.allclose(q.sigma_u_px.mean(axis=0) / floor, 1.0, atol=0.2)


def noisy(grey):
    return grey + 18.0 * np.random.default_rng(1).standard_normal(grey.shape)


def test_a_good_pattern_is_not_warned_about(lab, scene):
    q = quality(lab.expose(scene(), 3.0, 1), settings=SETTINGS)
    assert q.warnings == ()
    assert q.usable_fraction == 1.0
    assert 0.0 < q.saturated_fraction < 0.01
    gx, gy = np.gradient(scene(), axis=1), np.gradient(scene(), axis=0)
    assert q.mean_intensity_gradient_grey_px == pytest.approx(np.mean(np.hypot(gx, gy)), rel=0.08)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda grey: 128.0 + 0.2 * (grey - 128.0), r"contrast of the pattern is 7\.\d grey levels \(at least 10 are needed\): increase"),
        (lambda grey: 128.0 + 4.0 * (grey - 128.0), r"% of the pixels are saturated .* reduce the contrast of the detector"),
        (noisy, r"noise of 0\.0\d+ px .* use a subset of \d+ px, or increase the dwell time \d\.\d times"),
        (lambda grey: np.where(np.arange(300) < 150, 128.0, grey), r"\d+ % of the points have too little contrast .* mask areas"),
    ],
)
def test_a_poor_pattern_is_named_with_its_figure_and_the_remedy(lab, scene, change, words):
    q = quality(lab.expose(change(scene()), 0.0, 1), settings=SETTINGS)
    assert len(q.warnings) >= 1
    assert re.search(words, " | ".join(q.warnings)), q.warnings


def test_coarse_and_fine_speckle_are_named(lab):
    coarse = quality(lab.expose(lab.Speckle(260, 240, spot_px=6.0, seed=5).render(), 2.0), settings=DicSettings(subset_px=31, roi_px=None))
    assert any("a subset of 31 px contains" in text and "use a subset of" in text for text in coarse.warnings)
    fine = quality(lab.expose(lab.Speckle(260, 240, spot_px=0.8, seed=5).render(), 2.0))
    assert any("px wide (at least 3 px are needed): magnify more, or defocus" in text for text in fine.warnings)


def test_an_empty_frame_is_warned_about_and_no_error():
    q = quality(np.full((120, 140), 90, dtype=np.uint8))
    assert not q.usable.any()
    assert q.median_sigma_px == (0.0, 0.0)
    assert (q.speckle_x_px, q.speckles_per_subset, q.noise_grey) == (0.0, 0.0, 0.0)
    assert any("100 % of the points" in text for text in q.warnings)


def test_a_file_that_is_no_image_gives_one_error_line():
    for image in (np.zeros((60, 60)), np.zeros((60, 60, 3), dtype=np.uint8), "image.tif"):
        with pytest.raises(BadInput, match="two-dimensional array of uint8 or uint16"):
            quality(image)
    with pytest.raises(BadInput, match="no subset of 43 px fits"):
        quality(np.zeros((30, 30), dtype=np.uint8))


def test_what_the_mask_hides_does_not_count(lab, scene):
    image = lab.expose(scene(), 5.0, 3)
    spoiled = image.copy()
    mask = np.ones(image.shape, dtype=bool)
    mask[:, :90] = mask[200:, 150:] = False
    spoiled[~mask] = 255  # a grip, a blank corner
    clear, hidden, shown = (
        quality(image, settings=SETTINGS),
        quality(spoiled, settings=SETTINGS, mask=mask),
        quality(spoiled, settings=SETTINGS),
    )
    for name, rel in (("noise_grey", 0.03), ("contrast_grey", 0.05), ("mean_grey", 0.05), ("mean_intensity_gradient_grey_px", 0.05)):
        assert getattr(hidden, name) == pytest.approx(getattr(clear, name), rel=rel), name
        assert name == "noise_grey" or getattr(shown, name) != pytest.approx(getattr(clear, name), rel=2 * rel), name
    assert hidden.speckle_x_px == pytest.approx(clear.speckle_x_px, rel=0.1)
    assert hidden.speckle_y_px == pytest.approx(clear.speckle_y_px, rel=0.1)
    assert hidden.saturated_fraction == pytest.approx(clear.saturated_fraction, abs=1e-3)
    assert hidden.warnings == ()  # masked points lack no contrast
    assert any("saturated" in warning for warning in shown.warnings)
    assert not hidden.usable[:, 0].any()
    both = hidden.usable & clear.usable & (hidden.grid.mesh()[0] > 90 + 24)
    assert np.allclose((hidden.sigma_u_px / clear.sigma_u_px)[both & (hidden.grid.mesh()[1] < 170)], 1.0, atol=0.15)


def test_a_mask_of_nothing_is_refused(lab, scene):
    image = lab.expose(scene(), 5.0, 3)
    with pytest.raises(BadInput, match="the mask excludes every pixel"):
        quality(image, settings=SETTINGS, mask=np.zeros(image.shape, dtype=bool))
    with pytest.raises(BadInput, match="give a mask of its size"):
        quality(image, settings=SETTINGS, mask=np.ones((3, 3), dtype=bool))
