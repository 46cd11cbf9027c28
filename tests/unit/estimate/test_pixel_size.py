"""Pixel size from translations and distances, and the path of the stage, against truths made by hand."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from semlive.data.drift import PairMotion
from semlive.errors import IllPosed
from semlive.estimate.joint.outputs.stage_path import stage_path, stage_path_notes
from semlive.estimate.pixel_size import (
    PixelSize,
    magnification_from_distances,
    magnification_from_metadata,
    magnification_from_translations,
)

X_UM, Y_UM, SHEAR = 1.25, 1.27, 0.004
# The raster's x axis along the specimen's x; its y axis leans towards it by the shear.
RASTER = np.array([[X_UM, Y_UM * np.sin(SHEAR)], [0.0, Y_UM * np.cos(SHEAR)]])
CROSS_PX = np.array([(0, 0), (8, 0), (-16, 0), (24, 0), (-32, 0), (0, 8), (0, -16), (0, 24), (0, -32)], dtype=np.float64)


def turned(angle_deg: float) -> np.ndarray:
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return np.array([[c, -s], [s, c]])


def sigmas(found: PixelSize) -> np.ndarray:
    return np.array(
        [
            (found.x_um - X_UM) / found.x_sigma_um,
            (found.y_um - Y_UM) / found.y_sigma_um,
            (found.shear_rad - SHEAR) / found.shear_sigma_rad,
        ]
    )


@pytest.mark.parametrize("angle_deg", [0.0, 1.5, -40.0])
def test_known_translations_give_the_pixel_within_half_a_percent(angle_deg: float) -> None:
    """Positions known to 0.1 um, shifts to 0.01 px; the stage lies at an angle."""
    z = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        moved = CROSS_PX @ (turned(angle_deg) @ RASTER).T + rng.normal(0, 0.1, CROSS_PX.shape)
        found = magnification_from_translations(moved, CROSS_PX + rng.normal(0, 0.01, CROSS_PX.shape))
        assert found.x_um == pytest.approx(X_UM, rel=0.01)
        z.append(sigmas(found))
        assert abs(found.aspect - (Y_UM / X_UM - 1)) < 0.02
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 1.4
    mean = magnification_from_translations(CROSS_PX @ (turned(angle_deg) @ RASTER).T, CROSS_PX)
    assert (mean.x_um, mean.y_um, mean.shear_rad) == pytest.approx((X_UM, Y_UM, SHEAR), rel=1e-9)


def test_half_a_percent_with_the_stage_error_of_the_paper() -> None:
    """0.1 um on 80 um: the 95th percentile of the error."""
    errors = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        moved = CROSS_PX @ RASTER.T + rng.normal(0, 0.1, CROSS_PX.shape)
        found = magnification_from_translations(moved, CROSS_PX)
        errors.append(max(abs(found.x_um / X_UM - 1), abs(found.y_um / Y_UM - 1)))
    assert np.percentile(errors, 95) < 0.005


def test_nine_points_give_the_pixel_within_a_percent() -> None:
    """Distances known to 1 um of 250 to 1,000 um, all 36 of them."""
    points = np.array([(x, y) for y in (100.0, 400.0, 700.0) for x in (100.0, 500.0, 900.0)])
    pairs = np.array(list(itertools.combinations(range(9), 2)))
    between = (points[pairs[:, 0]] - points[pairs[:, 1]]) @ RASTER.T
    z = []
    for seed in range(60):
        known = np.linalg.norm(between, axis=1) + np.random.default_rng(seed).normal(0, 1.0, len(pairs))
        found = magnification_from_distances(points, pairs, known)
        assert found.x_um == pytest.approx(X_UM, rel=0.01)
        assert found.y_um == pytest.approx(Y_UM, rel=0.01)
        z.append(sigmas(found))
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 1.25


def test_translations_and_distances_on_a_line_are_refused() -> None:
    with pytest.raises(IllPosed, match="two directions"):
        magnification_from_translations(CROSS_PX[:5] * 1.25, CROSS_PX[:5])
    with pytest.raises(IllPosed, match="two directions"):
        magnification_from_distances(CROSS_PX[:5], np.array([(0, 1), (1, 2), (2, 3), (3, 4)]), np.ones(4))
    square = np.array([(0.0, 0.0), (100.0, 0.0), (0.0, 100.0), (100.0, 100.0)])
    with pytest.raises(IllPosed, match="diagonal"):
        magnification_from_distances(square, np.array([(0, 1), (0, 2), (1, 3), (2, 3)]), np.full(4, 125.0))


def test_a_stated_scale_is_as_good_as_makers_say() -> None:
    found = magnification_from_metadata(1.25)
    assert found.x_sigma_um == pytest.approx(0.0375)
    with pytest.raises(IllPosed, match="is none"):
        magnification_from_metadata(0.0)


def test_the_path_of_the_stage_tells_scale_and_angle() -> None:
    """A stage whose y axis leans by 2 degrees and whose y screw is 1 % long."""
    axes = np.array([[0.8, 0.0], [0.8 * 1.01 * np.sin(np.radians(2.0)), 0.8 * 1.01 * np.cos(np.radians(2.0))]])
    rng = np.random.default_rng(3)
    shifts = 1.25 * CROSS_PX @ axes @ turned(5.0).T + rng.normal(0, 0.05, CROSS_PX.shape)
    found = stage_path(1.25 * CROSS_PX, shifts)
    assert found.scale_y / found.scale_x == pytest.approx(1.01, abs=4 * 1.4 * found.scale_sigma)
    assert found.angle_deg == pytest.approx(88.0, abs=4 * found.angle_sigma_deg)
    assert found.rotation_deg == pytest.approx(5.0, abs=0.3)
    assert found.residual_px == pytest.approx(0.05, rel=0.5)


def test_the_path_is_told_only_where_it_can_be() -> None:
    def motion(pair: int, shift: np.ndarray) -> PairMotion:
        return PairMotion(pair, shift, np.zeros(2), np.zeros((2, 2)), np.zeros((2, 2)))

    commands = [(pair, (float(x), float(y))) for pair, (x, y) in enumerate(CROSS_PX)]
    motions = [motion(pair, 0.8 * shift) for pair, shift in enumerate(CROSS_PX)]
    (said,) = stage_path_notes(commands, motions)
    assert "0.8 px/um along the stage's x" in said.text
    assert "90.00" in said.text
    assert stage_path_notes(commands[:5], motions) == ()
    assert stage_path_notes(commands, motions[:3]) == ()
    assert stage_path_notes([(pair, (0.0, 0.0)) for pair, _ in commands], motions) == ()
