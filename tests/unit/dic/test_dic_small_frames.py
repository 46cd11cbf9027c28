"""Frames so small that every block of the first guess lies at an edge of them."""

from __future__ import annotations

from typing import Any

import pytest

from semlive import dic
from semlive.data.settings import DicSettings


@pytest.mark.parametrize(("u_px", "v_px"), [(1.0, 0.0), (0.0, 1.0), (0.4, 0.0), (-3.0, 0.0), (0.0, 0.0)])
def test_a_small_frame_that_moves_along_its_edge_is_matched(lab: Any, u_px: float, v_px: float) -> None:
    speckle = lab.Speckle(200, 160)
    first, second = (lab.expose(image, 0.0, 0) for image in (speckle.render(), speckle.render(lab.Affine(u=u_px, v=v_px))))
    found = dic.match(first, second, settings=DicSettings(subset_px=21, roi_px=None))
    assert found.valid.mean() > 0.95
    assert abs(found.u_px[found.valid].mean() - u_px) < 1e-3
    assert abs(found.v_px[found.valid].mean() - v_px) < 1e-3
