"""Smaller SVG files: the same pixels, and each image stored once."""

from __future__ import annotations

import base64
import io
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from semlive.report.style import figure_bytes
from semlive.report.svg_images import compact_svg, palette_png


def png(pixels: np.ndarray) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format="png")
    return stream.getvalue()


def rgba(data: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGBA"))


@pytest.mark.parametrize("opacities", [1, 3])
def test_few_colours_become_a_palette_with_the_same_pixels(opacities: int) -> None:
    rng = np.random.default_rng(1)
    table = np.column_stack([rng.integers(0, 256, (80, 3)), 255 - 85 * rng.integers(0, opacities, 80)]).astype(np.uint8)
    pixels = table[rng.integers(0, 80, (60, 50))]
    small = palette_png(png(pixels))
    assert np.array_equal(rgba(small), pixels)
    assert len(small) < 0.5 * len(png(pixels))


def test_many_colours_stay_as_they_are() -> None:
    data = png(np.random.default_rng(1).integers(0, 256, (60, 50, 4), dtype=np.uint8))
    assert palette_png(data) == data


def test_an_image_that_is_drawn_twice_is_stored_once_and_keeps_both_places() -> None:
    data = base64.b64encode(png(np.zeros((4, 5), dtype=np.uint8))).decode()
    drawn = f'<image xlink:href="data:image/png;base64,{data}" id="i%d" transform="translate(0,%d)" width="5" height="4"/>'
    svg = compact_svg("<svg>" + drawn % (1, 10) + drawn % (2, 70) + "</svg>")
    assert svg.count("<image ") == 1
    assert re.findall(r'<use xlink:href="#shared0"[^>]*transform="([^"]*)"', svg) == ["translate(0,10)", "translate(0,70)"]
    assert re.findall(r'<image id="shared0" width="5" height="4"', svg)


def test_an_image_of_another_size_is_another_image() -> None:
    data = base64.b64encode(png(np.zeros((4, 5), dtype=np.uint8))).decode()
    drawn = f'<image xlink:href="data:image/png;base64,{data}" width="%d" height="4"/>'
    assert compact_svg("<svg>" + drawn % 5 + drawn % 6 + "</svg>").count("<image ") == 2


def test_a_figure_is_still_well_formed() -> None:
    figure, values = Figure(figsize=(4.0, 2.0)), np.random.default_rng(1).normal(size=(40, 50))
    for axes in figure.subplots(1, 2):
        axes.imshow(values, cmap="gray", interpolation="none")
        axes.imshow(values[:20], cmap="cividis", alpha=0.85, interpolation="none")
    drawing = ElementTree.fromstring(figure_bytes(figure, "svg"))
    assert len(list(drawing.iter("{http://www.w3.org/2000/svg}use"))) >= 4


def test_a_drawing_without_images_is_not_changed() -> None:
    assert compact_svg('<svg><path d="M 0 0"/></svg>') == '<svg><path d="M 0 0"/></svg>'
