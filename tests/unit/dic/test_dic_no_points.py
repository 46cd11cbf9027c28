"""Cause of a map without points, measured on pairs whose cause is known."""

import re

import cv2
import numpy as np
import pytest

from semlive import dic
from semlive.dic.image_quality.frame_comparison import compare_frames
from semlive.dic.image_quality.grey_scale import GreyScale, grey_scale
from semlive.dic.image_quality.no_points import NoPointsCause, explain_no_points, has_few_points
from semlive.errors import BadInput

HEIGHT, WIDTH = 220, 280
MARGIN = 110  # of the pattern around the frame
SETTINGS = dic.DicSettings(step_px=20, roi_px=None, method="subset")


def pattern(seed=0, spot_px=2.2):
    """Random pattern with a standard deviation of 38 about zero, larger than the frame."""
    white = np.random.default_rng(seed).standard_normal((HEIGHT + 2 * MARGIN, WIDTH + 2 * MARGIN))
    grey = cv2.GaussianBlur(white, (0, 0), spot_px)
    return 38.0 * grey / grey.std()


def frame(grey, x=0, y=0, noise=2.0, seed=9):
    """Frame of a pattern, its content moved by (-x, -y), 8 bit."""
    part = grey[MARGIN + y : MARGIN + y + HEIGHT, MARGIN + x : MARGIN + x + WIDTH]
    return np.clip(np.round(128 + part + noise * np.random.default_rng(seed).standard_normal(part.shape)), 0, 255).astype(np.uint8)


def warped(degrees, scale):
    """The pattern turned counterclockwise and magnified about the centre of the frame."""
    centre = (MARGIN + WIDTH / 2 - 0.5, MARGIN + HEIGHT / 2 - 0.5)
    grey = pattern()
    return cv2.warpAffine(grey, cv2.getRotationMatrix2D(centre, degrees, scale), grey.shape[::-1], flags=cv2.INTER_CUBIC)


REFERENCE = frame(pattern(), seed=1)
SAME = frame(pattern())
QUARTER = np.pad(np.rot90(SAME), ((0, 0), (30, 30)), mode="reflect")[30:-30]

CASES = {
    "constant": (np.full_like(SAME, 77), NoPointsCause.CURRENT_CONSTANT, "grey level 77"),
    "saturated": (
        np.where(np.random.default_rng(1).random(SAME.shape) < 0.02, SAME, 255),
        NoPointsCause.CURRENT_CONSTANT,
        "grey level 255",
    ),
    "negative": (255 - SAME, NoPointsCause.NEGATIVE, "bright and dark are exchanged"),
    "left-right": (SAME[:, ::-1], NoPointsCause.MIRRORED, "left and right are exchanged"),
    "top-bottom": (SAME[::-1], NoPointsCause.MIRRORED, "top and bottom are exchanged"),
    "negative left-right": (255 - SAME[:, ::-1], NoPointsCause.MIRRORED, "and it is negative"),
    "turned by 180": (SAME[::-1, ::-1], NoPointsCause.TURNED, "turned by 180 degrees"),
    "turned by 90": (QUARTER, NoPointsCause.TURNED, "turned by 90 degrees counterclockwise"),
    "rotated": (frame(warped(20.0, 1.0)), NoPointsCause.ROTATED, "turned by 20 degrees counterclockwise"),
    "rotated clockwise": (frame(warped(-100.0, 1.0)), NoPointsCause.ROTATED, "turned by 100 degrees clockwise"),
    "magnified": (frame(warped(0.0, 1.5)), NoPointsCause.MAGNIFIED, r"are about 1\.(4[7-9]|5[0-3]) times"),
    "reduced and rotated": (frame(warped(25.0, 0.8)), NoPointsCause.MAGNIFIED, "and turned by 25 degrees"),
    "moved too far": (
        frame(pattern(), x=-110, y=110),
        NoPointsCause.OUT_OF_RANGE,
        r"moved by about \(\+110, -110\) px, so that the frames share 30 %",
    ),
    "another detector": (frame(np.abs(pattern()) * 2.0 - 60.0), NoPointsCause.OTHER_DETECTOR, "edges of both frames agree"),
    "noise": (frame(pattern(), noise=75.0), NoPointsCause.NOISE, "both frames show the same place, but noise limits"),
    "noise alone": (frame(0.0 * pattern(), noise=20.0), NoPointsCause.NOISE, "noise hides the pattern"),
    "another place": (frame(pattern(seed=5)), NoPointsCause.UNRELATED, "no common pattern"),
}


@pytest.mark.parametrize("name", CASES)
def test_cause_is_measured_on_the_frames(name):
    current, cause, text = CASES[name]
    current = np.ascontiguousarray(current, dtype=np.uint8)
    disparity = dic.match(REFERENCE, current, settings=SETTINGS)
    assert has_few_points(disparity)
    reason = explain_no_points(REFERENCE, current, disparity, SETTINGS)
    assert reason.cause is cause, reason
    assert re.search(text, reason.text), reason
    assert str(reason) == f"{reason.text}: {reason.remedy}"


def test_cause_in_the_reference_or_the_settings():
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    dots = np.round(128 + 40 * np.sin(0.5 * x) + 40 * np.sin(0.5 * y)).astype(np.uint8)
    for reference, settings, cause, text in (
        (np.full_like(SAME, 90), SETTINGS, NoPointsCause.REFERENCE_CONSTANT, "reference frame has no pattern"),
        (frame(0.03 * pattern()), SETTINGS, NoPointsCause.THIN_TEXTURE, "100 % of the points of the reference have too little contrast"),
        (dots, SETTINGS, NoPointsCause.PERIODIC, "repeats"),
        (
            frame(pattern(), x=40),
            dic.DicSettings(step_px=20, roi_px=None, search_px=10.0, method="subset"),
            NoPointsCause.OUT_OF_RANGE,
            "search range of 10",
        ),
    ):
        disparity = dic.match(reference, SAME, settings=settings)
        assert not disparity.valid.any()
        reason = explain_no_points(reference, SAME, disparity, settings)
        assert reason.cause is cause, reason
        assert text in reason.text


def test_what_the_mask_hides_is_no_evidence():
    mask = np.zeros(SAME.shape, dtype=bool)
    disparity = dic.match(REFERENCE, SAME, settings=SETTINGS, mask=mask)
    assert explain_no_points(REFERENCE, SAME, disparity, SETTINGS, mask=mask).cause is NoPointsCause.MASKED
    mask[:, WIDTH // 3 :] = True
    blank = np.where(mask, 90, REFERENCE).astype(np.uint8)  # a pattern outside the specimen only
    disparity = dic.match(blank, SAME, settings=SETTINGS, mask=mask)
    assert explain_no_points(blank, SAME, disparity, SETTINGS, mask=mask).cause is NoPointsCause.REFERENCE_CONSTANT


def test_sizes_must_agree():
    disparity = dic.match(REFERENCE, SAME, settings=SETTINGS)
    assert not has_few_points(disparity)
    with pytest.raises(BadInput, match="give frames of one size"):
        explain_no_points(REFERENCE, SAME[1:], disparity, SETTINGS)


@pytest.mark.parametrize("spot_px", [1.5, 4.0, 9.0])
def test_unrelated_frames_do_not_agree(spot_px):
    for seed in range(4):
        found = compare_frames(frame(pattern(2 * seed, spot_px), seed=1), frame(pattern(2 * seed + 1, spot_px)))
        assert not found.significant, found


def test_a_large_frame_is_compared_in_detail():
    # Binned to 512 px, a pattern of 2 px disappears.
    grey = cv2.GaussianBlur(np.random.default_rng(2).standard_normal((2400, 2600)), (0, 0), 1.0)
    image = np.clip(np.round(128 + 38 * grey / grey.std()), 0, 255).astype(np.uint8)
    found = compare_frames(image, np.ascontiguousarray(image[:, ::-1]))
    assert found.significant
    assert (found.orientation, found.negative) == ("mirrored_x", False)


@pytest.mark.parametrize(
    ("pixels", "expected"),
    [
        (np.array([0, 3, 200], np.uint8), GreyScale(1, 255)),
        (np.array([100, 101, 3000], np.uint16), GreyScale(1, 4095)),
        (np.array([100, 101, 4096], np.uint16), GreyScale(1, 8191)),
        (np.array([16, 32, 65520], np.uint16), GreyScale(16, 65520)),
        (np.arange(256, dtype=np.uint16) * 257, GreyScale(257, 65535)),
        (np.arange(20, 90, dtype=np.uint16) * 256, GreyScale(256, 65280)),
        (np.array([5, 6, 40], np.uint16), GreyScale(1, 255)),
        (np.array([7, 7], np.uint16), GreyScale(1, 255)),
        (np.array([3, 13, 23], np.uint16), GreyScale(1, 255)),
    ],
)
def test_grey_scale_is_that_of_the_data(pixels, expected):
    assert grey_scale(pixels) == expected


def test_contrast_and_saturation_are_judged_against_the_scale_of_the_data():
    grey, noise = pattern()[:HEIGHT, :WIDTH] / 38.0, np.random.default_rng(4).standard_normal((HEIGHT, WIDTH))
    good = np.clip(np.round(2048 + 600 * grey + 32 * noise), 0, 4095).astype(np.uint16)
    q = dic.quality(good, settings=SETTINGS)
    assert q.warnings == ()
    assert q.contrast_grey == pytest.approx(600.0, rel=0.05)
    clipped = np.clip(np.round(3500 + 600 * grey + 32 * noise), 0, 4095).astype(np.uint16)
    q = dic.quality(clipped, settings=SETTINGS)
    assert q.saturated_fraction == pytest.approx(float(np.mean(clipped == 4095)))
    assert any("of the pixels are saturated" in text for text in q.warnings)
    faint = np.clip(np.round(2500 + 100 * grey + 2 * noise), 0, 4095).astype(np.uint16)
    assert any("at least 161 are needed" in text for text in dic.quality(faint, settings=SETTINGS).warnings)


@pytest.mark.parametrize(("current", "u_px", "v_px"), [("moved too far", 110, -110), ("noise", 0, 0)])
def test_the_method_auto_measures_where_subsets_find_no_point(current, u_px, v_px):
    disparity = dic.match(REFERENCE, np.ascontiguousarray(CASES[current][0]), settings=dic.DicSettings(step_px=20, roi_px=None))
    valid = disparity.valid
    assert disparity.method == "global"
    assert valid.mean() > 0.2
    assert np.abs(disparity.u_px[valid] - u_px).max() < 0.5
    assert np.abs(disparity.v_px[valid] - v_px).max() < 0.5
