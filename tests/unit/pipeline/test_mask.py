"""Masks in the path from images to maps: they follow the specimen, and results are equal however frames are prepared."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from semlive import pipeline
from semlive.data.disparity import DisparityMap, PoiStatus
from semlive.data.experiment import Phase, Step
from semlive.data.frame import Frame, FrameInfo
from semlive.data.pair import Pair, PairDecision
from semlive.data.scan import Provenance, ScanTiming, Sourced
from semlive.data.settings import AnalysisSettings, DicSettings
from semlive.errors import BadInput
from semlive.inputs.mask_file import embedded_mask

WIDTH, HEIGHT, MARGIN = 200, 160, 40
HOLE = np.s_[60:100, 70:130]
SHIFTS = ((0, 0), (10, -10))


def mask_text(width: int = WIDTH, height: int = HEIGHT) -> str:
    image = np.full((height, width), 255, dtype=np.uint8)
    image[HOLE] = 0
    return embedded_mask(cv2.imencode(".png", image)[1].tobytes(), "mask.png")


SETTINGS = AnalysisSettings(dic=DicSettings(subset_px=21, step_px=10, roi_px=(30, 30, 170, 130), method="subset"))
MASKED = replace(SETTINGS, dic=replace(SETTINGS.dic, mask=mask_text()))


def frame(number: int, shift: tuple[int, int], seed: int) -> Frame:
    """A specimen with a hole at the place of the mask, shifted by integer pixels; the hole contains other noise in every frame."""
    specimen = gaussian_filter(np.random.default_rng(5).normal(size=(HEIGHT + 2 * MARGIN, WIDTH + 2 * MARGIN)), 2.0)
    noise = np.random.default_rng(seed).normal(size=(HEIGHT, WIDTH))
    grey = 128.0 + 200.0 * specimen
    grey[MARGIN + HOLE[0].start : MARGIN + HOLE[0].stop, MARGIN + HOLE[1].start : MARGIN + HOLE[1].stop] = 128.0 + 40.0 * noise[HOLE]
    dx, dy = shift
    image = grey[MARGIN - dy : MARGIN - dy + HEIGHT, MARGIN - dx : MARGIN - dx + WIDTH] + noise
    file = Provenance.FILE
    timing = ScanTiming(Sourced(1e-4, file), Sourced(0.1, file), Sourced(16.0, file), Sourced(1, file))
    info = FrameInfo(
        number, f"{number}.tif", "fei", WIDTH, HEIGHT, 0, timing, Sourced(20 * 10**9 * number, file), 0.01, Sourced(1e-6, file)
    )
    return Frame(info, np.clip(image, 0, 255).astype(np.uint8))


def pairs(seed: int = 0) -> list[Pair]:
    made = []
    for number, shift in enumerate(SHIFTS):
        first, second = (frame(2 * number + member, shift, 100 * seed + 2 * number + member) for member in (0, 1))
        step = Step(number, Phase.CALIBRATION, shift, shift, None)
        made.append(Pair(PairDecision(number, step, first.info, second.info, None), first, second))
    return made


def maps(settings: AnalysisSettings, made: list[Pair], *, prepared: bool = False) -> list[DisparityMap]:
    """The maps of two pairs; `prepared`: frames are correlated as they arrive."""
    state = pipeline.start(settings, made[0].first)
    found = list(pipeline.correlate(state, made[0]))
    state = pipeline.accumulate(state, made[0].decision, tuple(found))
    ready = {}
    if prepared:
        ready = {
            item.info.export: pipeline.precorrelate(state, item, first=item is made[1].first) for item in (made[1].first, made[1].second)
        }
    return [*found, *pipeline.correlate(state, made[1], ready)]


def status(disparity: DisparityMap) -> NDArray[np.bool_]:
    return disparity.status == PoiStatus.MASKED


@pytest.fixture(scope="module")
def measured() -> list[DisparityMap]:
    return maps(MASKED, pairs())


def test_points_in_the_hole_are_masked_and_all_others_are_measured(measured: list[DisparityMap]) -> None:
    for disparity in measured:
        assert status(disparity).any()
        assert (disparity.valid | status(disparity)).all()


def test_within_a_later_pair_the_mask_is_where_the_specimen_is(measured: list[DisparityMap]) -> None:
    first, within = status(measured[0]), status(next(disparity for disparity in measured if disparity.reference == 2))
    # The second pair is one step to the right and one step up, so its masked points are, too.
    assert np.array_equal(within[:-1, 1:], first[1:, :-1])


def test_maps_do_not_depend_on_when_frames_are_prepared(measured: list[DisparityMap]) -> None:
    for once, again in zip(measured, maps(MASKED, pairs(), prepared=True), strict=True):
        for name in ("u_px", "v_px", "sigma_u_px", "sigma_v_px", "zncc", "status"):
            assert np.array_equal(getattr(once, name), getattr(again, name), equal_nan=True), name


def test_a_mask_that_excludes_nothing_changes_no_bit() -> None:
    clear = embedded_mask(cv2.imencode(".png", np.full((HEIGHT, WIDTH), 255, dtype=np.uint8))[1].tobytes(), "clear.png")
    settings = replace(SETTINGS, dic=replace(SETTINGS.dic, mask=clear))
    for once, again in zip(maps(SETTINGS, pairs()), maps(settings, pairs()), strict=True):
        assert np.array_equal(once.u_px, again.u_px, equal_nan=True)
        assert np.array_equal(once.status, again.status)


def test_a_mask_of_another_size_is_refused_with_both_sizes() -> None:
    settings = replace(SETTINGS, dic=replace(SETTINGS.dic, mask=mask_text(240, 180)))
    with pytest.raises(BadInput, match="the mask is 240 x 180 px but the frame 200 x 160 px"):
        pipeline.start(settings, frame(0, (0, 0), 1))
