"""The recommended method, subset and step: row structure, the rule, and the predicted noise against repeated exposures."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from bench_recommendation import repeats
from rasters.scenes import DISTURBANCES, render

from semlive import dic
from semlive.data.settings import DicSettings
from semlive.dic.image_quality.row_structure import row_structure
from semlive.errors import BadInput


def frame(disturbance, texture="speckle", **changes):
    return render(texture, replace(DISTURBANCES[disturbance], **changes), disturbance, 3)


@pytest.mark.parametrize("jitter_px", [0.3, 1.0])
def test_row_shifts_are_estimated_from_one_frame(jitter_px):
    found = row_structure(frame("rows shifted 0.7 px", jitter_px=jitter_px).first)
    assert found.shift_px == pytest.approx(jitter_px, rel=0.3)
    assert found.offset_grey < 2.0


def test_row_offsets_are_estimated_from_one_frame():
    s = frame("row brightness", gain_sd=0.0, tilt_grey=0.0)
    white = np.std(np.diff(s.optics[0].brightness.offset_grey, n=2)) / np.sqrt(6.0)
    assert row_structure(s.first).offset_grey == pytest.approx(white, rel=0.15)


def test_a_pattern_without_row_structure_has_none(lab, scene):
    found = row_structure(lab.expose(scene(), 3.0, 1))
    assert found.shift_px < 0.05
    assert found.offset_grey < 0.5
    assert row_structure(np.full((60, 80), 90, np.uint8)) == row_structure(np.zeros((5, 80), np.uint8))


@pytest.mark.parametrize(
    ("texture", "disturbance", "changes", "method", "reason"),
    [
        ("speckle", "none", {}, "subset", r"a subset of 21 px contains"),
        ("speckle", "weak contrast", {}, "subset", r"a subset of 31 px contains"),
        ("speckle", "weak contrast", {"contrast": 0.1}, "global", r"the largest of acceptable resolution"),
        ("speckle", "row brightness", {}, "global", r"the grey offset of a row is \d\.\d grey levels at a contrast of 3\d"),
        ("speckle", "rows shifted 0.7 px", {}, "global", r"rows are shifted by 0\.\d\d px, which adds"),
        ("deflection", "weak contrast", {}, "global", r"has sufficient contrast at \d+ % of the points"),
    ],
)
def test_the_rule_with_its_figures(texture, disturbance, changes, method, reason):
    choice = dic.recommend(frame(disturbance, texture, **changes).first)
    assert choice.method == method
    assert re.search(reason, choice.reason), choice.reason
    assert choice.step_px == max(choice.subset_px // 8, 1)


def test_predicted_noise_of_displacement_and_strain_is_that_of_repeats():
    found = repeats(frame("weak contrast"), 8)
    assert found.recommended.choice.method == "subset"
    assert found.measured > 0.9
    assert np.array(found.predicted) / found.observed == pytest.approx(np.ones(5), abs=0.15)


def test_a_large_smooth_structure_is_too_thin_and_an_empty_frame_has_no_noise():
    x, y = np.meshgrid(np.arange(256.0), np.arange(240.0))
    noise = np.random.default_rng(2).normal(0.0, 30.0, x.shape)
    smooth = np.round(32768.0 + 20000.0 * np.sin(x / 20.0) * np.sin(y / 23.0 + x / 90.0) + noise).astype(np.uint16)
    choice = dic.recommend(smooth)
    assert choice.method == "global"
    assert "structures of" in choice.reason
    empty = dic.recommend(np.full((200, 200), 90, np.uint8))
    assert (empty.method, empty.sigma_u_px, empty.sigma_v_px) == ("global", 0.0, 0.0)


def test_the_region_of_interest_is_evaluated(lab, scene):
    image = lab.expose(scene(), 3.0, 1)
    half = np.where(np.arange(300) < 150, 128, image).astype(np.uint8)
    assert dic.recommend(half).method == "global"
    assert dic.recommend(half, DicSettings(roi_px=(180, 40, 270, 220))).method == "subset"
    with pytest.raises(BadInput, match="two-dimensional array of uint8 or uint16"):
        dic.recommend(np.zeros((60, 60)))
