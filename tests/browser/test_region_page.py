"""The page of `semlive init` in a real Chromium: region and masks with the mouse and with the keyboard."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from semlive.cli.before_run.region.drawing import FrameSize, default_region
from semlive.cli.before_run.region.server import RegionServer

SIZE = FrameSize(640, 480, 43)
HALF = 21


@pytest.fixture
def server() -> Iterator[RegionServer]:
    image = np.random.default_rng(1).integers(0, 4095, (480, 640), dtype=np.uint16)
    with RegionServer(image, SIZE, default_region(SIZE)) as running:
        yield running


@pytest.fixture
def page(server: RegionServer, tab: Callable[..., Page]) -> Page:
    opened = tab()
    opened.goto(server.address)
    expect(opened.locator("#overlay .region")).to_be_visible()
    opened.wait_for_function("document.getElementById('image').complete && document.getElementById('image').naturalWidth === 640")
    return opened


def drag(page: Page, *points: tuple[float, float]) -> None:
    """Move the mouse with its button pressed over points in px of the frame."""
    box = page.locator("#overlay").bounding_box()
    assert box is not None
    places = [(box["x"] + x * box["width"] / 640, box["y"] + y * box["height"] / 480) for x, y in points]
    page.mouse.move(*places[0])
    page.mouse.down()
    for place in places[1:]:
        page.mouse.move(*place, steps=3)
    page.mouse.up()


def test_region_and_masks_are_drawn_with_the_mouse(
    server: RegionServer, page: Page, shoot: Callable[[Page, str], None], readable: Callable[[Page], None]
) -> None:
    drag(page, (500, 400), (100, 80))
    page.get_by_label("Mask: rectangle").check()
    drag(page, (200, 100), (260, 150))
    page.get_by_label("Mask: polygon").check()
    for corner in ((300, 300), (360, 300), (330, 350)):
        drag(page, corner)
    page.keyboard.press("Enter")
    expect(page.locator("#masks li")).to_have_count(2)
    shoot(page, "init-region")
    readable(page)
    page.get_by_role("button", name="Use this drawing").click()
    expect(page.locator("#message")).to_contain_text("Taken")
    drawing = server.answer(20.0)
    assert drawing is not None
    np.testing.assert_allclose(drawing.region_px, (100, 80, 500, 400), atol=1)
    rectangle, polygon = drawing.masks_px
    np.testing.assert_allclose(rectangle, ((200, 100), (260, 100), (260, 150), (200, 150)), atol=1)
    np.testing.assert_allclose(polygon, ((300, 300), (360, 300), (330, 350)), atol=1)


def test_subsets_of_a_region_stay_in_the_frame(page: Page) -> None:
    drag(page, (0, 0), (639, 479))
    assert [page.locator(f"#{name}").input_value() for name in ("x0", "y0", "x1", "y1")] == ["21", "21", "618", "458"]


def test_the_keyboard_suffices(server: RegionServer, page: Page) -> None:
    for name, value in (("x0", 50), ("y0", 60), ("x1", 300), ("y1", 200), ("mx0", 100), ("my0", 90), ("mx1", 120), ("my1", 130)):
        page.locator(f"#{name}").fill(str(value))
        page.keyboard.press("Tab")
    page.get_by_role("button", name="Add rectangle").press("Enter")
    expect(page.locator("#masks li")).to_have_count(1)
    page.get_by_role("button", name="Add rectangle").press("Enter")
    page.get_by_role("button", name="Remove mask 2").press("Enter")
    page.get_by_role("button", name="Use this drawing").press("Enter")
    drawing = server.answer(20.0)
    assert drawing is not None
    assert drawing.region_px == (50, 60, 300, 200)
    assert drawing.masks_px == (((100, 90), (120, 90), (120, 130), (100, 130)),)


def test_a_single_click_is_no_mask_and_the_region_can_stay(server: RegionServer, page: Page) -> None:
    page.get_by_label("Mask: rectangle").check()
    drag(page, (200, 100))
    expect(page.locator("#masks li")).to_have_count(0)
    page.get_by_role("button", name="Keep the region as it was").click()
    assert server.answer(20.0) is None


def test_without_the_token_the_page_shows_why_there_is_no_frame(server: RegionServer, tab: Callable[..., Page]) -> None:
    opened = tab()
    opened.goto(server.address.split("#")[0])
    expect(opened.locator("#message")).to_contain_text("token is missing or wrong")
