"""Maps over the SEM image: extent, colour range, scale bar, and the bound of their size."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from semlive.data.grid import Grid
from semlive.report.maps import (
    MAX_IMAGE_PX,
    MAX_PANEL_PX,
    ImageScale,
    background_of,
    colour_range,
    draw_map,
    masked,
    round_length,
    scale_bar,
)


@pytest.mark.parametrize(("most", "length"), [(280.0, 200.0), (499.0, 200.0), (500.0, 500.0), (0.019, 0.01), (1.0, 1.0)])
def test_a_scale_bar_has_a_round_length(most: float, length: float) -> None:
    assert round_length(most) == pytest.approx(length)


def test_a_scale_bar_states_its_length_in_micrometres() -> None:
    axes = Figure().subplots()
    axes.set(xlim=(0, 1280), ylim=(1105, 0))
    scale_bar(axes, ImageScale(1.25))
    assert [text.get_text() for text in axes.texts] == ["200 µm"]
    (bar,) = axes.patches
    assert isinstance(bar, Rectangle)
    assert bar.get_width() == pytest.approx(200.0)


def test_a_range_on_both_sides_of_zero_is_symmetric_and_another_is_not() -> None:
    both, positive = np.linspace(-0.9, 2.1, 1001), np.linspace(2.0, 3.1, 1001)
    assert (colour_range([both]).low, colour_range([both]).colours) == (-colour_range([both]).high, "RdBu_r")
    found = colour_range([positive])
    assert not found.diverging
    assert 1.5 <= found.low <= 2.02
    assert 3.08 <= found.high <= 3.6


def test_maps_of_a_quantity_have_one_range_without_outliers() -> None:
    values = np.r_[np.linspace(0.0, 1.0, 1000), 500.0]
    found = colour_range([values, values + 3.0])
    assert found.low <= 0.01
    assert 3.9 <= found.high < 6.0
    assert colour_range([np.zeros(0)]).high == 1.0


def test_a_map_covers_the_squares_of_its_points_in_micrometres_with_y_down() -> None:
    axes, grid = Figure().subplots(), Grid(100, 50, 10, 5, 4, 21)
    shown = draw_map(axes, grid, np.zeros(grid.shape), np.ones(grid.shape, bool), colour_range([np.zeros(1)]), ImageScale(2.0))
    assert list(shown.get_extent()) == [190.0, 290.0, 170.0, 90.0]


def test_over_an_image_the_axes_have_a_margin_within_the_image() -> None:
    axes, grid = Figure().subplots(), Grid(100, 50, 10, 5, 4, 21)
    under = background_of(np.zeros((300, 400), np.uint8))
    draw_map(axes, grid, np.zeros(grid.shape), np.ones(grid.shape, bool), colour_range([np.zeros(1)]), ImageScale(0.5), under)
    assert (axes.get_xlim(), axes.get_ylim()) == ((45.0, 75.0), (45.0, 20.0))


def test_images_and_fields_of_any_size_are_bounded() -> None:
    image = np.arange(2100 * 3000, dtype=np.uint16).reshape(2100, 3000) % 251
    under = background_of(image.astype(np.uint8))
    assert max(under.grey.shape) <= MAX_IMAGE_PX
    assert under.grey[0, 0] == pytest.approx(image[:3, :3].mean())
    assert (under.width_px, under.height_px) == (3000, 2100)
    assert max(masked(np.zeros((900, 1300)), np.ones((900, 1300), bool)).shape) <= MAX_PANEL_PX


def test_without_a_pixel_size_lengths_are_pixels() -> None:
    assert (ImageScale().unit, ImageScale().factor, ImageScale(1.25).unit) == ("px", 1.0, "µm")
